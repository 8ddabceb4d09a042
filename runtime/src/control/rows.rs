//! What the safety filter asks of a joint velocity, as rows. Hot path: bounded, no allocation, no I/O, no lock.
//!
//! Zero velocity satisfies every row in every state, so that the filter always has an answer: braking is always allowed, and a
//! boundary that has been passed asks only not to go further.

use hal::joints::INSERTION;
use hal::psm::SHAFT_RADIUS_M;
use hal::{JOINT_COUNT, JointVector};
use nalgebra::{Matrix3x6, Vector3};

use super::config::{ControlConfig, FORBIDDEN_MAX, FilterConfig, Geometry};
use super::motion::{AxisLimits, MotionState};
use super::viability::viable_speed;
use crate::kinematics::Frames;

/// Workspace planes for the control point and the finger tips, and three links against each forbidden sphere.
pub const GEOMETRY_ROWS: usize = 12 + 3 * FORBIDDEN_MAX;

/// Share of the distance to a joint limit that the viable speed counts on; the rest is for acceleration under way.
const VIABLE_SHARE: f64 = 0.7;

/// `coefficients . u <= bound`, in m/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Per joint velocity, m (insertion 1).
    pub coefficients: JointVector,
    /// Highest speed towards the boundary, m/s.
    pub bound: f64,
}

/// All rows of one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rows {
    /// Lowest joint velocities, rad/s (m/s), not above zero.
    pub low: JointVector,
    /// Highest joint velocities, rad/s (m/s), not below zero.
    pub high: JointVector,
    /// Boundaries in space.
    pub geometry: [Row; GEOMETRY_ROWS],
    /// Velocity of the control point per joint velocity.
    pub tip: Matrix3x6<f64>,
    /// Highest speed of the control point, m/s.
    pub tip_speed_m_s: f64,
}

/// Which of the joints move a point.
#[derive(Clone, Copy)]
enum Link {
    Shaft,
    Wrist,
    Fingers,
}

impl Rows {
    /// The rows at the commanded `state`, whose axes and points are `frames`.
    #[must_use]
    pub fn new(config: &ControlConfig, state: &MotionState, frames: &Frames) -> Self {
        let filter = &config.filter;
        let nothing = Row {
            coefficients: JointVector::zeros(),
            bound: config.tip_speed_m_s,
        };
        let mut geometry = [nothing; GEOMETRY_ROWS];
        let (planes, spheres) = geometry.split_at_mut(12);
        let points = [
            (frames.tip_m, Link::Wrist),
            (frames.finger_m, Link::Fingers),
        ];
        for (rows, (point_m, link)) in planes.chunks_exact_mut(6).zip(points) {
            workspace_rows(
                rows,
                &config.geometry,
                filter,
                point_m,
                &point_jacobian(frames, point_m, link),
            );
        }
        for (rows, sphere) in spheres.chunks_exact_mut(3).zip(&config.geometry.forbidden) {
            let keep_m = sphere.radius_m + SHAFT_RADIUS_M + filter.margin_m;
            sphere_rows(rows, frames, filter, sphere.center_m, keep_m);
        }
        let bounds = |joint: usize| {
            let window_s = filter.acceleration_window_s;
            joint_bounds(
                &config.axes[joint],
                state.position[joint],
                state.velocity[joint],
                window_s,
            )
        };
        Self {
            low: JointVector::from_fn(|joint, _| bounds(joint).0),
            high: JointVector::from_fn(|joint, _| bounds(joint).1),
            geometry,
            tip: point_jacobian(frames, frames.tip_m, Link::Wrist),
            tip_speed_m_s: config.tip_speed_m_s * filter.tip_speed_fraction,
        }
    }

