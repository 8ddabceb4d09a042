//! The tick: measured arms and newest chunks in, commands out. Hot path: bounded, no allocation, no
//! I/O, no clock, no lock.

use hal::tail::{AxisPoint, AxisTail, SafeTail, TailPhase};
use hal::{Chunk, JointVector, Pose, TICK_NS, TICK_S, TimeNs};

use super::arm_control::{ArmControl, Plan};
use super::config::ControlConfig;
use super::filter::{Filter, Filtered, Problem};
use super::guard::{Decision, Guard, GuardError, MeasuredClearance, Request};
use super::instrument::KinematicState;
use super::mode::{Event, Mode, OperatingState, OperatorEvent};
use super::motion::{AXES, Axes, AxisLimits, MotionState};
use super::report::{QpOutcome, TickInput, TickOutput, TickReport};
use super::rows::{ARMS_MAX, RowInput, Rows, Velocities};
use super::smoother::Smoother;
use super::snapshot::{
    HeldChunk, Reader, STATE_WORDS_MAX, Snapshot, SnapshotError, Stateful, Words, layout, possible,
};
use super::stop::Remainder;
use crate::kinematics::forward;

/// The controller of one arm or of two that share a scene: aggregate, inverse kinematics, filter,
/// smoother, guard.
///
/// An arm starts disabled and follows the measured arm until the operator enables it, so that the
/// first command is where the arm is. A fault of one arm pauses the other. The same inputs give the
/// same commands, bit for bit.
#[derive(Debug)]
pub struct Controller<const ARMS: usize = 1> {
    pub(super) arms: [ArmControl; ARMS],
    /// One for each arm: the soft start lowers the limits of one and not of the other.
    smoothers: [Smoother; ARMS],
    rows: Rows,
    filter: Filter,
    guard: Guard<ARMS>,
    config: ControlConfig,
    /// Time of the newest tick; none before the first.
    newest: Option<TimeNs>,
    /// What a test breaks, to see what the rest is worth.
    #[cfg(test)]
    pub(super) sabotage: super::sabotage::Sabotage,
}

/// Why there is no such controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ControllerError {
    /// It is for another number of arms.
    #[error("the configuration has {configured} arms, the controller is for {wanted}")]
    ArmCount {
        /// Arms in the configuration.
        configured: usize,
        /// Arms of the controller.
        wanted: usize,
    },
    /// There is no guard for these arms.
    #[error(transparent)]
    Guard(#[from] GuardError),
}

impl Controller {
    /// A disabled controller of one arm; see [`Self::for_arms`].
    ///
    /// # Errors
    /// [`ControllerError`] if the configuration has two.
    pub fn new(config: &ControlConfig) -> Result<Self, ControllerError> {
        Self::for_arms(config)
    }

    /// Tip pose at `joints`, in the RCM frame.
    #[must_use]
    pub fn tip_in_rcm(joints: &JointVector) -> Pose {
        forward(joints)
    }

    /// The operating state with CRTK's flags.
    #[must_use]
    pub fn mode(&self) -> Mode {
        let [arm] = &self.arms;
        arm.mode()
    }

    /// Chunks that the gate let through, and chunks that it refused, since the start.
    #[must_use]
    pub fn chunk_counts(&self) -> (u64, u64) {
        let [arm] = &self.arms;
        (arm.gate.accepted_count(), arm.gate.refused_count())
    }

    /// One control period.
    pub fn tick(&mut self, input: &TickInput<'_>) -> TickOutput {
        let [output] = self.tick_arms(core::array::from_ref(input));
        output
    }
}

