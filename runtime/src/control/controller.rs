//! The tick: measured arm and newest chunk in, command out. Hot path: bounded, no I/O, no clock, no lock; allocates only inside
//! Clarabel's solve.

use clarabel::solver::SolverError;
use hal::{ArmError, ArmState, Chunk, JOINT_COUNT, JointVector, Pose, TICK_NS, TimeNs, TipTarget};

use super::aggregate::Aggregator;
use super::config::ControlConfig;
use super::filter::{Filter, Filtered};
use super::gate::{Gate, Verdict};
use super::guard::Guard;
use super::mode::{Event, Mode, OperatingState, next};
use super::motion::{AXES, Axes, JAW, MotionState};
use super::report::{Fault, QpOutcome, TickInput, TickOutput, TickReport};
use super::rows::Rows;
use super::smoother::Smoother;
use super::tracking::Tracking;
use crate::kinematics::{Frames, forward};

/// One tick, s.
const TICK_S: f64 = 1e-3;

/// The controller of one arm: aggregate, inverse kinematics, filter, smoother, guard.
///
/// It starts disabled and follows the measured arm until the operator enables it, so that the first command is where the arm
/// is. The same inputs give the same commands, bit for bit.
#[derive(Debug)]
pub struct Controller {
    state: OperatingState,
    homed: bool,
    /// Whether the drives hold torque.
    powered: bool,
    fault: Option<Fault>,
    /// What was commanded last.
    commanded: MotionState,
    pub(super) gate: Gate,
    aggregator: Aggregator,
    tracking: Tracking,
    filter: Filter,
    smoother: Smoother,
    guard: Guard,
    tracking_error_max: [f64; JOINT_COUNT],
    stale_ns: u64,
    lookahead_ns: u64,
    config: ControlConfig,
    /// Lets a test show what the guard is for.
    #[cfg(test)]
    pub(super) guard_removed: bool,
}

/// What a tick's motion came from.
struct Motion {
    filtered: Filtered,
    target: Option<TipTarget>,
    guard_intervened: bool,
}

impl Controller {
    /// A disabled controller; this allocates all that a tick needs, but for Clarabel's solves.
    ///
    /// # Errors
    /// [`SolverError`] if the QP solver cannot be built.
    pub fn new(config: &ControlConfig) -> Result<Self, SolverError> {
        let rest = MotionState {
            position: [0.0; AXES],
            velocity: [0.0; AXES],
            acceleration: [0.0; AXES],
        };
        Ok(Self {
            state: OperatingState::Disabled,
            homed: false,
            powered: false,
            fault: None,
            commanded: rest,
            gate: Gate::new(config.gate),
            aggregator: Aggregator::new(config.aggregation),
            tracking: Tracking::new(config),
            filter: Filter::new(config)?,
            smoother: Smoother::new(&config.axes, TICK_S),
            guard: Guard::new(config, &rest, TICK_S),
            tracking_error_max: config.tracking_error_max,
            stale_ns: config.stale_ns,
            lookahead_ns: config.lookahead_ns,
            config: config.clone(),
            #[cfg(test)]
            guard_removed: false,
        })
    }

    /// Tip pose at `joints`, in the RCM frame.
    #[must_use]
    pub fn tip_in_rcm(joints: &JointVector) -> Pose {
        forward(joints)
    }

    /// The operating state with CRTK's flags.
    #[must_use]
    pub fn mode(&self) -> Mode {
        Mode {
            state: self.state,
            homed: self.homed,
            busy: !self.commanded.is_at_rest(),
        }
    }

    /// Chunks that the gate let through, and chunks that it refused, since the start.
    #[must_use]
    pub fn chunk_counts(&self) -> (u64, u64) {
        (self.gate.accepted_count(), self.gate.refused_count())
    }

    /// One control period.
    pub fn tick(&mut self, input: &TickInput<'_>) -> TickOutput {
        self.look_at(&input.measured);
        if let Some(event) = input.operator {
            self.change(Event::Operator(event));
        }
        let (gate, motion) = match self.state {
            OperatingState::Enabled => {
                let gate = input.chunk.and_then(|chunk| self.take(chunk, input.now));
                (gate, self.follow(input.now))
            }
            OperatingState::Disabled | OperatingState::Paused | OperatingState::Fault => {
                (None, self.come_to_rest())
            }
        };
        TickOutput {
            command: self.commanded.command(input.now, self.powered),
            report: TickReport {
                mode: self.mode(),
                gate,
                qp: motion.filtered.outcome,
                rows_active: motion.filtered.rows_active,
                correction: motion.filtered.correction,
                guard_intervened: motion.guard_intervened,
                target: motion.target,
                fault: self.fault,
            },
        }
    }

