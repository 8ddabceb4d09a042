//! Facts about needles: shape, mass, mesh.

use super::*;

pub(crate) const HALF_CIRCLE: NeedleShape = NeedleShape {
    arc_radius_m: 0.012,
    arc_angle_rad: core::f64::consts::PI,
    uneven: [0.0, 0.0],
    wire_radius_m: 0.000_7,
    mass_kg: 0.001_5,
};

#[test]
fn centre_line_is_an_arc_with_its_middle_on_x() {
    let points = HALF_CIRCLE.centre_line(11);
    assert_eq!(points.len(), 11);
    assert!(
        points
            .iter()
            .all(|p| (p.coords.norm() - 0.012).abs() < 1e-15 && p.z.abs() < 1e-15)
    );
    assert!((points[5] - Point3::new(0.012, 0.0, 0.0)).norm() < 1e-15);
    assert!((points[10] - Point3::new(0.0, 0.012, 0.0)).norm() < 1e-12);
}

#[test]
fn mass_properties_equal_those_of_many_beads() {
    let exact = HALF_CIRCLE.mass_properties();
    let beads = HALF_CIRCLE.centre_line(20_001);
    let bead_kg = HALF_CIRCLE.mass_kg / 20_001.0;
    let centre = beads.iter().map(|p| p.coords).sum::<Vector3<f64>>() / 20_001.0;
    let mut inertia = Vector3::zeros();
    for bead in &beads {
        let arm = bead.coords - centre;
        inertia += (Vector3::repeat(arm.norm_squared()) - arm.component_mul(&arm)) * bead_kg;
    }
    assert!((exact.centre.coords - centre).norm() < 1e-6);
    // The beads have no thickness; the wire does.
    assert!(
        (exact.inertia - inertia).norm() < 5e-3 * inertia.norm(),
        "{} against {inertia}",
        exact.inertia
    );
}

const HOOK: NeedleShape = NeedleShape {
    uneven: [-0.7, 0.3],
    ..HALF_CIRCLE
};

#[test]
fn uneven_wire_has_its_length_and_its_curvature() {
    let count = 2001;
    let points = HOOK.centre_line(count);
    let step_m = HOOK.arc_radius_m * HOOK.arc_angle_rad / 2000.0;
    assert!((points[1000] - Point3::new(0.012, 0.0, 0.0)).norm() < 1e-15);
    for index in 1..count - 1 {
        let (before, after) = (
            points[index] - points[index - 1],
            points[index + 1] - points[index],
        );
        assert!((before.norm() / step_m - 1.0).abs() < 1e-6);
        let turn = before.cross(&after).z / (step_m * step_m);
        let u = ratio(index, count - 1) * 2.0 - 1.0;
        let expected = (1.0 - 0.7 * u + 0.3 * u * u) / HOOK.arc_radius_m;
        assert!((turn / step_m - expected).abs() < 1e-4 * expected.abs());
    }
}

#[test]
fn almost_even_wire_is_almost_the_arc() {
    let nearly = NeedleShape {
        uneven: [1e-9, 0.0],
        ..HALF_CIRCLE
    };
    for (a, b) in nearly
        .centre_line(33)
        .iter()
        .zip(HALF_CIRCLE.centre_line(33))
    {
        assert!((a - b).norm() < 1e-9);
    }
    let (a, b) = (nearly.mass_properties(), HALF_CIRCLE.mass_properties());
    assert!((a.centre - b.centre).norm() < 3e-5);
    // The first axis may be either one of the plane.
    assert!((a.inertia.z / b.inertia.z - 1.0).abs() < 0.01);
    assert!((a.inertia.min() / b.inertia.min() - 1.0).abs() < 0.02);
}

#[test]
fn principal_axes_are_those_of_the_wire() {
    let mass = HOOK.mass_properties();
    let (sin, cos) = mass.axes_rad.sin_cos();
    let beads: Vec<_> = (0..4000)
        .map(|bead| HOOK.wire_at(ratio(2 * bead + 1, 8000) - 0.5).0)
        .collect();
    let (mut mixed, mut about_first) = (0.0, 0.0);
    for bead in &beads {
        let arm = bead - mass.centre;
        let (first, second) = (cos * arm.x + sin * arm.y, cos * arm.y - sin * arm.x);
        mixed += first * second / 4000.0;
        about_first += second * second / 4000.0;
    }
    assert!(mixed.abs() < 1e-3 * about_first, "{mixed}");
    let wire = 0.5 * HOOK.wire_radius_m * HOOK.wire_radius_m;
    let expected = (about_first + wire) * HOOK.mass_kg;
    assert!((mass.inertia.x / expected - 1.0).abs() < 0.01);
}

#[test]
fn mesh_faces_outwards_and_stays_on_the_wire() {
    let mesh = HALF_CIRCLE.mesh();
    assert!((1_100..=1_160).contains(&(mesh.indices.len() / 3)));
    for triangle in mesh.indices.chunks_exact(3) {
        let [a, b, c] = [0, 1, 2].map(|k| {
            let [x, y, z] = mesh.positions[triangle[k] as usize].map(f64::from);
            Vector3::new(x, y, z)
        });
        let face = (b - a).cross(&(c - a));
        let normal: Vector3<f64> = triangle
            .iter()
            .map(|&index| Vector3::from(mesh.normals[index as usize].map(f64::from)))
            .sum();
        assert!(
            face.norm() < 1e-12 || face.dot(&normal) > 0.0,
            "{a} {b} {c} {normal}"
        );
    }
    let wire = mesh.positions.iter().map(|p| {
        let flat = f64::from(p[0]).hypot(f64::from(p[1])) - 0.012;
        flat.hypot(f64::from(p[2]))
    });
    assert!(wire.fold(0.0, f64::max) < 0.000_701);
}
