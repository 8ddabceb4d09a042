//! Checks the commands of one arm, one after the other.

use hal::{ArmCommand, ArmError, ArmState, JointVector, Pose, TICK_NS};

use super::axis::{Axis, PERIOD_S};
use super::boundary::Moment;
use super::chain::Instrument;
use super::differences::{AXES, History};
use super::ledger::{Ledger, LimitId};
use super::limits::{ArmLimits, Limits};
use super::space::Space;
use super::tip::{Place, Tip};

/// What came before a command.
#[derive(Clone, Copy, Debug)]
enum Before {
    /// Nothing: the commands begin, and a controller begins without torque.
    Beginning,
    /// Missing ticks, in which the drives may have been switched.
    Gap,
    /// Drives without torque, and where they were told to be.
    Limp([f64; AXES]),
    /// Drives with torque.
    Powered,
}

/// The check of one arm between two commands.
#[derive(Clone, Debug)]
pub(super) struct Arm {
    scene_from_rcm: Pose,
    axes: Vec<Axis>,
    pub(super) space: Space,
    pub(super) tip: Tip,
    stamp_limit: LimitId,
    missing_limit: LimitId,
    hash_limit: LimitId,
    history: History,
    place: Option<Place>,
    stamp: Option<u64>,
    /// Periods from the command before the newest to the newest.
    periods: f64,
    before: Before,
    pub(super) skipped_periods: u64,
    pub(super) newest: Option<Newest>,
}

/// The newest command and what it means.
#[derive(Clone, Copy, Debug)]
pub(super) struct Newest {
    pub(super) command: ArmCommand,
    pub(super) at: Instrument,
    /// Whether it moves the arm: the drives have torque, or lose it with this command.
    pub(super) powered: bool,
    /// Whether the drives get torque with it.
    pub(super) gained: bool,
}

impl Arm {
    pub(super) fn new(ledger: &mut Ledger, limits: &Limits, arm: &ArmLimits) -> Self {
        let name = arm.name.as_str();
        let axes = limits.axes.iter().enumerate();
        Self {
            scene_from_rcm: arm.scene_from_rcm,
            axes: axes
                .map(|(index, limits)| Axis::new(ledger, name, index, limits))
                .collect(),
            space: Space::new(ledger, limits, arm),
            tip: Tip::new(ledger, limits, name),
            stamp_limit: ledger.open(name, "stamp".to_owned()),
            missing_limit: ledger.open(name, "missing_ticks".to_owned()),
            hash_limit: ledger.open(name, "command_hash_mismatches".to_owned()),
            history: History::new(),
            place: None,
            stamp: None,
            periods: 1.0,
            before: Before::Beginning,
            skipped_periods: 0,
            newest: None,
        }
    }

    /// Checks the next command.
    pub(super) fn tick(
        &mut self,
        ledger: &mut Ledger,
        command: &ArmCommand,
        measured: &Result<ArmState, ArmError>,
    ) {
        self.stamp(ledger, command);
        let at = self.instrument(&positions(command));
        let was_powered = matches!(self.before, Before::Powered);
        if command.enabled {
            if let (Before::Beginning | Before::Limp(_), Ok(state)) = (self.before, measured) {
                self.begin(state);
            }
            self.powered(ledger, command, &at);
            self.before = Before::Powered;
        } else {
            match self.before {
                // Torque goes when the arm rests: this last setpoint is still part of the motion.
                Before::Powered => self.powered(ledger, command, &at),
                Before::Limp(held) => self.limp(ledger, command, measured, Some(held)),
                Before::Beginning => self.limp(ledger, command, measured, None),
                Before::Gap => {}
            }
            for (axis, velocity) in self.axes.iter().zip(velocities(command)) {
                axis.limp_velocity(ledger, velocity);
            }
            self.forget();
            self.before = Before::Limp(positions(command));
        }
        self.newest = Some(Newest {
            command: *command,
            at,
            powered: was_powered || command.enabled,
            gained: command.enabled && !was_powered,
        });
    }

    /// The instrument with its joints and jaw at `positions`.
    pub(super) fn instrument(&self, positions: &[f64; AXES]) -> Instrument {
        let [joints @ .., jaw] = *positions;
        Instrument::new(&self.scene_from_rcm, &JointVector::from(joints), jaw)
    }

