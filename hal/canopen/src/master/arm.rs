//! An arm on a bus behind the trait that every backend implements.

use super::cycle::{Cycle, Goal, HOLD_NS};
use super::fault::Fault;
use super::link::Bus;
use super::plan::ArmPlan;
use super::space::Axes;
use crate::Outbox;
use crate::cia301::{NmtCommand, NmtTarget};
use hal::tail::{TAIL_AXES, TailPlayer};
use hal::{Arm, ArmCommand, ArmError, ArmState, JOINT_COUNT, SafeTail, TimeNs};

/// Most periods of a stop that are made up for at once.
const CATCH_UP_MAX: u64 = 1000;

/// How long drives may take to stop and to lose their torque, ns, and cycles of set-points for it
/// meanwhile.
const TAKE_DOWN_NS: u64 = 300_000_000;
const TAKE_DOWN_CYCLES: u64 = 20;

/// Seven drives on one to three buses.
///
/// Everything is exchanged in one place, [`CanArm::exchange`]: when a SYNC is due it takes what has
/// come, sends the set-points that the newest [`Arm::write`] left and then the SYNC that puts them
/// into effect. The answers to it are what the exchange of the next SYNC gives, so a measurement is
/// one cycle old. Whoever paces the cycle knows when the next exchange comes, and lets the
/// set-points leave as soon as they are there, by [`CanArm::send_before`]; then nothing stands
/// before the SYNC, whose answers otherwise come later by the set-points' time on the bus. A cycle
/// without a new command is one of the tail. A controller may be faster than the bus by a whole
/// factor; between two SYNCs it reads the same measurement again, since half of the answers would
/// have to be guessed. After a [`Fault`] the drives stop, and nothing enables them again but a new
/// [`Offline`](super::Offline).
#[derive(Debug)]
pub struct CanArm<B> {
    bus: B,
    plan: ArmPlan,
    cycle: Cycle,
    player: TailPlayer,
    /// Whether the controller gave a command since the last SYNC.
    written: bool,
    /// Whether the set-points of this cycle are on their way.
    sent: bool,
    /// The arm as it was at the newest SYNC.
    measured: Result<ArmState, ArmError>,
    /// Commands with a set-point that was NaN, infinite or out of range.
    refused: u64,
    out: Outbox,
}

impl<B: Bus> CanArm<B> {
    pub(super) fn new(bus: B, plan: &ArmPlan, cycle: Cycle) -> Self {
        Self {
            bus,
            plan: *plan,
            cycle,
            player: TailPlayer::new(plan.cycle_ns),
            written: false,
            sent: false,
            measured: Err(ArmError::MeasurementLost { age_ns: 0 }),
            refused: 0,
            out: Outbox::default(),
        }
    }

    /// The latched fault.
    #[must_use]
    pub fn fault(&self) -> Option<Fault> {
        self.cycle.fault()
    }

    /// The state of the cycle: health of axes and buses.
    #[must_use]
    pub const fn cycle(&self) -> &Cycle {
        &self.cycle
    }

    /// What it was brought up with.
    #[must_use]
    pub const fn plan(&self) -> &ArmPlan {
        &self.plan
    }

    pub(super) const fn cycle_ns(&self) -> u64 {
        self.plan.cycle_ns
    }

    /// Commands that were NaN, infinite or out of range; the tail was played instead.
    #[must_use]
    pub const fn refused(&self) -> u64 {
        self.refused
    }

    /// The buses.
    pub const fn bus_mut(&mut self) -> &mut B {
        &mut self.bus
    }

    pub(super) fn set_goal(&mut self, now: TimeNs, goal: Goal) {
        self.cycle.set_goal(now, goal);
    }

    pub(super) fn is_enabled(&self) -> bool {
        self.cycle.is_enabled()
    }

    /// Ends a cycle and begins the next one: judges, stands in for a silent controller, and sends
    /// SYNC.
    pub(super) fn turn(&mut self, now: TimeNs) {
        self.receive(now);
        self.cycle.judge(now);
        // Of the periods that have passed, the controller has taken care of one at most.
        let written = u64::from(core::mem::take(&mut self.written));
        self.play(now, self.cycle.cycles_since_sync(now) - written);
        let sent = core::mem::take(&mut self.sent);
        // Without a SYNC no set-point takes effect, not even one that is a quick stop. On a bus
        // that had no room for all, it is the one that must find some.
        for line in 0..self.plan.lines {
            if !sent && !self.cycle.is_transmit_queue_full(line) {
                self.send_set_points(line, now);
            }
        }
        self.begin_cycle(now);
        for line in 0..self.plan.lines {
            if !sent && self.cycle.is_transmit_queue_full(line) {
                self.send_set_points(line, now);
            }
        }
        self.measured = self.cycle.state(now);
    }

    /// Begins the cycle at `now`: on each bus SYNC, then the NMT commands that are due.
    fn begin_cycle(&mut self, now: TimeNs) {
        self.cycle.begin(now);
        for line in 0..self.plan.lines {
            self.out.clear();
            self.cycle.emit_sync(&mut self.out);
            self.cycle.stop_nodes(line, &mut self.out);
            self.transmit(line);
        }
    }

    /// A period at `now`: the one place in which the arm exchanges with its drives. Begins a cycle
    /// if a SYNC is due, otherwise only takes what has come.
    ///
    /// # Errors
    /// As [`Arm::read`], which is this.
    pub fn exchange(&mut self, now: TimeNs) -> Result<ArmState, ArmError> {
        self.turn_if_due(now);
        self.measured(now)
    }

