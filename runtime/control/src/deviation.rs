//! How far a measured instrument is from the commanded one. Hot path: bounded, no allocation, no
//! I/O, no lock.
//!
//! Compared are the present command and the present measurement, so the lag of drives and bus is in
//! it. In each tick the guard and the filter get the larger of it and a decaying memory (`held`).

use nalgebra::Vector3;

use super::instrument::{Instrument, KinematicState, LINKS};
use super::kinematics::Frames;
use super::snapshot::words;

/// Decay of a held deviation per tick: it decays within about the longest stop, 0.4 s.
const LEFT_PER_TICK: f64 = 0.9975;

/// A deviation below this counts as zero, m: far below an encoder's resolution.
const NONE_M: f64 = 1e-9;

/// How far a measured instrument is from the commanded one, in space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deviation {
    /// Of each link the point that is furthest from where it is commanded to be, m.
    pub links_m: [f64; LINKS],
    /// The control point, m.
    pub tip_m: f64,
    /// The tips of the fingers, left and right, m.
    pub fingers_m: [f64; 2],
    /// By how much the tip is turned, rad.
    pub turn_rad: f64,
}

words!(Deviation {
    links_m: [f64; LINKS],
    tip_m: f64,
    fingers_m: [f64; 2],
    turn_rad: f64,
});

impl Deviation {
    /// The deviation of `measured` from `commanded`.
    #[must_use]
    pub fn between(commanded: &KinematicState, measured: &KinematicState) -> Self {
        let apart = |point: fn(&Instrument) -> Vector3<f64>| {
            (point(&measured.instrument) - point(&commanded.instrument)).norm()
        };
        let wrist_m = apart(|at| at.wrist_m);
        let tip_m = apart(|at| at.tip_m);
        let fingers_m = [apart(|at| at.fingers_m[0]), apart(|at| at.fingers_m[1])];
        // Points between a link's ends are off by no more than its ends.
        let [left_m, right_m] = fingers_m.map(|finger_m| finger_m.max(tip_m));
        Self {
            links_m: [wrist_m, wrist_m.max(tip_m), left_m, right_m],
            tip_m,
            fingers_m,
            turn_rad: turn(&commanded.frames, &measured.frames),
        }
    }

    /// The larger of this deviation, decayed by a tick, and a `newer` one.
    ///
    /// Per part, `max(new, 0.9975 old)`: after 0.4 s a peak has fallen to 37 percent.
    #[must_use]
    pub fn held(&self, newer: &Self) -> Self {
        let hold = |before: f64, now: f64| {
            let left = before * LEFT_PER_TICK;
            if left < NONE_M { now } else { left.max(now) }
        };
        Self {
            links_m: core::array::from_fn(|link| hold(self.links_m[link], newer.links_m[link])),
            tip_m: hold(self.tip_m, newer.tip_m),
            fingers_m: core::array::from_fn(|side| {
                hold(self.fingers_m[side], newer.fingers_m[side])
            }),
            turn_rad: hold(self.turn_rad, newer.turn_rad),
        }
    }
}

/// The angle between two tip frames, rad.
///
/// `acos((trace(R_a' R_b) - 1) / 2)`; the columns of both are orthonormal, so the trace is a sum of
/// three products.
fn turn(one: &Frames, other: &Frames) -> f64 {
    let axes = |frames: &Frames| {
        let side = frames.wrist_yaw_axis.cross(&frames.approach);
        [frames.wrist_yaw_axis, side, frames.approach]
    };
    let trace: f64 = axes(one)
        .iter()
        .zip(&axes(other))
        .map(|(axis, its)| axis.dot(its))
        .sum();
    ((trace - 1.0) / 2.0).clamp(-1.0, 1.0).acos()
}

#[cfg(test)]
mod tests {
    use super::Deviation;
    use crate::instrument::KinematicState;
    use crate::motion::{AXES, JAW, MotionState};

    fn stance(changes: &[(usize, f64)]) -> KinematicState {
        let mut state = MotionState::ZERO;
        state.position = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0, 0.2];
        for &(axis, by) in changes {
            state.position[axis] += by;
        }
        KinematicState::new(&state)
    }

    #[test]
    fn each_axis_deviates_in_space_by_its_lever() {
        let home = stance(&[]);
        let of = |axis: usize, by: f64| Deviation::between(&home, &stance(&[(axis, by)]));
        assert!(Deviation::between(&home, &home).tip_m < 1e-15);
        let inserted = of(2, 0.003);
        assert!((inserted.tip_m - 0.003).abs() < 1e-12 && inserted.turn_rad < 1e-7);
        assert!(inserted.links_m.iter().all(|m| (m - 0.003).abs() < 1e-12));
        let yawed = of(0, 0.01);
        let lever_m = home.instrument.tip_m.norm();
        assert!((yawed.tip_m - 0.01 * lever_m).abs() < 1e-6, "{yawed:?}");
        assert!((yawed.turn_rad - 0.01).abs() < 1e-9);
        // Roll turns the tip on the spot, the jaw moves the fingers alone.
        let rolled = of(3, 0.1);
        assert!(rolled.tip_m < 1e-12 && (rolled.turn_rad - 0.1).abs() < 1e-9);
        let opened = of(JAW, 0.1);
        assert!(opened.tip_m < 1e-12 && opened.fingers_m.iter().all(|m| *m > 4e-4));
        assert_eq!(AXES, JAW + 1);
    }

    #[test]
    fn a_deviation_is_held_for_about_a_stop() {
        let (home, off) = (stance(&[]), stance(&[(2, 0.001)]));
        let none = Deviation::between(&home, &home);
        let mut held = Deviation::default().held(&Deviation::between(&home, &off));
        assert!((held.tip_m - 0.001).abs() < 1e-12);
        let mut after = [0.0; 2];
        for tick in 0..20_000 {
            held = held.held(&none);
            match tick {
                99 => after[0] = held.tip_m,
                1199 => after[1] = held.tip_m,
                _ => {}
            }
        }
        assert!(after[0] > 0.000_7 && after[1] < 0.000_06, "{after:?}");
        assert_eq!(held, Deviation::default());
    }
}
