//! One arm of a controller: its mode and faults, its chunks, and its nominal velocity. Hot path:
//! bounded, no allocation, no I/O, no lock.

use hal::{ArmError, ArmState, Chunk, TICK_NS, TimeNs, TipTarget};

use super::aggregate::{self, Aggregator};
use super::config::{ControlConfig, FollowingError};
use super::deviation::Deviation;
use super::gate::{Gate, GateDecision};
use super::instrument::{Instrument, KinematicState};
use super::mode::{Event, Mode, OperatingState, OperatorEvent, next};
use super::motion::{AXES, Axes, MotionState};
use super::report::{Fault, TickInput};
use super::snapshot::{Reader, Snapshot, SnapshotError, Stateful, possible, state};
use super::tracking::Tracking;
use crate::kinematics::forward;

/// Share of the speed limits with which a soft start begins.
const START_PACE: f64 = 0.1;

/// One arm's mode, faults and chunks.
///
/// In a tick: [`ArmControl::observe`] first, then [`ArmControl::plan`], then the filter, smoother
/// and guard of the controller, and [`ArmControl::release`] at the end.
#[derive(Debug)]
pub(super) struct ArmControl {
    /// Changed by [`ArmControl::change`] and by a fault alone.
    pub(super) state: OperatingState,
    /// A valid measurement has arrived; it stays so.
    homed: bool,
    /// Whether the drives hold torque.
    pub(super) powered: bool,
    /// The first one since the arm last became DISABLED: later ones are mostly its consequences.
    pub(super) fault: Option<Fault>,
    /// What was commanded last.
    pub(super) commanded: MotionState,
    /// The newest measured effort of the jaw, N m.
    pub(super) jaw_effort_n_m: f64,
    pub(super) gate: Gate,
    aggregator: Aggregator,
    tracking: Tracking,
    /// When the arm last became enabled, also from PAUSED: the soft start counts from here.
    enabled_at: TimeNs,
    /// The operator's share of the speed limits.
    speed: f64,
    following_error_max: FollowingError,
    /// How far the measured instrument is from the commanded one, or was within about the longest
    /// stop; none without torque.
    pub(super) deviation: Deviation,
    /// The largest deviation of any part of the instrument since the start, m.
    pub(super) following_error_m: f64,
    /// Where the instrument is measured in this tick, if it holds torque.
    pub(super) measured: Option<Instrument>,
    stale_ns: u64,
    /// At least a tick, since it is divided by.
    lookahead_ns: u64,
    soft_start_ns: u64,
}

/// The intended motion of an arm in a tick, before the filter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    pub(super) gate: Option<GateDecision>,
    pub(super) target: Option<TipTarget>,
    /// Velocity of each axis, rad/s (m/s).
    ///
    /// Zero without a target: the arm then brakes under the filter, and still counts as following.
    pub(super) nominal: Axes,
    /// Whether the arm follows; otherwise it comes to rest.
    pub(super) follows: bool,
    /// Share of the speed limits that it may use.
    pub(super) pace: f64,
}

impl Plan {
    /// Of an arm that is not enabled.
    const AT_REST: Self = Self {
        gate: None,
        target: None,
        nominal: [0.0; AXES],
        follows: false,
        pace: 1.0,
    };
}

// The aggregator's is beside it, since chunks are not words; where the instrument is measured is
// found in each tick before it counts.
state!(ArmControl {
    state: OperatingState,
    homed: bool,
    powered: bool,
    fault: Option<Fault>,
    commanded: MotionState,
    jaw_effort_n_m: f64,
    gate: Gate,
    enabled_at: TimeNs,
    speed: f64,
    deviation: Deviation,
    following_error_m: f64,
} beside {
    aggregator,
    tracking,
    following_error_max,
    measured,
    stale_ns,
    lookahead_ns,
    soft_start_ns,
});

impl ArmControl {
    /// Names, types and order of what [`Self::save_all`] adds.
    pub(super) const LAYOUT_OF_ALL: [u64; 2] = [<Self as Stateful>::LAYOUT, aggregate::LAYOUT];

    /// How many words that takes at most.
    pub(super) const WORDS_OF_ALL: usize = <Self as Stateful>::WORDS_MAX + aggregate::WORDS;

