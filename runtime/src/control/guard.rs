//! The guard: a command leaves only if the stop after it is verified. Hot path: bounded, no allocation, no I/O, no lock.
//!
//! At every tick it holds a jerk-limited stop from the commanded state along which every limit has been checked. A candidate
//! replaces it only if the stop from the candidate passes too; otherwise the held stop is played. Safety is inductive and
//! depends neither on the filter, whose rows it does not share, nor on the smoother.

mod clearance;

use hal::joints::INSERTION;
use hal::psm::{FINGER_M, WRIST_M};

use super::config::ControlConfig;
use super::motion::{AXES, AxisLimits, MotionState};
use super::stop::Stop;
use crate::kinematics::Frames;
use clearance::{Boundaries, CLEARANCES, Clearances};

/// Intervals into which a stop is cut.
const INTERVALS: u32 = 20;

/// Rounding allowed on limits, relative.
const ROUNDING: f64 = 1e-9;

/// The guard with the stop that it holds.
#[derive(Clone, Debug)]
pub struct Guard {
    axes: [AxisLimits; AXES],
    tip_speed_m_s: f64,
    margin_m: f64,
    recovery_m: f64,
    boundaries: Boundaries,
    tick_s: f64,
    /// Clearances that a stop must keep: the margin, or less where the arm was enabled without it.
    floors: Clearances,
    /// Position ranges that a stop must keep: the limits, or wider where the arm was enabled beyond them.
    ranges: [(f64, f64); AXES],
    held: Stop,
    played_s: f64,
}

/// One sample of a stop.
#[derive(Clone, Copy)]
struct Sample {
    clearances: Clearances,
    speeds: [f64; AXES],
    tip_speed_m_s: f64,
    wrist_distance_m: f64,
}

impl Guard {
    /// A guard that holds the arm at `state`, at rest.
    #[must_use]
    pub fn new(config: &ControlConfig, state: &MotionState, tick_s: f64) -> Self {
        let mut guard = Self {
            axes: config.axes,
            tip_speed_m_s: config.tip_speed_m_s,
            margin_m: config.guard.margin_m,
            recovery_m: config.guard.recovery_m,
            boundaries: Boundaries::new(&config.geometry),
            tick_s,
            floors: [config.guard.margin_m; CLEARANCES],
            ranges: config.axes.map(|axis| (axis.low, axis.high)),
            held: Stop::new(state, &config.axes),
            played_s: 0.0,
        };
        guard.seed(state);
        guard
    }

    /// Starts anew from `state`, at rest.
    ///
    /// An arm that is within a boundary stays within it, even if it starts without the margin. Where the arm is beyond a
    /// boundary already, that boundary moves to `recovery_m` behind the arm. Either comes back with the arm.
    pub fn seed(&mut self, state: &MotionState) {
        self.held = Stop::new(state, &self.axes);
        self.played_s = 0.0;
        let clearances = self.boundaries.clearances(&Frames::at(&state.joints()));
        self.floors = clearances.map(|h| self.floor(h));
        for (range, (limits, &position)) in self
            .ranges
            .iter_mut()
            .zip(self.axes.iter().zip(&state.position))
        {
            *range = (limits.low.min(position), limits.high.max(position));
        }
    }

    /// What an arm that has the clearance `h` must keep, m.
    fn floor(&self, h: f64) -> f64 {
        // Stops are bounded from below, so a boundary right at the arm would let it move neither on nor back.
        let behind = (h - self.recovery_m).min(self.margin_m);
        if h < 0.0 { behind } else { behind.max(0.0) }
    }

    /// The next state: `candidate` if it follows from `current` within the limits and its stop is verified, otherwise the
    /// next one of the stop that is held. The flag tells whether the guard intervened.
    pub fn next(
        &mut self,
        current: &MotionState,
        candidate: Option<&MotionState>,
    ) -> (MotionState, bool) {
        if let Some(candidate) = candidate {
            let stop = Stop::new(candidate, &self.axes);
            if self.follows(current, candidate)
                && let Some(least) = self.verify(&stop)
            {
                self.tighten(&stop, &least);
                self.held = stop;
                self.played_s = 0.0;
                return (*candidate, false);
            }
        }
        (self.play(), true)
    }

    /// The next state of the stop that is held.
    pub fn play(&mut self) -> MotionState {
        self.played_s += self.tick_s;
        self.held.at(self.played_s)
    }

    /// Whether one tick of motion within the limits leads from `current` to `candidate`.
    fn follows(&self, current: &MotionState, candidate: &MotionState) -> bool {
        let t = self.tick_s;
        candidate.is_finite()
            && self.axes.iter().enumerate().all(|(axis, limits)| {
                let (p, v, a) = (
                    current.position[axis],
                    current.velocity[axis],
                    current.acceleration[axis],
                );
                let jerk = limits.jerk * (1.0 + 1e-7);
                (candidate.acceleration[axis] - a).abs() <= jerk * t + 1e-12
                    && (candidate.velocity[axis] - v - a * t).abs() <= jerk * t * t / 2.0 + 1e-12
                    && (candidate.position[axis] - p - v * t - a * t * t / 2.0).abs()
                        <= jerk * t * t * t / 6.0 + 1e-12
                    && candidate.acceleration[axis].abs() <= limits.acceleration * (1.0 + ROUNDING)
            })
    }

    /// The least clearances of `stop` if it keeps every limit from its first moment to rest.
    fn verify(&self, stop: &Stop) -> Option<Clearances> {
        let axes_keep = stop.axes().iter().zip(&self.axes).zip(&self.ranges).all(
            |((axis, limits), &(low, high))| {
                let (least, most) = axis.position_range();
                least >= low
                    && most <= high
                    && axis.peak_velocity() <= limits.velocity * (1.0 + ROUNDING)
                    && axis.peak_acceleration() <= limits.acceleration * (1.0 + ROUNDING)
            },
        );
        if axes_keep {
            self.verify_in_space(stop)
        } else {
            None
        }
    }

