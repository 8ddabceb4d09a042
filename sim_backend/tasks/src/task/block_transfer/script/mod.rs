//! Block transfer: grips a wall of the block from above, one finger in the hole, and moves it to
//! the goal peg.
//!
//! It takes the wall that turns the wrist least where the peg leaves room for a finger, keeps the
//! block upright and its hole over the goal on the way, goes up again if the block does not go
//! down, and starts over when the fingers closed on nothing, the block slipped out, or it was let
//! go beside the peg.

mod grip;
mod phase;
mod style;

use hal::{Pose, TimeNs};
use nalgebra::{Translation3, Vector3};

use super::BlockTransfer;
use crate::script::alone::View;
use crate::script::hand::{ARRIVED_PATIENCE_S, raised, settled};
use crate::script::motion::{Motion, Placement};
use crate::script::play::{Activity, Event, Hand, Part};
use grip::{Grip, Gripping};
use phase::Phase;
use style::Style;

/// How far the block may be from its place when a carrying motion ends, m.
const CARRIED_M: f64 = 0.000_6;

/// How high above its end the block may be at the end of the lowering, m; higher, something holds
/// it up.
const STUCK_M: f64 = 0.002;

/// How long to wait for both fingers after the jaw's motion has ended, s.
const GRIP_PATIENCE_S: f64 = 0.5;

/// Steps without touch by both fingers after which the block counts as lost.
const LOST_STEPS: u32 = 4;

/// Time to rest with an open jaw, s.
const OPEN_S: f64 = 0.25;

/// How long the block is looked at before it counts as misplaced, s.
const REST_S: f64 = 1.0;

/// Height of the control point at which the open fingers pass over the pegs, beyond the pegs'
/// height, m.
const OVER_PEGS_M: f64 = hal::psm::FINGER_M + 0.004;

/// The script of the block transfer.
#[derive(Clone, Debug)]
pub(super) struct Mover {
    task: BlockTransfer,
    grip: Option<Grip>,
}

impl Part for Mover {
    type Habits = Style;
    type Stage = Phase;
    type View = View;

    fn carries(hand: &Hand<Self>) -> bool {
        matches!(hand.phase, Phase::Lift | Phase::Carry | Phase::Lower)
    }

    fn activity(hand: &Hand<Self>) -> Activity {
        match hand.phase {
            Phase::Approach => Activity::Reach,
            Phase::Descend | Phase::Close => Activity::Grasp,
            Phase::Lift => Activity::Lift,
            Phase::Carry => Activity::Carry,
            Phase::Lower
            | Phase::Release
            | Phase::Rise
            | Phase::Rest
            | Phase::Open
            | Phase::Retreat => Activity::Other,
        }
    }

    fn tries_again(hand: &Hand<Self>, next: Phase) -> bool {
        next == Phase::Open || hand.phase == Phase::Rest
    }

    fn begin(hand: &mut Hand<Self>, now: TimeNs, from: Placement, view: &View) -> Motion {
        // Another approach may take another wall.
        let before = hand.part.grip.filter(|_| hand.phase != Phase::Approach);
        let grip = hand.gripping().choose(before, &view.thing);
        hand.part.grip = Some(grip);
        let style = &hand.style;
        let straight = Vector3::zeros();
        let open = |tip| from.with_tip(tip).with_jaw(style.open_rad);
        let held = |tip_in_scene| from.with_tip(tip_in_scene);
        let jaw = |jaw| from.with_jaw(jaw);
        let (to, bow_m, pace) = match hand.phase {
            Phase::Approach => (open(hand.poise_pose(view)), style.bow_m, style.approach),
            Phase::Descend => (open(hand.grasp_pose(view)), straight, style.descend),
            Phase::Close => (jaw(style.grip_rad), straight, style.close),
            Phase::Lift => (raised(from, hand.lift_m(view)), straight, style.carry),
            Phase::Carry => (held(hand.over_goal(view)), style.detour_m, style.carry),
            Phase::Lower => (held(hand.on_goal(view)), straight, style.lower),
            Phase::Release | Phase::Open => (jaw(style.open_rad), straight, style.close),
            Phase::Rise => (raised(from, style.rise_m), straight, style.lower),
            Phase::Retreat => (raised(from, hand.retreat_m(&from)), straight, style.lower),
            Phase::Rest => return Motion::rest(from, now, REST_S),
        };
        Motion::new(from, to, bow_m, now, pace)
    }

    fn moving_goal(hand: &Hand<Self>, view: &View) -> Option<Pose> {
        match hand.phase {
            Phase::Approach => Some(hand.poise_pose(view)),
            Phase::Descend => Some(hand.grasp_pose(view)),
            Phase::Carry if view.arm.both_touch => Some(hand.over_goal(view)),
            Phase::Close
            | Phase::Lift
            | Phase::Carry
            | Phase::Lower
            | Phase::Release
            | Phase::Rise
            | Phase::Rest
            | Phase::Open
            | Phase::Retreat => None,
        }
    }

