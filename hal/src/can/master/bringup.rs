//! The way from silent buses to an enabled arm, a type a step: each has only the next one.
//!
//! [`Offline::scan`] → [`Scanned::check_identity`] → [`Identified::map`] → [`Mapped::home`] → [`Homed::enable`] →
//! [`CanArm`]. Whatever goes wrong ends the bring-up with the node and the cause; nothing is retried.

mod configure;
mod error;
mod homing;
mod settings;

use super::arm::CanArm;
use super::client::{expect, read_number, send};
use super::cycle::{Cycle, Goal};
use super::link::Bus;
use super::plan::ArmPlan;
use crate::TimeNs;
use crate::can::cia301::{Cob, NmtCommand, NmtState, NmtTarget};
use crate::can::cia402::Mode;
use crate::can::od::index;
use crate::tail::TAIL_AXES;

pub use error::BringUpError;

/// How long a node may take to boot up, ns.
const BOOT_NS: u64 = 2_000_000_000;
/// How long the bus is listened to before the first word, ns.
const LISTEN_NS: u64 = 30_000_000;
/// How long the drives may take to be enabled, ns.
const ENABLE_NS: u64 = 3_000_000_000;
/// How long the last words of bring-up may take on the bus, ns.
const SETTLE_NS: u64 = 10_000_000;
/// Device profile 402, in the lower half of 1000h.
const PROFILE_402: u32 = 402;

/// Buses, and nothing known about them.
#[derive(Debug)]
pub struct Offline<B> {
    bus: B,
    plan: ArmPlan,
}

/// Every node of the plan is there, in pre-operational, as after power-on.
#[derive(Debug)]
pub struct Scanned<B> {
    bus: B,
    plan: ArmPlan,
}

/// Every node is what the plan says.
#[derive(Debug)]
pub struct Identified<B> {
    bus: B,
    plan: ArmPlan,
    /// Serial numbers in the order of the axes.
    serials: [u32; TAIL_AXES],
}

/// Process data, watches and modes are set and read back.
#[derive(Debug)]
pub struct Mapped<B> {
    bus: B,
    plan: ArmPlan,
}

/// Every axis has its reference; no torque.
#[derive(Debug)]
pub struct Homed<B> {
    bus: B,
    plan: ArmPlan,
}

impl<B: Bus> Offline<B> {
    /// An arm on `bus`.
    ///
    /// # Errors
    /// [`BringUpError::Overload`] if a bus cannot carry its part of the plan; nothing has been said then.
    pub fn new(bus: B, plan: &ArmPlan) -> Result<Self, BringUpError> {
        plan.check_load()?;
        Ok(Self { bus, plan: *plan })
    }

    /// Listens for another master, then resets every node of the plan and waits for it to boot up.
    ///
    /// # Errors
    /// [`BringUpError`]; a node that is missing is named.
    pub fn scan(mut self) -> Result<Scanned<B>, BringUpError> {
        let plan = self.plan;
        for line in 0..plan.lines {
            let heard = expect(&mut self.bus, line, LISTEN_NS, |frame| {
                let ours = match Cob::of(frame.id) {
                    Cob::ReceivePdo(_, node) => plan.axis_of(line, node).is_some(),
                    Cob::Heartbeat(node) => node == plan.master,
                    Cob::Nmt
                    | Cob::Sync
                    | Cob::Time
                    | Cob::Emergency(_)
                    | Cob::TransmitPdo(..)
                    | Cob::SdoResponse(_)
                    | Cob::SdoRequest(_)
                    | Cob::Other(_) => false,
                };
                (ours || frame.id == plan.sync_id).then_some(*frame)
            })?;
            if let Some(frame) = heard {
                return Err(BringUpError::ForeignMaster { line, frame });
            }
        }
        for axis in 0..TAIL_AXES {
            let who = plan.who(axis);
            let reset = NmtCommand::ResetNode.emit(NmtTarget::Node(who.node));
            send(&mut self.bus, who.line, reset)?;
            let booted = expect(&mut self.bus, who.line, BOOT_NS, |frame| {
                let boots = frame.id == Cob::Heartbeat(who.node).id()
                    && NmtState::parse(frame.data()) == Ok(NmtState::BootUp);
                boots.then_some(())
            })?;
            booted.ok_or(BringUpError::Missing(who))?;
        }
        let Self { bus, plan } = self;
        Ok(Scanned { bus, plan })
    }
}

impl<B: Bus> Scanned<B> {
    /// The buses.
    pub const fn bus_mut(&mut self) -> &mut B {
        &mut self.bus
    }

