//! Base-colour textures: what tissue looks like near by, painted over a mesh's UV square.
//!
//! A colour depends on the place in the scan, so it goes on across seams, and neighbours that share
//! a surface share their pattern.

mod noise;

#[cfg(test)]
mod tests;

use image::{ExtendedColorType, ImageEncoder as _, ImageError, codecs::png::PngEncoder};
use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;

use crate::groups::{Group, Pattern};
use crate::mesh::GroupMesh;
use crate::number::{floor_to, real};
use noise::{domain_warped, fractal, noise, smoothstep, worley};

/// Smallest and largest side, pixels.
pub const SIDE_PX: [u32; 2] = [16, 2048];

/// Dark blood in the vessels of a serosa, linear RGB.
const BLOOD: [f64; 3] = [0.24, 0.015, 0.015];
/// How far charts are dilated, pixels: for filters, and two levels of mipmaps.
const DILATION_PX: usize = 4;

/// Widths of vessels, as shares of the distance between them; distances, mm; and how much blood
/// shows.
const VESSELS: [(f64, f64, f64); 2] = [(0.06, 13.0, 0.75), (0.05, 5.0, 0.45)];

impl Pattern {
    /// The colour of tissue of `base` colour at `p`, mm, linear RGB.
    fn colour(self, base: [f64; 3], p: &Point3<f64>) -> [f64; 3] {
        let shaded = |shade: f64| base.map(|channel| (channel * shade).clamp(0.0, 1.0));
        match self {
            Self::Parenchyma => {
                let (near, second) = worley(&(p / 1.7), 11);
                let border = smoothstep(second - near, 0.14);
                let shade = 1.0 + 0.32 * fractal(&(p / 11.0), 12) + 0.16 * fractal(&(p / 2.1), 13);
                shaded(shade * (0.86 + 0.16 * border))
            }
            Self::Serosa => {
                let shade = 1.0 + 0.14 * fractal(&(p / 10.0), 21) + 0.05 * noise(&(p / 1.3), 22);
                let mut colour = shaded(shade);
                for (seed, (width, apart_mm, much)) in (100..).step_by(100).zip(VESSELS) {
                    // A surface where noise changes its sign cuts the organ's in lines; not all of
                    // them are vessels.
                    let winding = domain_warped(&(p / apart_mm), 0.5, seed + 2);
                    let line = 1.0 - smoothstep(noise(&winding, seed).abs(), width);
                    let there = smoothstep(noise(&(p / (2.5 * apart_mm)), seed + 1) + 0.25, 0.3);
                    let share = much * line * there;
                    for (channel, blood) in colour.iter_mut().zip(BLOOD) {
                        *channel += share * (blood - *channel);
                    }
                }
                colour
            }
            Self::Muscle => {
                let along = Vector3::new(1.0, 1.0, 0.07);
                let fibre = |size_mm: f64| Point3::from(p.coords.component_mul(&along) / size_mm);
                let strands = 0.24 * noise(&fibre(1.6), 31) + 0.16 * noise(&fibre(0.6), 32);
                shaded(1.0 + strands + 0.10 * fractal(&(p / 14.0), 33))
            }
            Self::Bone => {
                shaded(1.0 + 0.10 * fractal(&(p / 6.0), 41) + 0.05 * fractal(&(p / 1.2), 42))
            }
            Self::Plain => {
                shaded(1.0 + 0.08 * fractal(&(p / 9.0), 51) + 0.03 * noise(&(p / 1.1), 52))
            }
        }
    }
}

/// Where each pixel of a square of `side` lies on `mesh`, mm, row by row from the top; none where
/// no triangle is.
fn places(mesh: &GroupMesh, side: usize) -> Vec<Option<Point3<f64>>> {
    let mut places = vec![None; side * side];
    for (triangle, uv) in mesh.uv.iter().enumerate() {
        let corners = mesh.corners(triangle);
        // In pixels, rows downwards.
        let flat = uv.map(|[u, v]| {
            Point2::new(f64::from(u), 1.0 - f64::from(v)) * real(side) - Vector3::repeat(0.5).xy()
        });
        let area = (flat[1] - flat[0]).perp(&(flat[2] - flat[0]));
        if area == 0.0 {
            continue;
        }
        let range = |axis: usize| {
            let low = flat.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
            let high = flat
                .iter()
                .map(|p| p[axis])
                .fold(f64::NEG_INFINITY, f64::max);
            floor_to(low.ceil().max(0.0), side)..floor_to(high.floor().max(-1.0) + 1.0, side)
        };
        for row in range(1) {
            for column in range(0) {
                let at = Point2::new(real(column), real(row));
                let shares = [[1, 2], [2, 0], [0, 1]]
                    .map(|[i, j]| (flat[i] - at).perp(&(flat[j] - at)) / area);
                if shares.iter().all(|share| *share >= -1e-9) {
                    let place = corners
                        .iter()
                        .zip(shares)
                        .map(|(p, share)| p.coords * share);
                    places[row * side + column] = Some(Point3::from(place.sum::<Vector3<f64>>()));
                }
            }
        }
    }
    places
}

/// Dilates the charts by a pixel.
fn dilate(pixels: &mut [Option<[u8; 3]>], side: usize) {
    let before = pixels.to_vec();
    let at = |column: usize, row: usize| before.get(row * side + column).copied().flatten();
    for row in 0..side {
        for column in 0..side {
            let beside = || {
                let right = (column + 1 < side).then(|| at(column + 1, row));
                let left = column.checked_sub(1).map(|column| at(column, row));
                let below = at(column, row + 1);
                let above = row.checked_sub(1).and_then(|row| at(column, row));
                right.flatten().or(left.flatten()).or(below).or(above)
            };
            let pixel = &mut pixels[row * side + column];
            *pixel = pixel.or_else(beside);
        }
    }
}

/// A linear colour as sRGB has it in 8 bits.
fn encoded(colour: [f64; 3]) -> [u8; 3] {
    colour.map(|linear| {
        let share = if linear <= 0.003_130_8 {
            12.92 * linear
        } else {
            1.055 * linear.powf(1.0 / 2.4) - 0.055
        };
        u8::try_from(floor_to((255.0 * share + 0.5).max(0.0), 255)).unwrap_or(u8::MAX)
    })
}

/// The texture of `side` by `side` pixels of `mesh`, a mesh of `group`, as PNG: sRGB, the first row
/// at v = 1.
///
/// # Errors
/// [`ImageError`] if it can't be encoded.
///
/// # Panics
/// If `mesh` has no texture coordinates.
pub fn png(group: &Group, mesh: &GroupMesh, side: u32) -> Result<Vec<u8>, ImageError> {
    assert_eq!(
        mesh.uv.len(),
        mesh.triangles.len(),
        "a mesh without an atlas"
    );
    let length = side as usize;
    let painted = |place: &Option<Point3<f64>>| {
        let place = place.as_ref()?;
        Some(encoded(group.pattern.colour(group.colour, place)))
    };
    let mut pixels: Vec<Option<[u8; 3]>> = places(mesh, length).par_iter().map(painted).collect();
    for _ in 0..DILATION_PX {
        dilate(&mut pixels, length);
    }
    let elsewhere = encoded(group.colour);
    let bytes: Vec<u8> = pixels
        .into_iter()
        .flat_map(|pixel| pixel.unwrap_or(elsewhere))
        .collect();
    let mut png = Vec::new();
    PngEncoder::new(&mut png).write_image(&bytes, side, side, ExtendedColorType::Rgb8)?;
    Ok(png)
}
