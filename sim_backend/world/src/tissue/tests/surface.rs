//! The drawn surface: closed, facing outwards, following the sheet without allocating.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::{OPEN_RAD, flap_config, jaw_at, organ_ground};
use crate::tissue::{FlapSnapshot, NODES_MAX, Patch, Surface, Tissue};

fn vertex(surface: &Surface, index: u32) -> Vector3<f64> {
    Vector3::from(surface.mesh().positions[index as usize].map(f64::from))
}

#[test]
fn surface_is_closed_and_faces_outwards() {
    let config = flap_config();
    let tissue = Tissue::new(
        &config,
        organ_ground(),
        1,
        &[jaw_at([0.0, 0.0, 0.1], OPEN_RAD, 0.0)],
    );
    let surface = Surface::new(tissue.sheet());
    // The rim has vertices of its own where the faces end, so edges are matched by place.
    let place = |index: u32| surface.mesh().positions[index as usize].map(f32::to_bits);
    let mut edges: BTreeMap<[[u32; 3]; 2], i32> = BTreeMap::new();
    let mut volume = 0.0;
    for triangle in surface.mesh().indices.chunks_exact(3) {
        let [a, b, c] = [0, 1, 2].map(|k| vertex(&surface, triangle[k]));
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
    // The root is behind the attached edge, the free corners are round.
    let expected = config.length_m * (config.grid_depth_m() + 0.0045) * config.material.thickness_m;
    assert!(
        (volume / expected - 1.0).abs() < 0.04,
        "{volume:e} of {expected:e}"
    );
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
    let last = tissue.sheet().positions().len() - 1;
    let lift = Vector3::new(0.0, 0.002, 0.003);
    tissue.sheet.positions[last] += lift;
    let before = surface.clone();
    surface.update(tissue.sheet().positions());
    assert!(core::ptr::eq(place, surface.mesh().positions.as_ptr()));
    assert_eq!(
        (count, &before.mesh().indices),
        (surface.mesh().positions.len(), &surface.mesh().indices)
    );
    // What is near the last node goes along, what is three cells away stays.
    let far_m = 3.0 * config.length_m / 15.0;
    let node = tissue.sheet().positions()[last] - lift;
    let mut most = 0.0_f64;
    for index in 0..u32::try_from(count).unwrap() {
        let moved = vertex(&surface, index) - vertex(&before, index);
        most = most.max(moved.norm());
        assert!(moved.norm() < 1e-8 || (vertex(&before, index) - node).norm() < far_m);
    }
    assert!(most > 0.5 * lift.norm(), "{most}");
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
        assert!(at.y > -0.006 && at.y < size_m[1] + 0.001, "{at}");
        // A round corner: nothing is where two straight edges met.
        let corner = nalgebra::Vector2::new((at.x - 0.5 * size_m[0]).abs(), at.y)
            - nalgebra::Vector2::new(0.5 * size_m[0], size_m[1]);
        assert!(corner.norm() > 0.0015, "{at}");
        // Behind the attached edge the root dives into the organ.
        assert!(at.y > -0.0040 || at.z < -0.001, "{at}");
    }
    assert!(furthest[0] > size_m[0] - 0.001 && furthest[1] > size_m[1] - 0.001);
}
