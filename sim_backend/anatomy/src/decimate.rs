//! Decimation by edge collapse with quadric errors (Garland and Heckbert 1997), of the surfaces
//! between all groups at once.
//!
//! Each group's surface stays a closed manifold: an edge collapses only if the link condition holds
//! on the surface of every group at it. Lines where three groups meet collapse along themselves,
//! points where more meet stay. The error is bounded, not estimated: every vertex of the fine
//! surface is kept as a sample of the triangle nearest to it, and no collapse takes a sample
//! farther than the bound from triangles between the same two groups. And no collapse lets a
//! triangle cross another of its part.
//!
//! A complex is cut into slabs along its longest side, each is decimated by itself with the
//! vertices between slabs held (`split`, `state`); they are put together (`merge`) and decimated
//! once more without any held. The samples of the first pass are those of the second, so the bound
//! is not doubled.
//!
//! The bound is one-sided: from the fine vertices to the coarse triangles. How far the coarse
//! surface strays from the fine one between them is not bounded; [`crate::measure`] measures both
//! directions.

mod cells;
mod collapse;
mod quadric;
mod state;

use std::collections::BTreeMap;

use nalgebra::Point3;
use rayon::prelude::*;

use crate::number::{floor_to, index, real};
use crate::surface::complex::Complex;

pub(crate) use cells::crossing_vertices;
use state::State;

/// Triangles of a part that is decimated by itself.
///
/// A patient of 4.4 million fine triangles makes 18 parts, which is work for many cores; larger
/// parts have shorter rims, at which nothing collapses in the first pass.
const PART: usize = 250_000;

/// A complex with the samples of each triangle, and vertices that must stay.
#[derive(Default)]
struct Sampled {
    /// Its triangles and vertices, with numbers of its own.
    complex: Complex,
    /// Vertices of the fine surface, mm. They never move; only the triangle that each belongs to
    /// changes.
    samples: Vec<Point3<f64>>,
    /// The triangle of each sample, one between the same two groups as a fine triangle at it.
    sampled: Vec<u32>,
    /// Whether each vertex is in other parts too.
    locked: Vec<bool>,
    /// Vertices' indices in the whole, where this is a part of it.
    whole: Vec<u32>,
}

/// `complex` with far fewer triangles, none of its vertices farther than `error_mm` from the
/// result's triangles between the same groups.
///
/// Parts run on all cores with the vertices between them kept, then all once more as a whole. The
/// result depends on neither cores nor their timing.
///
/// Most of the time of a build goes here: a trial that has passed the cheap rules looks at all
/// samples of its triangles. Vertices of the result need not be vertices of `complex`.
#[must_use]
pub fn decimate(complex: Complex, error_mm: f64) -> Complex {
    let parts = split(&complex);
    let count = complex.positions.len();
    drop(complex);
    let parts: Vec<Sampled> = parts
        .into_par_iter()
        .map(|part| State::new(part).run(error_mm))
        .collect();
    let whole = merge(parts, count);
    State::new(whole).run(error_mm).complex
}

/// Slabs of about [`PART`] triangles across the longest side, with one sample a vertex.
fn split(complex: &Complex) -> Vec<Sampled> {
    let (low, high) = complex.positions.iter().fold(
        (
            Point3::from([f64::INFINITY; 3]),
            Point3::from([f64::NEG_INFINITY; 3]),
        ),
        |(low, high), p| (low.inf(p), high.sup(p)),
    );
    let axis = (high - low).imax();
    let count = complex.triangles.len().div_ceil(PART);
    let slab = |triangle: &[u32; 3]| {
        let middle = triangle
            .iter()
            .map(|v| complex.positions[*v as usize][axis])
            .sum::<f64>()
            / 3.0;
        let share = (middle - low[axis]) / (high[axis] - low[axis]).max(1e-9);
        floor_to(share * real(count), count.saturating_sub(1))
    };
    let mut lists = vec![Vec::new(); count];
    // The slab of each vertex, or that it has several.
    let mut owners = vec![u32::MAX; complex.positions.len()];
    let mut shared = vec![false; complex.positions.len()];
    for (i, triangle) in complex.triangles.iter().enumerate() {
        let slab = slab(triangle);
        lists[slab].push(i);
        for v in triangle.map(|v| v as usize) {
            shared[v] |= owners[v] != u32::MAX && owners[v] != index(slab);
            owners[v] = index(slab);
        }
    }
    lists
        .par_iter()
        .map(|list| part(complex, list, &shared))
        .collect()
}

/// The triangles of `list` with vertices of their own; a vertex is sampled where it is first met, a
/// shared one in each part.
fn part(complex: &Complex, list: &[usize], shared: &[bool]) -> Sampled {
    let mut vertices: Vec<u32> = list.iter().flat_map(|t| complex.triangles[*t]).collect();
    vertices.sort_unstable();
    vertices.dedup();
    let local = |v: u32| vertices.binary_search(&v).map_or(u32::MAX, index);
    let triangles: Vec<[u32; 3]> = list
        .iter()
        .map(|t| complex.triangles[*t].map(local))
        .collect();
    let positions: Vec<_> = vertices
        .iter()
        .map(|v| complex.positions[*v as usize])
        .collect();
    let mut sampled = vec![u32::MAX; vertices.len()];
    for (triangle, corners) in triangles.iter().enumerate() {
        for v in corners {
            sampled[*v as usize] = index(triangle);
        }
    }
    Sampled {
        samples: positions.clone(),
        sampled,
        locked: vertices.iter().map(|v| shared[*v as usize]).collect(),
        complex: Complex {
            positions,
            triangles,
            sides: list.iter().map(|t| complex.sides[*t]).collect(),
        },
        whole: vertices,
    }
}

/// Parts put together again at the vertices that they share; `count` is how many vertices the whole
/// once had.
fn merge(parts: Vec<Sampled>, count: usize) -> Sampled {
    let mut merged = Sampled::default();
    let mut known = BTreeMap::new();
    for part in parts {
        let first = index(merged.complex.triangles.len());
        let places: Vec<u32> = (0..part.whole.len())
            .map(|v| {
                let mut add = || {
                    merged.complex.positions.push(part.complex.positions[v]);
                    index(merged.complex.positions.len() - 1)
                };
                if part.locked[v] {
                    *known.entry(part.whole[v]).or_insert_with(add)
                } else {
                    add()
                }
            })
            .collect();
        let moved = part
            .complex
            .triangles
            .iter()
            .map(|t| t.map(|v| places[v as usize]));
        merged.complex.triangles.extend(moved);
        merged.complex.sides.extend(part.complex.sides);
        merged.samples.extend(part.samples);
        merged
            .sampled
            .extend(part.sampled.iter().map(|t| t + first));
    }
    assert!(
        merged.complex.positions.len() <= count,
        "decimation adds no vertices"
    );
    merged.locked = vec![false; merged.complex.positions.len()];
    merged.whole = (0..index(merged.complex.positions.len())).collect();
    merged
}
