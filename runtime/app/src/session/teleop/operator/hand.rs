//! One simulated hand: what it does with its controller.

use hal::{Pose, TimeNs, TipTarget};
use nalgebra::UnitQuaternion;
use trocar_world::rng::Rng;

use super::corrections::{Corrections, Step, between, blend, moved, to_ns};
use super::noise::Noise;
use super::{MESSAGE_S, OperatorFigures};
use crate::session::teleop::DEFAULT_SCALE;
use crate::session::teleop::message::HandMessage;
use crate::session::teleop::source::{JAW_CLOSED_RAD, JAW_OPEN_RAD};

/// A clutch that is held for so long without effect is let go and taken again.
const NO_EFFECT_NS: u64 = 50_000_000;

/// A plan that is further than this from where the last one led begins anew from where the tip is,
/// m.
const ANEW_M: f64 = 0.001_5;

/// What the fingers do with the clutch.
#[derive(Clone, Copy, Debug)]
enum Grip {
    /// It is open until then.
    Open(TimeNs),
    /// It is held since then.
    Held(TimeNs),
    /// It is open while the hand comes back into comfort since then, from there.
    Back(TimeNs, Pose),
}

/// A hand.
#[derive(Clone, Debug)]
pub(super) struct SimulatedHand {
    view_from_rcm: UnitQuaternion<f64>,
    rng: Rng,
    noise: Noise,
    grip: Grip,
    /// Where it is in the picture's axes, its tremor aside.
    at: Pose,
    /// Where the plan wanted the tip last.
    wanted: Option<Pose>,
    corrections: Corrections,
}

/// What a hand goes by at one instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment<'a> {
    pub(super) now: TimeNs,
    /// Where the plan wants the tip.
    pub(super) wanted: &'a TipTarget,
    /// Where the tip is seen, and when it was there.
    pub(super) seen: (TimeNs, &'a Pose),
    /// Whether the arm is seen to follow.
    pub(super) engaged: bool,
    /// Whether the plan stands still.
    pub(super) stands: bool,
}

impl SimulatedHand {
    /// A hand at rest in the middle of its range, whose arm moves in axes that `rcm_from_view`
    /// turns the picture's into.
    pub(super) fn new(rcm_from_view: &Pose, figures: &OperatorFigures, mut rng: Rng) -> Self {
        let [least, most] = figures.reaction_s;
        let noise = Noise::new(figures, Rng::new(rng.next_u64()));
        let until = TimeNs(to_ns(rng.range(least, most)));
        Self {
            view_from_rcm: rcm_from_view.rotation.inverse(),
            rng,
            noise,
            grip: Grip::Open(until),
            at: Pose::identity(),
            wanted: None,
            corrections: Corrections::default(),
        }
    }

    /// Whether the plan can go on.
    pub(super) fn goes_on(&self, engaged: bool, figures: &OperatorFigures) -> bool {
        matches!(self.grip, Grip::Held(_)) && engaged && self.is_in_comfort(figures)
    }

    fn is_in_comfort(&self, figures: &OperatorFigures) -> bool {
        let (way_m, turn_rad) = (self.at.translation.vector.norm(), self.at.rotation.angle());
        way_m < figures.range_m && turn_rad < figures.range_rad
    }

    /// What the controller says after the next step.
    pub(super) fn step(&mut self, moment: &Moment<'_>, figures: &OperatorFigures) -> HandMessage {
        let step = self.follow(moment, figures);
        let (step, trigger) = self.noise.step(step, figures, MESSAGE_S);
        self.at = moved(&self.at, step);
        self.next_grip(moment, figures);
        let tremor = self.noise.tremor(moment.now.seconds());
        let pose = moved(&self.at, tremor);
        let q = pose.rotation.coords;
        let closed = (JAW_OPEN_RAD - moment.wanted.jaw) / (JAW_OPEN_RAD - JAW_CLOSED_RAD);
        let pressed = closed > 0.0 && closed < 1.0;
        let trigger = if pressed { trigger } else { 0.0 };
        HandMessage {
            clutch: matches!(self.grip, Grip::Held(_)),
            at: pose.translation.vector.into(),
            turn: [q.x, q.y, q.z, q.w],
            tracked: false,
            jaw: (closed + trigger).clamp(0.0, 1.0),
        }
    }

    /// What the hand means to do: to go with the plan, and to correct what it sees.
    fn follow(&mut self, moment: &Moment<'_>, figures: &OperatorFigures) -> Step {
        let wanted = moment.wanted.tip_in_rcm();
        let before = self.wanted.replace(wanted).unwrap_or(wanted);
        if !(matches!(self.grip, Grip::Held(_)) && moment.engaged) {
            return Step::default();
        }
        let mut step = between(&before, &wanted);
        if step[0].norm() > ANEW_M {
            self.corrections.forget(moment.now);
            step = Step::default();
        }
        let corrected = self.corrections.step(moment.now, &wanted, figures);
        self.corrections.look(moment.now, moment.seen, figures);
        let [way, turn] = [0, 1].map(|part| self.view_from_rcm * (step[part] + corrected[part]));
        [way / DEFAULT_SCALE, turn]
    }

    fn next_grip(&mut self, moment: &Moment<'_>, figures: &OperatorFigures) {
        let now = moment.now;
        self.grip = match self.grip {
            Grip::Open(until) if now >= until => self.take(now),
            Grip::Held(since) if !moment.engaged && now.since(since) > NO_EFFECT_NS => {
                let [least, most] = figures.reaction_s;
                Grip::Open(now.plus_ns(to_ns(self.rng.range(least, most))))
            }
            Grip::Held(_)
                if moment.stands && !self.corrections.any() && !self.is_in_comfort(figures) =>
            {
                Grip::Back(now, self.at)
            }
            Grip::Back(began, from) => {
                let share = TimeNs(now.since(began)).seconds() / figures.return_s;
                self.at = from.lerp_slerp(&Pose::identity(), blend(share));
                if share < 1.0 {
                    self.grip
                } else {
                    self.take(now)
                }
            }
            Grip::Open(_) | Grip::Held(_) => self.grip,
        };
    }

    fn take(&mut self, now: TimeNs) -> Grip {
        self.corrections.forget(now);
        Grip::Held(now)
    }
}
