//! A patient of a phantom is what its voxels say.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;

use super::{Options, Patient, Report, Stage, build, write};
use crate::geometry::cross;
use crate::groups::Groups;
use crate::mesh::GroupMesh;
use crate::phantom::{self, Size};
use crate::surface::Method;

/// A phantom's labels in a folder of the test's own.
fn phantom(name: &str, size: [usize; 3]) -> PathBuf {
    phantom_of(7, name, size)
}

fn phantom_of(seed: u64, name: &str, size: [usize; 3]) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("trocar-build-{name}-{}", std::process::id()));
    let patient = phantom::Patient::new(seed);
    phantom::write(&patient, Size(size), &folder, |_, _| ()).expect("written");
    folder
}

#[test]
fn a_phantoms_meshes_are_closed_and_have_its_volumes() {
    let folder = phantom("measures", [110, 110, 132]);
    let groups = Groups::load("vista3d").expect("the table is right");
    for surface in [Method::Nets, Method::MarchingCubes] {
        let nets = surface == Method::Nets;
        let options = Options {
            surface,
            measure_stages: nets,
            levels: if nets { 2 } else { 0 },
            ..Options::default()
        };
        let mut stages = Vec::new();
        let patient = build(
            &folder.join("labels.nii.gz"),
            &groups,
            &options,
            &mut |stage| stages.push(stage),
        )
        .expect("built");
        assert_eq!(stages, Stage::ALL[..7]);
        assert_eq!(patient.report.groups.len(), 17, "{surface:?}");
        for group in &patient.report.groups {
            let (name, found) = (&group.name, &group.measures);
            assert!(found.watertight, "{surface:?} {name}");
            assert!(
                (found.volume_ratio - 1.0).abs() < 0.005,
                "{surface:?} {name}: {found:?}"
            );
            // Half a voxel along each axis by smoothing, half a millimetre of 4 mm voxels by
            // decimation.
            assert!(
                found.hausdorff_voxels < 1.0 && found.mean_voxels < 0.2,
                "{surface:?} {name}: {found:?}"
            );
            // Marching cubes round off ribs of one or two voxels.
            let least = if nets { 0.98 } else { 0.97 };
            assert!(found.dice > least, "{surface:?} {name}: {found:?}");
        }
        assert_eq!(patient.report.stage_distances.is_empty(), !nets);
        if nets {
            stages_are_measured(&patient.report);
        }
        assert!(patient.report.triangles * 4 < patient.report.triangles_fine);
        write(&patient, &groups, &folder).expect("written");
        levels_are_coarser(&patient, &folder);
    }
    std::fs::remove_dir_all(folder).expect("the folder can go");
}

/// Each has fewer triangles than the one before, of closed surfaces with the same volumes, and a
/// file; none that was there before stays.
fn levels_are_coarser(patient: &Patient, folder: &Path) {
    let wanted = patient.report.options.levels;
    assert_eq!(patient.levels.len(), wanted as usize);
    let file = |level: u32| folder.join(format!("patient-level-{level}.usda"));
    assert!((1..=4).all(|level| file(level).exists() == (level <= wanted)));
    let all = std::fs::read_to_string(folder.join("patient-levels.usda"));
    assert_eq!(all.is_ok(), wanted > 0);
    let Ok(all) = all else { return };
    assert!(all.contains("variantSet \"LOD\" = {") && all.contains("@./patient-level-2.usda@"));
    let count = |meshes: &[GroupMesh]| meshes.iter().map(|it| it.triangles.len()).sum::<usize>();
    let mut before = count(&patient.meshes);
    for (meshes, report) in patient.levels.iter().zip(&patient.report.levels) {
        assert_eq!(meshes.len(), patient.meshes.len());
        let now = count(meshes);
        assert!(5 * now < 4 * before, "{now} of {before}: {report:?}");
        before = now;
        for (mesh, finest) in meshes.iter().zip(&patient.meshes) {
            let ratio = mesh.volume_mm3() / finest.volume_mm3();
            assert!((ratio - 1.0).abs() < 0.02, "{}: {ratio}", mesh.group);
            let mut edges: Vec<[u32; 2]> = Vec::new();
            for [a, b, c] in &mesh.triangles {
                edges.extend([[*a, *b], [*b, *c], [*c, *a]]);
            }
            edges.sort_unstable();
            let open = edges
                .iter()
                .filter(|[a, b]| edges.binary_search(&[*b, *a]).is_err());
            assert_eq!(open.count(), 0, "group {}", mesh.group);
        }
    }
}

