//! Needle handover: one hand takes the needle from the organ and presents it, the other one takes
//! it away.
//!
//! Each hand has its own phases. They agree by what they see of each other: the taker comes when
//! the needle is presented, the giver lets go when the taker holds it, the taker goes when the
//! giver is gone. If the needle falls, the giver fetches it again.

mod giver;
mod style;
mod taker;

use core::f64::consts::PI;

use hal::psm::FINGER_M;
use hal::{Pose, TimeNs, TipTarget};
use trocar_world::ArmStart;
use trocar_world::needle::NeedleShape;
use trocar_world::organ::Organ;
use trocar_world::rng::Rng;

use super::NeedleHandover;
use crate::scene::{ArmScene, SceneState};
use crate::script::motion::Placement;
use crate::script::play::{Activity, ArmView, Hand, Looks};
use crate::script::{Script, SettleCriteria, TipTargets, arrive, carry};
use giver::Giver;
use hal::ARMS_MAX;
use style::Style;
use taker::Taker;

/// How long to wait for both fingers after the jaw's motion has ended, s.
const GRIP_PATIENCE_S: f64 = 0.5;

/// Steps without touch by both fingers after which the needle counts as lost.
const LOST_STEPS: u32 = 4;

/// Time to rest with an open jaw, s.
const REOPEN_S: f64 = 0.3;

/// How far the finger tips press into the soft organ, and reach beyond the wire that lies on it, at
/// the grasp, m: a needle that is held far from its middle slides out of the very ends of the
/// fingers.
const TIP_SINK_M: f64 = 0.000_5;

/// Distances from the grasp at which the organ's height is looked at, m.
const FINGER_REACH_M: f64 = 0.001_5;

/// The script of the needle handover.
#[derive(Clone, Debug)]
pub(super) struct Passer {
    shape: NeedleShape,
    organ: Organ,
    /// The RCM frames of giver and taker in the scene.
    bases: [Pose; 2],
    giver: Hand<Giver>,
    taker: Hand<Taker>,
}

/// What a hand sees, in the scene frame.
#[derive(Clone)]
pub(crate) struct View {
    shape: NeedleShape,
    organ: Organ,
    needle: Pose,
    presented: Pose,
    /// The arm of the hand that looks.
    arm: ArmView,
    /// Whether the giver holds the needle out.
    offered: bool,
    /// Whether the giver has let go and is out of the way.
    given: bool,
    /// Whether the taker holds the needle.
    taken: bool,
    /// Whether the taker waits.
    idle: bool,
}

impl Script for Passer {
    /// Both hands look before either moves on, so what one sees of the other is a step old.
    fn step(&mut self, now: TimeNs, scene: &SceneState) -> TipTargets {
        let [giver, taker] = self.views(scene);
        let first = self.giver.play(now, &giver);
        let second = self.taker.play(now, &taker);
        TipTargets {
            first: target(&self.bases[0], &first),
            second: Some(target(&self.bases[1], &second)),
        }
    }

    /// Of both hands: 1 if neither had to try again.
    fn attempts(&self) -> u32 {
        self.giver.attempts() + self.taker.attempts() - 1
    }

    fn activities(&self) -> [Activity; ARMS_MAX] {
        [self.giver.activity(), self.taker.activity()]
    }

    fn take_care(&mut self, care: SettleCriteria, seed: u64) {
        self.giver
            .take_care(care, Rng::stream(seed, "giver's care"));
        self.taker
            .take_care(care, Rng::stream(seed, "taker's care"));
    }

    /// The needle goes along with the hand that holds it, the taker before the giver, and then is
    /// put where that is in the other arm's frame too.
    fn foresee(&self, scene: &mut SceneState, wish: &TipTargets) {
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
    /// The script at the start of the episode `seed`.
    pub(super) fn new(scene: &NeedleHandover, arms: &[ArmStart], seed: u64) -> Self {
        Self {
            shape: scene.needle,
            organ: scene.organ.clone(),
            bases: [arms[0].scene_from_rcm, arms[1].scene_from_rcm],
            giver: Hand::new(Giver, Rng::stream(seed, "giver")),
            taker: Hand::new(Taker, Rng::stream(seed, "taker")),
        }
    }

    /// What giver and taker see at one instant.
    fn views(&self, scene: &SceneState) -> [View; 2] {
        #[expect(clippy::expect_used, reason = "the task has two arms")]
        let second = scene.second.as_ref().expect("a handover has two arms");
        let arms = [&scene.first, second];
        let view = |arm: &ArmScene, base: &Pose| View {
            shape: self.shape,
            organ: self.organ.clone(),
            needle: self.bases[0] * scene.first.thing_in_rcm,
            presented: scene.goal_in_scene.unwrap_or_else(Pose::identity),
            arm: ArmView {
                tip: base * arm.tip_in_rcm,
                jaw: arm.jaw,
                both_touch: arm.grasp.both_touch,
            },
            offered: self.giver.presents(),
            given: self.giver.is_away(),
            taken: self.taker.holds(),
            idle: self.taker.is_idle(),
        };
        [0, 1].map(|hand| view(arms[hand], &self.bases[hand]))
    }
}

impl Looks for View {
    fn arm(&self) -> &ArmView {
        &self.arm
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

#[cfg(test)]
mod tests;
