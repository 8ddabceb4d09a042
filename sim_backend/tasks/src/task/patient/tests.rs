//! Patients under the instruments: the phantom's liver is worked on, and what can't be one is
//! refused.

use core::cell::Cell;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use hal::Pose;
use hal::config::Source;
use hal::count::count_u32;
use nalgebra::Point3;
use trocar_anatomy::assets::{self, GLB_FILE};
use trocar_anatomy::build::{Options, build, write};
use trocar_anatomy::groups::Groups;
use trocar_anatomy::phantom::{self, Size};
use trocar_render::visual::{Visual, instance};
use trocar_world::organ::Organ;
use trocar_world::{Ground, World};

use super::{SceneFile, Site};
use crate::closed_loop;
use crate::task::laying::settled;
use crate::task::needle_lift::NeedleLift;
use crate::task::suture_pad::SuturePad;
use crate::task::tissue_retraction::TissueRetraction;
use crate::task::{Outcome, TaskConfig, TaskFiles, TaskScene};

mod neighbours;
mod plateaus;

/// A folder with a patient of a coarse grid, gone when this is.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _gone = fs::remove_dir_all(&self.0);
    }
}

/// The task `name` on an organ of the patient at `place`.
fn scene(name: &str, place: &Path, organ: &str) -> Source {
    let files = TaskFiles::built_in(name).unwrap();
    let (text, patient) = (files.scene.text(), place.display());
    let scene = format!("{text}\n[scene]\npatient = \"{patient}\"\norgan = \"{organ}\"\n");
    Source::embedded("liver.toml", &scene)
}

impl Folder {
    fn new(test: &str) -> Self {
        let name = format!("trocar-patient-{}-{test}", std::process::id());
        Self(env::temp_dir().join(name))
    }

    /// A patient in a folder that the tests which run at the same time share: they do not write
    /// into it.
    fn with_patient() -> Arc<Self> {
        static SHARED: Mutex<(u32, Weak<Folder>)> = Mutex::new((0, Weak::new()));
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        shared.1.upgrade().unwrap_or_else(|| {
            // An earlier one may be going this moment.
            let made = Arc::new(Self::made(shared.0));
            *shared = (shared.0 + 1, Arc::downgrade(&made));
            made
        })
    }

    fn made(count: u32) -> Self {
        Self::with_phantom(&format!("shared-{count}"), 7)
    }

    /// The phantom of `seed` in a folder of its own.
    fn with_phantom(test: &str, seed: u64) -> Self {
        let folder = Self::new(test);
        let patient = phantom::Patient::new(seed);
        phantom::write(&patient, Size([80, 80, 96]), &folder.0, |_, _| ()).unwrap();
        let groups = Groups::load("vista3d").unwrap();
        let labels = folder.0.join("labels.nii.gz");
        let patient = build(&labels, &groups, &Options::default(), &mut |_| ()).unwrap();
        write(&patient, &groups, &folder.0).unwrap();
        folder
    }

    /// The task `name` on an organ of the patient.
    fn scene(&self, name: &str, organ: &str) -> Source {
        scene(name, &self.0, organ)
    }

    fn task(&self, name: &str) -> TaskConfig {
        TaskConfig::parse(name, &self.scene(name, "liver")).unwrap()
    }

    fn refused(&self, organ: &str) -> String {
        let scene = self.scene("needle-lift", organ);
        TaskConfig::parse("needle-lift", &scene)
            .unwrap_err()
            .to_string()
    }
}

#[test]
fn experts_work_on_a_patients_liver() {
    let folder = Folder::with_patient();
    for (name, seeds) in [
        ("needle-lift", 6),
        ("needle-handover", 3),
        ("tissue-retraction", 6),
        ("suture-pad", 6),
    ] {
        let task = folder.task(name);
        let outcome = |seed| closed_loop::run(&task, seed, |_, _| {}).outcome;
        let outcomes: Vec<Outcome> = (0..seeds).map(outcome).collect();
        let lost = outcomes
            .iter()
            .filter(|outcome| **outcome != Outcome::Success);
        assert!(lost.count() <= 1, "{name}: {outcomes:?}");
    }
}

