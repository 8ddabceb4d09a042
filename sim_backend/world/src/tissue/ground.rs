//! What the sheet rests on: an organ's surface as a table of heights, an elastic bed with friction.

use hal::config::{ConfigError, Source};
use nalgebra::Vector3;
use serde::Deserialize;

use super::sheet::count;

/// Contact parameters of a surface against the sheet.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactParameters {
    /// Pressure for a depth, N/m³.
    pub stiffness_n_m3: f64,
    /// Damping ratio of the sheet's own mass on that spring, while it sinks in.
    pub damping_ratio: f64,
    /// Coulomb friction.
    pub friction: f64,
}

impl ContactParameters {
    /// Checks the ranges of a contact read from `source` at the dotted `key`.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`].
    pub fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        let check = |name: &str, value, low, high| {
            source.check_range(&format!("{key}.{name}"), value, low, high)
        };
        check("stiffness_n_m3", self.stiffness_n_m3, 1e5, 2e8)?;
        check("damping_ratio", self.damping_ratio, 0.0, 1.0)?;
        check("friction", self.friction, 0.0, 2.0)
    }

    /// Damping of a square metre of sheet of `mass_kg_m2`, N s/m³.
    pub(super) fn damping_n_s_m3(&self, mass_kg_m2: f64) -> f64 {
        2.0 * self.damping_ratio * (self.stiffness_n_m3 * mass_kg_m2).sqrt()
    }
}

/// A rectangle of heights over the scene's xy-plane, which may have holes; beyond its rim there is
/// nothing to rest on.
#[derive(Clone, Debug)]
pub struct Ground {
    low_m: [f64; 2],
    spacing_m: [f64; 2],
    points: [usize; 2],
    heights_m: Vec<f64>,
    is_measured: bool,
}

/// The plane that stands for the ground under one node.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    /// A point of it, scene frame, m.
    pub(super) point: Vector3<f64>,
    /// Unit normal, up.
    pub(super) normal: Vector3<f64>,
}

/// How far the table goes on beyond a rim, m.
const SKIRT_M: f64 = 0.015;
/// Distance of the table's points, m, at most.
const SPACING_M: f64 = 0.000_5;

