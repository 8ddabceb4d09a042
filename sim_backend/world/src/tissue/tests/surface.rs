//! The drawn surface: closed, facing outwards, following the sheet without allocating.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::{OPEN_RAD, flap_config, jaw_at, organ_ground};
use crate::tissue::{FlapSnapshot, NODES_MAX, Patch, Surface, Tissue};

fn vertex(surface: &Surface, index: u32) -> Vector3<f64> {
    Vector3::from(surface.mesh().positions[index as usize].map(f64::from))
}

/// Asserts that `surface` is closed and faces outwards; its volume, m3.
fn closed_volume_m3(surface: &Surface) -> f64 {
    // The rim has vertices of its own where the faces end, so edges are matched by place.
    let place = |index: u32| surface.mesh().positions[index as usize].map(f32::to_bits);
    let mut edges: BTreeMap<[[u32; 3]; 2], i32> = BTreeMap::new();
    let mut volume = 0.0;
    for triangle in surface.mesh().indices.chunks_exact(3) {
        let [a, b, c] = [0, 1, 2].map(|k| vertex(surface, triangle[k]));
        volume += a.cross(&b).dot(&c) / 6.0;
        let normal = (b - a).cross(&(c - a));
        for k in 0..3 {
            let (from, to) = (place(triangle[k]), place(triangle[(k + 1) % 3]));
            let (edge, sign) = if from < to {
                ([from, to], 1)
            } else {
                ([to, from], -1)
            };
            *edges.entry(edge).or_insert(0) += sign;
            let drawn = Vector3::from(surface.mesh().normals[triangle[k] as usize].map(f64::from));
            assert!((drawn.norm() - 1.0).abs() < 1e-5 && drawn.dot(&normal) > 0.0);
        }
    }
    assert!(
        edges.values().all(|count| *count == 0),
        "every edge is walked once each way"
    );
    volume
}

#[test]
fn surface_is_closed_and_faces_outwards() {
    let config = flap_config();
    let away = jaw_at([0.0, 0.0, 0.1], OPEN_RAD, 0.0);
    let tissue = Tissue::new(&config, organ_ground(), 1, &[away]);
    let volume = closed_volume_m3(&Surface::new(tissue.sheet()));
    // The root is behind the first row, the free corners are round.
    let expected = config.length_m * (config.grid_depth_m() + 0.0053) * config.material.thickness_m;
    assert!(
        (volume / expected - 1.0).abs() < 0.04,
        "{volume:e} of {expected:e}"
    );
}

#[test]
fn small_and_thick_sheets_are_closed_too() {
    for (size_m, thickness_m) in [(0.01, 0.0015), (0.01, 0.01), (0.01, 0.02), (0.06, 0.02)] {
        let mut config = flap_config();
        (config.length_m, config.depth_m, config.cells) = (size_m, size_m, [2, 2]);
        config.material.thickness_m = thickness_m;
        assert!(closed_volume_m3(&config.surface()) > 0.0);
    }
}

#[test]
fn surface_follows_the_sheet_and_keeps_its_memory() {
    let config = flap_config();
    let away = jaw_at([0.0, 0.0, 0.1], OPEN_RAD, 0.0);
    let mut tissue = Tissue::new(&config, organ_ground(), 1, &[away]);
    let mut surface = Surface::new(tissue.sheet());
    let (place, count) = (
        surface.mesh().positions.as_ptr(),
        surface.mesh().positions.len(),
    );
    let moved = tissue.sheet().node(8, 6);
    let lift = Vector3::new(0.0, 0.002, 0.003);
    tissue.sheet.positions[moved] += lift;
    let before = surface.clone();
    surface.update(tissue.sheet().positions());
    assert!(core::ptr::eq(place, surface.mesh().positions.as_ptr()));
    assert_eq!(
        (count, &before.mesh().indices),
        (surface.mesh().positions.len(), &surface.mesh().indices)
    );
    // What is near the node goes along, what is three cells away stays.
    let far_m = 3.0 * config.length_m / 15.0;
    let node = tissue.sheet().positions()[moved] - lift;
    let mut most = 0.0_f64;
    for index in 0..u32::try_from(count).unwrap() {
        let way = vertex(&surface, index) - vertex(&before, index);
        most = most.max(way.norm());
        assert!(way.norm() < 1e-8 || (vertex(&before, index) - node).norm() < far_m);
    }
    assert!(most > 0.9 * lift.norm(), "{most}");
}

