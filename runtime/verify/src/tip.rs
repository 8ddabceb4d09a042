//! How fast the tip moves and turns between two places.
//!
//! Chord over time and rotation angle over time are mean speeds between two set-points. Somewhere
//! in between the tip is at least that fast, so a mean beyond the bound is a violation whatever
//! happens there.

use nalgebra::{Point3, UnitQuaternion};

use super::boundary::{Moment, TOLERANCE};
use super::chain::Instrument;
use super::ledger::{Ledger, LimitId};
use super::limits::Limits;

/// The checks of the tip's two speeds.
#[derive(Clone, Debug)]
pub(super) struct Tip {
    /// For commands and for their tails.
    speed: [LimitId; 2],
    angular_speed: [LimitId; 2],
    /// Bound, as `angular_speed_rad_s`; both from `control.toml`.
    speed_m_s: f64,
    angular_speed_rad_s: f64,
}

/// A place of the tip.
pub(super) type TipPose = (Point3<f64>, UnitQuaternion<f64>);

impl Tip {
    pub(super) fn new(ledger: &mut Ledger, limits: &Limits, arm: &str) -> Self {
        let mut both = |name: &str| {
            [
                ledger.open(arm, name.to_owned()),
                ledger.open(arm, format!("tail.{name}")),
            ]
        };
        Self {
            speed: both("tip_speed"),
            angular_speed: both("tip_angular_speed"),
            speed_m_s: limits.tip_speed_m_s,
            angular_speed_rad_s: limits.tip_angular_speed_rad_s,
        }
    }

    /// Where the tip of an instrument is.
    pub(super) const fn place(at: &Instrument) -> TipPose {
        (at.control_point, at.rotation)
    }

    /// Checks the way from one place to the next, `elapsed_s` later.
    pub(super) fn check(
        &self,
        ledger: &mut Ledger,
        moment: Moment,
        before: &TipPose,
        after: &TipPose,
        elapsed_s: f64,
    ) {
        let ids = [moment.of(self.speed), moment.of(self.angular_speed)];
        let speed = (after.0 - before.0).norm() / elapsed_s;
        let angular_speed = before.1.angle_to(&after.1) / elapsed_s;
        let bounds = [self.speed_m_s, self.angular_speed_rad_s];
        for ((limit, value), bound) in ids.into_iter().zip([speed, angular_speed]).zip(bounds) {
            ledger.judge(limit, value - bound, TOLERANCE, value, bound);
        }
    }
}
