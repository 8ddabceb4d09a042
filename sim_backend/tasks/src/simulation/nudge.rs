//! A thing that moves though no instrument touches it, as when a thread is tugged at.

use nalgebra::Vector3;

use super::Simulation;

/// A slide of the thing that the task is about, while no instrument touches it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nudge {
    /// Velocity along the scene's x and y, m/s.
    pub velocity_m_s: [f64; 2],
    /// Rate of turning about the scene's z, rad/s.
    pub turn_rad_s: f64,
    /// How long it lasts, ms.
    pub steps: u32,
    /// Whether the thing has been set in motion.
    is_under_way: bool,
}

impl Nudge {
    /// A nudge along the scene's x and y, m/s, and about its z, rad/s, for `steps` ms.
    #[must_use]
    pub const fn new(velocity_m_s: [f64; 2], turn_rad_s: f64, steps: u32) -> Self {
        Self {
            velocity_m_s,
            turn_rad_s,
            steps,
            is_under_way: false,
        }
    }

    /// Whether a thing with the velocity `moving` follows the nudge, rather than being held up.
    fn is_followed(&self, moving: &Vector3<f64>) -> bool {
        let [x, y] = self.velocity_m_s;
        x * moving.x + y * moving.y > 0.5 * (x * x + y * y)
    }
}

impl Simulation {
    /// Begins to nudge the thing that the task is about; the nudge ends early where an instrument
    /// touches it or something is in its way. False if there is no such thing, or an instrument
    /// touches it now.
    pub fn nudge(&mut self, nudge: Nudge) -> bool {
        let can = self.world.thing_count() > 0 && !self.is_touched();
        if can {
            self.nudge = Some(nudge);
        }
        can
    }

    /// Nudges for one more millisecond, if there is a nudge.
    pub(super) fn continue_nudge(&mut self) {
        let Some(mut nudge) = self.nudge.take() else {
            return;
        };
        let is_free = !nudge.is_under_way || nudge.is_followed(&self.world.thing_velocity(0)[0]);
        if nudge.steps > 0 && is_free && !self.is_touched() {
            self.world.nudge(0, nudge.velocity_m_s, nudge.turn_rad_s);
            nudge.is_under_way = true;
            nudge.steps -= 1;
            self.nudge = Some(nudge);
        }
    }

    fn is_touched(&self) -> bool {
        (0..self.arm_count()).any(|arm| self.world.is_touched(arm, 0))
    }
}