/// What is felt is what is drawn, the needle starts on it, and the same file lies in the same way.
#[test]
fn liver_is_felt_where_it_is_drawn() {
    let folder = Folder::with_patient();
    let task = folder.task("needle-lift");
    let lift = task.scene::<NeedleLift>().unwrap();
    let visuals = task.scene.visuals();
    assert_eq!(visuals[0].name, "liver");
    let near = |p: &&[f32; 3]| p[0].hypot(p[1]) < 0.03 && p[2] > -0.03;
    let drawn: Vec<_> = visuals[0].mesh.positions.iter().filter(near).collect();
    assert!(drawn.len() > 100, "{}", drawn.len());
    let mut sum_m = 0.0;
    for p in &drawn {
        let [x, y, z] = p.map(f64::from);
        let apart_m = lift.organ.height_m(x, y) - z;
        assert!(apart_m.abs() < 1e-4, "{apart_m} at {x}, {y}");
        sum_m += z / f64::from(count_u32(drawn.len()));
    }
    assert!(
        (sum_m - 0.005).abs() < 0.002,
        "the patch's mean height is {sum_m} m"
    );
    for seed in 0..20 {
        let pose = lift.start.draw(seed, &lift.needle, &lift.organ);
        for point in lift.needle.centre_line(41) {
            let point: Point3<f64> = pose * point;
            let gap_m = point.z - lift.organ.height_m(point.x, point.y);
            assert!(
                gap_m > lift.needle.wire_radius_m - 5e-5,
                "seed {seed}: {gap_m}"
            );
            assert!(lift.organ.covers(point.x, point.y));
        }
    }
    assert!(
        visuals
            .iter()
            .any(|visual| visual.instance == instance::NEIGHBOUR)
    );
    let (again, lie) = (folder.task("needle-lift"), task.patient().unwrap());
    assert_eq!(
        format!("{:?}", again.patient().unwrap()),
        format!("{lie:?}")
    );
    // The scene's z is the patient's front, more or less, and its y leads to the head.
    assert!(
        lie.axes_in_scan[2][1] > 0.5 && lie.axes_in_scan[1][2] > 0.4,
        "{lie:?}"
    );
}

/// Needles stay where they are when an episode begins, also where the first place is one that they
/// slide off.
#[test]
fn needles_are_at_rest_when_an_episode_begins() {
    let folder = Folder::with_patient();
    let mut laid_again = 0;
    for (name, seeds) in [
        ("needle-lift", 50),
        ("needle-handover", 150),
        ("suture-pad", 50),
    ] {
        let task = folder.task(name);
        for seed in 0..seeds {
            let mut world = settled(&task, &*task.scene, seed);
            let start = world.thing_in_scene(0);
            let first = task.scene.scenery(seed).things[0].in_scene;
            let moved = |world: &World, from: &Pose| {
                (world.thing_in_scene(0).translation.vector - from.translation.vector).norm()
            };
            laid_again += usize::from(moved(&world, &first) > 0.01);
            for _ in 0..1000 {
                world.step();
            }
            let moved_m = moved(&world, &start);
            assert!(moved_m < 0.002, "{name}, seed {seed}: {moved_m} m");
        }
    }
    assert!(
        laid_again > 0,
        "no first place was one that a needle slides off"
    );
}

