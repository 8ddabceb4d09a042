//! The drives of all arms with the world that they move, or with nothing but their motors, in a
//! time of their own.
//!
//! Nothing here knows of threads, sockets or the clock: time is an argument, and what happens is
//! told to a [`Listener`]. The bus thread runs it with real buses, tests without.

use hal::count::{count_u8, count_u32};
use hal::joints::INSERTION;
use hal::{Arm as _, ArmState, JointVector, TimeNs, psm};
use trocar_canopen::cia301::NmtState;
use trocar_canopen::master::CanConfig;
use trocar_canopen::{Frame, NodeId, Payload};
use trocar_drives::node::{AxisConfig, Node};
use trocar_drives::{Network, Terminal};
use trocar_tasks::simulation::Simulation;

use super::coupling::Coupling;
use super::inject::{FaultKind, InjectedFault, Injector, Outside};
use super::seen::Seen;
use super::stops::{Stop, StopWatch};
use crate::session::SessionError;
use crate::session::source::STEP_TICKS;
use crate::session::world_report::WorldState;

/// Frames that wait for a bus on their way in from outside.
///
/// A queue that is full loses frames, which the station counts.
const QUEUE: usize = 256;

/// The interfaces of the first `arms` arms, each once: line 0 of the network first.
///
/// Two arms may share buses. The place of a name in the result is the line by which the network
/// knows it.
pub(super) fn interfaces(can: &CanConfig, arms: usize) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for name in can.arms.iter().take(arms).flat_map(|arm| &arm.interfaces) {
        if !names.contains(name) {
            names.push(name.clone());
        }
    }
    names
}

/// Checks that no node stands for two axes.
///
/// Two arms on buses of their own may reuse numbers on real hardware; the emulated network finds a
/// drive by its node alone.
pub(super) fn check_nodes(can: &CanConfig, arms: usize) -> Result<(), SessionError> {
    let mut seen: Vec<NodeId> = Vec::new();
    for axis in can.arms.iter().take(arms).flat_map(|arm| &arm.plan.axes) {
        if seen.contains(&axis.node) {
            return Err(SessionError::BadArgument(format!(
                "node {} is of two arms; `trocar drives` needs a number of its own for each drive",
                axis.node
            )));
        }
        seen.push(axis.node);
    }
    Ok(())
}

/// What those outside are notified of.
///
/// Called from within [`Bench::step`], in the drives' time; must not block, since the drives stand
/// still meanwhile.
pub(super) trait Listener {
    /// A drive has stopped and rests.
    ///
    /// Once a stop, when its axis has been slow for 10 ms. `stalled_ns` is still 0: the listener
    /// knows it.
    fn stopped(&mut self, stop: Stop);

    /// The fault at this place has begun.
    ///
    /// `place` counts the faults as they were given.
    fn injected(&mut self, place: usize);

    /// All drives follow: the episode begins.
    ///
    /// Once a run.
    fn begun(&mut self, at: TimeNs);

    /// A policy step has passed in the world.
    ///
    /// Every 40 ms of the drives' time; `sequence` counts policy steps from the start, also before
    /// the episode. Not called without a world.
    fn step(&mut self, sequence: u64, world: &WorldState, simulation: &Simulation);

    /// The controllers of all others on this line are off the bus.
    ///
    /// The network emulates no error frame: the listener sees to one on the real bus.
    fn bus_off(&mut self, line: u8);
}

/// An arm at rest where homing leaves it.
fn at_home() -> ArmState {
    let mut position = JointVector::zeros();
    position[INSERTION] = psm::HOME_INSERTION_M;
    ArmState::at_rest(TimeNs(0), position, 0.0)
}

/// Arms, their world, and what is injected.
pub(super) struct Bench {
    /// What the motors turn; without one each follows its set-point.
    simulation: Option<Simulation>,
    /// In the order of `can.toml`, which is the simulation's.
    arms: Vec<Coupling>,
    watches: Vec<StopWatch>,
    injector: Injector,
    /// Until all drives follow, [`Simulation::wait`] stands in for the world's step: nothing is
    /// judged, and the episode's time does not run.
    begun: Option<TimeNs>,
}

