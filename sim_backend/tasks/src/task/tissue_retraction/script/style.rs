//! How one demonstration differs from the next: what a person would do a little differently each
//! time.

use nalgebra::Vector3;
use trocar_world::rng::Rng;

use crate::script::motion::Pace;
use crate::script::play::Habits;

/// The habits of one demonstration, drawn once from its seed.
#[derive(Clone, Debug)]
pub(crate) struct Style {
    /// Pace from the start to before the edge.
    pub(super) approach: Pace,
    /// Pace from there over and under the edge.
    pub(super) enter: Pace,
    /// Pace of the jaw around the flap.
    pub(super) close: Pace,
    /// Pace of the lift.
    pub(super) lift: Pace,
    /// Distance of the poise before the grasp, m.
    pub(super) poise_m: f64,
    /// Error of the poise along the scene's x and z, m; taken back on the way in.
    pub(super) poise_offset_m: Vector3<f64>,
    /// Sideways bow of the approach, m.
    pub(super) bow_m: Vector3<f64>,
    /// Distance of the grasp from the mark, along the edge, m.
    pub(super) along_m: f64,
    /// How far the ends of the fingers reach past the free edge, over twice the mark's distance
    /// from it.
    pub(super) over: f64,
    /// How far the jaw points down from level, rad.
    pub(super) tilt_rad: f64,
    /// Jaw angle when open, rad.
    pub(super) open_rad: f64,
    /// Jaw command when holding, rad; so far below contact that the tissue is squeezed with about 2
    /// N, not with all that the drive has.
    pub(super) grip_rad: f64,
    /// Time between the hold and the lift, s.
    pub(super) settle_s: f64,
    /// Height of the lift, m.
    pub(super) lift_height_m: f64,
    /// How far the lift goes towards the attached edge, over its height.
    pub(super) lean: f64,
}

impl Habits for Style {
    fn draw(rng: &mut Rng) -> Self {
        let jaw_rate_rad_s = rng.range(2.0, 3.0);
        let pace = |speed_m_s, duration_s_min| Pace {
            speed_m_s,
            jaw_rate_rad_s,
            duration_s_min,
        };
        Self {
            approach: pace(rng.range(0.034, 0.048), 0.9),
            enter: pace(rng.range(0.016, 0.024), 0.5),
            close: pace(0.02, rng.range(0.5, 0.7)),
            lift: pace(rng.range(0.020, 0.030), 0.8),
            poise_m: rng.range(0.010, 0.015),
            poise_offset_m: Vector3::new(
                rng.range(-0.0015, 0.0015),
                0.0,
                rng.range(-0.0005, 0.0015),
            ),
            bow_m: Vector3::new(
                rng.range(-0.003, 0.003),
                rng.range(-0.002, 0.0),
                rng.range(0.0, 0.003),
            ),
            along_m: rng.range(-0.0008, 0.0008),
            over: rng.range(0.80, 0.95),
            tilt_rad: rng.range(-0.05, 0.10),
            open_rad: rng.range(0.58, 0.70),
            grip_rad: rng.range(0.09, 0.11),
            settle_s: rng.range(0.08, 0.25),
            lift_height_m: rng.range(0.024, 0.027),
            lean: rng.range(0.15, 0.35),
        }
    }
}
