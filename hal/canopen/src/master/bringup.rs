//! The way from silent buses to an enabled arm, a type a step: each has only the next one.
//!
//! [`Offline::scan`] → [`Scanned::check_identity`] → [`Identified::map`] → [`Mapped::home`] →
//! [`Homed::enable`] → [`CanArm`]. Whatever goes wrong ends the bring-up with the node and the
//! cause; nothing is retried.

mod check;
pub mod client;
mod configure;
mod enable;
mod error;
pub(super) mod exchange;
mod homing;
mod settings;
mod step;
mod timed;
mod watched;
mod writer;

use std::sync::mpsc::Sender;

use super::arm::CanArm;
use super::foreign::leads;
use super::link::Bus;
use super::plan::{ArmPlan, AxisNode};
use crate::Frame;
use crate::cia301::{Cob, NmtCommand, NmtState, NmtTarget};
use crate::cia402::Mode;
use crate::index;
use hal::tail::TAIL_AXES;

pub use enable::{Permission, enable_together};
pub use error::BringUpError;
pub use step::Step;

use exchange::Exchange;
use timed::{expect, send};
use watched::MonitoredBuses;

/// How long a node may take to boot up, ns.
const BOOT_NS: u64 = 2_000_000_000;
/// How long the bus is listened to before the first word, ns.
const LISTEN_NS: u64 = 30_000_000;
/// All axes.
const ALL: [usize; TAIL_AXES] = [0, 1, 2, 3, 4, 5, 6];
/// Device profile 402, in the lower half of 1000h.
const PROFILE_402: u32 = 402;

/// Buses, and nothing known about them.
#[derive(Debug)]
pub struct Offline<B> {
    bus: MonitoredBuses<B>,
    plan: ArmPlan,
}

/// Every node of the plan is there, in pre-operational, as after power-on.
#[derive(Debug)]
pub struct Scanned<B> {
    bus: MonitoredBuses<B>,
    plan: ArmPlan,
}

/// Every node is what the plan says.
#[derive(Debug)]
pub struct Identified<B> {
    bus: MonitoredBuses<B>,
    plan: ArmPlan,
    /// Serial numbers in the order of the axes.
    serials: [u32; TAIL_AXES],
}

/// Process data, watches and modes are set and read back.
#[derive(Debug)]
pub struct Mapped<B> {
    bus: MonitoredBuses<B>,
    plan: ArmPlan,
}

/// Every axis has its reference; no torque.
#[derive(Debug)]
pub struct Homed<B> {
    bus: MonitoredBuses<B>,
    plan: ArmPlan,
    /// The home offset that each drive was given, counts; none if it has no such object.
    homes: homing::Homes,
}

impl<B: Bus> Offline<B> {
    /// An arm on `bus`.
    ///
    /// # Errors
    /// [`BringUpError::Overload`] if a bus cannot carry its part of the plan; nothing has been said
    /// then.
    pub fn new(bus: B, plan: &ArmPlan) -> Result<Self, BringUpError> {
        plan.check_load()?;
        Ok(Self {
            bus: MonitoredBuses::new(bus, plan),
            plan: *plan,
        })
    }

    /// Tells `steps` what bring-up is at, from setting up the first node on until all is done but
    /// the SYNC: a slow bus takes its time.
    #[must_use]
    pub fn telling(mut self, steps: Sender<Step>) -> Self {
        self.bus.steps = Some(steps);
        self
    }

    /// Asks `cancelled`, while an axis moves to its home position, whether it is to stop: homing
    /// then ends with [`BringUpError::Cancelled`], by a quick stop.
    #[must_use]
    pub fn cancelled_by(mut self, cancelled: fn() -> bool) -> Self {
        self.bus.cancelled = Some(cancelled);
        self
    }

    /// Listens for another master, then resets every node of the plan and waits for it to boot up.
    ///
    /// # Errors
    /// [`BringUpError`]; a node that is missing is named, and so is what another master said, which
    /// is listened for in all that follows, too.
    pub fn scan(mut self) -> Result<Scanned<B>, BringUpError> {
        let plan = self.plan;
        let before = self.bus.catch_up();
        self.bus.judge(before)?;
        for line in 0..plan.lines {
            let answer = expect(&mut self.bus, line, LISTEN_NS, |frame| {
                leads(&plan, line, frame).then_some(())
            });
            self.bus.judge(answer)?;
        }
        // A node that boots up by itself before has not answered to our reset.
        self.bus.drain()?;
        let reset = async |exchange: &Exchange<'_, _>, axis| reset(exchange, plan.who(axis)).await;
        self.bus.side_by_side(&plan, &ALL, reset)?;
        let Self { bus, plan } = self;
        Ok(Scanned { bus, plan })
    }
}

async fn reset<B: Bus>(exchange: &Exchange<'_, B>, who: AxisNode) -> Result<(), BringUpError> {
    let reset = NmtCommand::ResetNode.emit(NmtTarget::Node(who.node));
    exchange.send(who.line, reset).await?;
    let boots = |frame: &Frame| {
        let boots = frame.id == Cob::Heartbeat(who.node).id()
            && NmtState::parse(frame.data()) == Ok(NmtState::BootUp);
        boots.then_some(())
    };
    let booted = exchange.expect(who.line, BOOT_NS, boots).await?;
    booted.ok_or(BringUpError::Missing(who))
}

