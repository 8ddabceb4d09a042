//! How far and how sharply the instrument's points can move between two samples of a stop. Hot
//! path: bounded, no allocation, no I/O, no lock.

use hal::joints::INSERTION;
use hal::psm::{FINGER_M, JAW_MAX, WRIST_M};

use super::sample::Sample;
use super::way::Way;
use crate::instrument::LINKS;
use crate::motion::{AXES, AxisLimits, JAW};
use crate::stop::Stop;

/// Upper bounds of the motion in one gap.
pub(super) struct Bounds {
    shaft: Way,
    wrist: Way,
    fingers: Way,
    /// How much faster than at the ends' mean the control point can be, m/s.
    pub(super) tip_rise_m_s: f64,
    /// How much faster than at the faster end the tip can turn, rad/s.
    pub(super) turn_rise_rad_s: f64,
}

impl Bounds {
    /// What can happen in `stop` between two samples that are `gap_s` apart.
    pub(super) fn new(
        axes: &[AxisLimits; AXES],
        stop: &Stop,
        before: &Sample,
        after: &Sample,
        gap_s: f64,
    ) -> Self {
        let speeds = core::array::from_fn(|axis| {
            // Between two samples a velocity leaves the line through them by an eighth of the jerk
            // times the gap squared.
            let bulge = axes[axis].jerk * gap_s * gap_s / 8.0;
            (before.velocity[axis].abs().max(after.velocity[axis].abs()) + bulge)
                .min(stop.axes()[axis].peak_velocity())
        });
        let accelerations = core::array::from_fn(|axis| {
            let ends = before.acceleration[axis].abs() + after.acceleration[axis].abs();
            ((ends + axes[axis].jerk * gap_s) / 2.0).min(stop.axes()[axis].peak_acceleration())
        });
        let distance_m = f64::midpoint(before.wrist_distance_m, after.wrist_distance_m)
            + speeds[INSERTION] * gap_s / 2.0;
        let reach = Reach {
            distance_m,
            speeds,
            accelerations,
        };
        let jerks = axes.map(|axis| axis.jerk);
        let way = |(speed, acceleration): (f64, f64), kink_m_s: f64| Way {
            half_m: speed * gap_s / 2.0,
            bend_m: acceleration * gap_s * gap_s / 8.0,
            turn_m2: speed * speed * gap_s * gap_s / 8.0,
            kink_m: kink_m_s * gap_s / 4.0,
        };
        let ends = jaw_ends_passed(before.jaw, after.jaw, speeds[JAW] * gap_s / 2.0);
        let wrist = reach.wrist();
        Self {
            shaft: way(reach.shaft(), 0.0),
            wrist: way(wrist, 0.0),
            fingers: way(reach.fingers(), ends * FINGER_M * speeds[JAW] / 2.0),
            tip_rise_m_s: wrist.1 * gap_s / 2.0,
            turn_rise_rad_s: reach.turn_bend(&jerks) * gap_s * gap_s / 8.0,
        }
    }

    /// How the points of each link, in the order of [`crate::instrument::Link::ALL`], can move.
    pub(super) const fn ways(&self) -> [Way; LINKS] {
        [self.shaft, self.wrist, self.fingers, self.fingers]
    }
}

/// How often the fingers' opening can meet one of its ends, between which alone the jaw moves them,
/// in half a gap in which the jaw moves `half` rad: a stop turns back at most once, so twice for
/// each end that is near.
fn jaw_ends_passed(before: f64, after: f64, half: f64) -> f64 {
    let (low, high) = (before.min(after) - half, before.max(after) + half);
    let near = |end: f64| if low <= end && high >= end { 2.0 } else { 0.0 };
    near(0.0) + near(JAW_MAX)
}

/// Upper bounds of the joint motion in a gap, and what they mean for points of the instrument.
struct Reach {
    /// From the remote centre to the wrist, m.
    distance_m: f64,
    speeds: [f64; AXES],
    accelerations: [f64; AXES],
}

impl Reach {
    /// Speed and acceleration that no point of the shaft exceeds.
    ///
    /// The wrist is at `L s` with `s` turning about yaw and pitch, which are at right angles, and
    /// the shaft's points are fractions of it: `(L s)'' = L'' s + 2 L' s' + L s''`, where `s''`
    /// holds the joints' accelerations, at right angles to `s`, the turning of the pitch axis with
    /// yaw, and the centripetal part.
    fn shaft(&self) -> (f64, f64) {
        let [yaw, pitch, insertion, ..] = self.speeds;
        let [a_yaw, a_pitch, a_insertion, ..] = self.accelerations;
        let (swing, distance_m) = (yaw.hypot(pitch), self.distance_m);
        let speed = (distance_m * swing).hypot(insertion);
        let joints = (distance_m * a_yaw.hypot(a_pitch)).hypot(a_insertion);
        let turning = 2.0 * insertion * swing + distance_m * (yaw * pitch + swing * swing);
        (speed, joints + turning)
    }

    /// The same for the wrist, whose points turn about the shaft's end.
    fn wrist(&self) -> (f64, f64) {
        self.further(self.shaft(), WRIST_M, 5)
    }

    /// The same for the fingers, whose points turn about the control point.
    fn fingers(&self) -> (f64, f64) {
        self.further(self.wrist(), FINGER_M, AXES)
    }

    /// Speed and acceleration of points up to `length_m` from one that has `base`, turned by the
    /// axes before `end`.
    ///
    /// A body that turns at `w` at most accelerates such a point by `length (|w'| + w²)`, and `w'`
    /// holds the axes' accelerations and the turning of each axis with those before it, together at
    /// most `w² / 2`.
    fn further(&self, base: (f64, f64), length_m: f64, end: usize) -> (f64, f64) {
        let sum = |values: &[f64; AXES]| {
            let mut sum = values[0].hypot(values[1]);
            for (axis, value) in values.iter().enumerate().take(end).skip(INSERTION + 1) {
                sum += if axis == JAW { 0.5 * value } else { *value };
            }
            sum
        };
        let (turn, turn_rate) = (sum(&self.speeds), sum(&self.accelerations));
        (
            base.0 + length_m * turn,
            base.1 + length_m * (turn_rate + 1.5 * turn * turn),
        )
    }

    /// The second derivative of the tip's turning velocity is no greater, rad/s³.
    ///
    /// The velocity is the sum of `z v` over the joints that turn, and each axis turns with those
    /// before it at `w`: `(z v)'' = z v'' + 2 (w x z) v' + (w' x z + w x (w x z)) v`.
    fn turn_bend(&self, jerks: &[f64; AXES]) -> f64 {
        let (mut w, mut w_rate, mut bend) = (0.0, 0.0, 0.0);
        for joint in [0, 1, 3, 4, 5] {
            let (speed, acceleration) = (self.speeds[joint], self.accelerations[joint]);
            bend += jerks[joint] + 2.0 * w * acceleration + (w_rate + w * w) * speed;
            w_rate += acceleration + w * speed;
            w += speed;
        }
        bend
    }
}
