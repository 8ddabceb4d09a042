//! Needle handover: one hand takes the needle from the organ and presents it, the other one takes it away.
//!
//! Each hand has its own phases. They agree by what they see of each other: the taker comes when the needle is
//! presented, the giver lets go when the taker holds it, the taker goes when the giver is gone. If the needle falls, the
//! giver fetches it again.

mod giver;
mod style;
mod taker;

use core::f64::consts::PI;

use hal::psm::FINGER_M;
use hal::{Pose, TimeNs, TipTarget};

use super::motion::{Motion, Placement};
use super::{Script, Wish, arrive, carry};
use crate::needle::NeedleShape;
use crate::organ::OrganShape;
use crate::rng::Rng;
use crate::simulation::{ArmScene, SceneState};
use crate::task::TaskConfig;
use crate::task::needle_handover::NeedleHandover;
use giver::Giver;
use style::Style;
use taker::Taker;

/// A step's share of following a moving needle, m and rad.
const FOLLOW_STEP_M: f64 = 0.000_8;
const FOLLOW_STEP_RAD: f64 = 0.04;

/// How long to wait for both fingers after the jaw's motion has ended, s.
const GRIP_PATIENCE_S: f64 = 0.5;

/// Steps without touch by both fingers after which the needle counts as lost.
const LOST_STEPS: u32 = 4;

/// Time to rest with an open jaw, s.
const REOPEN_S: f64 = 0.3;

/// How far the finger tips press into the soft organ, and reach beyond the wire that lies on it, at the grasp, m: a needle
/// that is held far from its middle slides out of the very ends of the fingers.
const TIP_SINK_M: f64 = 0.000_5;

/// Distances from the grasp at which the organ's height is looked at, m.
const FINGER_REACH_M: f64 = 0.001_5;

/// The script of the needle handover.
#[derive(Clone, Debug)]
pub(super) struct Passer {
    shape: NeedleShape,
    organ: OrganShape,
    bases: [Pose; 2],
    giver: Giver,
    taker: Taker,
}

/// What both hands have.
#[derive(Clone, Debug)]
struct Hand {
    rng: Rng,
    style: Style,
    motion: Option<Motion>,
    attempts: u32,
    untouched_steps: u32,
}

/// What a hand sees of one arm, in the scene frame.
struct ArmView {
    tip: Pose,
    jaw: f64,
    both_touch: bool,
}

/// What both hands see, in the scene frame.
struct View {
    shape: NeedleShape,
    organ: OrganShape,
    needle: Pose,
    presented: Pose,
    giver: ArmView,
    taker: ArmView,
}

impl Script for Passer {
    fn step(&mut self, now: TimeNs, scene: &SceneState) -> Wish {
        let view = self.view(scene);
        let (taken, idle) = (self.taker.holds(), self.taker.is_idle());
        let (offered, given) = (self.giver.presents(), self.giver.is_away());
        let first = self.giver.step(now, &view, taken, idle);
        let second = self.taker.step(now, &view, offered, given);
        Wish {
            first: target(&self.bases[0], &first),
            second: Some(target(&self.bases[1], &second)),
        }
    }

    fn attempts(&self) -> u32 {
        self.giver.hand.attempts + self.taker.hand.attempts - 1
    }

    fn foresee(&self, scene: &mut SceneState, wish: &Wish) {
        let (Some(taker), Some(wished)) = (&mut scene.second, &wish.second) else {
            return;
        };
        let giver = &mut scene.first;
        if self.taker.holds() && taker.grasp.both_touch {
            carry(taker, wished);
            arrive(giver, &wish.first);
            let needle = self.bases[1] * taker.thing_in_rcm;
            giver.thing_in_rcm = self.bases[0].inv_mul(&needle);
        } else if self.giver.carries() && giver.grasp.both_touch {
            carry(giver, &wish.first);
            arrive(taker, wished);
            let needle = self.bases[0] * giver.thing_in_rcm;
            taker.thing_in_rcm = self.bases[1].inv_mul(&needle);
        } else {
            arrive(giver, &wish.first);
            arrive(taker, wished);
        }
    }
}

impl Passer {
    pub(super) fn new(task: &TaskConfig, scene: &NeedleHandover, seed: u64) -> Self {
        let hand = |name| Hand::new(Rng::stream(seed, name));
        Self {
            shape: scene.needle,
            organ: scene.organ,
            bases: [task.arms[0].scene_from_rcm, task.arms[1].scene_from_rcm],
            giver: Giver::new(hand("giver")),
            taker: Taker::new(hand("taker")),
        }
    }

    fn view(&self, scene: &SceneState) -> View {
        let arm = |base: &Pose, arm: &ArmScene| ArmView {
            tip: base * arm.tip_in_rcm,
            jaw: arm.jaw,
            both_touch: arm.grasp.both_touch,
        };
        View {
            shape: self.shape,
            organ: self.organ,
            needle: self.bases[0] * scene.first.thing_in_rcm,
            presented: scene.goal_in_scene.unwrap_or_else(Pose::identity),
            giver: arm(&self.bases[0], &scene.first),
            taker: arm(
                &self.bases[1],
                scene.second.as_ref().unwrap_or(&scene.first),
            ),
        }
    }
}

impl Hand {
    fn new(mut rng: Rng) -> Self {
        let style = Style::draw(&mut rng);
        Self {
            rng,
            style,
            motion: None,
            attempts: 1,
            untouched_steps: 0,
        }
    }

    /// A person does not repeat a failed attempt exactly.
    fn try_again(&mut self) {
        self.style = Style::draw(&mut self.rng);
        self.attempts += 1;
    }

    fn feel(&mut self, both_touch: bool) {
        self.untouched_steps = if both_touch {
            0
        } else {
            self.untouched_steps + 1
        };
    }

    fn follow(&self, motion: &mut Motion, goal: &Pose) {
        motion.drift_end(goal, FOLLOW_STEP_M, FOLLOW_STEP_RAD);
    }
}

impl ArmView {
    fn placement(&self) -> Placement {
        Placement {
            tip_in_scene: self.tip,
            jaw: self.jaw,
        }
    }
}

impl View {
    /// `hold`, as low as the organ under the fingers and the wire on it allow.
    fn above_organ(&self, hold: &Pose) -> Pose {
        let place = hold.translation.vector;
        let heights_m = (0..8).map(|step| {
            let (sin, cos) = (0.25 * PI * f64::from(step)).sin_cos();
            self.organ.height_m(
                place.x + FINGER_REACH_M * cos,
                place.y + FINGER_REACH_M * sin,
            )
        });
        let floor_m = heights_m.fold(f64::NEG_INFINITY, f64::max);
        let wire_m = place.z - FINGER_M - self.shape.wire_radius_m;
        let mut hold = *hold;
        hold.translation.z = floor_m.max(wire_m) - TIP_SINK_M + FINGER_M;
        hold
    }
}

fn target(base: &Pose, placement: &Placement) -> TipTarget {
    TipTarget::new(&base.inv_mul(&placement.tip_in_scene), placement.jaw)
}
