//! How one demonstration differs from the next: what a person would do a little differently each
//! time.

use nalgebra::Vector3;
use trocar_world::rng::Rng;

use crate::script::motion::Pace;
use crate::script::play::Habits;

/// The habits of one demonstration, drawn once from its seed.
#[derive(Clone, Debug)]
pub(crate) struct Style {
    /// Pace from the start to above the needle.
    pub(super) approach: Pace,
    /// Pace from there down to the needle.
    pub(super) descend: Pace,
    /// Pace of the jaw around the needle.
    pub(super) close: Pace,
    /// Pace of the lift.
    pub(super) lift: Pace,
    /// Height of the poise above the grasp, m.
    pub(super) poise_height_m: f64,
    /// Sideways error of the poise in the scene's x and y, m; taken back on the way down.
    pub(super) poise_offset_m: Vector3<f64>,
    /// Time spent above the needle, s.
    pub(super) poise_s: f64,
    /// Sideways bow of the approach, m.
    pub(super) bow_m: Vector3<f64>,
    /// Distance of the grasp from the middle of the wire, along the wire, m.
    pub(super) along_m: f64,
    /// Jaw angle when open, rad.
    pub(super) open_rad: f64,
    /// Jaw command when gripping, rad; below contact.
    pub(super) grip_rad: f64,
    /// Time between the grip and the lift, s.
    pub(super) settle_s: f64,
    /// Height of the lift, m.
    pub(super) lift_height_m: f64,
}

impl Habits for Style {
    fn draw(rng: &mut Rng) -> Self {
        let jaw_rate_rad_s = rng.range(2.4, 3.4);
        let pace = |speed_m_s, duration_s_min| Pace {
            speed_m_s,
            jaw_rate_rad_s,
            duration_s_min,
        };
        let approach = pace(rng.range(0.036, 0.050), 0.9);
        let descend = pace(rng.range(0.018, 0.026), 0.5);
        let close = pace(0.02, rng.range(0.45, 0.65));
        let lift = pace(rng.range(0.028, 0.040), 0.8);
        let bow_m = Vector3::new(
            rng.range(-0.003, 0.003),
            rng.range(-0.003, 0.003),
            rng.range(0.0, 0.003),
        );
        let poise_s = if rng.chance(0.5) {
            rng.range(0.0, 0.25)
        } else {
            0.0
        };
        Self {
            approach,
            descend,
            close,
            lift,
            poise_height_m: rng.range(0.009, 0.014),
            poise_offset_m: Vector3::new(rng.range(-0.001, 0.001), rng.range(-0.0015, 0.0015), 0.0),
            poise_s,
            bow_m,
            along_m: rng.range(-0.0008, 0.0008),
            open_rad: rng.range(0.60, 0.75),
            grip_rad: rng.range(-0.18, -0.13),
            settle_s: rng.range(0.08, 0.2),
            lift_height_m: rng.range(0.034, 0.038),
        }
    }
}
