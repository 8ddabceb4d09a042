//! A coarse mesh rounded where one works: edges are halved, and their middles put where the normals at both ends say.

use std::collections::BTreeMap;

use hal::Mesh;
use hal::count::count_u32;
use hal::mesh::single;
use nalgebra::{Point3, Vector3};

/// Edges are halved until they are shorter, m.
const EDGE_M: f64 = 0.005;
/// Rounds of halving at most.
const ROUNDS: usize = 4;
/// How far beyond the rectangle, and how far below the patch, it is rounded as well, for its outline, m.
const BEYOND_M: f64 = 0.03;
const DEEP_M: f64 = -0.08;

/// `mesh` (scene frame) with shorter edges over the rectangle of `half_m` about the origin. The middle of an edge is that of the cubic curve
/// that stands on the normals at its ends (Vlachos et al., "Curved PN triangles", 2001), so it depends on the edge alone: what was closed
/// stays closed.
pub(super) fn rounded(mut mesh: Mesh, half_m: [f64; 2]) -> Mesh {
    for _ in 0..ROUNDS {
        let before = mesh.indices.len();
        mesh = halved(mesh, half_m);
        if mesh.indices.len() == before {
            break;
        }
    }
    mesh
}

fn halved(mut mesh: Mesh, half_m: [f64; 2]) -> Mesh {
    let mut middles = BTreeMap::new();
    let faces = std::mem::take(&mut mesh.indices);
    for corners in faces.as_chunks::<3>().0 {
        let [a, b, c] = *corners;
        let split =
            [[a, b], [b, c], [c, a]].map(|edge| middle(&mut mesh, &mut middles, edge, half_m));
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

/// The vertex in the middle of an edge, if that is long and lies where one works.
fn middle(
    mesh: &mut Mesh,
    known: &mut BTreeMap<[u32; 2], Option<u32>>,
    [a, b]: [u32; 2],
    half_m: [f64; 2],
) -> Option<u32> {
    let edge = [a.min(b), a.max(b)];
    *known.entry(edge).or_insert_with(|| {
        let [from, to] = edge.map(|end| Point3::from(mesh.positions[end as usize].map(f64::from)));
        let [left, right] =
            edge.map(|end| Vector3::from(mesh.normals[end as usize].map(f64::from)));
        let along = to - from;
        let straight = from + 0.5 * along;
        let inside = (0..2).all(|axis| straight[axis].abs() <= half_m[axis] + BEYOND_M);
        if along.norm() <= EDGE_M || !inside || straight.z < DEEP_M {
            return None;
        }
        let lift = (left * along.dot(&left) - right * along.dot(&right)) / 8.0;
        let normal = (left + right).try_normalize(1e-6)?;
        mesh.positions.push(single(&(straight - lift).coords));
        mesh.normals.push(single(&normal));
        Some(count_u32(mesh.positions.len() - 1))
    })
}
