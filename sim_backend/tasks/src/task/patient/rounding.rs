//! A coarse mesh rounded where one works: edges are halved, and their middles put where the normals
//! at both ends say.

use std::collections::BTreeMap;

use hal::Mesh;
use hal::count::count_u32;
use hal::mesh::single;
use nalgebra::{Point3, Vector3};

/// Edges are halved until they are shorter, m.
const EDGE_M: f64 = 0.005;
/// Rounds of halving at most.
const ROUNDS: usize = 4;
/// How far beyond the rectangle, and how far below the patch, it is rounded as well, for its
/// outline, m.
const BEYOND_M: f64 = 0.03;
const DEEP_M: f64 = -0.08;

/// `mesh` (scene frame) with shorter edges over the rectangle of `half_m` about the origin. The
/// middle of an edge is that of the cubic curve that stands on the normals at its ends (Vlachos et
/// al., "Curved PN triangles", 2001), so it depends on the edge alone: what was closed stays
/// closed.
pub(super) fn rounded(mesh: Mesh, half_m: [f64; 2]) -> Mesh {
    finer(mesh, |at| {
        let inside = (0..2).all(|axis| at[axis].abs() <= half_m[axis] + BEYOND_M);
        (inside && at.z >= DEEP_M).then_some(EDGE_M)
    })
}

/// `mesh` (scene frame), rounded in the same way, with edges that are no longer than `edge_m` says
/// of their middles.
pub(super) fn finer(mut mesh: Mesh, edge_m: impl Fn(&Point3<f64>) -> Option<f64>) -> Mesh {
    for _ in 0..ROUNDS {
        let before = mesh.indices.len();
        mesh = halved(mesh, &edge_m);
        if mesh.indices.len() == before {
            break;
        }
    }
    mesh
}

/// One round: every edge that is too long gets a vertex in its middle, shared by the faces on both
/// sides; each face becomes one to four.
fn halved(mut mesh: Mesh, edge_m: impl Fn(&Point3<f64>) -> Option<f64>) -> Mesh {
    let mut middles = BTreeMap::new();
    let faces = std::mem::take(&mut mesh.indices);
    for corners in faces.as_chunks::<3>().0 {
        let [a, b, c] = *corners;
        let split =
            [[a, b], [b, c], [c, a]].map(|edge| middle(&mut mesh, &mut middles, edge, &edge_m));
        divide(&mut mesh.indices, *corners, split);
    }
    mesh
}

/// The triangles of one whose edges, from corner to corner, are split at the given vertices.
fn divide(indices: &mut Vec<u32>, corners: [u32; 3], split: [Option<u32>; 3]) {
    let turned = |from: usize| {
        let index = |k: usize| (from + k) % 3;
        (
            [0, 1, 2].map(|k| corners[index(k)]),
            [0, 1, 2].map(|k| split[index(k)]),
        )
    };
    for from in 0..3 {
        let ([a, b, c], edges) = turned(from);
        match edges {
            [None, None, None] => indices.extend([a, b, c]),
            [Some(ab), Some(bc), Some(ca)] => {
                indices.extend([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca]);
            }
            [Some(ab), None, None] => indices.extend([a, ab, c, ab, b, c]),
            [Some(ab), Some(bc), None] => indices.extend([a, ab, c, ab, bc, c, ab, b, bc]),
            _ => continue,
        }
        return;
    }
}

/// The vertex in the middle of an edge, if that is longer than `edge_m` says.
fn middle(
    mesh: &mut Mesh,
    known: &mut BTreeMap<[u32; 2], Option<u32>>,
    [a, b]: [u32; 2],
    edge_m: impl Fn(&Point3<f64>) -> Option<f64>,
) -> Option<u32> {
    let edge = [a.min(b), a.max(b)];
    *known.entry(edge).or_insert_with(|| {
        let [from, to] = edge.map(|end| Point3::from(mesh.positions[end as usize].map(f64::from)));
        let [left, right] =
            edge.map(|end| Vector3::from(mesh.normals[end as usize].map(f64::from)));
        let along = to - from;
        let straight = from + 0.5 * along;
        if along.norm() <= edge_m(&straight)? {
            return None;
        }
        let lift = (left * along.dot(&left) - right * along.dot(&right)) / 8.0;
        let normal = (left + right).try_normalize(1e-6)?;
        mesh.positions.push(single(&(straight - lift).coords));
        mesh.normals.push(single(&normal));
        Some(count_u32(mesh.positions.len() - 1))
    })
}