impl Bench {
    /// Puts the drives of the first `count` arms of `can` on the lines of their interfaces;
    /// `simulation` has as many, if there is one.
    ///
    /// A drive's serial number is 100 per arm plus its node, its identity that of the plan;
    /// [`FaultKind::WrongIdentity`] raises the product code by one before any node boots. Bit rate
    /// and cycle of all lines are those of the first arm.
    ///
    /// # Errors
    /// If the simulation cannot read an arm.
    pub(super) fn new(
        mut simulation: Option<Simulation>,
        (can, count): (&CanConfig, usize),
        faults: &[InjectedFault],
    ) -> Result<(Self, Network<Terminal>), SessionError> {
        let names = interfaces(can, count);
        let lines = count_u8(names.len());
        let plans: Vec<_> = can.arms.iter().take(count).collect();
        let (bit_rate, cycle_ns) = plans
            .first()
            .map_or((1, 1), |arm| (arm.plan.bit_rate, arm.plan.cycle_ns));
        let mut network = Network::new(lines, bit_rate, QUEUE);
        let (mut arms, mut watches) = (Vec::new(), Vec::new());
        for (index, arm) in plans.into_iter().enumerate() {
            let coupling = Coupling::new(&arm.plan);
            let state = match &mut simulation {
                None => at_home(),
                Some(simulation) => match simulation.arm(index) {
                    Some(mut simulated) => simulated.read(TimeNs(0))?,
                    None => continue,
                },
            };
            for (axis, feedback) in coupling.feedback(&state).into_iter().enumerate() {
                let plan = &arm.plan.axes[axis];
                let interface = &arm.interfaces[usize::from(plan.line)];
                let before = names.iter().take_while(|name| *name != interface);
                let line = count_u8(before.count());
                let serial = 100 * count_u32(index + 1) + u32::from(plan.node.raw());
                let mut drive = AxisConfig::of(plan, serial);
                let lies = |fault: &InjectedFault| {
                    fault.kind == FaultKind::WrongIdentity && fault.node == plan.node
                };
                if faults.iter().any(lies) {
                    drive.identity.1 = drive.identity.1.wrapping_add(1);
                }
                network.add(line, Node::new(plan.node, &drive), Terminal::new(feedback));
            }
            watches.push(StopWatch::new(index, &arm.plan));
            arms.push(coupling);
        }
        let injector = Injector::new(faults, cycle_ns, &mut network);
        let bench = Self {
            simulation,
            arms,
            watches,
            injector,
            begun: None,
        };
        Ok((bench, network))
    }

    /// When all drives followed for the first time.
    pub(super) const fn begun(&self) -> Option<TimeNs> {
        self.begun
    }

    /// A millisecond of the world, which is over at `at`.
    ///
    /// In this order: motors and world, stops, the beginning of the episode, faults, and a report
    /// of the world if a policy step ends here.
    ///
    /// # Errors
    /// If the simulation cannot read an arm.
    pub(super) fn step(
        &mut self,
        at: TimeNs,
        network: &mut Network<Terminal>,
        listener: &mut dyn Listener,
    ) -> Result<(), SessionError> {
        self.turn_motors(at, network)?;
        for watch in &mut self.watches {
            watch.look(at, network, &mut |stop| listener.stopped(stop));
        }
        if self.begun.is_none() && self.watches.iter().all(StopWatch::all_follow) {
            self.begun = Some(at);
            listener.begun(at);
        }
        if let Some(begun) = self.begun {
            self.inject(at.since(begun), network, listener);
        }
        let tick = at.tick();
        if tick.is_multiple_of(STEP_TICKS)
            && let (Some(world), Some(simulation)) = (self.world(network), &self.simulation)
        {
            listener.step(tick / STEP_TICKS, &world, simulation);
        }
        Ok(())
    }

    /// Without a world: each motor stands where its drive wants it, at once.
    fn turn_freely(&self, network: &mut Network<Terminal>) {
        for coupling in &self.arms {
            coupling.turn_freely(network);
        }
    }

