//! A script as an operator with visual delay and motor noise follows it: each phase waits until the
//! tip is seen at its goal.
//!
//! The paths stay those of the expert. Only the ends of motions, as their part sees them, come
//! later: by a pause that is drawn for each motion, and by as much as the tip lags behind.
//! Meanwhile the target stands at the motion's end.

use hal::{Pose, TimeNs};
use trocar_world::rng::Rng;

use super::STEP_NS;
use super::motion::Motion;

/// One step, s.
fn step_s() -> f64 {
    TimeNs(STEP_NS).seconds()
}

/// What an operator waits for at the end of each motion, which the expert, whose arm is where it
/// wants it, need not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SettleCriteria {
    /// How near the tip has to be to where the motion ends, m.
    pub near_m: f64,
    /// The same of its rotation, rad.
    pub near_rad: f64,
    /// How long to look after each motion before the next one: evenly from the first to the second,
    /// s.
    pub pause_s: [f64; 2],
    /// How long to wait at most for the tip to be near, s: what holds it does not go away.
    pub patience_s: f64,
}

/// A hand's care, in the middle of a motion.
#[derive(Clone, Debug)]
pub(crate) struct Careful {
    care: SettleCriteria,
    rng: Rng,
    /// How long the present motion's end has been put off for the tip, s, without its pause.
    waited_s: f64,
}

impl Careful {
    pub(crate) fn new(care: SettleCriteria, rng: Rng) -> Self {
        Self {
            care,
            rng,
            waited_s: 0.0,
        }
    }

    /// The motion begins: there is a pause at its end.
    pub(crate) fn begin(&mut self, motion: &mut Motion) {
        let [least, most] = self.care.pause_s;
        self.waited_s = 0.0;
        motion.put_off(self.rng.range(least, most));
    }

    /// Puts the end of `motion` off at `now` as long as the tip, seen at `tip_in_scene`, is not
    /// near it.
    pub(crate) fn wait(&mut self, motion: &mut Motion, now: TimeNs, tip_in_scene: &Pose) {
        let over = motion.overdue_s(now) > -step_s();
        if over && self.waited_s < self.care.patience_s && !self.is_near(motion, tip_in_scene) {
            self.waited_s += step_s();
            motion.put_off(step_s());
        }
    }

    fn is_near(&self, motion: &Motion, tip: &Pose) -> bool {
        let end = &motion.end().tip_in_scene;
        let gap_m = (end.translation.vector - tip.translation.vector).norm();
        gap_m < self.care.near_m && end.rotation.angle_to(&tip.rotation) < self.care.near_rad
    }
}
