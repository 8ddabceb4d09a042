//! Checks the commands of one arm, one after the other.
//!
//! A command with torque is checked for place (ranges, workspace, regions), motion (differences of
//! set-points up to the jerk), its own rates, and the tip's two speeds since the one before. The
//! history begins where the drives get their torque: at rest at the measured place, so that a jump
//! at the first command shows as speed, acceleration and jerk. Without torque the command must copy
//! the measured arm, and all its rates be zero.

use hal::{ArmCommand, ArmError, ArmState, JOINT_COUNT, JointVector, Pose, TICK_NS};

use super::axis::{Axis, Order, PERIOD_S};
use super::boundary::Moment;
use super::chain::Instrument;
use super::differences::{AXES, History};
use super::ledger::{Ledger, LimitId};
use super::limits::{ArmLimits, Limits};
use super::measured::{Measured, possible};
use super::space::Space;
use super::tip::{Tip, TipPose};

/// What came before a command.
#[derive(Clone, Copy, Debug)]
enum Before {
    /// Nothing: the commands begin, and a controller begins without torque.
    Beginning,
    /// Missing ticks, in which the drives may have been switched.
    Gap,
    /// Drives without torque, and their commanded positions.
    Limp([f64; AXES]),
    /// Drives with torque.
    Powered,
}

/// The check of one arm between two commands.
#[derive(Clone, Debug)]
pub(super) struct Arm {
    /// All places are compared in the scene's frame.
    scene_from_rcm: Pose,
    /// In joint order, then the jaw.
    axes: Vec<Axis>,
    pub(super) space: Space,
    pub(super) tip: Tip,
    pub(super) measured: Measured,
    /// Broken by a stamp that does not rise by whole periods; value and bound are ns.
    stamp_limit: LimitId,
    /// Value: how many ticks are missing.
    missing_limit: LimitId,
    hash_limit: LimitId,
    /// Empty without torque.
    history: History,
    /// The tip at the newest command with torque; none without one.
    place: Option<TipPose>,
    /// The newest command's, ns.
    stamp: Option<u64>,
    /// Periods from the command before the newest to the newest.
    periods: f64,
    before: Before,
    /// Since the beginning; the arm played its tail in them, which is no violation.
    pub(super) skipped_periods: u64,
    /// None before the first command. Tails and pair are checked with it.
    pub(super) newest: Option<Newest>,
    /// How the newest command with torque says that the axes move: velocities, and accelerations of
    /// the joints.
    rates: Option<Rates>,
}

/// Velocities of the axes and accelerations of the joints.
type Rates = ([f64; AXES], [f64; JOINT_COUNT]);

