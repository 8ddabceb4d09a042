//! How one demonstration differs from the next: what a person would do a little differently each
//! time.

use nalgebra::Vector3;
use trocar_world::rng::Rng;

use crate::script::motion::Pace;
use crate::script::play::Habits;

/// The habits of one attempt.
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
    /// Pace through the hole.
    pub(super) drive: Pace,
    /// Height of the end of the approach above the grasp, m.
    pub(super) poise_height_m: f64,
    /// Sideways bow of the approach, m.
    pub(super) bow_m: Vector3<f64>,
    /// Detour of the way along the lip, m: up and away from it.
    pub(super) detour_m: Vector3<f64>,
    /// Distance of the grasp from the middle of the wire, along the wire, m.
    pub(super) along_m: f64,
    /// Jaw angle when open, rad.
    pub(super) open_rad: f64,
    /// Jaw command when gripping, rad; below contact.
    pub(super) grip_rad: f64,
    /// Time between the grip and the lift, s.
    pub(super) settle_s: f64,
    /// How far before the lip the needle is turned, m.
    pub(super) aside_m: f64,
    /// Angle of the needle's point about its arc's centre before the drive, from the plane of the
    /// lip, rad.
    pub(super) ready_rad: f64,
    /// That angle at the end of the drive, rad.
    pub(super) driven_rad: f64,
}

impl Habits for Style {
    fn draw(rng: &mut Rng) -> Self {
        let jaw_rate_rad_s = rng.range(2.4, 3.4);
        let pace = |speed_m_s, duration_s_min| Pace {
            speed_m_s,
            jaw_rate_rad_s,
            duration_s_min,
        };
        Self {
            approach: pace(rng.range(0.036, 0.050), 0.9),
            descend: pace(rng.range(0.018, 0.026), 0.5),
            close: pace(0.02, rng.range(0.45, 0.65)),
            carry: pace(rng.range(0.026, 0.038), 0.8),
            drive: pace(rng.range(0.012, 0.018), 1.5),
            poise_height_m: rng.range(0.009, 0.014),
            bow_m: Vector3::new(
                rng.range(-0.003, 0.003),
                rng.range(-0.003, 0.003),
                rng.range(0.0, 0.003),
            ),
            detour_m: Vector3::new(0.0, rng.range(-0.003, 0.0), rng.range(0.0, 0.004)),
            along_m: rng.range(-0.0008, 0.0008),
            open_rad: rng.range(0.60, 0.75),
            grip_rad: rng.range(-0.18, -0.13),
            settle_s: rng.range(0.08, 0.2),
            aside_m: rng.range(0.021, 0.024),
            ready_rad: rng.range(-0.40, -0.33),
            driven_rad: rng.range(0.73, 0.80),
        }
    }
}
