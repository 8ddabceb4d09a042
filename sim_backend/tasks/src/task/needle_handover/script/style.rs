//! How one demonstration differs from the next: what a person would do a little differently each
//! time.

use nalgebra::Vector3;
use trocar_world::rng::Rng;

use crate::script::motion::Pace;
use crate::script::play::Habits;

/// The habits of one hand during one attempt.
#[derive(Clone, Debug)]
pub(crate) struct Style {
    /// Pace from anywhere to above the needle.
    pub(super) approach: Pace,
    /// Pace around the needle.
    pub(super) descend: Pace,
    /// Pace of the jaw around the wire.
    pub(super) close: Pace,
    /// Pace with the needle in hand.
    pub(super) carry: Pace,
    /// Height of the end of the approach above the grasp, m.
    pub(super) poise_height_m: f64,
    /// Sideways bow of the approach, m.
    pub(super) bow_m: Vector3<f64>,
    /// Where the wire is gripped: angle from the middle of its arc, rad, without sign.
    pub(super) angle_rad: f64,
    /// How far the finger tips reach beyond a wire in the air, m.
    pub(super) beyond_m: f64,
    /// Jaw angle when open, rad.
    pub(super) open_rad: f64,
    /// Jaw command when gripping, rad; below contact.
    pub(super) grip_rad: f64,
    /// Time between the grip and what follows, s.
    pub(super) settle_s: f64,
    /// How far from the agreed place the needle is presented, m.
    pub(super) presented_m: Vector3<f64>,
    /// How far the hand goes in the end, m: outwards and up.
    pub(super) away_m: [f64; 2],
}

impl Habits for Style {
    fn draw(rng: &mut Rng) -> Self {
        let jaw_rate_rad_s = rng.range(2.4, 3.4);
        let pace = |speed_m_s, duration_s_min| Pace {
            speed_m_s,
            jaw_rate_rad_s,
            duration_s_min,
        };
        let mut about = |half: f64| rng.range(-half, half);
        let bow_m = Vector3::new(about(0.003), about(0.003), 0.0);
        let presented_m = Vector3::new(about(0.003), about(0.003), about(0.002));
        Self {
            approach: pace(rng.range(0.036, 0.050), 0.9),
            descend: pace(rng.range(0.018, 0.026), 0.5),
            close: pace(0.02, rng.range(0.45, 0.65)),
            carry: pace(rng.range(0.028, 0.040), 0.8),
            poise_height_m: rng.range(0.010, 0.014),
            bow_m,
            angle_rad: rng.range(0.75, 0.95),
            beyond_m: rng.range(0.001_5, 0.002_2),
            open_rad: rng.range(0.60, 0.75),
            grip_rad: rng.range(-0.18, -0.13),
            settle_s: rng.range(0.12, 0.25),
            presented_m,
            away_m: [rng.range(0.008, 0.014), rng.range(0.010, 0.016)],
        }
    }
}