    /// Compares device type, vendor, product and modes of every node with the plan.
    ///
    /// # Errors
    /// [`BringUpError::Identity`] or [`BringUpError::Mode`] for the first that differs.
    pub fn check_identity(mut self) -> Result<Identified<B>, BringUpError> {
        let mut serials = [0; TAIL_AXES];
        for (axis, serial) in serials.iter_mut().enumerate() {
            let who = self.plan.who(axis);
            let bus = &mut self.bus;
            let mut read = |address| read_number(bus, who.line, who.node, address);
            let (vendor, product) = self.plan.axes[axis].identity;
            for (address, expected, found) in [
                (
                    index::DEVICE_TYPE,
                    PROFILE_402,
                    read(index::DEVICE_TYPE)? & 0xFFFF,
                ),
                (index::VENDOR, vendor, read(index::VENDOR)?),
                (index::PRODUCT, product, read(index::PRODUCT)?),
            ] {
                if found != expected {
                    return Err(BringUpError::Identity {
                        who,
                        address,
                        expected,
                        found,
                    });
                }
            }
            let modes = read(index::SUPPORTED_MODES)?;
            for mode in [Mode::CyclicPosition, Mode::Homing] {
                if modes & mode.supported_bit() == 0 {
                    return Err(BringUpError::Mode { who, mode });
                }
            }
            *serial = read(index::SERIAL)?;
        }
        let Self { bus, plan } = self;
        Ok(Identified { bus, plan, serials })
    }
}

impl<B: Bus> Identified<B> {
    /// Serial numbers of the drives, in the order of the axes.
    #[must_use]
    pub const fn serials(&self) -> &[u32; TAIL_AXES] {
        &self.serials
    }

    /// Sets process data, watches and reactions of every node, and reads them back.
    ///
    /// # Errors
    /// [`BringUpError`] with the node and the object.
    pub fn map(mut self) -> Result<Mapped<B>, BringUpError> {
        for axis in 0..TAIL_AXES {
            configure::node(&mut self.bus, &self.plan, axis)?;
        }
        let Self { bus, plan, .. } = self;
        Ok(Mapped { bus, plan })
    }
}

impl<B: Bus> Mapped<B> {
    /// Gives every axis its reference: where its absolute encoder says that it is.
    ///
    /// Axis after axis is enabled for it and let go again. No axis moves.
    ///
    /// # Errors
    /// [`BringUpError::Homing`] with the node.
    pub fn home(mut self) -> Result<Homed<B>, BringUpError> {
        for axis in 0..TAIL_AXES {
            homing::home(&mut self.bus, &self.plan, axis)?;
        }
        let Self { bus, plan } = self;
        Ok(Homed { bus, plan })
    }
}

impl<B: Bus> Homed<B> {
    /// The buses.
    pub const fn bus_mut(&mut self) -> &mut B {
        &mut self.bus
    }

    /// Starts the beat and enables all drives in the same cycle, each where it is.
    ///
    /// # Errors
    /// [`BringUpError::Fault`] if a drive fails meanwhile; it and the others then have no torque.
    pub fn enable(self) -> Result<CanArm<B>, BringUpError> {
        let mut arms = enable_together(vec![self]).map_err(|(_, error)| error)?;
        arms.pop().ok_or(BringUpError::Slow)
    }

    fn start(&mut self) -> Result<(), BringUpError> {
        for axis in 0..TAIL_AXES {
            let who = self.plan.who(axis);
            let start = NmtCommand::Start.emit(NmtTarget::Node(who.node));
            send(&mut self.bus, who.line, start)?;
        }
        Ok(())
    }
}

/// Starts the beats of several arms and enables all their drives, so that no arm waits without a beat for another one.
///
/// # Errors
/// As [`Homed::enable`], with the place of the arm that failed; no drive of any arm has torque then.
pub fn enable_together<B: Bus>(
    mut homed: Vec<Homed<B>>,
) -> Result<Vec<CanArm<B>>, (usize, BringUpError)> {
    for (place, arm) in homed.iter_mut().enumerate() {
        arm.start().map_err(|error| (place, error))?;
    }
    let Some(first) = homed.first_mut() else {
        return Ok(Vec::new());
    };
    // Heartbeats from before are not what the cycle should judge by.
    let start = first.bus.now().plus_ns(SETTLE_NS);
    first.bus.wait(start);
    let begin = |Homed { mut bus, plan }: Homed<B>| {
        for line in 0..plan.lines {
            bus.receive(line, &mut |_| {});
        }
        let mut arm = CanArm::new(bus, &plan, Cycle::new(&plan, start));
        arm.set_goal(start, Goal::Enabled);
        arm
    };
    let mut arms: Vec<CanArm<B>> = homed.into_iter().map(begin).collect();
    match turn_until_enabled(&mut arms, start) {
        Ok(()) => Ok(arms),
        Err(failed) => {
            arms.iter_mut().for_each(CanArm::shut_down);
            Err(failed)
        }
    }
}

fn turn_until_enabled<B: Bus>(
    arms: &mut [CanArm<B>],
    start: TimeNs,
) -> Result<(), (usize, BringUpError)> {
    let cycle_ns = arms.iter().map(CanArm::cycle_ns).max().unwrap_or(1);
    let mut at = start;
    while let Some(slow) = arms.iter().position(|arm| !arm.is_enabled()) {
        if at.since(start) > ENABLE_NS {
            return Err((slow, BringUpError::Slow));
        }
        at = at.plus_ns(cycle_ns);
        if let Some(first) = arms.first_mut() {
            first.bus_mut().wait(at);
            // Beats that a late process has missed are not made up for: nobody could answer them.
            at = at.max(first.bus_mut().now());
        }
        for (place, arm) in arms.iter_mut().enumerate() {
            arm.turn(at);
            if let Some(fault) = arm.fault() {
                return Err((place, BringUpError::Fault(fault)));
            }
        }
    }
    Ok(())
}
