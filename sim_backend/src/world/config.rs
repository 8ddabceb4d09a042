//! Settings of the contact physics, each with what it does.

use hal::config::{ConfigError, Source};
use serde::Deserialize;

use crate::plant::PlantConfig;

/// Everything about the simulated world that is not a shape.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldConfig {
    /// The drives.
    pub plant: PlantConfig,
    /// Contact between the instrument and things.
    pub grip: Surface,
    /// Contact between things and the ground.
    pub tissue: Surface,
    /// How the ground pushes back at the instrument.
    pub press: Press,
    /// Damping of the jaw while it squeezes something, N m s/rad: what finger pads, hinge and cables lose. Without it
    /// a jaw at its effort limit, whose controller then damps nothing, bounces on the wire.
    pub squeeze_damping_n_m_s: f64,
    /// Solver sub-steps in one millisecond. More are not better by themselves: stiffness is resolved a sub-step at a
    /// time, so tune it together with `grip.frequency_hz`.
    pub solver_substeps: u32,
    /// Sweeps over all contacts in one sub-step.
    pub solver_sweeps: u32,
    /// Size of what is typical here, m. The engine's tolerances (20 mm prediction, 5 mm slop at 1) scale with it.
    pub length_unit_m: f64,
    /// Gravity, m/s², along -z.
    pub gravity_m_s2: f64,
}

/// One kind of contact of a thing.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// Stiffness as the frequency at which the thing's mass swings on the contact, Hz.
    pub frequency_hz: f64,
    /// Damping ratio of that swing.
    pub damping_ratio: f64,
    /// Coulomb friction.
    pub friction: f64,
}

/// Ground under the instrument: springs with friction, which give way instead of stopping the tool dead.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Press {
    /// Stiffness at each of the instrument's sample points, or where it overlaps a solid, N/m.
    pub stiffness_n_m: f64,
    /// Damping there while it sinks in, N s/m.
    pub damping_n_s_m: f64,
    /// Coulomb friction.
    pub friction: f64,
}

impl WorldConfig {
    /// Checks the ranges of a world read from `source` at the dotted `key`: outside them the physics is not stable.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`].
    pub fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        self.plant.check(source, &format!("{key}.plant"))?;
        for (name, surface) in [("grip", &self.grip), ("tissue", &self.tissue)] {
            source.check_range(
                &format!("{key}.{name}.frequency_hz"),
                surface.frequency_hz,
                20.0,
                2000.0,
            )?;
            source.check_range(
                &format!("{key}.{name}.damping_ratio"),
                surface.damping_ratio,
                0.2,
                20.0,
            )?;
            source.check_range(
                &format!("{key}.{name}.friction"),
                surface.friction,
                0.0,
                2.0,
            )?;
        }
        source.check_range(
            &format!("{key}.press.stiffness_n_m"),
            self.press.stiffness_n_m,
            10.0,
            4000.0,
        )?;
        source.check_range(
            &format!("{key}.press.damping_n_s_m"),
            self.press.damping_n_s_m,
            0.0,
            20.0,
        )?;
        source.check_range(
            &format!("{key}.press.friction"),
            self.press.friction,
            0.0,
            2.0,
        )?;
        source.check_range(
            &format!("{key}.squeeze_damping_n_m_s"),
            self.squeeze_damping_n_m_s,
            0.0,
            0.1,
        )?;
        source.check_range(
            &format!("{key}.solver_substeps"),
            f64::from(self.solver_substeps),
            1.0,
            32.0,
        )?;
        source.check_range(
            &format!("{key}.solver_sweeps"),
            f64::from(self.solver_sweeps),
            1.0,
            16.0,
        )?;
        source.check_range(
            &format!("{key}.length_unit_m"),
            self.length_unit_m,
            0.001,
            0.1,
        )?;
        source.check_range(&format!("{key}.gravity_m_s2"), self.gravity_m_s2, 0.0, 20.0)
    }
}
