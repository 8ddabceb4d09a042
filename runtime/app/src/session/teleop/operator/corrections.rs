//! Corrections of what is seen to have gone astray: minimum-jerk movements on top of the one under
//! way, one after another.

use std::collections::VecDeque;

use hal::{Pose, TimeNs};
use nalgebra::{UnitQuaternion, Vector3};

use super::OperatorFigures;

/// A way, m, and a turn as a rotation vector, rad.
pub(super) type Step = [Vector3<f64>; 2];

/// What one correction comes to at most, m and rad.
const WAY_M_MAX: f64 = 0.01;
const TURN_RAD_MAX: f64 = 0.35;

/// How long what a hand did is remembered; longer than any delay, ns.
const MEMORY_NS: u64 = 1_000_000_000;

/// One hand's.
#[derive(Clone, Debug, Default)]
pub(super) struct Corrections {
    /// Where the tip should have come to by what the hand meant to do.
    meant: VecDeque<(TimeNs, Pose)>,
    /// What they come to so far.
    done: Step,
    under_way: Option<UnderWay>,
    /// Before this there is none.
    next: TimeNs,
}

#[derive(Clone, Copy, Debug)]
struct UnderWay {
    began: TimeNs,
    all: Step,
    /// What part of it is done.
    share: f64,
}

impl Corrections {
    /// What went on before `now` is of no account: the tip goes on from where it is.
    pub(super) fn forget(&mut self, now: TimeNs) {
        *self = Self {
            next: now,
            ..Self::default()
        };
    }

    /// Whether one is under way.
    pub(super) const fn any(&self) -> bool {
        self.under_way.is_some()
    }

    /// What they add at `now`, the tip being meant to be `wanted` but for them.
    pub(super) fn step(&mut self, now: TimeNs, wanted: &Pose, figures: &OperatorFigures) -> Step {
        let added = self.go_on(now, figures.correction_s);
        for (done, added) in self.done.iter_mut().zip(added) {
            *done += added;
        }
        self.meant.push_back((now, moved(wanted, self.done)));
        let old = |(at, _): &(TimeNs, Pose)| now.since(*at) > MEMORY_NS;
        while self.meant.front().is_some_and(old) {
            self.meant.pop_front();
        }
        added
    }

    fn go_on(&mut self, now: TimeNs, lasts_s: f64) -> Step {
        let Some(mut one) = self.under_way else {
            return Step::default();
        };
        let share = blend(TimeNs(now.since(one.began)).seconds() / lasts_s);
        let added = one.all.map(|all| all * (share - one.share));
        one.share = share;
        self.under_way = Some(one).filter(|_| share < 1.0);
        added
    }

    /// The tip is seen at `tip`, where it was at `seen_at`: begins a correction at `now` if it is
    /// off and none is under way.
    pub(super) fn look(
        &mut self,
        now: TimeNs,
        (seen_at, tip): (TimeNs, &Pose),
        figures: &OperatorFigures,
    ) {
        let lag = TimeNs(to_ns(figures.arm_lag_s));
        let meant = self.meant_at(TimeNs(seen_at.since(lag)));
        let (Some(meant), false) = (meant, self.any() || now.0 < self.next.0) else {
            return;
        };
        let off = between(&meant, tip);
        let [way, turn] = [0, 1].map(|part| -off[part] - self.done[part]);
        if way.norm() < figures.near_m && turn.norm() < figures.near_rad {
            return;
        }
        let all = [capped(way, WAY_M_MAX), capped(turn, TURN_RAD_MAX)];
        self.under_way = Some(UnderWay {
            began: now,
            all,
            share: 0.0,
        });
        self.next = now.plus_ns(to_ns(figures.correct_every_s));
    }

    /// Where the tip was meant to be at `at`, as far as that is remembered.
    fn meant_at(&self, at: TimeNs) -> Option<Pose> {
        let after = self.meant.iter().position(|(time, _)| *time >= at)?;
        let (end, to) = self.meant[after];
        let (begin, from) = *self.meant.get(after.checked_sub(1)?)?;
        let share = TimeNs(at.since(begin)).seconds() / TimeNs(end.since(begin)).seconds();
        Some(from.lerp_slerp(&to, share))
    }
}

/// From one pose to another: the way between their places, and the turn before the first.
pub(super) fn between(from: &Pose, to: &Pose) -> Step {
    [
        to.translation.vector - from.translation.vector,
        (to.rotation * from.rotation.inverse()).scaled_axis(),
    ]
}

/// `pose` after a step.
pub(super) fn moved(pose: &Pose, [way, turn]: Step) -> Pose {
    let mut rotation = UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
    rotation.renormalize();
    Pose::from_parts((pose.translation.vector + way).into(), rotation)
}

/// Minimum-jerk blend from 0 to 1.
pub(super) fn blend(share: f64) -> f64 {
    let s = share.clamp(0.0, 1.0);
    s.powi(3) * (10.0 - 15.0 * s + 6.0 * s * s)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "times of an operator are positive and short"
)]
pub(super) fn to_ns(seconds: f64) -> u64 {
    (seconds * 1e9) as u64
}

fn capped(vector: Vector3<f64>, most: f64) -> Vector3<f64> {
    vector * (most / vector.norm().max(most))
}
