//! Drives on CAN, paced by the clock. Hot path: bounded, no allocation, no lock; its system calls
//! are the arms' sockets.
//!
//! The order of a period: set-points of the period before are put into the drives' PDOs and sent if
//! a SYNC is due, the thread sleeps until the next period, and what the drives answered is read. A
//! fault of an arm is an error of its measurement: the controller decides what follows.

use hal::{ARM_NAMES, Arm as _, PerArm, Period, Rig, Setpoint, TICK_NS, TimeNs};
use trocar_canopen::master::cycle::LINES_MAX;
use trocar_canopen::master::{CanArm, Fault};
use trocar_canopen::socket::SocketBus;

use super::can_clock::CanClock;
use crate::mailbox::MailboxWriter;
use crate::rt::{MonotonicClock, Periodic};

/// An arm of this machine's buses.
pub(crate) type BusArm = CanArm<SocketBus<CanClock>>;

/// The arms, and who else wants to know what happens to them.
pub(crate) struct CanRig {
    /// Each with buses and a cycle of its own; the controller's arm order.
    pub(crate) arms: PerArm<BusArm>,
    /// To the observing thread, which writes it into the log; written only when something has
    /// changed.
    noticed: MailboxWriter<Noticed>,
    /// What `noticed` was given last, to see a change.
    happened: PerArm<CanStatus>,
    /// Whether each arm's drives have all confirmed that they are without torque, when they were
    /// taken down.
    pub(crate) confirmed_down: PerArm<bool>,
    periodic: Periodic,
}

/// Faults and controller events of an arm so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct CanStatus {
    /// What stopped its drives.
    pub(crate) fault: Option<Fault>,
    /// How often our controller became error passive on each bus.
    pub(crate) passives: [u64; LINES_MAX],
}

/// The same of all arms, and when the newest of it was noticed.
pub(crate) type Noticed = (TimeNs, PerArm<CanStatus>);

impl CanRig {
    /// `periodic` gives the control period, on the clock of the buses.
    pub(crate) fn new(
        arms: PerArm<BusArm>,
        noticed: MailboxWriter<Noticed>,
        periodic: Periodic,
    ) -> Self {
        let happened = arms.as_ref().map(|_| CanStatus::default());
        Self {
            confirmed_down: arms.as_ref().map(|_| false),
            arms,
            noticed,
            happened,
            periodic,
        }
    }

    /// What has stopped each arm, if something did, in words and with the arm's name.
    ///
    /// Allocates: for the end of a run, after the loop.
    pub(crate) fn fault_texts(&self) -> Vec<String> {
        let named = self.arms.iter().zip(ARM_NAMES);
        named
            .filter_map(|(arm, name)| arm.fault().map(|fault| format!("{name}: {fault}")))
            .collect()
    }

    /// Takes all drives down through the states of CiA 402, all arms at once, and stops their
    /// nodes.
    ///
    /// Blocks for at most the longest [`CanArm::take_down_ns`] of all arms, with a grid of periods
    /// of its own on `clock`. A drive that is silent never confirms: then the time runs out, its
    /// arm's `confirmed_down` stays false, and its node is sent the stop all the same.
    pub(crate) fn take_down(&mut self, clock: MonotonicClock) {
        let first = clock.now().plus_ns(TICK_NS);
        let mut periodic = Periodic::new(clock, first, TICK_NS);
        loop {
            let now = periodic.wait().due;
            let mut all_down = true;
            // Each arm has its turn, whether the ones before it are down or not.
            for (arm, confirmed) in self.arms.iter_mut().zip(self.confirmed_down.iter_mut()) {
                all_down &= arm.take_down(now);
                *confirmed = arm.cycle().is_confirmed_down();
            }
            // A fault on the way takes longer.
            let longest_ns = self.arms.iter().map(CanArm::take_down_ns).max();
            if all_down || now.since(first) >= longest_ns.unwrap_or(0) {
                break;
            }
        }
        self.arms.iter_mut().for_each(CanArm::shut_down);
    }

    /// Compares faults and error counters with those of the period before; one mailbox write if
    /// they differ.
    fn notice(&mut self, now: TimeNs) {
        let happened = self.arms.as_ref().map(|arm| CanStatus {
            fault: arm.fault(),
            passives: arm.cycle().line_health().map(|health| health.passives),
        });
        if happened != self.happened {
            self.happened = happened;
            self.noticed.put((now, happened));
        }
    }
}

impl Rig for CanRig {
    /// Writes, waits, reads: one period of all arms. `setpoints` is none before the first answer of
    /// the controller, and then nothing is sent. The second arm's set-points are sent after the
    /// first's, and both before the thread sleeps.
    fn exchange(&mut self, setpoints: Option<&PerArm<Setpoint>>) -> Period {
        for (arm, (command, tail)) in self
            .arms
            .iter_mut()
            .zip(setpoints.into_iter().flat_map(PerArm::iter))
        {
            // A fault is told at the next reading too, and there the controller hears of it.
            let _told = arm.write(command, tail);
            arm.send_before(self.periodic.next());
        }
        let wake = self.periodic.wait();
        let PerArm { first, second } = &mut self.arms;
        let measured = PerArm {
            first: first.exchange(wake.due),
            second: second.as_mut().map(|arm| arm.exchange(wake.due)),
        };
        self.notice(wake.due);
        wake.period(Some(measured))
    }
}