    /// Whether `velocity` satisfies every row, joint speeds and tip speeds exceeding by at most `tolerance` of their limits.
    #[must_use]
    pub fn hold(&self, velocity: &JointVector, scale: &JointVector, tolerance: f64) -> bool {
        let tip_tolerance_m_s = tolerance * self.tip_speed_m_s;
        (0..JOINT_COUNT).all(|joint| {
            let slack = tolerance * scale[joint];
            velocity[joint] >= self.low[joint] - slack
                && velocity[joint] <= self.high[joint] + slack
        }) && self
            .geometry
            .iter()
            .all(|row| row.coefficients.dot(velocity) <= row.bound + tip_tolerance_m_s)
            && (self.tip * velocity).norm() <= self.tip_speed_m_s + tip_tolerance_m_s
    }

    /// How many rows `velocity` touches, to within `tolerance` of the limits.
    #[must_use]
    pub fn active(&self, velocity: &JointVector, scale: &JointVector, tolerance: f64) -> u32 {
        let tip_tolerance_m_s = tolerance * self.tip_speed_m_s;
        let mut count = 0;
        for joint in 0..JOINT_COUNT {
            let slack = tolerance * scale[joint];
            count += u32::from(velocity[joint] <= self.low[joint] + slack);
            count += u32::from(velocity[joint] >= self.high[joint] - slack);
        }
        for row in &self.geometry {
            count += u32::from(row.coefficients.dot(velocity) >= row.bound - tip_tolerance_m_s);
        }
        count + u32::from((self.tip * velocity).norm() >= self.tip_speed_m_s - tip_tolerance_m_s)
    }
}

/// Velocity, acceleration and viability of one joint merged into one interval around zero.
fn joint_bounds(limits: &AxisLimits, position: f64, velocity: f64, window_s: f64) -> (f64, f64) {
    let reach = limits.acceleration * window_s;
    let viable =
        |distance: f64| viable_speed(VIABLE_SHARE * distance, limits.acceleration, limits.jerk);
    let low = -viable(position - limits.low).min(limits.velocity);
    let high = viable(limits.high - position).min(limits.velocity);
    (
        low.max((velocity - reach).min(0.0)),
        high.min((velocity + reach).max(0.0)),
    )
}

/// Velocity of a point of `link` per joint velocity.
fn point_jacobian(frames: &Frames, point_m: Vector3<f64>, link: Link) -> Matrix3x6<f64> {
    let from_wrist = point_m - frames.wrist_m;
    let from_tip = point_m - frames.tip_m;
    let zero = Vector3::zeros();
    let (wrist, fingers) = match link {
        Link::Shaft => (false, false),
        Link::Wrist => (true, false),
        Link::Fingers => (true, true),
    };
    Matrix3x6::from_columns(&[
        frames.yaw_axis.cross(&point_m),
        frames.pitch_axis.cross(&point_m),
        frames.shaft,
        if wrist {
            frames.shaft.cross(&from_wrist)
        } else {
            zero
        },
        if wrist {
            frames.wrist_pitch_axis.cross(&from_wrist)
        } else {
            zero
        },
        if fingers {
            frames.wrist_yaw_axis.cross(&from_tip)
        } else {
            zero
        },
    ])
}

fn approach_bound(distance_m: f64, filter: &FilterConfig) -> f64 {
    filter.alpha_1_s * distance_m.max(0.0)
}

fn workspace_rows(
    rows: &mut [Row],
    geometry: &Geometry,
    filter: &FilterConfig,
    point_m: Vector3<f64>,
    jacobian: &Matrix3x6<f64>,
) {
    for (axis, pair) in rows.chunks_exact_mut(2).enumerate() {
        let along = jacobian.row(axis).transpose();
        let below_m = point_m[axis] - geometry.workspace_min_m[axis] - filter.margin_m;
        let above_m = geometry.workspace_max_m[axis] - point_m[axis] - filter.margin_m;
        pair[0] = Row {
            coefficients: -along,
            bound: approach_bound(below_m, filter),
        };
        pair[1] = Row {
            coefficients: along,
            bound: approach_bound(above_m, filter),
        };
    }
}

