//! Tetrahedra fill what they should.

use nalgebra::Point3;

use super::Tetrahedra;
use crate::grid::Grid;
use crate::mesh::GroupMesh;
use crate::nifti::LabelVolume;
use crate::surface::complex::Complex;
use crate::surface::nets;
use crate::volume::Padded;

/// A ball of 20 voxels' radius of 1 mm, or a plate of 30 x 30 x `thick`.
fn mesh(inside: impl Fn([f64; 3]) -> bool) -> GroupMesh {
    let grid = Grid::centred([48; 3], [1.0; 3]);
    let at = |i: usize| [i % 48, i / 48 % 48, i / (48 * 48)].map(|c| crate::number::real(c) - 23.5);
    let voxels = (0..grid.len()).map(|i| u8::from(inside(at(i)))).collect();
    let volume = Padded::new(LabelVolume { grid, voxels });
    GroupMesh::of(&Complex::of_net(nets::extract(&volume), &volume.grid), 0)
}

/// Whether each face is there once, or twice with the surface's, and edges of the surface are
/// closed.
fn is_whole(filled: &Tetrahedra) -> bool {
    let surface = GroupMesh {
        positions: filled.positions.clone(),
        triangles: filled.surface.clone(),
        ..GroupMesh::default()
    };
    (surface.volume_mm3() / filled.volume_mm3() - 1.0).abs() < 1e-9
}

#[test]
fn a_ball_is_filled_within_its_surface() {
    let ball = mesh(|p| p.iter().map(|x| x * x).sum::<f64>() < 400.0);
    let filled = Tetrahedra::fill(&ball, 5.0).expect("it is thick enough");
    assert!((filled.side_mm - 5.0).abs() < 1e-12, "{}", filled.side_mm);
    assert!((filled.volume_mm3() / ball.volume_mm3() - 1.0).abs() < 0.01);
    assert!(
        filled.least_share() >= super::FLAT,
        "{}",
        filled.least_share()
    );
    assert!(is_whole(&filled));
    assert!(filled.corners.len() > 1000, "{}", filled.corners.len());
    // The boundary is at the ball's surface, within a voxel and what bounds of shape leave.
    for v in filled.boundary() {
        let from_surface = (filled.positions[v as usize] - Point3::origin()).norm() - 20.0;
        assert!(from_surface.abs() < 2.5, "{from_surface}");
    }
    assert!(
        (4.0..6.0).contains(&filled.mean_edge()),
        "{}",
        filled.mean_edge()
    );
}

#[test]
fn a_thin_plate_gets_a_finer_lattice_and_a_thinner_one_a_reason() {
    let plate = mesh(|[x, y, z]| x.abs() < 15.0 && y.abs() < 15.0 && z.abs() < 1.0);
    let filled = Tetrahedra::fill(&plate, 8.0).expect("an eighth is thin enough");
    assert!(filled.side_mm < 8.0);
    assert!((filled.volume_mm3() / plate.volume_mm3() - 1.0).abs() < 0.01);
    assert!(filled.least_share() > 0.0 && is_whole(&filled));
    let filled = Tetrahedra::fill(&plate, 0.1).map(|filled| filled.corners.len());
    let error = filled.expect_err("too many");
    assert!(error.contains("more than"), "{error}");
}