    /// Adds all of its state after the tick `newest` to a snapshot, as that of the arm `index`.
    pub(super) fn save_all(&self, index: usize, newest: TimeNs, to: &mut Snapshot) {
        self.save(to);
        self.aggregator.save(index, newest, to);
    }

    /// Takes over what [`Self::save_all`] added.
    pub(super) fn restore_all(
        &mut self,
        index: usize,
        newest: TimeNs,
        from: &mut Reader<'_>,
    ) -> Result<(), SnapshotError> {
        self.restore(from)?;
        possible(self.commanded.is_finite() && (0.0..=1.0).contains(&self.speed))?;
        self.aggregator.restore(index, newest, &self.gate, from)
    }

    /// The chunk that it holds at `slot`.
    pub(super) fn held(&self, slot: usize) -> Option<&Chunk> {
        self.aggregator.at(slot)
    }

    pub(super) fn new(config: &ControlConfig) -> Self {
        Self {
            state: OperatingState::Disabled,
            homed: false,
            powered: false,
            fault: None,
            commanded: MotionState::ZERO,
            jaw_effort_n_m: 0.0,
            gate: Gate::new(config.gate),
            aggregator: Aggregator::new(config.aggregation),
            tracking: Tracking::new(config),
            enabled_at: TimeNs(0),
            speed: 1.0,
            following_error_max: config.following_error_max,
            deviation: Deviation::default(),
            following_error_m: 0.0,
            measured: None,
            stale_ns: config.stale_ns,
            lookahead_ns: config.lookahead_ns.max(TICK_NS),
            soft_start_ns: config.soft_start_ns,
        }
    }

    pub(super) fn mode(&self) -> Mode {
        Mode {
            state: self.state,
            homed: self.homed,
            busy: !self.commanded.is_at_rest(),
        }
    }

    /// Checks the measurement and applies the operator's event; without torque the command follows
    /// the arm. Returns whether it does, so that the guard is seeded there.
    pub(super) fn observe(&mut self, input: &TickInput<'_>) -> bool {
        let follows = self.look_at(&input.measured);
        if let Some(event) = input.operator {
            self.obey(event, input.now);
            self.change(Event::Operator(event), input.now);
        }
        follows
    }

    /// What an event does beside the operating state.
    fn obey(&mut self, event: OperatorEvent, now: TimeNs) {
        match event {
            OperatorEvent::Speed { percent } => self.speed = f64::from(percent.min(100)) / 100.0,
            OperatorEvent::TakeOver => {
                self.aggregator.clear();
                self.gate.forget();
            }
            OperatorEvent::HandBack => {
                self.aggregator.clear();
                self.gate.begin_anew(now);
            }
            OperatorEvent::GoOn => self.gate.go_on(),
            OperatorEvent::Enable
            | OperatorEvent::Disable
            | OperatorEvent::Pause
            | OperatorEvent::Resume
            | OperatorEvent::Clear => {}
        }
    }

    /// Finds what is wrong with a measurement: missing, not finite, out of the mechanism's range,
    /// or too far from the command. Without torque it sets the command to the measured position and
    /// returns true.
    fn look_at(&mut self, measured: &Result<ArmState, ArmError>) -> bool {
        self.measured = None;
        let fault = match measured {
            Err(error) => Some(Fault::Arm(*error)),
            Ok(arm) if !arm.is_finite() => Some(Fault::MeasurementNotFinite),
            Ok(arm) => match arm.impossible() {
                Some((axis, value)) => Some(Fault::MeasurementOutOfRange { axis, value }),
                None => self.follow(arm),
            },
        };
        if let Some(fault) = fault {
            self.fault = self.fault.or(Some(fault));
            self.state = next(self.state, Event::Fail);
            return false;
        }
        if let Ok(arm) = measured {
            self.homed = true;
            self.jaw_effort_n_m = arm.jaw_effort;
            if !self.powered {
                self.commanded = MotionState::at_rest(arm);
                return true;
            }
        }
        false
    }

