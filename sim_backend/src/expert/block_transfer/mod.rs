//! Block transfer: grips a wall of the block from above, one finger in the hole, and moves it to the goal peg.
//!
//! It takes the wall that the peg leaves most room at, keeps the block upright and its hole over the goal on the way,
//! goes up again if the block does not go down, and starts over when the fingers closed on nothing, the block slipped
//! out, or it was let go beside the peg.

mod grip;
mod phase;
mod style;

use hal::{Pose, TimeNs, TipTarget};
use nalgebra::{Translation3, Vector3};

use super::hand::{ARRIVED_PATIENCE_S, raised, settled};
use super::motion::{Motion, Placement};
use super::{Script, Wish, arrive, carry};
use crate::rng::Rng;
use crate::simulation::SceneState;
use crate::task::TaskConfig;
use crate::task::block_transfer::BlockTransfer;
use grip::{Grip, Gripping};
use phase::{Event, Phase};
use style::Style;

/// A step's share of following a moving block, m and rad.
const FOLLOW_STEP_M: f64 = 0.000_8;
const FOLLOW_STEP_RAD: f64 = 0.04;

/// How far the block may be from its place when a carrying motion ends, m.
const CARRIED_M: f64 = 0.000_6;

/// How high above its end the block may be at the end of the lowering, m; higher, something holds it up.
const STUCK_M: f64 = 0.002;

/// How long to wait for both fingers after the jaw's motion has ended, s.
const GRIP_PATIENCE_S: f64 = 0.5;

/// Steps without touch by both fingers after which the block counts as lost.
const LOST_STEPS: u32 = 4;

/// Time to rest with an open jaw, s.
const OPEN_S: f64 = 0.25;

/// How long the block is looked at before it counts as misplaced, s.
const REST_S: f64 = 1.0;

/// Height of the control point at which the open fingers pass over the pegs, beyond the pegs' height, m.
const OVER_PEGS_M: f64 = hal::psm::FINGER_M + 0.004;

/// The script of the block transfer.
#[derive(Clone, Debug)]
pub(super) struct Mover {
    task: BlockTransfer,
    scene_from_rcm: Pose,
    rng: Rng,
    style: Style,
    phase: Phase,
    grip: Option<Grip>,
    motion: Option<Motion>,
    attempts: u32,
    untouched_steps: u32,
}

/// What the script sees, in the scene frame.
struct View {
    tip: Pose,
    block: Pose,
    goal: Vector3<f64>,
    both_touch: bool,
}

impl Script for Mover {
    fn step(&mut self, now: TimeNs, scene: &SceneState) -> Wish {
        let view = self.view(scene);
        let start = Placement {
            tip_in_scene: view.tip,
            jaw: scene.first.jaw,
        };
        let mut motion = match self.motion {
            Some(motion) => motion,
            None => self.begin(now, start, &view),
        };
        if let Some(goal) = self.moving_goal(&view) {
            motion.drift_end(&goal, FOLLOW_STEP_M, FOLLOW_STEP_RAD);
        }
        if let Some(event) = self.event(now, &motion, &view) {
            let next = self.phase.next(event);
            if next != self.phase {
                self.enter(next);
                motion = self.begin(now, motion.at(now), &view);
            }
        }
        self.motion = Some(motion);
        let placement = motion.at(now);
        let tip_in_rcm = self.scene_from_rcm.inv_mul(&placement.tip_in_scene);
        Wish {
            first: TipTarget::new(&tip_in_rcm, placement.jaw),
            second: None,
        }
    }

    fn attempts(&self) -> u32 {
        self.attempts
    }

    fn foresee(&self, scene: &mut SceneState, wish: &Wish) {
        if self.carries() && scene.first.grasp.both_touch {
            carry(&mut scene.first, &wish.first);
        } else {
            arrive(&mut scene.first, &wish.first);
        }
    }
}

impl Mover {
    pub(super) fn new(task: &TaskConfig, scene: &BlockTransfer, seed: u64) -> Self {
        let mut rng = Rng::stream(seed, "expert");
        let style = Style::draw(&mut rng);
        Self {
            task: scene.clone(),
            scene_from_rcm: task.arms[0].scene_from_rcm,
            rng,
            style,
            phase: Phase::Approach,
            grip: None,
            motion: None,
            attempts: 1,
            untouched_steps: 0,
        }
    }

    fn view(&self, scene: &SceneState) -> View {
        let goal = scene.goal_in_scene.unwrap_or_else(Pose::identity);
        View {
            tip: self.scene_from_rcm * scene.first.tip_in_rcm,
            block: self.scene_from_rcm * scene.first.thing_in_rcm,
            goal: goal.translation.vector,
            both_touch: scene.first.grasp.both_touch,
        }
    }

    /// Whether the block is meant to be in the jaw.
    fn carries(&self) -> bool {
        matches!(self.phase, Phase::Lift | Phase::Carry | Phase::Lower)
    }

    /// Book-keeping on entering a phase.
    fn enter(&mut self, phase: Phase) {
        if phase == Phase::Open || (phase == Phase::Approach && self.phase == Phase::Rest) {
            // A person does not repeat a failed attempt exactly.
            self.style = Style::draw(&mut self.rng);
            self.attempts += 1;
        }
        if phase == Phase::Approach {
            self.grip = None;
        }
        self.phase = phase;
        self.untouched_steps = 0;
    }