fn sphere_rows(
    rows: &mut [Row],
    frames: &Frames,
    filter: &FilterConfig,
    center_m: Vector3<f64>,
    keep_m: f64,
) {
    let links = [
        (Vector3::zeros(), frames.wrist_m, Link::Shaft),
        (frames.wrist_m, frames.tip_m, Link::Wrist),
        (frames.tip_m, frames.finger_m, Link::Fingers),
    ];
    for (row, (from_m, to_m, link)) in rows.iter_mut().zip(links) {
        let along = to_m - from_m;
        let fraction = ((center_m - from_m).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
        let nearest_m = from_m + along * fraction;
        let away = nearest_m - center_m;
        let distance_m = away.norm();
        // At the very centre every direction leads out; take the one to the remote centre.
        let normal = if distance_m > 1e-9 {
            away / distance_m
        } else {
            -frames.shaft
        };
        let mut coefficients = -(point_jacobian(frames, nearest_m, link).transpose() * normal);
        // The shaft's end at the remote centre stays there whatever the insertion does.
        if matches!(link, Link::Shaft) {
            coefficients[INSERTION] *= fraction;
        }
        *row = Row {
            coefficients,
            bound: approach_bound(distance_m - keep_m, filter),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::{GEOMETRY_ROWS, Rows};
    use crate::control::config::ControlConfig;
    use crate::control::motion::{AXES, MotionState};
    use crate::control::random::SplitMix64;
    use crate::kinematics::Frames;
    use hal::JointVector;

    fn config() -> ControlConfig {
        ControlConfig::load(
            &ControlConfig::default_control(),
            &ControlConfig::needle_lift_safety(),
        )
        .unwrap()
    }

    fn random_state(random: &mut SplitMix64, config: &ControlConfig) -> MotionState {
        let position = core::array::from_fn(|axis| {
            random.between(config.axes[axis].low - 0.01, config.axes[axis].high + 0.01)
        });
        let velocity = core::array::from_fn(|axis| {
            random.between(-config.axes[axis].velocity, config.axes[axis].velocity)
        });
        MotionState {
            position,
            velocity,
            acceleration: [0.0; AXES],
        }
    }

    #[test]
    fn zero_velocity_satisfies_every_row_everywhere() {
        let config = config();
        let mut random = SplitMix64::new(21);
        let scale = JointVector::from_fn(|joint, _| config.axes[joint].velocity);
        for case in 0..20_000 {
            let state = random_state(&mut random, &config);
            let rows = Rows::new(&config, &state, &Frames::at(&state.joints()));
            assert!(
                rows.hold(&JointVector::zeros(), &scale, 0.0),
                "case {case}: {state:?}"
            );
        }
    }

    #[test]
    fn every_geometry_row_is_the_rate_of_its_distance() {
        let config = config();
        let mut random = SplitMix64::new(22);
        let step = 1e-6;
        // With alpha 1 and no margin the bound is the distance itself, while it is positive.
        let mut plain = config.clone();
        plain.filter.alpha_1_s = 1.0;
        plain.filter.margin_m = 0.0;
        let mut compared = 0_u32;
        for _ in 0..2_000 {
            let mut state = random_state(&mut random, &config);
            let velocity = JointVector::from_fn(|_, _| random.between(-1.0, 1.0));
            let here = Rows::new(&plain, &state, &Frames::at(&state.joints()));
            for joint in 0..hal::JOINT_COUNT {
                state.position[joint] += step * velocity[joint];
            }
            let there = Rows::new(&plain, &state, &Frames::at(&state.joints()));
            for index in 0..GEOMETRY_ROWS {
                let (before, after) = (here.geometry[index], there.geometry[index]);
                if before.bound > 1e-4 && before.coefficients.norm() > 0.0 {
                    let rate = (after.bound - before.bound) / step;
                    let predicted = -before.coefficients.dot(&velocity);
                    assert!(
                        (rate - predicted).abs() < 2e-4,
                        "row {index}: {rate} {predicted}"
                    );
                    compared += 1;
                }
            }
        }
        assert!(compared > 10_000, "{compared}");
    }
}