impl<const ARMS: usize> Controller<ARMS> {
    /// A disabled controller of as many arms as `config` has; this allocates all that a tick needs.
    ///
    /// # Errors
    /// [`ControllerError`] if the configuration has another number of arms, or the number is not
    /// one or two.
    pub fn for_arms(config: &ControlConfig) -> Result<Self, ControllerError> {
        let configured = config.arms.len();
        if configured != ARMS {
            return Err(ControllerError::ArmCount {
                configured,
                wanted: ARMS,
            });
        }
        Ok(Self {
            arms: core::array::from_fn(|_| ArmControl::new(config)),
            smoothers: core::array::from_fn(|_| Smoother::new(&config.axes, TICK_S)),
            rows: Rows::new(config),
            filter: Filter::new(config),
            guard: Guard::new(config, &[MotionState::ZERO; ARMS], TICK_S)?,
            config: config.clone(),
            newest: None,
            #[cfg(test)]
            sabotage: super::sabotage::Sabotage::default(),
        })
    }

    /// The problem that the filter solved last, for a second opinion.
    #[must_use]
    pub const fn problem(&self) -> &Problem {
        self.filter.problem()
    }

    /// The filter's answer to that problem: the change of each axis in units of its velocity limit.
    #[must_use]
    pub const fn solution(&self) -> &Velocities {
        self.filter.solution()
    }

    /// How near each measured arm came to its boundaries while it held torque. For the end of a
    /// run: it allocates.
    #[must_use]
    pub fn measured_clearances(&self) -> Vec<MeasuredClearance> {
        self.guard.measured(&self.config)
    }

    /// The largest distance of each arm between a measured part of its instrument and where that
    /// was commanded to be, m.
    #[must_use]
    pub fn following_errors_m(&self) -> [f64; ARMS] {
        self.arms.each_ref().map(|arm| arm.following_error_m)
    }

    /// Puts the complete state after the newest tick into `to`. Hot path: bounded, no allocation.
    pub fn save(&self, to: &mut Snapshot) {
        const { assert!(<Self as Stateful>::WORDS_MAX <= STATE_WORDS_MAX) };
        to.begin(<Self as Stateful>::LAYOUT);
        Stateful::save(self, to);
    }

    /// Goes on from the state in `snapshot`, taken of a controller that was built from the same
    /// configuration: from the same inputs follow the same bits. `chunks` are those of
    /// [`Snapshot::held`], in the same order.
    ///
    /// # Errors
    /// [`SnapshotError`]; the controller is of no use then.
    pub fn restore(&mut self, snapshot: &Snapshot, chunks: &[Chunk]) -> Result<(), SnapshotError> {
        let mut from = snapshot.read(<Self as Stateful>::LAYOUT, chunks)?;
        possible(snapshot.held().iter().all(|held| held.arm < ARMS))?;
        Stateful::restore(self, &mut from)?;
        from.finish()
    }

    /// The chunk that the controller has where `held` says.
    #[must_use]
    pub fn held(&self, held: &HeldChunk) -> Option<&Chunk> {
        self.arms.get(held.arm)?.held(held.slot)
    }

