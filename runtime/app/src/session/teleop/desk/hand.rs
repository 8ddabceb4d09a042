//! A hand that devices move by velocities; it starts anew at each clutch-in.

use nalgebra::{UnitQuaternion, Vector3};

use super::super::message::HandMessage;

/// How far it goes, m.
const REACH_M: f64 = 5.0;

/// What devices ask for. Axes are the picture's: x to the right, y up, z towards the viewer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct DeviceAxes {
    /// Whether the clutch is held.
    pub(super) clutch: bool,
    /// m/s.
    pub(super) way: Vector3<f64>,
    /// rad/s.
    pub(super) turn: Vector3<f64>,
    /// How fast the jaw closes, 1/s.
    pub(super) jaw: f64,
    /// How far it is to be closed, of a device that says that, 0 to 1.
    pub(super) trigger: Option<f64>,
}

impl DeviceAxes {
    /// What two devices ask for; clutches do not depend on each other.
    pub(super) fn and(self, other: Self) -> Self {
        // A device moves nothing by the clutch of another.
        match (self.clutch, other.clutch) {
            (false, _) => other,
            (true, false) => self,
            (true, true) => Self {
                clutch: true,
                way: self.way + other.way,
                turn: self.turn + other.turn,
                jaw: self.jaw + other.jaw,
                trigger: self.trigger.or(other.trigger),
            },
        }
    }
}

/// The hand.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct VirtualHand {
    clutch: bool,
    at: Vector3<f64>,
    turn: UnitQuaternion<f64>,
    /// How far the trigger is pressed, 0 to 1.
    pub(super) jaw: f64,
}

impl VirtualHand {
    /// Does what is `asked` for `seconds`; the arm's jaw is closed so far now, 0 to 1.
    pub(super) fn go(&mut self, asked: &DeviceAxes, seconds: f64, jaw: f64) {
        if asked.clutch && !self.clutch {
            *self = Self {
                jaw,
                ..Self::default()
            };
        }
        self.clutch = asked.clutch;
        if !self.clutch {
            return;
        }
        let at = self.at + asked.way * seconds;
        self.at = at.map(|value| value.clamp(-REACH_M, REACH_M));
        self.turn = UnitQuaternion::from_scaled_axis(asked.turn * seconds) * self.turn;
        let closed = asked.trigger.unwrap_or(self.jaw + asked.jaw * seconds);
        self.jaw = closed.clamp(0.0, 1.0);
    }

    /// What the run is told of it.
    pub(super) fn told(&self) -> HandMessage {
        HandMessage {
            clutch: self.clutch,
            at: self.at.into(),
            turn: self.turn.coords.into(),
            tracked: false,
            jaw: self.jaw,
        }
    }
}
