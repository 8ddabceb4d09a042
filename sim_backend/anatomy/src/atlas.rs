//! Texture coordinates: charts of triangles that face the same of six directions, seen along it,
//! side by side in the unit square.
//!
//! Every triangle keeps at least 58 % of its area. No two overlap: a chart takes a triangle only if
//! it covers none that is there.
//!
//! A triangle goes to the direction of the largest component of its normal `n`. That is at least
//! `1 / sqrt(3)` = 0.577 of its length, which is the bound on the area above (box projection).
//!
//! Charts grow breadth-first over edges from the lowest triangle that has none, so the result
//! depends on the mesh alone. All charts of a mesh are scaled alike, so texel density is even over
//! it; between meshes it differs. Edges between charts are seams: [`crate::texture`] paints by the
//! place in the scan, so colours agree across them.

mod chart;
mod pack;

#[cfg(test)]
mod tests;

use nalgebra::{Point2, Point3};

use crate::mesh::GroupMesh;
use crate::number::single;
use chart::Chart;

/// The direction, of six, that a triangle faces most: twice the axis, plus 1 if backwards.
fn direction([a, b, c]: &[Point3<f64>; 3]) -> usize {
    let normal = (b - a).cross(&(c - a));
    let axis = normal.iamax();
    2 * axis + usize::from(normal[axis] < 0.0)
}

/// `p` as seen by one who looks against `direction`, so that outer sides stay counter-clockwise.
fn seen(p: &Point3<f64>, direction: usize) -> Point2<f64> {
    let (u, v) = match direction / 2 {
        0 => (p.y, p.z),
        1 => (p.z, p.x),
        _ => (p.x, p.y),
    };
    if direction % 2 == 1 {
        Point2::new(v, u)
    } else {
        Point2::new(u, v)
    }
}

/// Triangles that share an edge with each triangle.
fn neighbours(mesh: &GroupMesh) -> Vec<Vec<u32>> {
    let mut neighbours = vec![Vec::new(); mesh.triangles.len()];
    for pair in mesh.edges().chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        for a in pair {
            let others = pair.iter().filter(|b| b.2 != a.2).map(|b| b.2);
            neighbours[a.2 as usize].extend(others);
        }
    }
    neighbours
}

fn charts(mesh: &GroupMesh) -> Vec<Chart> {
    let neighbours = neighbours(mesh);
    let directions: Vec<usize> = (0..mesh.triangles.len())
        .map(|t| direction(&mesh.corners(t)))
        .collect();
    let mut taken = vec![false; mesh.triangles.len()];
    let mut charts = Vec::new();
    for start in 0..mesh.triangles.len() {
        if taken[start] {
            continue;
        }
        let facing = directions[start];
        let mut chart = Chart::new(mesh);
        let mut waiting = std::collections::VecDeque::from([start]);
        while let Some(t) = waiting.pop_front() {
            if taken[t] || directions[t] != facing {
                continue;
            }
            let corners = mesh.corners(t).map(|p| seen(&p, facing));
            if chart.take(t, corners) {
                taken[t] = true;
                waiting.extend(neighbours[t].iter().map(|n| *n as usize));
            }
        }
        charts.push(chart);
    }
    charts
}

/// Gives `mesh` its texture coordinates; the share of the square that is used.
pub fn unwrap(mesh: &mut GroupMesh) -> f64 {
    let charts = charts(mesh);
    let (places, side) = pack::pack(&charts);
    mesh.uv = vec![[[0.0; 2]; 3]; mesh.triangles.len()];
    let mut area = 0.0;
    for (chart, place) in charts.iter().zip(places) {
        for (t, corners) in chart.triangles() {
            let [a, b, c] = corners.map(|p| place.of(&p) / side);
            area += 0.5 * (b - a).perp(&(c - a)).abs();
            mesh.uv[t] = [a, b, c].map(|p| [single(p.x), single(p.y)]);
        }
    }
    area
}
