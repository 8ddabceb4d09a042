//! Suture pad: grips the needle at the middle of its arc, turns its point to the hole, and turns it
//! through.
//!
//! The needle stays flat all the way: its arc lies in a horizontal plane at the height of the hole,
//! and the drive is a turn about the arc's centre. The script keeps the needle, not the hand, on
//! that way, goes back and lines up again if the point does not get through, and starts over when
//! the fingers closed on nothing or the needle slipped out.

mod phase;
mod style;

use hal::{Pose, TimeNs};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use trocar_world::needle::NeedleShape;
use trocar_world::organ::Organ;

use super::{PadShape, SuturePad};
use crate::script::alone::View;
use crate::script::hand::{ARRIVED_PATIENCE_S, raised, settled};
use crate::script::motion::{Motion, Placement};
use crate::script::play::{Activity, Event, Hand, Part};
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
    /// What the needle lies on, if that is not the pad.
    organ: Option<Organ>,
}

impl Part for Driver {
    type Habits = Style;
    type Stage = Phase;
    type View = View;

    fn carries(hand: &Hand<Self>) -> bool {
        use Phase::{Back, Cross, Drive, Hold, Lift, Near};
        matches!(hand.phase, Lift | Cross | Near | Drive | Back | Hold)
    }

    fn activity(hand: &Hand<Self>) -> Activity {
        match hand.phase {
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

    fn tries_again(_hand: &Hand<Self>, next: Phase) -> bool {
        matches!(next, Phase::Open | Phase::Back)
    }

    fn begin(hand: &mut Hand<Self>, now: TimeNs, from: Placement, view: &View) -> Motion {
        let style = &hand.style;
        let straight = Vector3::zeros();
        let open = |tip| from.with_tip(tip).with_jaw(style.open_rad);
        let held = |tip_in_scene| from.with_tip(tip_in_scene);
        let jaw = |jaw| from.with_jaw(jaw);
        let lift_m = hand.part.pad.hole_height_m - view.thing.translation.z;
        let (to, bow_m, pace) = match hand.phase {
            Phase::Approach => (open(hand.poise_pose(view)), style.bow_m, style.approach),
            Phase::Descend => (open(hand.grasp_pose(view)), straight, style.descend),
            Phase::Close => (jaw(style.grip_rad), straight, style.close),
            Phase::Lift => (raised(from, lift_m), straight, style.carry),
            Phase::Cross => (held(hand.aside(view)), style.detour_m, style.carry),
            Phase::Near => (held(hand.lined_up(view)), straight, style.carry),
            Phase::Drive => {
                return hand.turn(now, from, view, style.driven_rad);
            }
            Phase::Back => return hand.turn(now, from, view, style.ready_rad),
            Phase::Hold => return Motion::rest(from, now, 0.0),
            Phase::Open => (jaw(style.open_rad), straight, style.close),
            Phase::Retreat => (raised(from, style.poise_height_m), straight, style.descend),
        };
        Motion::new(from, to, bow_m, now, pace)
    }

    fn moving_goal(hand: &Hand<Self>, view: &View) -> Option<Pose> {
        match hand.phase {
            Phase::Approach => Some(hand.poise_pose(view)),
            Phase::Descend => Some(hand.grasp_pose(view)),
            Phase::Cross if view.arm.both_touch => Some(hand.aside(view)),
            Phase::Near if view.arm.both_touch => Some(hand.lined_up(view)),
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

    fn event(hand: &Hand<Self>, now: TimeNs, motion: &Motion, view: &View) -> Option<Event> {
        let overdue_s = motion.overdue_s(now);
        if hand.carries() && hand.has_lost(LOST_STEPS) {
            return Some(Event::Lost);
        }
        let patient = overdue_s > ARRIVED_PATIENCE_S;
        match hand.phase {
            Phase::Approach | Phase::Lift | Phase::Cross | Phase::Retreat => {
                (overdue_s >= 0.0).then_some(Event::Arrived)
            }
            Phase::Descend => {
                let there = overdue_s >= 0.0 && settled(motion, &view.arm.tip);
                (there || patient).then_some(Event::Arrived)
            }
            Phase::Close if overdue_s < hand.style.settle_s => None,
            Phase::Close if view.arm.both_touch => Some(if hand.is_in_hole(view) {
                Event::Regripped
            } else {
                Event::Gripped
            }),
            Phase::Close => (overdue_s > GRIP_PATIENCE_S).then_some(Event::Lost),
            Phase::Near => {
                let gap = hand.lined_up(view).translation.vector - view.arm.tip.translation.vector;
                let there = overdue_s >= 0.0 && gap.norm() < LINED_UP_M;
                (there || patient).then_some(Event::Arrived)
            }
            Phase::Drive if overdue_s < 0.2 => None,
            Phase::Drive => {
                let through = hand.point(view).y >= hand.part.pad.lip_back_m() + THROUGH_M;
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
    /// The part in the script of a scene.
    pub(super) fn new(scene: &SuturePad) -> Self {
        Self {
            needle: scene.needle,
            pad: scene.pad,
            organ: scene.organ(),
        }
    }
}

impl Hand<Driver> {
    /// The turn about the drive's centre that brings the needle's point to `angle_rad`.
    fn turn(&self, now: TimeNs, from: Placement, view: &View, angle_rad: f64) -> Motion {
        let centre = self.drive_centre();
        let turn_rad = angle_rad - self.point_rad(view);
        Motion::swing(from, centre, turn_rad, now, self.style.drive)
    }

    /// The pose in which closing the jaw grips the wire near the middle of its arc.
    fn grasp_pose(&self, view: &View) -> Pose {
        let organ = self.part.organ.as_ref();
        wire_grasp(
            &self.part.needle,
            &view.thing,
            self.style.along_m,
            |x, y| organ.map_or(0.0, |organ| organ.height_m(x, y)),
        )
    }

    /// The pose to wait in above the needle.
    fn poise_pose(&self, view: &View) -> Pose {
        Translation3::new(0.0, 0.0, self.style.poise_height_m) * self.grasp_pose(view)
    }

    /// The centre of the circle that leads through the hole: left of it.
    fn drive_centre(&self) -> Point3<f64> {
        self.part.pad.hole() - Vector3::x() * self.part.needle.arc_radius_m
    }

    /// The pose of the tip that brings the needle before the hole, ready for the drive.
    fn lined_up(&self, view: &View) -> Pose {
        let yaw_rad = self.style.ready_rad - 0.5 * self.part.needle.arc_angle_rad;
        let wanted = Pose::from_parts(
            self.drive_centre().into(),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad),
        );
        wanted * view.thing.inv_mul(&view.arm.tip)
    }

    /// The same, further from the lip.
    fn aside(&self, view: &View) -> Pose {
        Translation3::new(0.0, -self.style.aside_m, 0.0) * self.lined_up(view)
    }

    /// The needle's point.
    fn point(&self, view: &View) -> Point3<f64> {
        let (sin, cos) = (0.5 * self.part.needle.arc_angle_rad).sin_cos();
        view.thing * (Point3::new(cos, sin, 0.0) * self.part.needle.arc_radius_m)
    }

    /// Angle of the needle's point about the drive's centre, from the plane of the lip.
    fn point_rad(&self, view: &View) -> f64 {
        let arm = self.point(view) - self.drive_centre();
        arm.y.atan2(arm.x)
    }

    fn is_in_hole(&self, view: &View) -> bool {
        let (point, hole) = (self.point(view), self.part.pad.hole());
        let near = (point.x - hole.x).abs() < 2.0 * self.part.pad.hole_half_m;
        near && point.y > self.part.pad.lip_front_m
    }
}

#[cfg(test)]
mod tests;
