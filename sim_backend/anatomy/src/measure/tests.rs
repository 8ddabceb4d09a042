//! Measures of meshes whose distances are known.

use nalgebra::{Point3, Vector3};

use super::boundary::distance_to_boundary;
use super::measure;
use super::nearest::Nearest;
use crate::grid::Grid;
use crate::mesh::GroupMesh;
use crate::nifti::LabelVolume;
use crate::surface::complex::Complex;
use crate::surface::nets;
use crate::volume::Padded;

/// A block of 8 x 8 x 8 voxels in 12 x 12 x 12.
fn block() -> Padded {
    let grid = Grid::centred([12; 3], [0.5, 1.0, 2.0]);
    let within = |i: usize| {
        [i % 12, i / 12 % 12, i / 144]
            .iter()
            .all(|c| (2..10).contains(c))
    };
    let voxels = (0..1728).map(|i| u8::from(within(i))).collect();
    Padded::new(LabelVolume { grid, voxels })
}

fn mesh(volume: &Padded) -> GroupMesh {
    GroupMesh::of(&Complex::of_net(nets::extract(volume), &volume.grid), 0)
}

#[test]
fn unsmoothed_mesh_is_its_voxels() {
    let volume = block();
    let found = measure(&mesh(&volume), &volume, 512.0).expect("there is a group");
    assert!(found.watertight);
    assert!(
        found.hausdorff_voxels < 1e-6 && found.mean_voxels < 1e-6,
        "{found:?}"
    );
    assert!((found.volume_ratio - 1.0).abs() < 1e-9);
    assert!((found.dice - 1.0).abs() < 1e-12);
}

#[test]
fn shifted_mesh_is_seen_by_every_measure() {
    let volume = block();
    let mut mesh = mesh(&volume);
    // Two voxels along the first axis.
    for p in &mut mesh.positions {
        *p += Vector3::new(1.0, 0.0, 0.0);
    }
    let found = measure(&mesh, &volume, 512.0).expect("there is a group");
    assert!((found.hausdorff_voxels - 2.0).abs() < 1e-6, "{found:?}");
    assert!(found.mean_voxels > 0.3);
    assert!((found.dice - 0.75).abs() < 1e-12, "{}", found.dice);
}

#[test]
fn opened_mesh_is_not_watertight() {
    let volume = block();
    let mut mesh = mesh(&volume);
    assert!(mesh.is_watertight());
    mesh.triangles.pop();
    assert!(!mesh.is_watertight());
}

#[test]
fn distances_far_from_everything_are_right() {
    let volume = block();
    // Voxel coordinates with the margin: the block's faces are at 2.5 and 10.5.
    let p = Point3::new(6.0, 6.0, 13.5);
    assert!((distance_to_boundary(&volume, 1, &p) - 3.0).abs() < 1e-12);
    let triangle = [
        Point3::new(0.0, 0.0, 0.0),
        Point3::new(1.0, 0.0, 0.0),
        Point3::new(0.0, 1.0, 0.0),
    ];
    let nearest = Nearest::new(&triangle, &[[0, 1, 2]]);
    let far = Point3::new(30.0, 0.0, 40.0);
    assert!((nearest.distance(&far) - (29.0_f64.powi(2) + 1600.0).sqrt()).abs() < 1e-9);
}
