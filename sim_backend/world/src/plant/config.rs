//! Numbers of the drive model that the dVRK's files do not give.

use hal::config::{ConfigError, Source};
use serde::Deserialize;

use super::coupling::AXIS_COUNT;

/// What the plant adds to [`hal::psm`]: inertias, friction, and how finely time is cut.
///
/// Actuators are in the order yaw, pitch, insertion, disc 1 to 4. The counterweighted Classic arm
/// is taken as balanced: gravity does not load the drives.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantConfig {
    /// Steps of the drive model in one millisecond; the joint controllers run in each.
    pub substeps: u32,
    /// Inertia seen by each actuator, kg m² (insertion kg).
    ///
    /// Estimates. Discs: a rotor of 1e-6 kg m², typical of a motor with this torque constant, times
    /// the gear ratio squared (11.71² = 137); the instrument itself is negligible beside it.
    /// Insertion: carriage 0.363 kg and counterweight 0.350 kg as identified by
    /// WPI-AIM/dvrk_dynamics_identification, and the rotor's 0.113 kg. Yaw and pitch: the CAD
    /// masses of the moving links (med-air/SurRoL, 3.5 kg) at about 0.15 m; the shipped gains are
    /// critically damped for 0.075 and 0.052.
    pub inertia: [f64; AXIS_COUNT],
    /// Coulomb friction at each actuator, N m (N). The first four as identified by
    /// WPI-AIM/dvrk_dynamics_identification, the wrist's inside the range found there.
    pub coulomb: [f64; AXIS_COUNT],
    /// Viscous friction at each actuator, N m s/rad (N s/m). Same source.
    pub viscous: [f64; AXIS_COUNT],
    /// Jaw effort that reaches the fingers, N m, at most the instrument's own limit of 0.16.
    ///
    /// The cables' friction and the surgeon-side limits keep the real grip far below what the
    /// motors could do; 0.04 gives 5 N a finger at 8 mm from the hinge.
    pub jaw_effort_max_n_m: f64,
}

impl PlantConfig {
    /// Checks the ranges of a plant read from `source` at the dotted `key`: outside them the model
    /// is not stable.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`].
    pub fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        source.check_range(
            &format!("{key}.substeps"),
            f64::from(self.substeps),
            2.0,
            32.0,
        )?;
        for (index, &inertia) in self.inertia.iter().enumerate() {
            let least = if index < 3 { 0.02 } else { 8e-5 };
            source.check_range(&format!("{key}.inertia.{index}"), inertia, least, 10.0)?;
        }
        for (index, &friction) in self.coulomb.iter().enumerate() {
            source.check_range(&format!("{key}.coulomb.{index}"), friction, 0.0, 5.0)?;
        }
        for (index, &friction) in self.viscous.iter().enumerate() {
            source.check_range(&format!("{key}.viscous.{index}"), friction, 0.0, 50.0)?;
        }
        source.check_range(
            &format!("{key}.jaw_effort_max_n_m"),
            self.jaw_effort_max_n_m,
            0.005,
            0.16,
        )
    }
}