impl<B: Bus> Scanned<B> {
    /// The buses.
    pub const fn bus_mut(&mut self) -> &mut B {
        &mut self.bus.bus
    }

    /// Compares device type, vendor, product and modes of every node with the plan.
    ///
    /// # Errors
    /// [`BringUpError::Identity`] or [`BringUpError::Mode`] for the first that differs.
    pub fn check_identity(mut self) -> Result<Identified<B>, BringUpError> {
        let plan = self.plan;
        let identify =
            async |exchange: &Exchange<'_, _>, axis| identify(exchange, &plan, axis).await;
        let identified = self.bus.side_by_side(&plan, &ALL, identify)?;
        let mut serials = [0; TAIL_AXES];
        serials.copy_from_slice(&identified);
        let Self { bus, plan } = self;
        Ok(Identified { bus, plan, serials })
    }
}

/// The serial number of the drive of `axis`, if it is what the plan says.
async fn identify<B: Bus>(
    exchange: &Exchange<'_, B>,
    plan: &ArmPlan,
    axis: usize,
) -> Result<u32, BringUpError> {
    let who = plan.who(axis);
    let read = |address| exchange.read_number(who.line, who.node, address);
    let (vendor, product) = plan.axes[axis].identity;
    for (address, expected, found) in [
        (
            index::DEVICE_TYPE,
            PROFILE_402,
            read(index::DEVICE_TYPE).await? & 0xFFFF,
        ),
        (index::VENDOR, vendor, read(index::VENDOR).await?),
        (index::PRODUCT, product, read(index::PRODUCT).await?),
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
    let modes = read(index::SUPPORTED_MODES).await?;
    for mode in [Mode::CyclicPosition, Mode::Homing] {
        if modes & mode.supported_bit() == 0 {
            return Err(BringUpError::Mode { who, mode });
        }
    }
    read(index::SERIAL).await
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
        let plan = self.plan;
        self.bus.enter(Step::SettingUp)?;
        let set_up = async |exchange: &Exchange<'_, MonitoredBuses<B>>, axis| {
            configure::node(exchange, &plan, axis).await?;
            exchange.with_bus(|bus| bus.note_set_up(axis));
            Ok(())
        };
        self.bus.side_by_side(&plan, &ALL, set_up)?;
        let Self { bus, plan, .. } = self;
        Ok(Mapped { bus, plan })
    }
}

impl<B: Bus> Mapped<B> {
    /// Gives every axis its reference: where its absolute encoder says that it is, or where the
    /// homing sequence of its drive finds it.
    ///
    /// Drives are enabled for it and let go again. No axis moves but those that the plan has a
    /// homing sequence for.
    ///
    /// # Errors
    /// [`BringUpError::Homing`], [`BringUpError::HomingError`] or [`BringUpError::HomingTimeOut`]
    /// with the node.
    pub fn home(mut self) -> Result<Homed<B>, BringUpError> {
        let homes = homing::home_all(&mut self.bus, &self.plan)?;
        self.bus.enter(Step::Waiting)?;
        let Self { bus, plan } = self;
        Ok(Homed { bus, plan, homes })
    }
}

impl<B: Bus> Homed<B> {
    /// The buses.
    pub const fn bus_mut(&mut self) -> &mut B {
        &mut self.bus.bus
    }

    /// Hears what has come: to be called all the time while another arm on the same bus is brought
    /// up, of whose frames a socket keeps a few hundred and drops the rest, those of this arm's
    /// nodes with them.
    ///
    /// # Errors
    /// What may not have happened to an arm that waits: another master, a node that booted up again
    /// or sent an emergency. All nodes of this arm are stopped then.
    pub fn listen(&mut self) -> Result<(), BringUpError> {
        self.bus.drain()
    }

    /// Asks every drive once more, starts the SYNC, and enables all drives in the same cycle, each
    /// where it is.
    ///
    /// # Errors
    /// [`BringUpError::Unsound`] or [`BringUpError::Forgotten`] for a drive that is no more as it
    /// was set up, [`BringUpError::Fault`] if one fails meanwhile; it and the others then have no
    /// torque.
    ///
    /// # Panics
    /// Never: one arm comes of one.
    pub fn enable(self) -> Result<CanArm<B>, BringUpError> {
        let arms = enable_together(vec![self], &mut || Permission::Granted);
        let mut arms = arms.map_err(|(_, error)| error)?;
        assert_eq!(arms.len(), 1, "an arm each");
        Ok(arms.remove(0))
    }

    /// Asks every node whether it is still as it was set up.
    fn check(&mut self) -> Result<(), BringUpError> {
        let Self { bus, plan, homes } = self;
        let check = async |exchange: &Exchange<'_, _>, axis: usize| {
            check::node(exchange, plan, axis, homes[axis]).await
        };
        bus.side_by_side(plan, &ALL, check).map(|_| ())
    }

    fn start(&mut self) -> Result<(), BringUpError> {
        self.bus.drain()?;
        for axis in 0..TAIL_AXES {
            let who = self.plan.who(axis);
            let start = NmtCommand::Start.emit(NmtTarget::Node(who.node));
            send(&mut self.bus, who.line, start)?;
        }
        // What came while there was no room.
        self.bus.judge(Ok(()))
    }
}