    /// A millisecond of what the motors turn.
    ///
    /// Drives to plant, a step of the plant, plant to drives: what a drive measures is a
    /// millisecond behind what it wants.
    fn turn_motors(
        &mut self,
        at: TimeNs,
        network: &mut Network<Terminal>,
    ) -> Result<(), SessionError> {
        let Some(simulation) = &mut self.simulation else {
            self.turn_freely(network);
            return Ok(());
        };
        for (index, coupling) in self.arms.iter().enumerate() {
            let setpoint = coupling.setpoint(network);
            if let Some(mut arm) = simulation.arm(index) {
                arm.lead(&setpoint);
            }
        }
        if self.begun.is_some() {
            simulation.step();
        } else {
            simulation.wait();
        }
        feed_back(&self.arms, simulation, at, network)
    }

    /// What the world knows of itself, if there is one.
    pub(super) fn world(&self, network: &Network<Terminal>) -> Option<WorldState> {
        let simulation = self.simulation.as_ref()?;
        let mut axes = self.arms.iter().flat_map(|arm| &arm.plan().axes);
        let operational = axes.all(|axis| {
            let state = network.node(axis.node).map(Node::nmt_state);
            state == Some(NmtState::Operational)
        });
        let begun = self.begun.is_some();
        Some(WorldState::of(simulation, operational, begun))
    }

    /// Lines that go bus-off are collected first and reported after, since the injector's other
    /// callback borrows the listener.
    fn inject(
        &mut self,
        since_ns: u64,
        network: &mut Network<Terminal>,
        listener: &mut dyn Listener,
    ) {
        let Self { arms, injector, .. } = self;
        let mut off = Vec::new();
        let mut outside = |what, network: &mut Network<Terminal>| match what {
            Outside::Slack(node, slack) => set_slack(arms, node, slack),
            Outside::BusOff(node) => off.extend(network.line_of(node)),
            Outside::ForeignMaster(node) => send_sync(arms, node, network),
        };
        injector.turn(since_ns, network, &mut outside, &mut |place| {
            listener.injected(place);
        });
        for line in off {
            listener.bus_off(line);
        }
    }

    /// The drives and their buses as they are, but for what the bench does not know of them.
    ///
    /// Loss and stalls are left at 0 for the bus thread to fill in.
    pub(super) fn seen(&self, network: &mut Network<Terminal>, lines: u8) -> Seen {
        let plans = self.arms.iter().map(Coupling::plan);
        Seen {
            begun: self.begun,
            ..Seen::look(network, plans, lines)
        }
    }

    /// How busy each line has been, ns and frames.
    ///
    /// From the start, one entry a line.
    pub(super) fn busy(network: &Network<Terminal>, lines: u8) -> Vec<(u64, u64)> {
        (0..lines).map(|line| network.wire(line).busy()).collect()
    }
}

/// Gives the drives the feedback of their arms.
fn feed_back(
    arms: &[Coupling],
    simulation: &mut Simulation,
    at: TimeNs,
    network: &mut Network<Terminal>,
) -> Result<(), SessionError> {
    for (index, coupling) in arms.iter().enumerate() {
        if let Some(mut arm) = simulation.arm(index) {
            coupling.feed_back(&arm.read(at)?, network);
        }
    }
    Ok(())
}

/// Slackens the axis that `node` turns, or tightens it.
fn set_slack(arms: &mut [Coupling], node: NodeId, slack: bool) {
    for arm in arms {
        let axis = arm.plan().axes.iter().position(|axis| axis.node == node);
        if let Some(axis) = axis {
            arm.set_slack(axis, slack);
        }
    }
}

/// Sends the SYNC of the arm that `node` belongs to, as a second master does.
fn send_sync(arms: &[Coupling], node: NodeId, network: &mut Network<Terminal>) {
    let has_node = |arm: &&Coupling| arm.plan().axes.iter().any(|axis| axis.node == node);
    let (arm, line) = (arms.iter().find(has_node), network.line_of(node));
    if let (Some(arm), Some(line)) = (arm, line) {
        let sync = Frame::new(arm.plan().sync_id, Payload::EMPTY);
        network.intrude(line, sync);
    }
}
