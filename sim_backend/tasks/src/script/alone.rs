//! The script of a task that has one arm.
//!
//! It has one [`Hand`], and targets for the first arm alone. What the hand sees is in the scene
//! frame, where its part plans; wishes leave in the arm's RCM frame.

use hal::{Pose, TimeNs, TipTarget};
use trocar_world::ArmStart;
use trocar_world::rng::Rng;

use super::play::{Activity, ArmView, Hand, Looks, Part};
use super::{Script, SettleCriteria, TipTargets, arrive, carry};
use crate::scene::SceneState;
use hal::ARMS_MAX;

/// What the hand sees, in the scene frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    /// The first arm.
    pub(crate) arm: ArmView,
    /// What the task is about. Its frame in the scene; of a flap, its mark's.
    pub(crate) thing: Pose,
    /// Where something is to be brought, if the task has such a place. The scene's origin in a task
    /// without one.
    pub(crate) goal: Pose,
}

impl Looks for View {
    fn arm(&self) -> &ArmView {
        &self.arm
    }
}

/// A script with a single hand.
#[derive(Clone, Debug)]
pub(crate) struct Alone<P: Part> {
    hand: Hand<P>,
    scene_from_rcm: Pose,
}

impl<P: Part> Alone<P> {
    /// The script of `part` in the episode `seed`, which the first of `arms` plays.
    pub(crate) fn new(part: P, arms: &[ArmStart], seed: u64) -> Self {
        Self {
            hand: Hand::new(part, Rng::stream(seed, "expert")),
            scene_from_rcm: arms[0].scene_from_rcm,
        }
    }
}

impl<P: Part<View = View>> Script for Alone<P> {
    fn step(&mut self, now: TimeNs, scene: &SceneState) -> TipTargets {
        let view = View {
            arm: ArmView {
                tip: self.scene_from_rcm * scene.first.tip_in_rcm,
                jaw: scene.first.jaw,
                both_touch: scene.first.grasp.both_touch,
            },
            thing: self.scene_from_rcm * scene.first.thing_in_rcm,
            goal: scene.goal_in_scene.unwrap_or_else(Pose::identity),
        };
        let placement = self.hand.play(now, &view);
        let tip_in_rcm = self.scene_from_rcm.inv_mul(&placement.tip_in_scene);
        TipTargets {
            first: TipTarget::new(&tip_in_rcm, placement.jaw),
            second: None,
        }
    }

    fn attempts(&self) -> u32 {
        self.hand.attempts()
    }

    fn activities(&self) -> [Activity; ARMS_MAX] {
        [self.hand.activity(), Activity::Other]
    }

    fn take_care(&mut self, care: SettleCriteria, seed: u64) {
        self.hand.take_care(care, Rng::stream(seed, "care"));
    }

    fn foresee(&self, scene: &mut SceneState, wish: &TipTargets) {
        if self.hand.carries() && scene.first.grasp.both_touch {
            carry(&mut scene.first, &wish.first);
        } else {
            arrive(&mut scene.first, &wish.first);
        }
    }
}