/// The newest command and what it means.
#[derive(Clone, Copy, Debug)]
pub(super) struct Newest {
    /// As it was sent.
    pub(super) command: ArmCommand,
    /// The instrument at the command's positions, scene frame.
    pub(super) at: Instrument,
    /// Whether it moves the arm: the drives have torque, or lose it with this command.
    pub(super) powered: bool,
    /// Whether the drives get torque with it.
    pub(super) gained: bool,
    /// Where the arm is measured, if it is and holds torque.
    pub(super) measured: Option<Instrument>,
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
            measured: Measured::new(ledger, limits, arm),
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
            rates: None,
        }
    }

    /// Checks the motion that a command begins, goes on with or ends.
    fn motion(
        &mut self,
        ledger: &mut Ledger,
        command: &ArmCommand,
        at: &Instrument,
        measured_now: &Result<ArmState, ArmError>,
    ) {
        if !command.enabled {
            self.without_torque(ledger, command, at, measured_now);
            return;
        }
        if let (Before::Beginning | Before::Limp(_), Ok(state)) = (self.before, measured_now) {
            self.begin(state);
        }
        self.powered(ledger, command, at);
        self.before = Before::Powered;
    }

    /// Checks a command that leaves the drives without torque.
    fn without_torque(
        &mut self,
        ledger: &mut Ledger,
        command: &ArmCommand,
        at: &Instrument,
        measured_now: &Result<ArmState, ArmError>,
    ) {
        match self.before {
            // Torque goes when the arm rests: this last setpoint is still part of the motion.
            Before::Powered => self.powered(ledger, command, at),
            Before::Limp(held) => self.limp(ledger, command, measured_now, Some(held)),
            Before::Beginning => self.limp(ledger, command, measured_now, None),
            Before::Gap => {}
        }
        self.still(ledger, command);
        self.forget();
        self.before = Before::Limp(positions(command));
    }

    /// Checks the next command.
    ///
    /// The stamp first, then the measured arm, then the motion. `measured_now` is what the
    /// controller was given in the same tick.
    pub(super) fn tick(
        &mut self,
        ledger: &mut Ledger,
        command: &ArmCommand,
        measured_now: &Result<ArmState, ArmError>,
    ) {
        self.stamp(ledger, command);
        let at = self.instrument(&positions(command));
        let was_powered = matches!(self.before, Before::Powered);
        let gained = command.enabled && !was_powered;
        if gained {
            self.measured.begin();
        }
        let measured = possible(measured_now)
            .filter(|_| was_powered || command.enabled)
            .map(|state| self.measure(ledger, state));
        self.motion(ledger, command, &at, measured_now);
        self.newest = Some(Newest {
            command: *command,
            at,
            powered: was_powered || command.enabled,
            gained,
            measured,
        });
    }

    /// Checks where the arm is measured.
    ///
    /// Scene frame.
    fn measure(&mut self, ledger: &mut Ledger, state: &ArmState) -> Instrument {
        let at = self.instrument(&axes(&state.position, state.jaw_position));
        self.measured.tick(ledger, &at);
        at
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
        self.rates = Some(([0.0; AXES], [0.0; JOINT_COUNT]));
        self.place = Some(Tip::place(&self.instrument(&sample)));
    }

    /// Without torque the command moves nothing: it follows the measured arm, and stays where it is
    /// if nothing is measured.
    fn limp(
        &self,
        ledger: &mut Ledger,
        command: &ArmCommand,
        measured: &Result<ArmState, ArmError>,
        held: Option<[f64; AXES]>,
    ) {
        let expected = possible(measured)
            .map(|state| axes(&state.position, state.jaw_position))
            .or(held);
        if let Some(expected) = expected {
            let values = positions(command).into_iter().zip(expected);
            for (axis, (value, expected)) in self.axes.iter().zip(values) {
                axis.limp_place(ledger, value, expected);
            }
        }
    }

    /// Checks that a command of an arm without torque says that nothing moves.
    fn still(&self, ledger: &mut Ledger, command: &ArmCommand) {
        for (axis, velocity) in self.axes.iter().zip(velocities(command)) {
            axis.limp_velocity(ledger, velocity);
        }
        for (axis, acceleration) in self.axes.iter().zip(accelerations(command)) {
            axis.limp_acceleration(ledger, acceleration);
        }
    }

    /// Checks the rates of a command against its limits, against the setpoints and against one
    /// another.
    ///
    /// `moved` is by how much the set-points changed since the command before. Velocity and
    /// acceleration go to the drives along with the position, so all three must agree.
    fn rates(&mut self, ledger: &mut Ledger, command: &ArmCommand, moved: Option<[f64; AXES]>) {
        let now: Rates = (velocities(command), accelerations(command));
        let before = self.rates.replace(now);
        let elapsed_s = self.periods * PERIOD_S;
        for (index, axis) in self.axes.iter().enumerate() {
            axis.commanded(ledger, now.0[index], now.1.get(index).copied());
            let (Some(before), Some(moved)) = (before, &moved) else {
                continue;
            };
            let speeds = [before.0[index], now.0[index]];
            axis.agrees(ledger, Order::Velocity, moved[index], speeds, elapsed_s);
            if let (Some(&then), Some(&since)) = (before.1.get(index), now.1.get(index)) {
                let gained = now.0[index] - before.0[index];
                axis.agrees(
                    ledger,
                    Order::Acceleration,
                    gained,
                    [then, since],
                    elapsed_s,
                );
            }
        }
    }

    /// Checks a command that moves the arm.
    ///
    /// Of the first command after a gap only the place is checked, since its predecessor is not
    /// known.
    fn powered(&mut self, ledger: &mut Ledger, command: &ArmCommand, at: &Instrument) {
        let sample = positions(command);
        self.places(ledger, Moment::Command, &sample, at);
        let moved = self
            .history
            .newest()
            .map(|before| core::array::from_fn(|axis| sample[axis] - before[axis]));
        self.history.push(sample, self.periods);
        for axis in &self.axes {
            axis.motion(ledger, &self.history);
        }
        self.rates(ledger, command, moved);
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
        self.rates = None;
        self.place = None;
        self.axes.iter_mut().for_each(Axis::forget);
        self.space.forget();
    }

    /// Says that what came before is not known.
    pub(super) fn resume(&mut self) {
        self.forget();
        self.measured.begin();
        self.before = Before::Gap;
    }

    /// Says that `count` ticks before this one are missing.
    pub(super) fn missing(&mut self, ledger: &mut Ledger, count: u64) {
        self.resume();
        #[expect(clippy::cast_precision_loss, reason = "for people")]
        let count = count as f64;
        ledger.judge(self.missing_limit, count, 0.0, count, 0.0);
    }

    /// Says that the commands are not the ones that the run reported.
    pub(super) fn other_hash(&self, ledger: &mut Ledger) {
        ledger.judge(self.hash_limit, 1.0, 0.0, 1.0, 0.0);
    }

    /// Stamps must rise by whole periods; more than one means that the driver skipped some, in
    /// which the arm played its tail.
    ///
    /// Sets `periods`, by which differences are divided.
    fn stamp(&mut self, ledger: &mut Ledger, command: &ArmCommand) {
        let now = command.stamp.0;
        self.periods = 1.0;
        // Missing ticks are counted, and are no skipped ones.
        let gap = matches!(self.before, Before::Gap);
        let Some(before) = self.stamp.replace(now) else {
            return;
        };
        let step = now.wrapping_sub(before);
        if now <= before || step % TICK_NS != 0 {
            #[expect(clippy::cast_precision_loss, reason = "for people")]
            let (step_ns, period_ns) = (now as f64 - before as f64, 1e9 * PERIOD_S);
            let excess_ns = (step_ns - period_ns).abs();
            ledger.judge(self.stamp_limit, excess_ns, 0.0, step_ns, period_ns);
        } else if !gap {
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

/// Joints and jaw in one array.
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

/// How fast a command says that the joints' velocities change.
fn accelerations(command: &ArmCommand) -> [f64; JOINT_COUNT] {
    let mut all = [0.0; JOINT_COUNT];
    for (value, &joint) in all.iter_mut().zip(command.acceleration.iter()) {
        *value = joint;
    }
    all
}
