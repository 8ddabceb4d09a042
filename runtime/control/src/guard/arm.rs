//! One arm's part of the guard: the stop that it holds, and the check of another. Hot path:
//! bounded, no allocation, no I/O, no lock.

mod axes;

use hal::Pose;

use super::bounds::Bounds;
use super::clearance::{Boundaries, CLEARANCES, Clearances, FACES, Wanted};
use super::floor::Floor;
use super::measured::{NearestOfArm, allowances};
#[cfg(test)]
use super::planted::{Check, Padding, PlantedGuardFault};
use super::sample::Sample;
use super::sweep::{INTERVALS, Rest, Sweep, travel_m};
use super::way::Way;
use crate::config::{ArmConfig, ControlConfig};
use crate::deviation::Deviation;
use crate::instrument::{Instrument, LINKS};
use crate::motion::{AXES, AxisLimits, MotionState};
use crate::snapshot::{state, words};
use crate::stop::Stop;

/// A stop, the positions that it takes, and where its links are on the way.
///
/// `ranges` are exact, from the closed form; the sweep has at most 21 samples, and bounds on what
/// happens between them.
#[derive(Clone, Debug)]
struct Path {
    stop: Stop,
    ranges: [(f64, f64); AXES],
    sweep: Sweep,
}

/// The limits of one arm, and the verified stop from where it is commanded to be.
///
/// A candidate is checked in this order: the step from the present state and the axes of its stop,
/// both in closed form, then its stop in space. The first failure ends the check.
#[derive(Clone, Debug)]
pub(super) struct ArmGuard {
    axes: [AxisLimits; AXES],
    tip_speed_m_s: f64,
    tip_turn_rad_s: f64,
    floor: Floor,
    boundaries: Boundaries,
    /// Where two arms are compared; none for one arm.
    scene_from_rcm: Option<Pose>,
    tick_s: f64,
    /// Clearances that a stop must keep: the margin, or less where the arm was enabled without it.
    floors: Clearances,
    /// Position ranges that a stop must keep: the limits, or wider where the arm was enabled beyond
    /// them.
    ranges: [(f64, f64); AXES],
    held: Path,
    /// Seconds of the held stop that were commanded; grows by a tick in [`ArmGuard::play`], 0 after
    /// [`ArmGuard::commit`].
    played_s: f64,
    /// The last candidate's stop.
    fresh: Path,
    /// What the last candidate's stop keeps at least.
    least: Clearances,
    /// What it had to keep: the floors, and where the candidate is beyond a boundary hardly less
    /// than it has itself.
    required: Clearances,
    /// What the stops up to now kept of margin and deviation together.
    kept: Clearances,
    /// How far the measured arm is from the commanded one.
    pub(super) deviation: Deviation,
    /// How near the measured arm came to each boundary.
    pub(super) nearest: NearestOfArm,
    #[cfg(test)]
    pub(super) planted: Option<PlantedGuardFault>,
}

words!(Path {
    stop: Stop,
    ranges: [(f64, f64); AXES],
    sweep: Sweep,
});

// What a candidate's check works with is filled before it is looked at.
state!(ArmGuard {
    floors: Clearances,
    ranges: [(f64, f64); AXES],
    held: Path,
    played_s: f64,
    kept: Clearances,
    deviation: Deviation,
    nearest: NearestOfArm,
} beside {
    axes,
    tip_speed_m_s,
    tip_turn_rad_s,
    floor,
    boundaries,
    scene_from_rcm,
    tick_s,
    fresh,
    least,
    required,
    #[cfg(test)]
    planted,
});