/// Before smoothing the surface is its voxels' faces, smoothing keeps it within half a voxel along
/// each axis, and after decimation it is what was measured at the end.
fn stages_are_measured(report: &Report) {
    let found = &report.stage_distances;
    let stages = [Stage::Surface, Stage::Smooth, Stage::Decimate];
    for (stage, found) in stages.iter().zip(found.chunks(17)) {
        assert!(found.iter().all(|found| found.stage == *stage), "{found:?}");
    }
    assert_eq!(found.len(), 51);
    for (at, group) in report.groups.iter().enumerate() {
        let [surface, smooth, last] = [0, 17, 34].map(|first| &found[first + at]);
        assert_eq!(surface.group, group.name);
        assert!(
            surface.hausdorff_voxels < 1e-6 && surface.dice > 0.999_999,
            "{surface:?}"
        );
        assert!(
            smooth.mean_voxels > 0.05 && smooth.hausdorff_voxels < 0.87,
            "{smooth:?}"
        );
        assert!((last.hausdorff_voxels - group.measures.hausdorff_voxels).abs() < 1e-12);
        assert!(last.triangles == group.triangles && last.triangles < smooth.triangles);
    }
}

/// Pairs of triangles of `mesh` that cross.
fn crossings(mesh: &GroupMesh) -> usize {
    let corners: Vec<_> = (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect();
    let crosses = |i: usize, j: usize| {
        let [one, other] = [i, j].map(|t| (&mesh.triangles[t], &corners[t]));
        cross(one, other)
    };
    let of_one = |i: usize| (0..i).filter(|j| crosses(i, *j)).count();
    (0..corners.len()).map(of_one).sum()
}

/// The patient of a phantom of 7 mm voxels has all groups, closed, with their volumes, and none
/// crosses itself.
fn is_sound(seed: u64, name: &str) {
    let folder = phantom_of(seed, name, [64, 64, 77]);
    let groups = Groups::load("vista3d").expect("the table is right");
    let labels = folder.join("labels.nii.gz");
    let patient = build(&labels, &groups, &Options::default(), &mut |_| ()).expect("built");
    std::fs::remove_dir_all(folder).expect("the folder can go");
    assert_eq!(patient.meshes.len(), 17, "seed {seed}");
    assert_eq!(patient.report.groups.len(), 17, "seed {seed}");
    for (mesh, group) in patient.meshes.iter().zip(&patient.report.groups) {
        let (name, found) = (&group.name, &group.measures);
        assert!(found.watertight, "seed {seed}, {name}");
        let off = (found.volume_ratio - 1.0).abs();
        assert!(off < 0.01, "seed {seed}, {name}: {found:?}");
        assert!(
            found.hausdorff_voxels < 1.0 && found.mean_voxels < 0.2 && found.dice > 0.97,
            "seed {seed}, {name}: {found:?}"
        );
        assert_eq!(crossings(mesh), 0, "seed {seed}, {name}");
    }
}

/// Of this patient kidneys, lungs and ribs once crossed themselves: sheets a voxel apart that
/// smoothing had folded.
#[test]
fn sheets_a_voxel_apart_do_not_cross() {
    is_sound(17, "sheets");
}

/// A minute or two; `make test-anatomy` runs it.
#[test]
#[ignore = "takes minutes"]
fn meshes_of_twenty_seeds_are_sound() {
    for seed in 0..20 {
        is_sound(seed, "twenty");
    }
}

/// Each voxel's middle lies in the mesh of exactly one group, or in none where there is background.
#[test]
fn neighbours_have_neither_gap_nor_overlap() {
    let folder = phantom("partition", [64, 64, 77]);
    let groups = Groups::load("vista3d").expect("the table is right");
    let patient = build(
        &folder.join("labels.nii.gz"),
        &groups,
        &Options::default(),
        &mut |_| (),
    )
    .expect("built");
    let volume = crate::nifti::read_labels(&folder.join("labels.nii.gz"), &groups).expect("read");
    let (mut owners, mut deep) = (vec![0_u8; volume.voxels.len()], 0);
    for mesh in &patient.meshes {
        for (owner, inside) in owners
            .iter_mut()
            .zip(crate::measure::inside(mesh, &volume.grid))
        {
            *owner += u8::from(inside);
        }
    }
    for mesh in &patient.meshes {
        assert_eq!(crossings(mesh), 0, "group {}", mesh.group);
    }
    let mut pushed = patient.meshes[0].clone();
    pushed.positions[0] += Vector3::new(60.0, 60.0, 60.0);
    assert!(crossings(&pushed) > 0);
    let [width, height, _] = volume.grid.dims;
    for (at, owners) in owners.iter().enumerate() {
        assert!(*owners <= 1, "voxel {at} is in {owners} meshes");
        // A voxel with tissue all around can't be outside of all meshes.
        let strides = [1, width, width * height];
        let around = strides.iter().flat_map(|s| [at.wrapping_sub(*s), at + s]);
        let is_tissue = |i: usize| volume.voxels.get(i).is_some_and(|group| *group != 0);
        if is_tissue(at) && around.into_iter().all(is_tissue) {
            deep += 1;
            assert_eq!(*owners, 1, "voxel {at} is in no mesh");
        }
    }
    assert!(deep > 20_000, "{deep}");
    std::fs::remove_dir_all(folder).expect("the folder can go");
}
