//! How one demonstration differs from the next: what a person would do a little differently each
//! time.

use nalgebra::Vector3;
use trocar_world::rng::Rng;

use crate::script::motion::Pace;
use crate::script::play::Habits;

/// The habits of one attempt.
#[derive(Clone, Debug)]
pub(crate) struct Style {
    /// Pace from anywhere to above the block.
    pub(super) approach: Pace,
    /// Time that the block is looked at before the way down to it, s.
    pub(super) aim_s: f64,
    /// Pace down to the block.
    pub(super) descend: Pace,
    /// Pace of the jaw around the wall.
    pub(super) close: Pace,
    /// Pace with the block up and across.
    pub(super) carry: Pace,
    /// Pace with the block down, and of the hand up again.
    pub(super) lower: Pace,
    /// Height of the end of the approach above the grasp, m.
    pub(super) poise_height_m: f64,
    /// Sideways bow of the approach, m.
    pub(super) bow_m: Vector3<f64>,
    /// Sideways bow of the way to the goal, m.
    pub(super) detour_m: Vector3<f64>,
    /// Distance of the grasp from the middle of the side, along the side, m.
    pub(super) along_m: f64,
    /// How far the fingers reach below the block's top, m.
    pub(super) depth_m: f64,
    /// Jaw angle when open, rad.
    pub(super) open_rad: f64,
    /// Jaw command when gripping, rad; below contact.
    pub(super) grip_rad: f64,
    /// Time between the grip and the lift, s.
    pub(super) settle_s: f64,
    /// Height of the block above the pegs on its way, m.
    pub(super) clear_m: f64,
    /// Height of the block above the board when it is let go, m.
    pub(super) drop_m: f64,
    /// Height of the last rise, m.
    pub(super) rise_m: f64,
}

impl Habits for Style {
    fn draw(rng: &mut Rng) -> Self {
        let jaw_rate_rad_s = rng.range(1.6, 2.4);
        let pace = |speed_m_s, duration_s_min| Pace {
            speed_m_s,
            jaw_rate_rad_s,
            duration_s_min,
        };
        Self {
            approach: pace(rng.range(0.036, 0.050), 0.9),
            aim_s: rng.range(0.3, 0.6),
            descend: pace(rng.range(0.010, 0.014), 0.8),
            close: pace(0.02, rng.range(0.40, 0.60)),
            carry: pace(rng.range(0.028, 0.042), 0.8),
            lower: pace(rng.range(0.016, 0.024), 0.8),
            poise_height_m: rng.range(0.009, 0.014),
            bow_m: Vector3::new(
                rng.range(-0.003, 0.003),
                rng.range(-0.003, 0.003),
                rng.range(0.0, 0.003),
            ),
            detour_m: Vector3::new(
                rng.range(-0.004, 0.004),
                rng.range(-0.004, 0.004),
                rng.range(0.0, 0.003),
            ),
            along_m: rng.range(-0.000_4, 0.000_4),
            depth_m: rng.range(0.003_4, 0.004_2),
            open_rad: rng.range(0.21, 0.24),
            grip_rad: rng.range(-0.18, -0.13),
            settle_s: rng.range(0.08, 0.2),
            clear_m: rng.range(0.003, 0.006),
            drop_m: rng.range(0.000_6, 0.001_5),
            rise_m: rng.range(0.018, 0.026),
        }
    }
}