impl Ground {
    /// The surface `height_m(x, y)` over the rectangle from `low_m` to `high_m`, which is round at
    /// its rim: it falls off over a further `rim_m` on all sides and then goes down steeply for 3
    /// cm. (An edge would be a step in the height, which hands energy to what slides over it.)
    #[must_use]
    pub fn sampled(
        low_m: [f64; 2],
        high_m: [f64; 2],
        rim_m: f64,
        height_m: impl Fn(f64, f64) -> f64,
    ) -> Self {
        let inner = [low_m, high_m];
        let low_m = low_m.map(|low| low - rim_m - SKIRT_M);
        let high_m = high_m.map(|high| high + rim_m + SKIRT_M);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a positive count, and casts saturate"
        )]
        let cells = [0, 1].map(|axis| {
            ((high_m[axis] - low_m[axis]) / SPACING_M)
                .ceil()
                .clamp(1.0, CELLS_MAX) as usize
        });
        let spacing_m = [0, 1].map(|axis| (high_m[axis] - low_m[axis]) / count(cells[axis]));
        let points = cells.map(|cells| cells + 1);
        let height = |index: usize| {
            let x = low_m[0] + count(index % points[0]) * spacing_m[0];
            let y = low_m[1] + count(index / points[0]) * spacing_m[1];
            let (inner_x, inner_y) = (
                x.clamp(inner[0][0], inner[1][0]),
                y.clamp(inner[0][1], inner[1][1]),
            );
            let beyond_m = ((x - inner_x).powi(2) + (y - inner_y).powi(2)).sqrt();
            height_m(inner_x, inner_y) - fall_m(beyond_m, rim_m)
        };
        let heights_m = (0..points[0] * points[1]).map(height).collect();
        Self {
            low_m,
            spacing_m,
            points,
            heights_m,
            is_measured: false,
        }
    }

    /// A surface as a table: heights at `points` (x and y) from `low_m` on, `spacing_m` apart, x
    /// first; NaN where there is none.
    ///
    /// # Panics
    /// If there are not as many heights as points.
    #[must_use]
    pub fn table(low_m: [f64; 2], spacing_m: f64, points: [usize; 2], heights_m: Vec<f64>) -> Self {
        assert_eq!(heights_m.len(), points[0] * points[1], "a height a point");
        Self {
            low_m,
            spacing_m: [spacing_m; 2],
            points,
            heights_m,
            is_measured: true,
        }
    }

    /// No ground at all.
    #[must_use]
    pub const fn none() -> Self {
        Self {
            low_m: [0.0; 2],
            spacing_m: [1.0; 2],
            points: [0; 2],
            heights_m: Vec::new(),
            is_measured: false,
        }
    }

    /// Whether its heights were measured: it may be steep where a made up one is nearly level.
    pub(super) const fn is_measured(&self) -> bool {
        self.is_measured
    }

    /// Height of the surface over (`x`, `y`) in the scene, m; none beyond the rectangle.
    #[must_use]
    pub fn height_m(&self, x: f64, y: f64) -> Option<f64> {
        self.plane(x, y).map(|plane| plane.point.z)
    }

    /// Unit normal of the surface there, up.
    #[must_use]
    pub fn normal(&self, x: f64, y: f64) -> Option<Vector3<f64>> {
        self.plane(x, y).map(|plane| plane.normal)
    }

    /// The rectangle over which there is a surface: its lowest and its highest corner, scene x and
    /// y, m.
    #[must_use]
    pub fn extent_m(&self) -> [[f64; 2]; 2] {
        let far = [0, 1].map(|axis| {
            self.low_m[axis] + self.spacing_m[axis] * count(self.points[axis].saturating_sub(1))
        });
        [self.low_m, far]
    }

    /// The tangent plane over (`x`, `y`); none beyond the table and next to a hole in it.
    pub(super) fn plane(&self, x: f64, y: f64) -> Option<Plane> {
        let (i, s) = self.place(0, x)?;
        let (j, t) = self.place(1, y)?;
        let first = j * self.points[0] + i;
        let (a, b) = (self.heights_m[first], self.heights_m[first + 1]);
        let (c, d) = (
            self.heights_m[first + self.points[0]],
            self.heights_m[first + self.points[0] + 1],
        );
        let (low, high) = (a + s * (b - a), c + s * (d - c));
        let slope_x = ((b - a) + t * ((d - c) - (b - a))) / self.spacing_m[0];
        let slope_y = (high - low) / self.spacing_m[1];
        let height_m = low + t * (high - low);
        if height_m.is_nan() {
            return None;
        }
        Some(Plane {
            point: Vector3::new(x, y, height_m),
            normal: Vector3::new(-slope_x, -slope_y, 1.0).normalize(),
        })
    }

    /// Cell and share of it along one axis.
    fn place(&self, axis: usize, value: f64) -> Option<(usize, f64)> {
        let cells = self.points[axis].checked_sub(1)?;
        let at = (value - self.low_m[axis]) / self.spacing_m[axis];
        if !(0.0..=count(cells)).contains(&at) {
            return None;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "inside the table, so small and not negative"
        )]
        let cell = (at as usize).min(cells - 1);
        Some((cell, at - count(cell)))
    }
}

/// How far a rim of radius `rim_m` falls, `beyond_m` from where it begins: a circle down to a steep
/// slope.
fn fall_m(beyond_m: f64, rim_m: f64) -> f64 {
    let round_m = beyond_m.min(STEEP * rim_m);
    let circle_m = rim_m - (rim_m * rim_m - round_m * round_m).sqrt();
    circle_m + (beyond_m - round_m) * STEEP / (1.0 - STEEP * STEEP).sqrt()
}

/// Share of a rim's radius at which its circle goes over into a slope, 64 degrees steep.
const STEEP: f64 = 0.9;

/// Most cells of a table along one axis.
const CELLS_MAX: f64 = 1000.0;
