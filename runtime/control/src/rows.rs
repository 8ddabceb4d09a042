//! The safety filter's constraints on the velocities of one arm or two, as rows. Hot path: bounded,
//! no allocation, no I/O, no lock.
//!
//! Zero velocity satisfies every row in every state, so that the filter always has an answer:
//! braking is always allowed, and a boundary that has been passed only forbids going further.
//!
//! A row of geometry bounds the speed towards a boundary by its distance (a linear control barrier
//! function): with the unit normal `n` out of the boundary, the point's Jacobian `J` and its
//! distance `h`, `-n' J u <= alpha max(h - margin, 0)`. In continuous time `h - margin` then decays
//! no faster than `exp(-alpha t)`.

mod bounds;
mod geometry;
mod names;
mod pair;
#[cfg(test)]
pub(crate) mod planted;

use hal::count::count_u32;
use nalgebra::SMatrix;

use super::active_set::VARIABLES_MAX;
use super::config::{ControlConfig, FORBIDDEN_MAX, Margins};
use super::deviation::Deviation;
use super::instrument::KinematicState;
use super::motion::{AXES, AxisLimits, MotionState};

pub use names::names;

pub use hal::ARMS_MAX;

/// Most rows of geometry: for each arm three points in the workspace and eight places of the
/// instrument against each region, and between the arms seven pairs of links.
pub const GEOMETRY_MAX: usize = ARMS_MAX * (18 + 8 * FORBIDDEN_MAX) + 7;

/// What the filter keeps beyond the guard's margin and a large deviation, as a share of what it
/// keeps beyond the guard's margin otherwise.
const ROOM_SHARE: f64 = 0.25;

/// Velocities of all axes of all arms, arm by arm.
pub type Velocities = [f64; VARIABLES_MAX];

/// Rows of a Jacobian of three over all axes of all arms.
pub type WideJacobian = [Velocities; 3];

/// `coefficients . u <= bound`, in m/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Per velocity of an axis, m (insertion 1).
    pub coefficients: Velocities,
    /// Highest speed towards the boundary, m/s.
    pub bound: f64,
}

/// `|matrix u| <= limit`: how fast a tip moves (m/s) or turns (rad/s).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedCone {
    /// Velocity of the tip, or its angular velocity, per velocity of an axis.
    pub matrix: WideJacobian,
    /// Highest speed.
    pub limit: f64,
}

/// One arm as its rows see it.
#[derive(Clone, Copy, Debug)]
pub struct RowInput<'a> {
    /// The commanded state.
    pub state: &'a MotionState,
    /// Where that puts the instrument.
    pub stance: &'a KinematicState,
    /// Whether the filter decides about this arm; one that comes to rest is given.
    pub moves: bool,
    /// Measured effort of the jaw, N m; negative closes.
    pub jaw_effort_n_m: f64,
    /// Share of the speed limits that is allowed, 0 to 1.
    pub pace: f64,
    /// How far the measured instrument is from the commanded one, as the guard takes it into
    /// account.
    pub deviation: Deviation,
}

/// All rows of one tick.
#[derive(Clone, Debug)]
pub struct Rows {
    /// Number of axes of all arms.
    pub variables: usize,
    /// Lowest velocities, rad/s (m/s), not above zero.
    ///
    /// Zero in both for an arm that does not move: its variables are fixed.
    pub low: Velocities,
    /// Highest velocities, rad/s (m/s), not below zero.
    pub high: Velocities,
    /// Boundaries in space, always in the same order for the same configuration.
    ///
    /// Arm by arm the workspace (three points of six faces), then the forbidden regions link by
    /// link, then the seven pairs of links. `names` has the same order.
    pub geometry: Vec<Row>,
    /// Speed and angular speed of each tip.
    pub cones: Vec<SpeedCone>,
    /// Highest speed of each axis, by which its tolerance is measured.
    scale: Velocities,
    tip_speed_m_s: f64,
}

impl Rows {
    /// Room for the rows of `config`'s arms; filling them allocates nothing.
    #[must_use]
    pub fn new(config: &ControlConfig) -> Self {
        Self {
            variables: 0,
            low: [0.0; VARIABLES_MAX],
            high: [0.0; VARIABLES_MAX],
            geometry: Vec::with_capacity(GEOMETRY_MAX),
            cones: Vec::with_capacity(2 * ARMS_MAX),
            scale: velocity_scale(config),
            tip_speed_m_s: config.tip_speed_m_s,
        }
    }

    /// The bounds of each axis of `arm`, whose variables begin at `first`.
    fn bound_axes(&mut self, config: &ControlConfig, first: usize, arm: &RowInput<'_>) {
        let low = self.low.iter_mut().skip(first);
        let high = self.high.iter_mut().skip(first);
        for ((low, high), bounds) in low.zip(high).zip(bounds::all(config, arm)) {
            (*low, *high) = bounds;
        }
    }

