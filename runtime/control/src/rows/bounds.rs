//! Position, velocity and acceleration of an axis merged into one interval of velocities around
//! zero.

use super::{AxisLimits, RowInput};
use crate::config::ControlConfig;
use crate::motion::{AXES, JAW};
use crate::viability::viable_speed;

/// Share of the distance to a joint limit that the viable speed counts on; the rest is for
/// acceleration under way.
const VIABLE_SHARE: f64 = 0.7;

/// Share of the closing effort from which on the jaw closes more slowly, until it stands still at
/// the whole.
const EFFORT_SHARE: f64 = 0.8;

/// Lowest and highest velocity of each axis of an arm.
pub(super) fn all(config: &ControlConfig, arm: &RowInput<'_>) -> [(f64, f64); AXES] {
    let window_s = config.filter.acceleration_window_s;
    core::array::from_fn(|axis| {
        let (position, velocity) = (arm.state.position[axis], arm.state.velocity[axis]);
        let limits = &config.axes[axis];
        let (low, high) = axis_bounds(limits, position, velocity, window_s, arm.pace);
        if axis == JAW {
            let share = closing_share(arm.jaw_effort_n_m, config.jaw_closing_effort_n_m_max);
            (low * share, high)
        } else {
            (low, high)
        }
    })
}

/// The velocities at which an axis can still stop within its range, is within its speed limit times
/// `pace`, and can be within `window_s`.
///
/// The intersection of three intervals, `[-v, v] * pace`, `[-w(p - low), w(high - p)]` with `w` the
/// [`viable_speed`] of a share of the distance, and `[v_now - a t, v_now + a t]` with `t` the
/// window. The last one is widened to hold zero, so that the result always does.
pub(crate) fn axis_bounds(
    limits: &AxisLimits,
    position: f64,
    velocity: f64,
    window_s: f64,
    pace: f64,
) -> (f64, f64) {
    let reach = limits.acceleration * window_s;
    let viable =
        |distance: f64| viable_speed(VIABLE_SHARE * distance, limits.acceleration, limits.jerk);
    let speed = limits.velocity * pace;
    let low = -viable(position - limits.low).min(speed);
    let high = viable(limits.high - position).min(speed);
    (
        low.max((velocity - reach).min(0.0)),
        high.min((velocity + reach).max(0.0)),
    )
}

/// How much of its closing speed the jaw has left at a measured effort; negative efforts close.
fn closing_share(effort_n_m: f64, closing_effort_n_m_max: f64) -> f64 {
    let left = 1.0 + effort_n_m / closing_effort_n_m_max;
    (left / (1.0 - EFFORT_SHARE)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::closing_share;

    /// The jaw closes more slowly from four fifths of the effort and stops at all of it.
    #[test]
    fn jaw_slows_down_near_its_effort_limit() {
        for (effort, share) in [
            (0.1, 1.0),
            (0.0, 1.0),
            (-0.048, 1.0),
            (-0.054, 0.5),
            (-0.06, 0.0),
            (-0.1, 0.0),
        ] {
            let found = closing_share(effort, 0.06);
            assert!((found - share).abs() < 1e-9, "{effort}: {found}");
        }
    }
}