    fn turn_if_due(&mut self, now: TimeNs) {
        if self.cycle.is_due(now) {
            self.turn(now);
        } else {
            self.receive(now);
        }
    }

    /// Sends the set-points of the newest command, if a SYNC is due at the next exchange, `next`:
    /// of a controller that is faster than the bus only the newest command before a SYNC is sent.
    pub fn send_before(&mut self, next: TimeNs) {
        if self.written && !self.sent && self.cycle.is_due(next) {
            for line in 0..self.plan.lines {
                self.send_set_points(line, next);
            }
            self.sent = true;
        }
    }

    /// What is known of the arm at `now`.
    fn measured(&self, now: TimeNs) -> Result<ArmState, ArmError> {
        let since_ns = self.cycle.began().map_or(0, |began| now.since(began));
        match (self.cycle.fault(), self.measured) {
            (Some(fault), _) => Err(fault.arm_error()),
            (None, Err(ArmError::MeasurementLost { age_ns })) => Err(ArmError::MeasurementLost {
                age_ns: age_ns.saturating_add(since_ns),
            }),
            (None, measured) => measured,
        }
    }

    /// The tail's set-points for `periods` without a command, of which the last one counts. It may
    /// let go, never enable.
    fn play(&mut self, now: TimeNs, periods: u64) {
        for _ in 0..periods.min(CATCH_UP_MAX) {
            if let Some(command) = self.player.next_period() {
                self.take(&command);
                if !command.enabled {
                    self.cycle.set_goal(now, Goal::Disabled);
                }
            }
        }
    }

    /// Takes a command's set-points; tells whether they can be gone to.
    fn take(&mut self, command: &ArmCommand) -> bool {
        let joints: Axes = core::array::from_fn(|axis| {
            if axis < JOINT_COUNT {
                command.position[axis]
            } else {
                command.jaw_position
            }
        });
        let units = self.plan.space.from_joints(&joints);
        self.cycle.set_targets(command.stamp, &units)
    }

    fn receive(&mut self, now: TimeNs) {
        let Self {
            bus, plan, cycle, ..
        } = self;
        for line in 0..plan.lines {
            bus.receive(line, &mut |received| {
                cycle.on_received(line, now, &received)
            });
        }
    }

    /// Sends what is in the outbox, unless that bus is lost.
    fn transmit(&mut self, line: u8) {
        let health = self.cycle.line_health().get(usize::from(line));
        if health.is_some_and(|health| health.off) {
            // What waits in a queue would leave as soon as the bus is back.
            self.bus.flush(line);
            return;
        }
        let frames = self.out.frames();
        let count = self.bus.send(line, frames);
        self.cycle.on_sent(line, frames, count);
    }

    fn send_set_points(&mut self, line: u8, now: TimeNs) {
        self.out.clear();
        self.cycle.commands(now, line, &mut self.out);
        self.transmit(line);
    }

    /// Takes the drives down, an exchange of the cycle that is due at `now`: operation disabled
    /// (0007h), after the brake's time shut down (0006h), no voltage (0000h), each state confirmed
    /// by the drive. Tells whether every drive that is heard is down; to be called once a control
    /// period until it is, or [`Self::take_down_ns`] have passed, and [`Self::shut_down`]
    /// thereafter. After a fault the drives stop first, as in every cycle after it.
    pub fn take_down(&mut self, now: TimeNs) -> bool {
        self.cycle.set_goal(now, Goal::Disabled);
        self.turn_if_due(now);
        self.cycle.is_down()
    }

    /// How long [`Self::take_down`] may take: the longest stop of a drive, its brake, and a few
    /// cycles for each state; after a fault also how long a drive holds before it loses its
    /// voltage.
    #[must_use]
    pub fn take_down_ns(&self) -> u64 {
        let hold_ns = self.fault().map_or(0, |_| HOLD_NS);
        TAKE_DOWN_NS + hold_ns + self.plan.brake_ns + TAKE_DOWN_CYCLES * self.plan.cycle_ns
    }

    /// Stops every node: drives that still have torque stop as 6007h says.
    pub fn shut_down(&mut self) {
        for axis in 0..TAIL_AXES {
            let who = self.plan.who(axis);
            self.out.clear();
            let stop = NmtCommand::Stop.emit(NmtTarget::Node(who.node));
            self.out.push(stop);
            self.transmit(who.line);
        }
    }

    /// The buses alone.
    pub(super) fn into_bus(self) -> B {
        self.bus
    }
}

impl<B: Bus> Arm for CanArm<B> {
    fn read(&mut self, now: TimeNs) -> Result<ArmState, ArmError> {
        self.exchange(now)
    }

    fn write(&mut self, command: &ArmCommand, tail: &SafeTail) -> Result<(), ArmError> {
        let now = command.stamp;
        if command.is_finite() && tail.is_finite() && self.take(command) {
            self.player.write(command, tail);
            // The player asks at the SYNC whether this period had its command; this one had.
            let _ = self.player.next_period();
            self.written = true;
            let goal = if command.enabled {
                Goal::Enabled
            } else {
                Goal::Disabled
            };
            self.cycle.set_goal(now, goal);
        } else {
            self.refused += 1;
        }
        match self.cycle.fault() {
            Some(fault) => Err(fault.arm_error()),
            None => Ok(()),
        }
    }
}