    /// Updates deviation and following error; a fault if the error is too large.
    fn follow(&mut self, arm: &ArmState) -> Option<Fault> {
        if !self.powered {
            self.deviation = Deviation::default();
            return None;
        }
        let measured = KinematicState::new(&MotionState::at_rest(arm));
        let deviation = Deviation::between(&KinematicState::new(&self.commanded), &measured);
        self.deviation = self.deviation.held(&deviation);
        let parts = deviation.links_m.iter();
        self.following_error_m = parts.fold(self.following_error_m, |most, &part| most.max(part));
        self.measured = Some(measured.instrument);
        let max = &self.following_error_max;
        let follows = deviation.tip_m <= max.tip_m && deviation.turn_rad <= max.turn_rad;
        (!follows).then_some(Fault::TrackingError {
            tip_m: deviation.tip_m,
            turn_rad: deviation.turn_rad,
        })
    }

    /// Becoming enabled drops all chunks and gives the drives torque; from DISABLED the gate
    /// forgets the order of the chunks as well. Torque is taken away in [`ArmControl::release`], at
    /// rest.
    pub(super) fn change(&mut self, event: Event, now: TimeNs) {
        let before = self.state;
        self.state = next(before, event);
        if before == self.state {
            return;
        }
        match self.state {
            OperatingState::Enabled => {
                self.aggregator.clear();
                if before == OperatingState::Disabled {
                    self.gate.forget();
                }
                self.powered = true;
                self.enabled_at = now;
            }
            OperatingState::Disabled => self.fault = None,
            OperatingState::Paused | OperatingState::Fault => {}
        }
    }

    /// Accepts the chunk and computes the nominal velocity towards its target; an arm that is not
    /// enabled comes to rest.
    pub(super) fn plan(&mut self, input: &TickInput<'_>, stance: &KinematicState) -> Plan {
        if self.state != OperatingState::Enabled {
            return Plan::AT_REST;
        }
        let gate = input.chunk.and_then(|chunk| self.take(chunk, input.now));
        let pace = self.pace(input.now);
        let targets = self.targets(input.now);
        let ahead_s = TimeNs(self.lookahead_ns).seconds();
        let nominal = targets.and_then(|(target, ahead)| {
            let (state, frames) = (&self.commanded, &stance.frames);
            self.tracking
                .velocity(state, frames, &target, &ahead, ahead_s, pace)
        });
        Plan {
            gate,
            target: targets.map(|(target, _)| target),
            nominal: nominal.unwrap_or([0.0; AXES]),
            follows: true,
            pace,
        }
    }

    /// None for the chunk that was judged last, which callers may hand over again in every tick.
    fn take(&mut self, chunk: &Chunk, now: TimeNs) -> Option<GateDecision> {
        let tip = forward(&self.commanded.joints());
        let verdict = self.gate.judge(chunk, now, &tip)?;
        if verdict.is_accepted() {
            self.aggregator.push(chunk, now);
        }
        Some(verdict)
    }

    /// Where the tip should be now and after the look-ahead; none without chunks, past their
    /// horizons, or if the newest observation is older than `stale_ns`.
    fn targets(&mut self, now: TimeNs) -> Option<(TipTarget, TipTarget)> {
        self.aggregator.advance(now);
        let observed_at = self.aggregator.newest_observed_at()?;
        if now.since(observed_at) > self.stale_ns {
            return None;
        }
        self.aggregator.targets(now, now.plus_ns(self.lookahead_ns))
    }

    /// The share of the speed limits that holds: the operator's, and less right after the arm was
    /// enabled.
    ///
    /// Rises linearly from [`START_PACE`] to 1 over the soft start, times the operator's share.
    fn pace(&self, now: TimeNs) -> f64 {
        let since_s = TimeNs(now.since(self.enabled_at)).seconds();
        let ramp_s = TimeNs(self.soft_start_ns).seconds();
        let start = if since_s < ramp_s {
            START_PACE + (1.0 - START_PACE) * since_s / ramp_s
        } else {
            1.0
        };
        self.speed * start
    }

    /// At rest, removes torque where the state requires it: an arm that lost a measurement keeps
    /// its grip; one with a following error, or whose drives failed, is released.
    pub(super) fn release(&mut self) {
        let releases = match self.state {
            OperatingState::Disabled => true,
            OperatingState::Enabled | OperatingState::Paused => false,
            OperatingState::Fault => matches!(
                self.fault,
                Some(Fault::TrackingError { .. } | Fault::Arm(ArmError::DriveFault { .. }))
            ),
        };
        if releases && self.commanded.is_at_rest() {
            self.powered = false;
        }
    }
}
