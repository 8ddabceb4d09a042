//! Settings of the contact physics, each with what it does.

use hal::config::{ConfigError, Source};
use serde::Deserialize;

use crate::plant::PlantConfig;

/// Everything about the simulated world that is not a shape.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldConfig {
    /// The drives, and into how many sub-steps they cut a millisecond: contacts are solved together
    /// with them.
    pub plant: PlantConfig,
    /// Contact between the instrument and things.
    pub grip: Surface,
    /// Contact between things and the ground.
    pub ground: Surface,
    /// Contact between the instrument and the ground.
    pub press: Surface,
    /// Damping of the jaw while it squeezes a flap, N m s/rad: what finger pads, hinge and cables
    /// lose. Without it a jaw at its effort limit, whose controller then damps nothing, bounces on
    /// the flap.
    pub squeeze_damping_n_m_s: f64,
    /// Gravity, m/s², along -z.
    pub gravity_m_s2: f64,
}

/// A pair of surfaces. A contact is a spring with a damper that pushes and never pulls, and Coulomb
/// friction.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// Stiffness of each contact point, N/m.
    ///
    /// On solids a face is met in up to four points; 1e6 gives 0.02 mm under 20 N. On soft ground
    /// each of the instrument's sample points (four at a finger's end, one on its back, two on the
    /// wrist) and each of a needle's nine is a point.
    pub stiffness_n_m: f64,
    /// Damping of each contact point, N s/m. What was pressed in comes back no faster than depth
    /// times stiffness over damping.
    pub damping_n_s_m: f64,
    /// Coulomb friction.
    pub friction: f64,
    /// Radius at which spin about the normal rubs, m: 0 for a point.
    pub patch_m: f64,
}

impl WorldConfig {
    /// Checks the ranges of a world read from `source` at the dotted `key`: outside them the
    /// physics is not stable.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`].
    pub fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        self.plant.check(source, &format!("{key}.plant"))?;
        let check = |name: &str, value, low, high| {
            source.check_range(&format!("{key}.{name}"), value, low, high)
        };
        for (name, surface) in [
            ("grip", &self.grip),
            ("ground", &self.ground),
            ("press", &self.press),
        ] {
            let of = |field| format!("{name}.{field}");
            check(&of("stiffness_n_m"), surface.stiffness_n_m, 10.0, 1e7)?;
            check(&of("damping_n_s_m"), surface.damping_n_s_m, 0.0, 1e4)?;
            check(&of("friction"), surface.friction, 0.0, 2.0)?;
            check(&of("patch_m"), surface.patch_m, 0.0, 0.01)?;
        }
        check(
            "squeeze_damping_n_m_s",
            self.squeeze_damping_n_m_s,
            0.0,
            0.1,
        )?;
        check("gravity_m_s2", self.gravity_m_s2, 0.0, 20.0)
    }
}