#[test]
fn mark_lies_on_the_upper_face_and_bends_with_it() {
    let config = flap_config();
    let away = jaw_at([0.0, 0.0, 0.1], OPEN_RAD, 0.0);
    let tissue = Tissue::new(&config, organ_ground(), 1, &[away]);
    let mut surface = Surface::new(tissue.sheet());
    let radius_m = 0.002;
    let mut patch = Patch::new(&surface, tissue.mark_m(), radius_m);
    let mark = tissue.mark_in_scene();
    let local = |patch: &Patch, vertex: usize| {
        let at = nalgebra::Point3::from(patch.mesh().positions[vertex].map(f64::from));
        mark.inverse_transform_point(&at)
    };
    let vertices = patch.mesh().positions.len();
    for vertex in 0..vertices {
        let at = local(&patch, vertex);
        assert!(at.coords.xy().norm() < 1.01 * radius_m, "{at}");
        // A tenth of a millimetre in front of the face, which bends by less than that over the
        // mark.
        assert!((0.000_02..0.000_3).contains(&at.z), "{at}");
    }
    for triangle in patch.mesh().indices.chunks_exact(3) {
        let [a, b, c] = [0, 1, 2].map(|k| local(&patch, triangle[k] as usize));
        assert!((b - a).cross(&(c - a)).z > 0.0, "faces out of the tissue");
    }
    // Lifted as a whole, it goes along.
    let up = Vector3::new(0.0, 0.0, 0.01);
    let lifted: Vec<_> = tissue
        .sheet()
        .positions()
        .iter()
        .map(|at| at + up)
        .collect();
    surface.update(&lifted);
    patch.update(&surface, tissue.mark_m());
    assert!((0..vertices).all(|vertex| local(&patch, vertex).z > 0.008));
}

/// How far below `from`, against `normal`, the surface is, m.
fn below_m(surface: &Surface, from: &Vector3<f64>, normal: &Vector3<f64>) -> Option<f64> {
    let mut nearest: Option<f64> = None;
    for triangle in surface.mesh().indices.chunks_exact(3) {
        let [a, b, c] = [0, 1, 2].map(|k| vertex(surface, triangle[k]));
        let columns = [b - a, c - a, *normal];
        let Some(inverse) = nalgebra::Matrix3::from_columns(&columns).try_inverse() else {
            continue;
        };
        let at = inverse * (from - a);
        if at.x >= -1e-6 && at.y >= -1e-6 && at.x + at.y <= 1.0 + 1e-6 && at.z > 0.0 {
            nearest = Some(nearest.map_or(at.z, |least| least.min(at.z)));
        }
    }
    nearest
}

#[test]
fn mark_is_just_above_what_is_drawn_wherever_it_lies() {
    let config = flap_config();
    let surface = config.surface();
    let v_m = config.grid_depth_m() - config.mark.inset_m;
    for step in 0..=20 {
        let u_m = 0.5 * config.length_m + config.mark.span_m * (f64::from(step) / 20.0 - 0.5);
        let patch = Patch::new(&surface, [u_m, v_m], 0.002);
        let mesh = patch.mesh();
        for (at, normal) in mesh.positions.iter().zip(&mesh.normals) {
            let [at, normal] = [at, normal].map(|v| Vector3::from(v.map(f64::from)));
            let below = below_m(&surface, &at, &normal);
            assert!(
                below.is_some_and(|below_m| (0.000_02..0.000_3).contains(&below_m)),
                "{u_m}: {at:?} {below:?}"
            );
        }
    }
}

#[test]
fn snapshot_has_every_node_to_a_tenth_of_a_micrometre() {
    let config = flap_config();
    let away = jaw_at([0.0, 0.0, 0.1], OPEN_RAD, 0.0);
    let tissue = Tissue::new(&config, organ_ground(), 1, &[away]);
    let snapshot = FlapSnapshot::of(&tissue);
    let nodes = tissue.sheet().positions();
    assert!(nodes.len() <= NODES_MAX);
    for (drawn, true_m) in snapshot.nodes().zip(nodes) {
        assert!((drawn - true_m).norm() < 1e-7);
    }
}

#[test]
fn outline_is_that_of_the_physics_within_a_millimetre() {
    let config = flap_config();
    let surface = config.surface();
    let in_material = config.scene_from_material().inverse();
    let size_m = [config.length_m, config.grid_depth_m()];
    let mut furthest = [0.0_f64; 2];
    for position in &surface.mesh().positions {
        let at = in_material * nalgebra::Point3::from(position.map(f64::from));
        furthest = [furthest[0].max(at.x), furthest[1].max(at.y)];
        assert!(at.x > -0.001 && at.x < size_m[0] + 0.001, "{at}");
        assert!(at.y > -0.0085 && at.y < size_m[1] + 0.001, "{at}");
        // A round corner: nothing is where two straight edges met.
        let corner = nalgebra::Vector2::new((at.x - 0.5 * size_m[0]).abs(), at.y)
            - nalgebra::Vector2::new(0.5 * size_m[0], size_m[1]);
        assert!(corner.norm() > 0.0020, "{at}");
        // Behind the first row the root dives into the organ.
        assert!(at.y > -0.0040 || at.z < -0.001, "{at}");
    }
    assert!(furthest[0] > size_m[0] - 0.001 && furthest[1] > size_m[1] - 0.001);
}