/// The same patient as a file that does not say that it is ours.
#[test]
fn a_patient_of_another_program_lies_as_its_nodes_say() {
    let folder = Folder::with_patient();
    let mut bytes = fs::read(folder.0.join(GLB_FILE)).unwrap();
    let ours: &[u8] = b"RAS of the scan, m";
    let frame = bytes.windows(ours.len()).position(|part| part == ours);
    bytes[frame.unwrap()] = b'?';
    let others = Folder::new("others");
    fs::create_dir(&others.0).unwrap();
    let file = others.0.join("other.GLB");
    fs::write(&file, bytes).unwrap();
    // Its vertices are welded, so other places are tried and another patch may be the flattest.
    let reach = |place: &Path| {
        let parts = assets::read(place).unwrap();
        let liver = parts.iter().find(|part| part.name == "liver").unwrap();
        let at = |axis: usize| liver.mesh.positions.iter().map(move |p| p[axis]);
        [0, 1, 2].map(|axis| {
            let least = at(axis).fold(f32::INFINITY, f32::min);
            [least, at(axis).fold(f32::NEG_INFINITY, f32::max)]
        })
    };
    let (theirs, ours) = (reach(&file), reach(&folder.0));
    for (theirs, ours) in theirs.iter().flatten().zip(ours.iter().flatten()) {
        assert!((theirs - ours).abs() < 1e-5, "{theirs} {ours}");
    }
    let of_others = scene("needle-lift", &file, "liver");
    let task = TaskConfig::parse("needle-lift", &of_others).unwrap();
    let lies_m = task.patient().unwrap().patch_in_scan_m;
    for (at, [least, most]) in lies_m.into_iter().zip(ours) {
        assert!(
            (f64::from(least)..f64::from(most)).contains(&at),
            "{lies_m:?}"
        );
    }
    assert_eq!(
        closed_loop::run(&task, 0, |_, _| {}).outcome,
        Outcome::Success
    );
}

/// Where an organ does not reach 30 mm around any place, a narrower patch is taken, and a needle
/// that fits lies there and is lifted.
#[test]
fn small_organs_have_narrower_patches() {
    let folder = Folder::with_patient();
    for organ in ["spleen", "stomach", "kidneys"] {
        let shipped = folder.scene("needle-lift", organ);
        let smaller = shipped
            .text()
            .replace("arc_radius_m = 0.0192", "arc_radius_m = 0.0121");
        let source = Source::embedded("small.toml", &smaller);
        let task = TaskConfig::parse("needle-lift", &source).unwrap();
        let lie = task.patient().unwrap();
        assert!(lie.radius_m < 0.029, "{lie:?}");
        let outcome = |seed| closed_loop::run(&task, seed, |_, _| {}).outcome;
        let lifted = (0..4).filter(|seed| outcome(*seed) == Outcome::Success);
        assert!(lifted.count() >= 3, "{organ}");
    }
}

#[test]
fn tasks_without_a_patient_have_made_up_ground() {
    let task = TaskConfig::shipped("needle-lift");
    assert!(task.patient().is_none());
    let lift = task.scene::<NeedleLift>().unwrap();
    assert!(matches!(lift.organ, Organ::Rolling(_)));
}

#[test]
fn what_is_no_patient_is_refused_with_file_and_key() {
    let nowhere = Folder::new("nowhere").refused("liver");
    assert!(
        nowhere.contains("liver.toml:") && nowhere.contains("scene.patient"),
        "{nowhere}"
    );
    assert!(nowhere.contains("patient.glb can't be read"), "{nowhere}");

    let folder = Folder::with_patient();
    let organ = folder.refused("brain");
    assert!(
        organ.contains("scene.organ = brain is outside liver, gallbladder"),
        "{organ}"
    );
    let small = folder.refused("gallbladder");
    assert!(
        small.contains("scene.organ = gallbladder: no place on its front has 16 mm of surface")
            && small.contains(" mm in the scan, is less than "),
        "{small}"
    );
    let suture = folder.scene("suture-pad", "gallbladder");
    let suture = TaskConfig::parse("suture-pad", &suture).unwrap_err();
    let suture = suture.to_string();
    assert!(suture.contains("has 30 mm of surface"), "{suture}");

    let bytes = fs::read(folder.0.join(GLB_FILE)).unwrap();
    let half = Folder::new("half");
    fs::create_dir(&half.0).unwrap();
    fs::write(half.0.join(GLB_FILE), &bytes[..bytes.len() / 2]).unwrap();
    let cut = half.refused("liver");
    assert!(cut.contains("patient.glb: it has not the length"), "{cut}");
}