    /// Samples the stop and bounds what can happen between the samples.
    fn verify_in_space(&self, stop: &Stop) -> Option<Clearances> {
        let gap_s = stop.joints_duration_s() / f64::from(INTERVALS);
        let mut before = self.sample(&stop.at(0.0));
        let mut least = before.clearances;
        for index in 1..=INTERVALS {
            let after = self.sample(&stop.at(gap_s * f64::from(index)));
            let reach = self.reach(stop, &before, &after, gap_s);
            let lows = self.interval_keeps(&before, &after, &reach, gap_s)?;
            for (least, low) in least.iter_mut().zip(lows) {
                *least = least.min(low);
            }
            before = after;
        }
        Some(least)
    }

    /// What can happen between two samples that are `gap_s` apart.
    fn reach(&self, stop: &Stop, before: &Sample, after: &Sample, gap_s: f64) -> Reach {
        let axes = stop.axes();
        let speeds: [f64; AXES] = core::array::from_fn(|axis| {
            // Between two samples a speed leaves the line through them by an eighth of the jerk times the gap squared.
            let bulge = self.axes[axis].jerk * gap_s * gap_s / 8.0;
            (before.speeds[axis].max(after.speeds[axis]) + bulge).min(axes[axis].peak_velocity())
        });
        Reach {
            distance_m: before.wrist_distance_m.max(after.wrist_distance_m)
                + speeds[INSERTION] * gap_s,
            speeds,
            accelerations: axes.map(|axis| axis.peak_acceleration()),
        }
    }

    /// What no clearance falls below between two samples, if that is enough and the tip is slow enough.
    fn interval_keeps(
        &self,
        before: &Sample,
        after: &Sample,
        reach: &Reach,
        gap_s: f64,
    ) -> Option<Clearances> {
        // A clearance changes no faster than its point moves, so half the way bounds the dip below the mean of the ends.
        let dip_m = reach.point_speed_m_s() * gap_s / 2.0;
        let lows = core::array::from_fn(|i| {
            f64::midpoint(before.clearances[i], after.clearances[i]) - dip_m
        });
        let clear = lows
            .iter()
            .zip(&self.floors)
            .all(|(low, floor)| low >= floor);
        let rise_m_s = reach.tip_acceleration_m_s2() * gap_s / 2.0;
        let fastest = f64::midpoint(before.tip_speed_m_s, after.tip_speed_m_s) + rise_m_s;
        let highest = before.tip_speed_m_s.max(after.tip_speed_m_s).max(fastest);
        // NaN fails both comparisons.
        (clear && highest <= self.tip_speed_m_s).then_some(lows)
    }

    fn sample(&self, state: &MotionState) -> Sample {
        let joints = state.joints();
        let frames = Frames::at(&joints);
        let velocity = frames.tip_jacobian() * state.joint_velocity();
        Sample {
            clearances: self.boundaries.clearances(&frames),
            speeds: state.velocity.map(f64::abs),
            tip_speed_m_s: velocity.fixed_rows::<3>(0).norm(),
            wrist_distance_m: frames.wrist_m.norm(),
        }
    }

    /// Boundaries that were passed when the arm was enabled come back with the arm, as far as the verified `stop`, whose
    /// least clearances are `least`, leaves them behind: it must still be allowed once it is played.
    fn tighten(&mut self, stop: &Stop, least: &Clearances) {
        for (index, &h) in least.iter().enumerate() {
            self.floors[index] = self.floors[index].max(self.floor(h));
        }
        for (range, (limits, axis)) in self
            .ranges
            .iter_mut()
            .zip(self.axes.iter().zip(stop.axes()))
        {
            let (low, high) = axis.position_range();
            *range = (
                range.0.max(limits.low.min(low)),
                range.1.min(limits.high.max(high)),
            );
        }
    }
}

/// Upper bounds of the joint motion in an interval, and what they mean for points of the instrument.
struct Reach {
    distance_m: f64,
    speeds: [f64; AXES],
    accelerations: [f64; AXES],
}

impl Reach {
    /// No point of the instrument beyond the RCM is faster.
    ///
    /// The wrist point moves in spherical coordinates (yaw, pitch, insertion), whose directions are orthogonal; whatever is
    /// further turns about it.
    fn point_speed_m_s(&self) -> f64 {
        let [yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw, _] = self.speeds;
        let swing = yaw.hypot(pitch);
        let wrist = (self.distance_m * swing).hypot(insertion);
        let turn = swing + roll + wrist_pitch;
        wrist + WRIST_M * turn + FINGER_M * (turn + wrist_yaw)
    }

    /// The control point's acceleration is no higher.
    fn tip_acceleration_m_s2(&self) -> f64 {
        let [yaw, pitch, insertion, roll, wrist_pitch, ..] = self.speeds;
        let [a_yaw, a_pitch, a_insertion, a_roll, a_wrist_pitch, ..] = self.accelerations;
        let (swing, turn) = (yaw + pitch, yaw + pitch + roll + wrist_pitch);
        let wrist = (self.distance_m * a_yaw.hypot(a_pitch)).hypot(a_insertion)
            + 2.0 * insertion * swing
            + self.distance_m * swing * swing;
        wrist + WRIST_M * (a_yaw + a_pitch + a_roll + a_wrist_pitch + 2.0 * turn * turn)
    }
}

#[cfg(test)]
mod tests;