    fn event(hand: &Hand<Self>, now: TimeNs, motion: &Motion, view: &View) -> Option<Event> {
        let overdue_s = motion.overdue_s(now);
        if hand.carries() && hand.has_lost(LOST_STEPS) {
            return Some(Event::Lost);
        }
        let patient = overdue_s > ARRIVED_PATIENCE_S;
        match hand.phase {
            Phase::Approach => (overdue_s >= hand.style.aim_s).then_some(Event::Arrived),
            Phase::Lift | Phase::Rise | Phase::Retreat => {
                (overdue_s >= 0.0).then_some(Event::Arrived)
            }
            Phase::Descend => {
                let there = overdue_s >= 0.0 && settled(motion, &view.arm.tip);
                (there || patient).then_some(Event::Arrived)
            }
            Phase::Close if overdue_s < hand.style.settle_s => None,
            Phase::Close if view.arm.both_touch => Some(Event::Gripped),
            Phase::Close => (overdue_s > GRIP_PATIENCE_S).then_some(Event::Lost),
            Phase::Carry => {
                let gap_m = hand.carried_gap_m(view);
                ((overdue_s >= 0.0 && gap_m < CARRIED_M) || patient).then_some(Event::Arrived)
            }
            Phase::Lower if overdue_s < 0.1 => None,
            Phase::Lower => Some(if hand.bottom_m(view) > hand.style.drop_m + STUCK_M {
                Event::Stuck
            } else {
                Event::Arrived
            }),
            Phase::Release | Phase::Open => (overdue_s >= OPEN_S).then_some(Event::Arrived),
            Phase::Rest => (overdue_s >= 0.0).then_some(Event::Lost),
        }
    }
}

impl Mover {
    /// The part in the script of a scene.
    pub(super) fn new(scene: &BlockTransfer) -> Self {
        Self {
            task: scene.clone(),
            grip: None,
        }
    }
}

impl Hand<Mover> {
    fn gripping(&self) -> Gripping<'_> {
        Gripping {
            block: &self.part.task.block,
            board: &self.part.task.board,
        }
    }

    /// The chosen wall.
    #[expect(
        clippy::expect_used,
        reason = "the first motion begins with the choice, and nothing comes before it"
    )]
    fn grip(&self) -> Grip {
        self.part.grip.expect("a motion has begun")
    }

    /// The pose in which closing the jaw grips the chosen wall.
    fn grasp_pose(&self, view: &View) -> Pose {
        let (along_m, depth_m) = (self.style.along_m, self.style.depth_m);
        self.gripping()
            .tip_pose(self.grip(), &view.thing, along_m, depth_m)
    }

    /// The pose to wait in above the block.
    fn poise_pose(&self, view: &View) -> Pose {
        Translation3::new(0.0, 0.0, self.style.poise_height_m) * self.grasp_pose(view)
    }

    /// The pose of the tip that brings the block upright over the goal.
    fn over_goal(&self, view: &View) -> Pose {
        self.bringing(view, self.part.task.board.peg_height_m + self.style.clear_m)
    }

    /// The pose of the tip that brings the block down around the goal.
    fn on_goal(&self, view: &View) -> Pose {
        self.bringing(view, self.style.drop_m)
    }

    fn bringing(&self, view: &View, bottom_m: f64) -> Pose {
        let goal = &view.goal.translation.vector;
        let wanted = self
            .gripping()
            .placed(self.grip(), &view.thing, goal, bottom_m);
        wanted * view.thing.inv_mul(&view.arm.tip)
    }

    /// Distance of the block from where a carrying motion brings it.
    fn carried_gap_m(&self, view: &View) -> f64 {
        let wanted = self.over_goal(view);
        (wanted.translation.vector - view.arm.tip.translation.vector).norm()
    }

    /// Height of the block's lower end above the board.
    fn bottom_m(&self, view: &View) -> f64 {
        view.thing.translation.z - 0.5 * self.part.task.block.height_m
    }

    /// How far to lift the block.
    fn lift_m(&self, view: &View) -> f64 {
        let height_m = self.part.task.board.peg_height_m + self.style.clear_m;
        (height_m - self.bottom_m(view)).max(0.001)
    }

    /// How far to rise for the fingers to pass over the pegs.
    fn retreat_m(&self, from: &Placement) -> f64 {
        let height_m = self.part.task.board.peg_height_m + OVER_PEGS_M;
        (height_m - from.tip_in_scene.translation.z).max(self.style.poise_height_m)
    }
}

#[cfg(test)]
mod tests;
