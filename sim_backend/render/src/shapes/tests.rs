//! Closedness, orientation and size of the procedural meshes.

use super::instrument::{Finger, finger, shaft, wrist};
use super::*;

/// Volume enclosed by the triangles, m^3: positive when they face outwards.
fn volume_m3(mesh: &Mesh) -> f64 {
    let at = |index: u32| Vector3::from(mesh.positions[index as usize].map(f64::from));
    mesh.indices
        .chunks_exact(3)
        .map(|t| at(t[0]).dot(&at(t[1]).cross(&at(t[2]))) / 6.0)
        .sum()
}

/// Triangles whose vertex normals point to the other side than their winding.
fn inverted(mesh: &Mesh) -> usize {
    let at = |index: u32| Vector3::from(mesh.positions[index as usize].map(f64::from));
    let normal = |index: u32| Vector3::from(mesh.normals[index as usize].map(f64::from));
    let wrong = |t: &&[u32]| {
        let face = (at(t[1]) - at(t[0])).cross(&(at(t[2]) - at(t[0])));
        t.iter().any(|&index| face.dot(&normal(index)) <= 0.0)
    };
    mesh.indices.chunks_exact(3).filter(wrong).count()
}

/// A slab of 40 x 20 x 5 mm whose vertical corners are rounded.
fn slab(corner_m: f64) -> Mesh {
    let outline = rounded_rectangle([0.02, 0.01], corner_m, 16);
    let ring = |z: f64, up: f64| -> Vec<_> {
        let vertex = |&(at, out): &(Point3<f64>, Vector3<f64>)| {
            let normal = (1.0 - up.abs()) * out + up * Vector3::z();
            (at + z * Vector3::z(), normal)
        };
        outline.iter().map(vertex).collect()
    };
    let middle = |z: f64, up: f64| {
        let vertex = (Point3::new(0.0, 0.0, z), up * Vector3::z());
        vec![vertex; outline.len()]
    };
    let top_m = 0.005;
    shaded_sheet(&[
        middle(0.0, -1.0),
        ring(0.0, -1.0),
        ring(0.0, 0.0),
        ring(top_m, 0.0),
        ring(top_m, 1.0),
        middle(top_m, 1.0),
    ])
}

fn named() -> Vec<(&'static str, Mesh)> {
    vec![
        ("cuboid", cuboid(Vector3::new(0.01, 0.02, 0.03))),
        ("cylinder", cylinder(0.004, -0.01, 0.02, 24)),
        ("capsule", capsule(0.002, 0.0, 0.01, 16)),
        ("sphere", sphere(0.01, 24)),
        ("needle", tube(&arc(0.01, 0.0, 3.0, 40), &[0.0005], 8)),
        (
            "field",
            height_field(0.02, 0.03, 12, |x, y| {
                0.002 * (90.0 * x).sin() * (70.0 * y).cos()
            }),
        ),
        ("slab", slab(0.004)),
        ("sharp slab", slab(0.0)),
        ("shaft", shaft(0.15)),
        ("wrist", wrist()),
        ("finger", finger(Finger::PlusY)),
        ("other finger", finger(Finger::MinusY)),
    ]
}

#[test]
fn triangles_and_normals_face_the_same_way() {
    for (name, mesh) in named() {
        assert!(!mesh.indices.is_empty(), "{name}");
        assert_eq!(inverted(&mesh), 0, "{name}");
        for normal in &mesh.normals {
            let length = Vector3::from(*normal).norm();
            assert!((length - 1.0).abs() < 1e-5, "{name}: {length}");
        }
    }
}

#[test]
fn solids_enclose_their_volume() {
    let pi = core::f64::consts::PI;
    let box_m3 = volume_m3(&cuboid(Vector3::new(0.01, 0.02, 0.03)));
    assert!((box_m3 / (8.0 * 6e-6) - 1.0).abs() < 1e-5);
    let cylinder_m3 = volume_m3(&cylinder(0.004, -0.01, 0.02, 96));
    assert!((cylinder_m3 / (pi * 0.004_f64.powi(2) * 0.03) - 1.0).abs() < 2e-3);
    let ball_m3 = volume_m3(&sphere(0.01, 96));
    assert!((ball_m3 / (4.0 / 3.0 * pi * 1e-6) - 1.0).abs() < 4e-3);
    let needle_m3 = volume_m3(&tube(&arc(0.01, 0.0, pi, 64), &[0.0005], 32));
    let arc_m3 = pi * 0.0005_f64.powi(2) * (pi * 0.01) + 4.0 / 3.0 * pi * 0.0005_f64.powi(3);
    assert!(
        (needle_m3 / arc_m3 - 1.0).abs() < 0.02,
        "{needle_m3} {arc_m3}"
    );
}

#[test]
fn a_rounded_slab_lacks_its_corners() {
    for corner_m in [0.0, 0.004, 0.01_f64] {
        let corners_m2 = (4.0 - core::f64::consts::PI) * corner_m.powi(2);
        let expected_m3 = (0.04 * 0.02 - corners_m2) * 0.005;
        let slab_m3 = volume_m3(&slab(corner_m));
        assert!((slab_m3 / expected_m3 - 1.0).abs() < 1e-3, "{slab_m3}");
    }
}

#[test]
fn fingers_meet_in_the_plane_of_the_jaw_and_end_at_the_tip() {
    for (which, side) in [(Finger::PlusY, 1.0), (Finger::MinusY, -1.0)] {
        let mesh = finger(which);
        let tip = mesh
            .positions
            .iter()
            .map(|p| f64::from(p[2]))
            .fold(f64::MIN, f64::max);
        assert!((tip - hal::psm::FINGER_M).abs() < 1e-7);
        // Beyond the hub nothing crosses the plane.
        let inside = mesh
            .positions
            .iter()
            .filter(|p| p[2] > 0.0025)
            .map(|p| side * f64::from(p[1]));
        let lowest = inside.fold(f64::MAX, f64::min);
        assert!(lowest.abs() < 1e-7, "{lowest}");
    }
}

#[test]
fn an_instrument_leaves_most_of_the_triangle_budget() {
    let parts = [
        shaft(0.15),
        wrist(),
        finger(Finger::PlusY),
        finger(Finger::MinusY),
    ];
    let triangles: usize = parts.iter().map(|mesh| mesh.indices.len() / 3).sum();
    assert!(triangles < 1500, "{triangles}");
}

#[test]
fn a_tube_through_one_point_is_empty() {
    assert!(tube(&[Point3::origin(); 3], &[0.001], 8).indices.is_empty());
    assert!(tube(&arc(0.01, 0.0, 1.0, 4), &[], 8).indices.is_empty());
}