    /// One control period of all arms, which share one `now`.
    ///
    /// For periods missed since the newest tick the rig has played the tail; the controller goes on
    /// from there.
    pub fn tick_arms(&mut self, inputs: &[TickInput<'_>; ARMS]) -> [TickOutput; ARMS] {
        const { assert!(ARMS > 0) };
        self.catch_up(inputs[0].now);
        for (index, (arm, input)) in self.arms.iter_mut().zip(inputs).enumerate() {
            if arm.observe(input) {
                self.guard.seed(index, &arm.commanded);
            }
        }
        self.guard.observe(&core::array::from_fn(|arm| {
            let arm = &self.arms[arm];
            #[cfg(test)]
            if self.sabotage.lag_ignored {
                return (super::Deviation::default(), arm.measured);
            }
            (arm.deviation, arm.measured)
        }));
        self.pause_beside_a_fault(inputs);
        let stances: [KinematicState; ARMS] =
            core::array::from_fn(|arm| KinematicState::new(&self.arms[arm].commanded));
        let plans: [Plan; ARMS] =
            core::array::from_fn(|arm| self.arms[arm].plan(&inputs[arm], &stances[arm]));
        let filtered = self.filter(&plans, &stances);
        let requests = core::array::from_fn(|arm| self.request(arm, &plans[arm], &filtered));
        let commanded = core::array::from_fn(|arm| self.arms[arm].commanded);
        let decisions = self.decide(&commanded, &requests);
        core::array::from_fn(|arm| {
            let now = inputs[arm].now;
            self.finish(arm, now, &plans[arm], &filtered, &decisions[arm])
        })
    }

    /// Plays the held stops for each missed period, until all arms rest. An interval below two
    /// periods misses none.
    fn catch_up(&mut self, now: TimeNs) {
        let newest = self.newest.replace(now).unwrap_or(now);
        for _ in 1..now.since(newest) / TICK_NS {
            if self.arms.iter().all(|arm| arm.commanded.is_at_rest()) {
                break;
            }
            let commanded = core::array::from_fn(|arm| self.arms[arm].commanded);
            let decisions = self.guard.next(&commanded, &[Request::Stop; ARMS]);
            for (arm, decision) in self.arms.iter_mut().zip(&decisions) {
                arm.commanded = decision.state;
            }
        }
    }

    /// The scene is shared: where one arm has a fault the other comes to rest and waits for the
    /// operator.
    fn pause_beside_a_fault(&mut self, inputs: &[TickInput<'_>; ARMS]) {
        let fault = |arm: &ArmControl| arm.state == OperatingState::Fault;
        if self.arms.iter().any(fault) {
            for (arm, input) in self.arms.iter_mut().zip(inputs) {
                arm.change(Event::Operator(OperatorEvent::Pause), input.now);
            }
        }
    }

    /// One problem for all arms. Without an arm that follows there is nothing to solve; one that
    /// does not is in it with its velocities fixed at zero.
    fn filter(&mut self, plans: &[Plan; ARMS], stances: &[KinematicState; ARMS]) -> Filtered {
        if !plans.iter().any(|plan| plan.follows) {
            return Filtered::AT_REST;
        }
        let deviations = self.guard.deviations();
        let inputs: [RowInput<'_>; ARMS] = core::array::from_fn(|arm| RowInput {
            state: &self.arms[arm].commanded,
            stance: &stances[arm],
            moves: plans[arm].follows,
            jaw_effort_n_m: self.arms[arm].jaw_effort_n_m,
            pace: plans[arm].pace,
            deviation: deviations[arm],
        });
        self.rows.fill(&self.config, &inputs);
        #[cfg(test)]
        self.sabotage.rows(&mut self.rows);
        let mut nominal: Velocities = Filtered::AT_REST.velocity;
        for (arm, plan) in nominal.chunks_exact_mut(AXES).zip(plans) {
            arm.copy_from_slice(&plan.nominal);
        }
        let stances: [&KinematicState; ARMS] = core::array::from_fn(|arm| &stances[arm]);
        let filtered = self.filter.filter(&nominal, &self.rows, &stances);
        #[cfg(test)]
        let filtered = self.sabotage.filtered(filtered);
        filtered
    }

    /// The filtered velocity, smoothed for one tick under limits that the pace lowers.
    /// `Request::Follow(None)` if the smoother finds no way, which the guard answers with the held
    /// stop.
    fn request(&mut self, arm: usize, plan: &Plan, filtered: &Filtered) -> Request {
        if !plan.follows {
            return Request::Stop;
        }
        let velocity: Axes = core::array::from_fn(|axis| filtered.velocity[AXES * arm + axis]);
        let limits = self.config.axes.map(|axis| AxisLimits {
            velocity: axis.velocity * plan.pace,
            ..axis
        });
        let smoother = &mut self.smoothers[arm];
        smoother.set_limits(&limits);
        Request::Follow(smoother.step(&self.arms[arm].commanded, &velocity))
    }

    /// The guard's part of the tick. In tests it may be taken out, to see what filter and smoother
    /// alone are worth.
    fn decide(
        &mut self,
        commanded: &[MotionState; ARMS],
        requests: &[Request; ARMS],
    ) -> [Decision; ARMS] {
        #[cfg(test)]
        if self.sabotage.guard_removed {
            return super::sabotage::without_guard(commanded, requests);
        }
        self.guard.next(commanded, requests)
    }

    /// Takes over what the guard decided, releases the drives where they may be, and reports. The
    /// QP's outcome and the number of active rows are reported only for arms that follow.
    fn finish(
        &mut self,
        index: usize,
        now: TimeNs,
        plan: &Plan,
        filtered: &Filtered,
        decision: &Decision,
    ) -> TickOutput {
        let arm = &mut self.arms[index];
        arm.commanded = decision.state;
        if !plan.follows {
            arm.release();
        }
        let arm = &self.arms[index];
        const { assert!(ARMS <= ARMS_MAX) };
        let correction = filtered.correction[index];
        TickOutput {
            command: arm.commanded.command(now, arm.powered),
            tail: self.tail(index, now, arm.powered),
            report: TickReport {
                mode: arm.mode(),
                gate: plan.gate,
                qp: if plan.follows {
                    filtered.outcome
                } else {
                    QpOutcome::NotNeeded
                },
                rows_active: if plan.follows {
                    filtered.rows_active
                } else {
                    0
                },
                correction,
                guard_intervened: decision.intervened,
                target: plan.target,
                fault: arm.fault,
            },
        }
    }

    /// What is left of the stop that the guard holds for `arm`, from the command on.
    fn tail(&self, arm: usize, now: TimeNs, enabled: bool) -> SafeTail {
        let (stop, played_s) = self.guard.held()[arm];
        SafeTail {
            stamp: now,
            axes: stop
                .axes()
                .each_ref()
                .map(|axis| axis_tail(&axis.remainder(played_s))),
            enabled,
        }
    }
}

// Rows and filter are filled anew in each tick.
impl<const ARMS: usize> Stateful for Controller<ARMS> {
    const LAYOUT: u64 = layout(
        "Controller newest arms smoothers guard",
        &[
            ARMS as u64,
            ArmControl::LAYOUT_OF_ALL[0],
            ArmControl::LAYOUT_OF_ALL[1],
            <Smoother as Stateful>::LAYOUT,
            <Guard<ARMS> as Stateful>::LAYOUT,
        ],
    );
    const WORDS_MAX: usize = <Option<TimeNs> as Words>::WORDS_MAX
        + ARMS * (ArmControl::WORDS_OF_ALL + <Smoother as Stateful>::WORDS_MAX)
        + <Guard<ARMS> as Stateful>::WORDS_MAX;