/// What is felt of an incision is what is drawn, and the flap stands out over it, so that a finger
/// fits under its free edge.
#[test]
fn a_flap_of_a_liver_stands_out_over_its_incision() {
    let folder = Folder::with_patient();
    let task = folder.task("tissue-retraction");
    let scene = task.scene::<TissueRetraction>().unwrap();
    let scenery = scene.scenery(0);
    let Ground::Bed(bed) = &scenery.ground else {
        panic!("{:?}", scenery.ground);
    };
    let visuals = task.scene.visuals();
    let (liver, flap) = (&visuals[0], &visuals[visuals.len() - 2]);
    assert_eq!((liver.name, flap.name), ("liver", "flap"));
    let looks = |visual: &Visual| visual.material.base_colour.map(f32::to_bits);
    assert_eq!(looks(flap), looks(liver));
    // Faces up, before the incision; there is no table beyond the organ's rim.
    let mesh = &liver.mesh;
    let before = mesh
        .positions
        .iter()
        .zip(&mesh.normals)
        .filter(|(p, normal)| {
            p[0].abs() < 0.03 && (-0.036..-0.016).contains(&p[1]) && p[2] > -0.03 && normal[2] > 0.5
        });
    let on_table = before.filter_map(|(p, _)| {
        let [x, y, z] = p.map(f64::from);
        bed.height_m(x, y).map(|height| (height - z, x, y))
    });
    let drawn: Vec<_> = on_table.collect();
    assert!(drawn.len() > 1000, "{}", drawn.len());
    for (apart_m, x, y) in drawn {
        // The table's heights are 0.5 mm apart.
        assert!(apart_m.abs() < 5e-4, "{apart_m} at {x}, {y}");
    }
    let world = World::new(&task.world, &scenery, &task.arms);
    let sheet = world.tissue().unwrap().sheet();
    let [columns, rows] = sheet.nodes();
    let mut over_organ = 0;
    for column in 0..columns {
        let free = sheet.positions()[sheet.node(column, rows - 1)];
        // Beyond the rim there is nothing below it.
        if let Some(height_m) = bed.height_m(free.x, free.y) {
            assert!(free.z - height_m > 0.004, "{height_m} at {free}");
            over_organ += 1;
        }
        let attached = sheet.positions()[sheet.node(column, 0)];
        let gap_m = attached.z - bed.height_m(attached.x, attached.y).unwrap();
        assert!(gap_m < 0.002, "{gap_m} at {attached}");
    }
    assert!(2 * over_organ > columns, "{over_organ} of {columns}");
}

/// The needle of a suture lies on the liver, before the fold, whose foot is in it everywhere.
#[test]
fn a_needle_lies_on_a_liver_before_its_fold() {
    let folder = Folder::with_patient();
    let task = folder.task("suture-pad");
    let scene = task.scene::<SuturePad>().unwrap();
    let patient = scene.patient.as_deref().unwrap();
    let organ = Organ::Measured(Arc::clone(&patient.organ));
    for seed in 0..20 {
        let scenery = scene.scenery(seed);
        let lies = scenery.things[0].in_scene;
        let wire = scene.needle.centre_line(41).into_iter();
        let gaps_m = wire.map(|point| {
            let point = lies * point;
            assert!(point.y < scene.pad.lip_front_m, "seed {seed}: {point}");
            point.z - organ.height_m(point.x, point.y) - scene.needle.wire_radius_m
        });
        let least_m = gaps_m.fold(f64::INFINITY, f64::min);
        assert!((0.0..0.000_3).contains(&least_m), "seed {seed}: {least_m}");
        // Where it would slide off it is laid elsewhere. It tips until it rests on three places,
        // and stays there.
        let mut world = settled(&task, &*task.scene, seed);
        let mut later = |steps: u32| {
            (0..steps).for_each(|_| world.step());
            world.thing_in_scene(0)
        };
        let (begins, rests, stays) = (later(0), later(1500), later(500));
        let tipped = (rests.translation.vector - begins.translation.vector).norm();
        assert!(tipped < 0.004, "seed {seed}: {tipped}");
        let crept = rests.inv_mul(&stays).translation.vector.norm();
        assert!(crept < 5e-5, "seed {seed}: {crept}");
    }
    let visuals = task.scene.visuals();
    let fold = visuals.iter().find(|visual| visual.name == "fold").unwrap();
    let looks = |visual: &Visual| visual.material.base_colour.map(f32::to_bits);
    assert_eq!(looks(fold), looks(&visuals[0]));
    for x in [-0.02, -0.01, 0.0, 0.01, 0.02] {
        let height_m = organ.height_m(x, scene.pad.hole().y);
        assert!((-0.028..0.007).contains(&height_m), "{height_m} at {x}");
    }
}

