//! Suture pad: grips the needle at the middle of its arc, turns its point to the hole, and turns it through.
//!
//! The needle stays flat all the way: its arc lies in a horizontal plane at the height of the hole, and the drive is a
//! turn about the arc's centre. The script keeps the needle, not the hand, on that way, goes back and lines up again if
//! the point does not get through, and starts over when the fingers closed on nothing or the needle slipped out.

mod phase;
mod style;

use hal::{Pose, TimeNs};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use trocar_world::needle::NeedleShape;
use trocar_world::rng::Rng;

use super::{PadShape, SuturePad};
use crate::script::alone::View;
use crate::script::hand::{ARRIVED_PATIENCE_S, raised, settled};
use crate::script::motion::{Motion, Placement};
use crate::script::play::{Activity, ArmView, Event, Hand, Part};
use crate::script::wire::wire_grasp;
use phase::Phase;
use style::Style;

/// How far the needle may be from its place before the drive, m.
const LINED_UP_M: f64 = 0.000_4;

/// How far behind the lip the point must get, m.
const THROUGH_M: f64 = 0.008_5;

/// How long to wait for both fingers after the jaw's motion has ended, s.
const GRIP_PATIENCE_S: f64 = 0.5;

/// Steps without touch by both fingers after which the needle counts as lost.
const LOST_STEPS: u32 = 4;

/// Time to rest with an open jaw after a failed attempt, s.
const REOPEN_S: f64 = 0.3;

/// The script of the suture pad.
#[derive(Clone, Debug)]
pub(super) struct Driver {
    needle: NeedleShape,
    pad: PadShape,
    hand: Hand<Style, Phase>,
}

impl Part for Driver {
    type Habits = Style;
    type Stage = Phase;
    type View = View;

    fn hand(&self) -> &Hand<Style, Phase> {
        &self.hand
    }

    fn hand_mut(&mut self) -> &mut Hand<Style, Phase> {
        &mut self.hand
    }

    fn own(view: &View) -> &ArmView {
        &view.arm
    }

    fn carries(&self) -> bool {
        use Phase::{Back, Cross, Drive, Hold, Lift, Near};
        matches!(self.hand.phase, Lift | Cross | Near | Drive | Back | Hold)
    }

    fn activity(&self) -> Activity {
        match self.hand.phase {
            Phase::Approach => Activity::Reach,
            Phase::Descend | Phase::Close => Activity::Grasp,
            Phase::Lift => Activity::Lift,
            Phase::Cross => Activity::Carry,
            Phase::Near
            | Phase::Drive
            | Phase::Back
            | Phase::Hold
            | Phase::Open
            | Phase::Retreat => Activity::Other,
        }
    }

    fn tries_again(&self, next: Phase) -> bool {
        matches!(next, Phase::Open | Phase::Back)
    }

    fn begin(&mut self, now: TimeNs, from: Placement, view: &View) -> Motion {
        let style = &self.hand.style;
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
        let lift_m = self.pad.hole_height_m - view.thing.translation.z;
        let (to, bow_m, pace) = match self.hand.phase {
            Phase::Approach => (open(self.poise_pose(view)), style.bow_m, style.approach),
            Phase::Descend => (open(self.grasp_pose(view)), straight, style.descend),
            Phase::Close => (jaw(style.grip_rad), straight, style.close),
            Phase::Lift => (raised(from, lift_m), straight, style.carry),
            Phase::Cross => (held(self.aside(view)), style.detour_m, style.carry),
            Phase::Near => (held(self.lined_up(view)), straight, style.carry),
            Phase::Drive => {
                return self.turn(now, from, view, style.driven_rad);
            }
            Phase::Back => return self.turn(now, from, view, style.ready_rad),
            Phase::Hold => return Motion::rest(from, now, 0.0),
            Phase::Open => (jaw(style.open_rad), straight, style.close),
            Phase::Retreat => (raised(from, style.poise_height_m), straight, style.descend),
        };
        Motion::new(from, to, bow_m, now, pace)
    }

    fn moving_goal(&self, view: &View) -> Option<Pose> {
        match self.hand.phase {
            Phase::Approach => Some(self.poise_pose(view)),
            Phase::Descend => Some(self.grasp_pose(view)),
            Phase::Cross if view.arm.both_touch => Some(self.aside(view)),
            Phase::Near if view.arm.both_touch => Some(self.lined_up(view)),
            Phase::Close
            | Phase::Lift
            | Phase::Cross
            | Phase::Near
            | Phase::Drive
            | Phase::Back
            | Phase::Hold
            | Phase::Open
            | Phase::Retreat => None,
        }
    }