    /// Judges the measurement, and follows it while the drives are off.
    fn look_at(&mut self, measured: &Result<ArmState, ArmError>) {
        let fault = match measured {
            Err(error) => Some(Fault::Arm(*error)),
            Ok(arm) if !arm.is_finite() => Some(Fault::MeasurementNotFinite),
            Ok(arm) => self.tracking_fault(arm),
        };
        if let Some(fault) = fault {
            self.fault = self.fault.or(Some(fault));
            self.change(Event::Fail);
            return;
        }
        if let Ok(arm) = measured {
            self.homed = true;
            if !self.powered {
                self.commanded = MotionState::at_rest(arm);
                self.guard.seed(&self.commanded);
            }
        }
    }

    fn tracking_fault(&self, arm: &ArmState) -> Option<Fault> {
        if !self.powered {
            return None;
        }
        let error = self.commanded.joints() - arm.position;
        let joint =
            (0..JOINT_COUNT).find(|&joint| error[joint].abs() > self.tracking_error_max[joint])?;
        Some(Fault::TrackingError {
            joint: u8::try_from(joint).unwrap_or(u8::MAX),
            error: error[joint],
        })
    }

    fn change(&mut self, event: Event) {
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
            }
            OperatingState::Disabled => self.fault = None,
            OperatingState::Paused | OperatingState::Fault => {}
        }
    }

    fn take(&mut self, chunk: &Chunk, now: TimeNs) -> Option<Verdict> {
        let tip = Self::tip_in_rcm(&self.commanded.joints());
        let verdict = self.gate.judge(chunk, now, &tip)?;
        if verdict.is_accepted() {
            self.aggregator.push(chunk, now);
        }
        Some(verdict)
    }

    /// One tick towards the aggregated target; without one, towards rest.
    fn follow(&mut self, now: TimeNs) -> Motion {
        self.aggregator.advance(now);
        let fresh = self
            .aggregator
            .newest_observed_at()
            .is_some_and(|at| now.since(at) <= self.stale_ns);
        let ahead_ns = self.lookahead_ns.max(TICK_NS);
        let targets = if fresh {
            self.aggregator.targets(now, now.plus_ns(ahead_ns))
        } else {
            None
        };

        let frames = Frames::at(&self.commanded.joints());
        let nominal = targets.and_then(|(target, ahead)| {
            self.tracking.velocity(
                &self.commanded,
                &frames,
                &target,
                &ahead,
                TimeNs(ahead_ns).seconds(),
            )
        });
        let nominal = nominal.unwrap_or([0.0; AXES]);
        let rows = Rows::new(&self.config, &self.commanded, &frames);
        let wanted = JointVector::from_fn(|joint, _| nominal[joint]);
        let filtered = self.filter.filter(&wanted, &rows, &frames.tip_jacobian());

        let velocity: Axes = core::array::from_fn(|axis| {
            if axis == JAW {
                nominal[JAW]
            } else {
                filtered.velocity[axis]
            }
        });
        let candidate = self.smoother.step(&self.commanded, &velocity);
        let guard_intervened = self.commit(candidate.as_ref());
        Motion {
            filtered,
            target: targets.map(|(target, _)| target),
            guard_intervened,
        }
    }

    fn commit(&mut self, candidate: Option<&MotionState>) -> bool {
        #[cfg(test)]
        if let (true, Some(candidate)) = (self.guard_removed, candidate) {
            self.commanded = *candidate;
            return false;
        }
        let (state, intervened) = self.guard.next(&self.commanded, candidate);
        self.commanded = state;
        intervened
    }

    /// Plays the verified stop; at rest, releases the drives where that is asked for.
    fn come_to_rest(&mut self) -> Motion {
        if !self.commanded.is_at_rest() {
            self.commanded = self.guard.play();
        }
        if self.commanded.is_at_rest() && self.releases() {
            self.powered = false;
        }
        let filtered = Filtered {
            velocity: JointVector::zeros(),
            outcome: QpOutcome::NotNeeded,
            rows_active: 0,
            correction: 0.0,
        };
        Motion {
            filtered,
            target: None,
            guard_intervened: false,
        }
    }

    /// Whether the drives lose torque at rest. An arm that lost a measurement holds what it has in its jaws; one that does
    /// not go where it is told, or whose drives have failed, must not press on.
    fn releases(&self) -> bool {
        match self.state {
            OperatingState::Disabled => true,
            OperatingState::Enabled | OperatingState::Paused => false,
            OperatingState::Fault => matches!(
                self.fault,
                Some(Fault::TrackingError { .. } | Fault::Arm(ArmError::DriveFault { .. }))
            ),
        }
    }
}