/// A hole that the organ covers is refused.
#[test]
fn a_fold_whose_hole_is_in_the_liver_is_refused() {
    let folder = Folder::with_patient();
    let text = folder
        .scene("suture-pad", "liver")
        .text()
        .replace("hole_height_m = 0.009", "hole_height_m = 0.002");
    let refused = TaskConfig::parse("suture-pad", &Source::embedded("low.toml", &text));
    let refused = refused.unwrap_err().to_string();
    assert!(
        refused.contains("pad.hole_height_m") && refused.contains("the hole begins at 0.0 mm"),
        "{refused}"
    );
}

/// Where the flattest patch does not fit, another one is taken; where none does, the flattest one's
/// reason is given.
#[test]
fn the_flattest_patch_that_fits_is_taken() {
    let folder = Folder::with_patient();
    let source = folder.scene("needle-lift", "liver");
    let file = SceneFile {
        patient: folder.0.display().to_string(),
        organ: "liver".to_owned(),
        needle: None,
    };
    let site = Site {
        half_m: [0.06, 0.045],
        centre_m: [0.0, 0.0, 0.005],
        radii_m: super::WIDE,
        incision: None,
    };
    let asked = Cell::new(0);
    let refuse = |count: u32| {
        asked.set(0);
        file.load(&source, &site, |_| {
            asked.set(asked.get() + 1);
            let reason = format!("patch {}", asked.get());
            if asked.get() > count {
                Ok(())
            } else {
                Err(source.refused("scene.organ", "liver", &reason))
            }
        })
    };
    let [first, second] = [0, 1].map(|count| refuse(count).unwrap().lie);
    let way = Point3::from(first.patch_in_scan_m) - Point3::from(second.patch_in_scan_m);
    assert!(way.norm() > 0.01, "{first:?} {second:?}");
    assert!(first.roughness_m <= second.roughness_m);
    let none = refuse(100).unwrap_err().to_string();
    assert!(asked.get() > 2);
    let tried = format!(
        "patch 1; {} patches were tried on the patient's liver",
        asked.get()
    );
    let flat_mm = 1e3 * first.roughness_m;
    let first = format!("the first {flat_mm:.1} mm from flat (root mean square) within 30 mm of (");
    assert!(none.contains(&tried) && none.contains(&first), "{none}");
}

/// A flap that would be stretched wherever it is laid is refused, before an episode begins with it
/// torn.
#[test]
fn a_flap_that_does_not_lie_on_the_liver_is_refused() {
    let folder = Folder::with_patient();
    let shipped = folder.scene("tissue-retraction", "liver");
    let text = shipped
        .text()
        .replace("length_m = 0.060", "length_m = 0.15");
    let source = Source::embedded("long.toml", &text);
    let refused = TaskConfig::parse("tissue-retraction", &source).unwrap_err();
    let refused = refused.to_string();
    assert!(
        refused.contains("tissue.edge_m") && refused.contains("150 mm x 48 mm would be stretched"),
        "{refused}"
    );
}

/// Small bowel is all folds: on the flattest place of this one a flap is flung off before an arm
/// moves.
#[test]
fn a_flap_is_laid_where_it_stays_or_refused() {
    let folder = Folder::with_phantom("bowel", 3);
    let scene = folder.scene("tissue-retraction", "small-bowel");
    match TaskConfig::parse("tissue-retraction", &scene) {
        Ok(task) => {
            let episode = closed_loop::run(&task, 1000, |_, _| {});
            assert!(episode.seconds > 0.5, "{:?}", episode.outcome);
        }
        Err(refused) => {
            let refused = refused.to_string();
            assert!(refused.contains("does not come to rest"), "{refused}");
        }
    }
}