    fn event(&self, now: TimeNs, motion: &Motion, view: &View) -> Option<Event> {
        let overdue_s = motion.overdue_s(now);
        if self.carries() && self.hand.has_lost(LOST_STEPS) {
            return Some(Event::Lost);
        }
        let patient = overdue_s > ARRIVED_PATIENCE_S;
        match self.hand.phase {
            Phase::Approach | Phase::Lift | Phase::Cross | Phase::Retreat => {
                (overdue_s >= 0.0).then_some(Event::Arrived)
            }
            Phase::Descend => {
                let there = overdue_s >= 0.0 && settled(motion, &view.arm.tip);
                (there || patient).then_some(Event::Arrived)
            }
            Phase::Close if overdue_s < self.hand.style.settle_s => None,
            Phase::Close if view.arm.both_touch => Some(if self.is_in_hole(view) {
                Event::Regripped
            } else {
                Event::Gripped
            }),
            Phase::Close => (overdue_s > GRIP_PATIENCE_S).then_some(Event::Lost),
            Phase::Near => {
                let gap = self.lined_up(view).translation.vector - view.arm.tip.translation.vector;
                let there = overdue_s >= 0.0 && gap.norm() < LINED_UP_M;
                (there || patient).then_some(Event::Arrived)
            }
            Phase::Drive if overdue_s < 0.2 => None,
            Phase::Drive => {
                let through = self.point(view).y >= self.pad.lip_back_m() + THROUGH_M;
                Some(if through {
                    Event::Arrived
                } else {
                    Event::Stuck
                })
            }
            Phase::Back => (overdue_s >= 0.2).then_some(Event::Arrived),
            Phase::Hold => None,
            Phase::Open => (overdue_s >= REOPEN_S).then_some(Event::Arrived),
        }
    }
}

impl Driver {
    /// The script at the start of the episode `seed`.
    pub(super) fn new(scene: &SuturePad, seed: u64) -> Self {
        Self {
            needle: scene.needle,
            pad: scene.pad,
            hand: Hand::new(Rng::stream(seed, "expert")),
        }
    }

    /// The turn about the drive's centre that brings the needle's point to `angle_rad`.
    fn turn(&self, now: TimeNs, from: Placement, view: &View, angle_rad: f64) -> Motion {
        let centre = self.drive_centre();
        let turn_rad = angle_rad - self.point_rad(view);
        Motion::swing(from, centre, turn_rad, now, self.hand.style.drive)
    }

    /// The pose in which closing the jaw grips the wire near the middle of its arc.
    fn grasp_pose(&self, view: &View) -> Pose {
        wire_grasp(
            &self.needle,
            &view.thing,
            self.hand.style.along_m,
            |_, _| 0.0,
        )
    }

    /// The pose to wait in above the needle.
    fn poise_pose(&self, view: &View) -> Pose {
        Translation3::new(0.0, 0.0, self.hand.style.poise_height_m) * self.grasp_pose(view)
    }

    /// The centre of the circle that leads through the hole: left of it.
    fn drive_centre(&self) -> Point3<f64> {
        self.pad.hole() - Vector3::x() * self.needle.arc_radius_m
    }

    /// The pose of the tip that brings the needle before the hole, ready for the drive.
    fn lined_up(&self, view: &View) -> Pose {
        let yaw_rad = self.hand.style.ready_rad - 0.5 * self.needle.arc_angle_rad;
        let wanted = Pose::from_parts(
            self.drive_centre().into(),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad),
        );
        wanted * view.thing.inv_mul(&view.arm.tip)
    }

    /// The same, further from the lip.
    fn aside(&self, view: &View) -> Pose {
        Translation3::new(0.0, -self.hand.style.aside_m, 0.0) * self.lined_up(view)
    }

    /// The needle's point.
    fn point(&self, view: &View) -> Point3<f64> {
        let (sin, cos) = (0.5 * self.needle.arc_angle_rad).sin_cos();
        view.thing * (Point3::new(cos, sin, 0.0) * self.needle.arc_radius_m)
    }

    /// Angle of the needle's point about the drive's centre, from the plane of the lip.
    fn point_rad(&self, view: &View) -> f64 {
        let arm = self.point(view) - self.drive_centre();
        arm.y.atan2(arm.x)
    }

    fn is_in_hole(&self, view: &View) -> bool {
        let (point, hole) = (self.point(view), self.pad.hole());
        let near = (point.x - hole.x).abs() < 2.0 * self.pad.hole_half_m;
        near && point.y > self.pad.lip_front_m
    }
}

#[cfg(test)]
mod tests;
