//! Drives on CAN, paced by the clock. Hot path: bounded, no allocation, no lock; its system calls
//! are the arms' sockets.

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
    pub(crate) arms: PerArm<BusArm>,
    noticed: MailboxWriter<Noticed>,
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
    pub(crate) fn fault_texts(&self) -> Vec<String> {
        let named = self.arms.iter().zip(ARM_NAMES);
        named
            .filter_map(|(arm, name)| arm.fault().map(|fault| format!("{name}: {fault}")))
            .collect()
    }

    /// Takes all drives down through the states of CiA 402, all arms at once, and stops their
    /// nodes.
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
