//! No two triangles of an atlas overlap, and all are in the square.

use nalgebra::Point3;

use super::unwrap;
use crate::mesh::GroupMesh;
use crate::number::{index, real};

/// A torus with a corrugated surface: charts that a view along an axis would fold over.
fn torus() -> GroupMesh {
    let (around, across) = (48, 24);
    let mut mesh = GroupMesh::default();
    for i in 0..around {
        for j in 0..across {
            let (a, b) = (
                std::f64::consts::TAU * real(i) / real(around),
                std::f64::consts::TAU * real(j) / real(across),
            );
            let r = 10.0 * (1.0 + 0.2 * (6.0 * a).sin() * (3.0 * b).sin());
            let ring = 25.0 + r * b.cos();
            mesh.positions
                .push(Point3::new(ring * a.cos(), ring * a.sin(), r * b.sin()));
            let v = |i: usize, j: usize| index((i % around) * across + j % across);
            let [p, q, r, s] = [v(i, j), v(i + 1, j), v(i + 1, j + 1), v(i, j + 1)];
            mesh.triangles.extend([[p, q, r], [p, r, s]]);
        }
    }
    mesh
}

/// How many texels of 2048 x 2048 have their middle well within more than one triangle.
fn covered_twice(mesh: &GroupMesh) -> usize {
    const SIDE: usize = 2048;
    let mut covered = vec![0_u8; SIDE * SIDE];
    for triangle in &mesh.uv {
        let [a, b, c] = triangle.map(|p| p.map(|x| f64::from(x) * real(SIDE)));
        let cross = |p: [f64; 2], q: [f64; 2], x: f64, y: f64| {
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
        };
        let range = |k: usize| {
            let low = a[k].min(b[k]).min(c[k]);
            let high = a[k].max(b[k]).max(c[k]);
            crate::number::floor_to(low, SIDE - 1)..=crate::number::floor_to(high, SIDE - 1)
        };
        for y in range(1) {
            for x in range(0) {
                let (u, v) = (real(x) + 0.5, real(y) + 0.5);
                let inside = [(a, b), (b, c), (c, a)]
                    .into_iter()
                    .all(|(p, q)| cross(p, q, u, v) > 1e-2);
                covered[x + SIDE * y] += u8::from(inside);
            }
        }
    }
    covered.into_iter().filter(|count| *count > 1).count()
}

#[test]
fn charts_do_not_overlap_and_fill_a_fair_share() {
    let mut mesh = torus();
    assert!(mesh.is_watertight());
    let used = unwrap(&mut mesh);
    assert!(used > 0.3, "{used}");
    assert!(
        mesh.uv
            .as_flattened()
            .as_flattened()
            .iter()
            .all(|x| (0.0..=1.0).contains(x))
    );
    assert_eq!(covered_twice(&mesh), 0);
    // The check itself sees an overlap.
    mesh.uv[1] = mesh.uv[0];
    assert!(covered_twice(&mesh) > 0);
}
