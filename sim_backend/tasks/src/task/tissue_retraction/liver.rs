//! The liver under the flap: a slightly wavy plateau with a round rim, and what is drawn around it.

use hal::config::{ConfigError, Source};
use hal::count::count_u32;
use hal::mesh::single;
use hal::{Mesh, Pose};
use nalgebra::Vector3;
use serde::Deserialize;
use trocar_render::shapes::{cuboid, placed};
use trocar_world::organ::OrganShape;
use trocar_world::tissue;

/// A liver that rises from the body.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiverShape {
    /// Lowest corner of the plateau, scene x and y, m.
    pub low_m: [f64; 2],
    /// Highest corner, m.
    pub high_m: [f64; 2],
    /// Radius of the rim around it, m.
    pub rim_m: f64,
    /// Bound on the plateau's distance from z = 0, m.
    pub amplitude_m: f64,
    /// Longest wavelength on it, m.
    pub wavelength_m: f64,
}

/// Distance of the drawn grid's lines on the plateau, m, at most.
const LINES_M: f64 = 0.004;
/// Lines across the rim, and across the slope below it.
const RIM_LINES: u32 = 5;
const SLOPE_LINES: u32 = 3;
/// How far the grid stays inside the ground's table, m.
const INSIDE_M: f64 = 1e-6;
/// Top of the body around the liver, m, and half its size.
const FLOOR_M: f64 = -0.030;
const FLOOR_HALF_M: f64 = 0.25;

impl LiverShape {
    pub(super) fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        for axis in 0..2 {
            let low_m = self.low_m[axis];
            source.check_range(&format!("{key}.low_m.{axis}"), low_m, -0.15, 0.15)?;
            source.check_range(
                &format!("{key}.high_m.{axis}"),
                self.high_m[axis],
                low_m + 0.01,
                low_m + 0.3,
            )?;
        }
        source.check_range(&format!("{key}.rim_m"), self.rim_m, 0.001, 0.02)?;
        source.check_range(&format!("{key}.amplitude_m"), self.amplitude_m, 0.0, 0.005)?;
        source.check_range(&format!("{key}.wavelength_m"), self.wavelength_m, 0.03, 1.0)
    }

    /// The surface for the physics.
    #[must_use]
    pub fn ground(&self) -> tissue::Ground {
        let waves = OrganShape {
            length_m: 1.0,
            width_m: 1.0,
            amplitude_m: self.amplitude_m,
            wavelength_m: self.wavelength_m,
        };
        let height_m = |x, y| waves.height_m(x, y);
        tissue::Ground::sampled(self.low_m, self.high_m, self.rim_m, height_m)
    }

    /// The surface as it is drawn, scene frame: lines close together where it bends.
    pub(super) fn mesh(&self) -> Mesh {
        let ground = self.ground();
        let [low_m, high_m] = ground.extent_m();
        let [xs, ys] = [0, 1].map(|axis| {
            let table_m = [low_m[axis] + INSIDE_M, high_m[axis] - INSIDE_M];
            lines(table_m, [self.low_m[axis], self.high_m[axis]], self.rim_m)
        });
        let mut mesh = Mesh::default();
        for y in &ys {
            for x in &xs {
                #[expect(clippy::expect_used, reason = "the lines end within the ground")]
                let (height_m, normal) = ground
                    .height_m(*x, *y)
                    .zip(ground.normal(*x, *y))
                    .expect("a line of the ground");
                mesh.positions.push(single(&Vector3::new(*x, *y, height_m)));
                mesh.normals.push(single(&normal));
            }
        }
        mesh.indices = triangles([xs.len(), ys.len()].map(count_u32));
        mesh
    }

    /// The body around it, as it is drawn, scene frame.
    pub(super) fn floor(&self) -> Mesh {
        let half_m = Vector3::new(FLOOR_HALF_M, FLOOR_HALF_M, 0.005);
        let pose = Pose::translation(0.0, 0.0, FLOOR_M - half_m.z);
        placed(cuboid(half_m), &pose)
    }
}

/// Two triangles for each cell of a lattice of vertices, row by row.
fn triangles([columns, rows]: [u32; 2]) -> Vec<u32> {
    let mut indices = Vec::new();
    for row in 1..rows {
        for column in 1..columns {
            let there = row * columns + column;
            let here = there - columns - 1;
            indices.extend([here, here + 1, there, here, there, there - 1]);
        }
    }
    indices
}

/// Places of the grid's lines along one axis: over the slope, the rim, the plateau, and down again.
fn lines(table_m: [f64; 2], plateau_m: [f64; 2], rim_m: f64) -> Vec<f64> {
    let stretch = |from: f64, to: f64, count: u32| {
        (0..count).map(move |index| from + (to - from) * (f64::from(index) / f64::from(count)))
    };
    let [low, high] = plateau_m;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "at most 75"
    )]
    let across = ((high - low) / LINES_M).ceil() as u32;
    stretch(table_m[0], low - rim_m, SLOPE_LINES)
        .chain(stretch(low - rim_m, low, RIM_LINES))
        .chain(stretch(low, high, across))
        .chain(stretch(high, high + rim_m, RIM_LINES))
        .chain(stretch(high + rim_m, table_m[1], SLOPE_LINES))
        .chain([table_m[1]])
        .collect()
}