    /// The motion of the present phase.
    fn begin(&mut self, now: TimeNs, from: Placement, view: &View) -> Motion {
        let grip = self
            .gripping()
            .choose(self.grip, &self.style.liking_m, &view.block);
        self.grip = Some(grip);
        let style = &self.style;
        let straight = Vector3::zeros();
        let open = |tip_in_scene| Placement {
            tip_in_scene,
            jaw: style.open_rad,
        };
        let held = |tip_in_scene| Placement {
            tip_in_scene,
            ..from
        };
        let jaw = |jaw| Placement { jaw, ..from };
        let (to, bow_m, pace) = match self.phase {
            Phase::Approach => (open(self.poise_pose(view)), style.bow_m, style.approach),
            Phase::Descend => (open(self.grasp_pose(view)), straight, style.descend),
            Phase::Close => (jaw(style.grip_rad), straight, style.close),
            Phase::Lift => (raised(from, self.lift_m(view)), straight, style.carry),
            Phase::Carry => (held(self.over_goal(view)), style.detour_m, style.carry),
            Phase::Lower => (held(self.on_goal(view)), straight, style.lower),
            Phase::Release | Phase::Open => (jaw(style.open_rad), straight, style.close),
            Phase::Rise => (raised(from, style.rise_m), straight, style.descend),
            Phase::Retreat => (raised(from, self.retreat_m(&from)), straight, style.descend),
            Phase::Rest => return Motion::rest(from, now, REST_S),
        };
        Motion::new(from, to, bow_m, now, pace)
    }

    /// The goal of a phase that follows the block.
    fn moving_goal(&self, view: &View) -> Option<Pose> {
        match self.phase {
            Phase::Approach => Some(self.poise_pose(view)),
            Phase::Descend => Some(self.grasp_pose(view)),
            Phase::Carry if view.both_touch => Some(self.over_goal(view)),
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

    /// What has happened at this step, if anything.
    fn event(&mut self, now: TimeNs, motion: &Motion, view: &View) -> Option<Event> {
        let overdue_s = motion.overdue_s(now);
        if view.both_touch {
            self.untouched_steps = 0;
        } else {
            self.untouched_steps += 1;
        }
        if self.carries() && self.untouched_steps >= LOST_STEPS {
            return Some(Event::Lost);
        }
        let patient = overdue_s > ARRIVED_PATIENCE_S;
        match self.phase {
            Phase::Approach | Phase::Lift | Phase::Rise | Phase::Retreat => {
                (overdue_s >= 0.0).then_some(Event::Arrived)
            }
            Phase::Descend => {
                let there = overdue_s >= 0.0 && settled(motion, &view.tip);
                (there || patient).then_some(Event::Arrived)
            }
            Phase::Close if overdue_s < self.style.settle_s => None,
            Phase::Close if view.both_touch => Some(Event::Gripped),
            Phase::Close => (overdue_s > GRIP_PATIENCE_S).then_some(Event::Lost),
            Phase::Carry => {
                let gap_m = self.carried_gap_m(view);
                ((overdue_s >= 0.0 && gap_m < CARRIED_M) || patient).then_some(Event::Arrived)
            }
            Phase::Lower if overdue_s < 0.1 => None,
            Phase::Lower => Some(if self.bottom_m(view) > self.style.drop_m + STUCK_M {
                Event::Stuck
            } else {
                Event::Arrived
            }),
            Phase::Release | Phase::Open => (overdue_s >= OPEN_S).then_some(Event::Arrived),
            Phase::Rest => (overdue_s >= 0.0).then_some(Event::Lost),
        }
    }

    fn gripping(&self) -> Gripping<'_> {
        Gripping {
            block: &self.task.block,
            board: &self.task.board,
        }
    }

    /// The pose in which closing the jaw grips the chosen wall.
    fn grasp_pose(&self, view: &View) -> Pose {
        let grip = self.grip.unwrap_or_default();
        let (along_m, depth_m) = (self.style.along_m, self.style.depth_m);
        self.gripping()
            .tip_pose(grip, &view.block, along_m, depth_m)
    }

    /// The pose to wait in above the block.
    fn poise_pose(&self, view: &View) -> Pose {
        Translation3::new(0.0, 0.0, self.style.poise_height_m) * self.grasp_pose(view)
    }

    /// The pose of the tip that brings the block upright over the goal.
    fn over_goal(&self, view: &View) -> Pose {
        self.bringing(view, self.task.board.peg_height_m + self.style.clear_m)
    }

    /// The pose of the tip that brings the block down around the goal.
    fn on_goal(&self, view: &View) -> Pose {
        self.bringing(view, self.style.drop_m)
    }

    fn bringing(&self, view: &View, bottom_m: f64) -> Pose {
        let grip = self.grip.unwrap_or_default();
        let wanted = self
            .gripping()
            .placed(grip, &view.block, &view.goal, bottom_m);
        wanted * view.block.inv_mul(&view.tip)
    }

    /// Distance of the block from where a carrying motion brings it.
    fn carried_gap_m(&self, view: &View) -> f64 {
        let wanted = self.over_goal(view);
        (wanted.translation.vector - view.tip.translation.vector).norm()
    }

    /// Height of the block's lower end above the board.
    fn bottom_m(&self, view: &View) -> f64 {
        view.block.translation.z - 0.5 * self.task.block.height_m
    }

    /// How far to lift the block.
    fn lift_m(&self, view: &View) -> f64 {
        let height_m = self.task.board.peg_height_m + self.style.clear_m;
        (height_m - self.bottom_m(view)).max(0.001)
    }

    /// How far to rise for the fingers to pass over the pegs.
    fn retreat_m(&self, from: &Placement) -> f64 {
        let height_m = self.task.board.peg_height_m + OVER_PEGS_M;
        (height_m - from.tip_in_scene.translation.z).max(self.style.poise_height_m)
    }
}