impl ArmGuard {
    /// Holds the arm at `state`, at rest. It may have to be `compared` with another.
    pub(super) fn new(
        config: &ControlConfig,
        arm: &ArmConfig,
        state: &MotionState,
        tick_s: f64,
        compared: bool,
    ) -> Self {
        let boundaries = Boundaries::new(arm);
        let stop = Stop::new(state, &config.axes);
        let sample = Sample::new(state, &boundaries, &[true; CLEARANCES]);
        let path = Path {
            stop,
            ranges: state.position.map(|position| (position, position)),
            sweep: Sweep::at_rest(sample.instrument),
        };
        let mut guard = Self {
            axes: config.axes,
            tip_speed_m_s: config.tip_speed_m_s,
            tip_turn_rad_s: config.tip_angular_speed_rad_s,
            floor: Floor::new(&config.margins),
            boundaries,
            scene_from_rcm: compared.then_some(arm.scene_from_rcm),
            tick_s,
            floors: [config.margins.guard_m; CLEARANCES],
            ranges: config.axes.map(|axis| (axis.low, axis.high)),
            held: path.clone(),
            played_s: 0.0,
            fresh: path,
            least: sample.clearances,
            required: [config.margins.guard_m; CLEARANCES],
            kept: [config.margins.guard_m; CLEARANCES],
            deviation: Deviation::default(),
            nearest: NearestOfArm::new(),
            #[cfg(test)]
            planted: None,
        };
        guard.seed(state);
        guard
    }

    /// Starts anew from the pose of `state`, at rest.
    pub(super) fn seed(&mut self, state: &MotionState) {
        let state = MotionState {
            velocity: [0.0; AXES],
            acceleration: [0.0; AXES],
            ..*state
        };
        let sample = Sample::new(&state, &self.boundaries, &[true; CLEARANCES]);
        self.held.stop = Stop::new(&state, &self.axes);
        self.held.ranges = state.position.map(|position| (position, position));
        self.held.sweep.begin(&sample.instrument, 0.0, [0.0; LINKS]);
        if let Some(frame) = &self.scene_from_rcm {
            self.held.sweep.move_to(frame);
        }
        self.played_s = 0.0;
        self.floors = sample.clearances.map(|h| self.floor.below(h));
        self.kept = self.floors;
        for (range, (limits, &position)) in self
            .ranges
            .iter_mut()
            .zip(self.axes.iter().zip(&state.position))
        {
            *range = (limits.low.min(position), limits.high.max(position));
        }
    }

    /// The next state of the stop that is held. Boundaries close in behind it as behind any
    /// command.
    pub(super) fn play(&mut self) -> MotionState {
        self.played_s += self.tick_s;
        let state = self.held.stop.at(self.played_s);
        if self.floors.iter().any(|floor| *floor < 0.0) {
            let sample = Sample::new(&state, &self.boundaries, &[true; CLEARANCES]);
            for (floor, &h) in self.floors.iter_mut().zip(&sample.clearances) {
                *floor = floor.max(self.floor.behind(h));
            }
        }
        state
    }

    /// Stores the deviation of the measured arm from the commanded one, and its pose if it was
    /// measured.
    pub(super) fn observe(&mut self, deviation: &Deviation, measured: Option<&Instrument>) {
        self.deviation = *deviation;
        if let Some(measured) = measured {
            let clearances = self.boundaries.clearances(measured, &[true; CLEARANCES]);
            self.nearest.add(&clearances);
        }
    }

    /// Where a measured instrument is, scene frame.
    pub(super) fn in_scene(&self, measured: &Instrument) -> Option<Instrument> {
        Some(measured.moved(self.scene_from_rcm.as_ref()?))
    }

    /// The stop that is held, and how much of it has been played, s.
    pub(super) const fn held(&self) -> (&Stop, f64) {
        (&self.held.stop, self.played_s)
    }