    /// An arm gets its torque at rest, where it was measured: its motion begins there.
    fn begin(&mut self, state: &ArmState) {
        self.forget();
        let sample = axes(&state.position, state.jaw_position);
        for _ in 0..3 {
            self.history.push(sample, 1.0);
        }
        self.place = Some(Tip::place(&self.instrument(&sample)));
    }

    /// Without torque the command moves nothing: it follows the measured arm, and stays where it is if nothing is measured.
    fn limp(
        &self,
        ledger: &mut Ledger,
        command: &ArmCommand,
        measured: &Result<ArmState, ArmError>,
        held: Option<[f64; AXES]>,
    ) {
        let expected = match measured {
            Ok(state) if state.is_finite() && state.impossible().is_none() => {
                Some(axes(&state.position, state.jaw_position))
            }
            Ok(_) | Err(_) => held,
        };
        if let Some(expected) = expected {
            let values = positions(command).into_iter().zip(expected);
            for (axis, (value, expected)) in self.axes.iter().zip(values) {
                axis.limp_place(ledger, value, expected);
            }
        }
    }

    /// Checks a command that moves the arm.
    fn powered(&mut self, ledger: &mut Ledger, command: &ArmCommand, at: &Instrument) {
        let sample = positions(command);
        self.places(ledger, Moment::Command, &sample, at);
        self.history.push(sample, self.periods);
        for (axis, velocity) in self.axes.iter().zip(velocities(command)) {
            axis.motion(ledger, &self.history, velocity);
        }
        let place = Tip::place(at);
        if let Some(before) = self.place.replace(place) {
            let elapsed_s = self.periods * PERIOD_S;
            self.tip
                .check(ledger, Moment::Command, &before, &place, elapsed_s);
        }
    }

    /// Checks where the arm is.
    pub(super) fn places(
        &mut self,
        ledger: &mut Ledger,
        moment: Moment,
        positions: &[f64; AXES],
        at: &Instrument,
    ) {
        for (axis, &position) in self.axes.iter_mut().zip(positions) {
            axis.place(ledger, moment, position);
        }
        self.space.check(ledger, moment, at);
    }

    /// Forgets how the arm moved and what it was allowed.
    fn forget(&mut self) {
        self.history.clear();
        self.place = None;
        self.axes.iter_mut().for_each(Axis::forget);
        self.space.forget();
    }

    /// Says that `count` ticks before this one are missing.
    pub(super) fn missing(&mut self, ledger: &mut Ledger, count: u64) {
        self.forget();
        self.stamp = None;
        self.before = Before::Gap;
        #[expect(clippy::cast_precision_loss, reason = "for people")]
        let count = count as f64;
        ledger.judge(self.missing_limit, count, 0.0, count, 0.0);
    }

    /// Says that the commands are not the ones that the run reported.
    pub(super) fn other_hash(&self, ledger: &mut Ledger) {
        ledger.judge(self.hash_limit, 1.0, 0.0, 1.0, 0.0);
    }

    /// Stamps must rise by whole periods; more than one means that the driver skipped some, in which the arm played its tail.
    fn stamp(&mut self, ledger: &mut Ledger, command: &ArmCommand) {
        let now = command.stamp.0;
        self.periods = 1.0;
        let Some(before) = self.stamp.replace(now) else {
            return;
        };
        let step = now.wrapping_sub(before);
        if now <= before || step % TICK_NS != 0 {
            #[expect(clippy::cast_precision_loss, reason = "for people")]
            let (step_ns, period_ns) = (now as f64 - before as f64, 1e9 * PERIOD_S);
            let excess_ns = (step_ns - period_ns).abs();
            ledger.judge(self.stamp_limit, excess_ns, 0.0, step_ns, period_ns);
        } else {
            let periods = step / TICK_NS;
            self.skipped_periods += periods - 1;
            #[expect(
                clippy::cast_precision_loss,
                reason = "a run has fewer than 2^53 periods"
            )]
            let periods = periods as f64;
            self.periods = periods;
        }
    }
}

/// Joints and jaw in one row.
fn axes(joints: &JointVector, jaw: f64) -> [f64; AXES] {
    let mut all = [jaw; AXES];
    for (value, &joint) in all.iter_mut().zip(joints.iter()) {
        *value = joint;
    }
    all
}

/// Where a command puts the axes.
pub(super) fn positions(command: &ArmCommand) -> [f64; AXES] {
    axes(&command.position, command.jaw_position)
}

/// How fast a command says that they move.
pub(super) fn velocities(command: &ArmCommand) -> [f64; AXES] {
    axes(&command.velocity, command.jaw_velocity)
}