    fn save(&self, to: &mut Snapshot) {
        let Self {
            arms,
            smoothers,
            rows: _,
            filter: _,
            guard,
            config: _,
            newest,
            #[cfg(test)]
                sabotage: _,
        } = self;
        newest.put(to);
        for (index, arm) in arms.iter().enumerate() {
            arm.save_all(index, newest.unwrap_or_default(), to);
        }
        for smoother in smoothers {
            smoother.save(to);
        }
        guard.save(to);
    }

    fn restore(&mut self, from: &mut Reader<'_>) -> Result<(), SnapshotError> {
        let Self {
            arms,
            smoothers,
            rows: _,
            filter: _,
            guard,
            config: _,
            newest,
            #[cfg(test)]
                sabotage: _,
        } = self;
        newest.restore(from)?;
        for (index, arm) in arms.iter_mut().enumerate() {
            arm.restore_all(index, newest.unwrap_or_default(), from)?;
        }
        for smoother in smoothers {
            smoother.restore(from)?;
        }
        guard.restore(from)
    }
}

fn axis_tail(rest: &Remainder) -> AxisTail {
    AxisTail {
        start: AxisPoint {
            position: rest.position,
            velocity: rest.velocity,
            acceleration: rest.acceleration,
        },
        phases: rest.phases.map(|phase| TailPhase {
            duration_s: phase.duration_s,
            jerk: phase.jerk,
        }),
    }
}