    /// Where the links will be on the rest of the stop that is held, scene frame.
    pub(super) fn held_rest(&self) -> Rest<'_> {
        self.held.sweep.rest(self.played_s)
    }

    /// Where the links will be on the stop of the candidate that was verified last, scene frame.
    pub(super) fn fresh_rest(&self) -> Rest<'_> {
        self.fresh.sweep.rest(0.0)
    }

    /// Whether `candidate` follows from `current` within the limits and its stop keeps all of them.
    /// If so, it may be [committed](Self::commit).
    pub(super) fn verify(&mut self, current: &MotionState, candidate: &MotionState) -> bool {
        if !self.follows(current, candidate) {
            return false;
        }
        self.fresh.stop = Stop::new(candidate, &self.axes);
        for (range, axis) in self.fresh.ranges.iter_mut().zip(self.fresh.stop.axes()) {
            *range = axis.position_range();
        }
        self.axes_keep() && self.verify_in_space()
    }

    /// Holds the stop that was verified last.
    ///
    /// Boundaries that were passed when the arm was enabled come back with the arm, as far as this
    /// stop leaves them behind: it must still be allowed once it is played.
    pub(super) fn commit(&mut self) {
        core::mem::swap(&mut self.held, &mut self.fresh);
        self.played_s = 0.0;
        for ((floor, &h), required) in self.floors.iter_mut().zip(&self.least).zip(self.required) {
            *floor = required.max(self.floor.below(h));
        }
        let allowances = allowances(&self.deviation);
        for ((kept, &h), allowance_m) in self.kept.iter_mut().zip(&self.least).zip(allowances) {
            *kept = self.floor.kept(*kept, h, allowance_m);
        }
        for ((range, limits), (low, high)) in
            self.ranges.iter_mut().zip(&self.axes).zip(self.held.ranges)
        {
            *range = (
                range.0.max(limits.low.min(low)),
                range.1.min(limits.high.max(high)),
            );
        }
    }

    /// Samples the candidate's stop and bounds what can happen between the samples.
    ///
    /// At most 20 intervals. Leaves the sweep in the scene's frame if arms are compared. A stop
    /// that begins beyond a boundary goes out by no more than the recovery margin, measured from as
    /// far as it has come back.
    fn verify_in_space(&mut self) -> bool {
        let stop = self.fresh.stop;
        let mut before = Sample::new(&stop.at(0.0), &self.boundaries, &[true; CLEARANCES]);
        self.required = core::array::from_fn(|index| {
            self.floors[index].max(self.floor.behind(before.clearances[index]))
        });
        let travel_m = travel_m(before.wrist_distance_m, &self.fresh.ranges);
        let allowances = allowances(&self.deviation);
        let wanted = self.look_for(&before.clearances, &travel_m, &allowances);
        let gap_s = stop.duration_s() / f64::from(INTERVALS);
        self.fresh.sweep.begin(&before.instrument, gap_s, travel_m);
        // A stop that comes back from beyond a boundary does not go out again before its end.
        let mut closing: Clearances = core::array::from_fn(|index| {
            let (required, kept) = (self.required[index], self.kept[index]);
            self.floor.widened(required, kept, allowances[index])
        });
        let beyond = closing.iter().any(|required| *required < 0.0);
        // An arm at rest is where it is; the interval that is left checks the one sample.
        let intervals = if gap_s > 0.0 { INTERVALS } else { 1 };
        for index in 1..=intervals {
            let state = stop.at(gap_s * f64::from(index));
            let after = Sample::new(&state, &self.boundaries, &wanted);
            let bounds = Bounds::new(&self.axes, &stop, &before, &after, gap_s);
            if !self.interval_keeps(&before, &after, &bounds, &wanted, &closing) {
                return false;
            }
            self.fresh.sweep.push(&after.instrument, &bounds);
            if beyond {
                for (closing, &h) in closing.iter_mut().zip(&after.clearances) {
                    *closing = closing.max(self.floor.behind(h));
                }
            }
            before = after;
        }
        if let Some(frame) = &self.scene_from_rcm {
            self.fresh.sweep.move_to(frame);
        }
        true
    }

    /// Which clearances the stop can bring near, `h` being the first ones; the least of the others
    /// is certain already.
    fn look_for(
        &mut self,
        h: &Clearances,
        travel_m: &[f64; LINKS],
        allowances: &Clearances,
    ) -> Wanted {
        core::array::from_fn(|index| {
            if index < FACES {
                self.least[index] = h[index];
                return true;
            }
            let low = h[index] - travel_m[(index - FACES) % LINKS];
            #[cfg(test)]
            let low = self.pad(Padding::Travel, h[index], low);
            let certain = low >= self.floor.enough_m() + allowances[index];
            self.least[index] = if certain { low } else { h[index] };
            !certain
        })
    }

    /// Whether floors and tip speeds are kept between two samples.
    ///
    /// Collects into `least` what each clearance does not fall below, from which
    /// [`ArmGuard::commit`] raises the floors.
    fn interval_keeps(
        &mut self,
        before: &Sample,
        after: &Sample,
        bounds: &Bounds,
        wanted: &Wanted,
        closing: &Clearances,
    ) -> bool {
        let ways = bounds.ways();
        for (index, _) in wanted.iter().enumerate().filter(|(_, wanted)| **wanted) {
            let low = self.lowest_between(index, (before, after), &ways, closing[index]);
            #[cfg(test)]
            let plain = before.clearances[index].min(after.clearances[index]);
            #[cfg(test)]
            let low = self.pad(Padding::Clearance, plain, low);
            let keeps = low >= closing[index];
            #[cfg(test)]
            let keeps = self.judge(Check::Clearance(index), keeps);
            if !keeps {
                return false;
            }
            self.least[index] = self.least[index].min(low);
        }
        self.tip_keeps(before, after, bounds)
    }

    /// What clearance `index` does not fall below between two samples, m, as exactly as it takes to
    /// tell whether that is at least `closing_m` and needs no recovery.
    fn lowest_between(
        &self,
        index: usize,
        (before, after): (&Sample, &Sample),
        ways: &[Way; LINKS],
        closing_m: f64,
    ) -> f64 {
        let h = (before.clearances[index], after.clearances[index]);
        let instruments = (&before.instrument, &after.instrument);
        let floor = &self.floor;
        let enough_m = floor.enough_m().max(closing_m + floor.recovery_m());
        let boundaries = &self.boundaries;
        boundaries.lowest_between(index, h, instruments, ways, enough_m)
    }

    /// Whether the tip is slow enough between two samples.
    ///
    /// Speed: the greater of the faster end and the mean of both ends plus acceleration times half
    /// the gap. Angular speed: the faster end plus an eighth of its second derivative times the gap
    /// squared.
    fn tip_keeps(&self, before: &Sample, after: &Sample, bounds: &Bounds) -> bool {
        let ends = (before.tip_speed_m_s, after.tip_speed_m_s);
        let speed = ends
            .0
            .max(ends.1)
            .max(f64::midpoint(ends.0, ends.1) + bounds.tip_rise_m_s);
        let end_turn = before.tip_turn_rad_s.max(after.tip_turn_rad_s);
        let turn = end_turn + bounds.turn_rise_rad_s;
        #[cfg(test)]
        let (speed, turn) = (
            self.pad(Padding::TipSpeed, ends.0.max(ends.1), speed),
            self.pad(Padding::AngularSpeed, end_turn, turn),
        );
        let slow = speed <= self.tip_speed_m_s;
        let steady = turn <= self.tip_turn_rad_s;
        #[cfg(test)]
        let (slow, steady) = (
            self.judge(Check::TipSpeed, slow),
            self.judge(Check::AngularSpeed, steady),
        );
        slow && steady
    }

    /// Holds the stop from `candidate`, whatever it is.
    #[cfg(test)]
    pub(super) fn skip(&mut self, candidate: &MotionState) {
        self.held.stop = Stop::new(candidate, &self.axes);
        self.played_s = 0.0;
    }

    #[cfg(test)]
    fn judge(&self, check: Check, verdict: bool) -> bool {
        self.planted
            .map_or(verdict, |planted| planted.judge(check, verdict))
    }

    #[cfg(test)]
    fn pad(&self, padding: Padding, plain: f64, padded: f64) -> f64 {
        self.planted
            .map_or(padded, |planted| planted.pad(padding, plain, padded))
    }
}