    /// The rows of `arms`, one or two.
    ///
    /// Replaces what was there; allocates nothing.
    pub fn fill(&mut self, config: &ControlConfig, arms: &[RowInput<'_>]) {
        self.geometry.clear();
        self.cones.clear();
        self.low = [0.0; VARIABLES_MAX];
        self.high = [0.0; VARIABLES_MAX];
        self.variables = AXES * arms.len();
        for (index, (arm, geometry)) in arms.iter().zip(&config.arms).enumerate() {
            let first = AXES * index;
            if arm.moves {
                self.bound_axes(config, first, arm);
            }
            geometry::workspace(self, config, first, arm, &geometry.workspace);
            for region in &geometry.forbidden {
                geometry::region(self, config, first, arm, &region.shape);
            }
            self.speeds(config, first, arm);
        }
        if let ([one, other], [first, second, ..]) = (arms, config.arms.as_slice())
            && let Some(gaps) = &config.between_arms
        {
            let frames = [&first.scene_from_rcm, &second.scene_from_rcm];
            pair::links(self, config, gaps, [one, other], frames);
        }
    }

    /// Two cones an arm: rows 0 to 2 of the tip Jacobian (m/s), then rows 3 to 5 (rad/s), each
    /// below the limit times `speed_fraction` times the pace.
    fn speeds(&mut self, config: &ControlConfig, first: usize, arm: &RowInput<'_>) {
        // The bounds of its axes hold an arm whose pace is zero; a cone of no width would only make
        // the problem harder.
        let pace = if arm.pace > 0.0 { arm.pace } else { 1.0 };
        let share = config.filter.speed_fraction * pace;
        let jacobian = arm.stance.frames.tip_jacobian();
        let mut cone = |from: usize, limit: f64| {
            let mut matrix = [[0.0; VARIABLES_MAX]; 3];
            for (row, wide) in matrix.iter_mut().enumerate() {
                let entries = wide.iter_mut().skip(first);
                for (entry, value) in entries.zip(jacobian.row(from + row).iter()) {
                    *entry = *value;
                }
            }
            let limit = limit * share;
            self.cones.push(SpeedCone { matrix, limit });
        };
        cone(0, config.tip_speed_m_s);
        cone(3, config.tip_angular_speed_rad_s);
    }

    /// Whether `velocity` satisfies every row, joint speeds and tip speeds exceeding by at most
    /// `tolerance` of their limits.
    #[must_use]
    pub fn hold(&self, velocity: &Velocities, tolerance: f64) -> bool {
        let slack_m_s = tolerance * self.tip_speed_m_s;
        self.excesses(velocity)
            .all(|(excess, scale)| excess <= tolerance * scale)
            && self
                .geometry
                .iter()
                .all(|row| row.excess(velocity) <= slack_m_s)
            && self
                .cones
                .iter()
                .all(|cone| cone.speed(velocity) <= cone.limit * (1.0 + tolerance) + 1e-15)
    }

    /// How many rows `velocity` touches, to within `tolerance` of the limits.
    #[must_use]
    pub fn active(&self, velocity: &Velocities, tolerance: f64) -> u32 {
        let slack_m_s = tolerance * self.tip_speed_m_s;
        let bounds = self
            .excesses(velocity)
            .filter(|(excess, scale)| *excess >= -tolerance * scale);
        let geometry = self
            .geometry
            .iter()
            .filter(|row| row.excess(velocity) >= -slack_m_s);
        let cones = self
            .cones
            .iter()
            .filter(|cone| cone.speed(velocity) >= cone.limit * (1.0 - tolerance));
        count_u32(bounds.count() + geometry.count() + cones.count())
    }

    /// How far each axis is beyond its lower and its upper bound, with its scale.
    fn excesses(&self, velocity: &Velocities) -> impl Iterator<Item = (f64, f64)> {
        let bounds = self.low.iter().zip(&self.high).zip(&self.scale);
        velocity
            .iter()
            .zip(bounds)
            .take(self.variables)
            .flat_map(|(v, ((low, high), scale))| [(low - v, *scale), (v - high, *scale)])
    }

    /// Adds a row for one arm, whose axes begin at `first`.
    fn push(&mut self, first: usize, coefficients: &SMatrix<f64, 1, AXES>, bound: f64) {
        let mut wide = [0.0; VARIABLES_MAX];
        for (entry, value) in wide.iter_mut().skip(first).zip(coefficients.iter()) {
            *entry = *value;
        }
        self.geometry.push(Row {
            coefficients: wide,
            bound,
        });
    }
}

impl Row {
    /// `coefficients . u - bound`, m/s; negative within.
    fn excess(&self, velocity: &Velocities) -> f64 {
        dot(&self.coefficients, velocity) - self.bound
    }
}

impl SpeedCone {
    /// The speed at these velocities.
    #[must_use]
    pub fn speed(&self, velocity: &Velocities) -> f64 {
        let squares = self.matrix.iter().map(|row| dot(row, velocity).powi(2));
        squares.sum::<f64>().sqrt()
    }
}

/// The highest speed of each axis of each arm, by which velocities are scaled.
pub(super) fn velocity_scale(config: &ControlConfig) -> Velocities {
    let mut scale = [1.0; VARIABLES_MAX];
    for arm in scale.chunks_exact_mut(AXES) {
        for (scale, axis) in arm.iter_mut().zip(&config.axes) {
            *scale = axis.velocity;
        }
    }
    scale
}

/// The velocity towards a boundary that is `distance_m` away, margin apart, m/s, of a part whose
/// measured place deviates by `deviation_m`.
///
/// The guard keeps its own margin and the deviation. Where these come to more than the filter's
/// margin, the filter keeps them too, with [`ROOM_SHARE`] to spare for stops, which curve:
/// otherwise it would lead the arm where the guard stops it.
fn approach_bound(distance_m: f64, deviation_m: f64, config: &ControlConfig) -> f64 {
    let Margins {
        filter_m, guard_m, ..
    } = config.margins;
    let room_m = ROOM_SHARE * (filter_m - guard_m);
    let margin_m = filter_m.max(guard_m + room_m + deviation_m);
    config.filter.alpha_1_s * (distance_m - margin_m).max(0.0)
}

/// Over all 14 axes; those of a missing arm are zero.
pub(super) fn dot(a: &Velocities, b: &Velocities) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

#[cfg(test)]
pub(super) mod tests;
