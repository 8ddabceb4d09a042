//! The set-point of each drive in a cycle. Hot path: bounded, no allocation, no I/O, no lock.

use super::{Cycle, Goal, SILENT_AFTER};
use crate::cia301::Cob;
use crate::cia301::cob::PdoNumber;
use crate::cia402::{Command, Control, PowerState};
use crate::{Frame, Outbox, Payload};
use hal::TimeNs;
use hal::tail::TAIL_AXES;

/// How long after a fault the drives hold before they lose their voltage, ns.
pub(in super::super) const HOLD_NS: u64 = 500_000_000;

/// How much it matters that a set-point is sent, after a fault; from what matters most.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Urgency {
    /// Its drive still follows.
    Follows,
    /// Its drive has torque only to stop.
    Brakes,
    /// Its drive has no torque.
    Free,
    /// Nothing has come from its node for so long that nothing is known of its drive.
    Unheard,
}

impl Cycle {
    /// The set-points for the drives on `line`, in the order of the axes. After a fault those that
    /// stop a drive that still follows come first, and of these the ones that found room least
    /// often: what a drive makes of a stop is heard a cycle after it was sent, and until then the
    /// others go before. Then come those for drives that brake, and last those for drives of which
    /// nothing is heard: a queue with little room takes only the first ones.
    pub fn commands(&mut self, now: TimeNs, line: u8, out: &mut Outbox) {
        let together = self.together();
        let mut order: [usize; TAIL_AXES] = core::array::from_fn(|n| n);
        order.sort_unstable_by_key(|&n| {
            let urgency = self.urgency(n);
            let follows = urgency == Urgency::Follows;
            let stops = if follows { self.axes[n].stops_sent } else { 0 };
            (urgency, stops, n)
        });
        for n in order {
            if self.plan.axes[n].line == line {
                out.push(self.set_point(n, now, together));
            }
        }
    }

    fn urgency(&self, n: usize) -> Urgency {
        let state = self.axes[n].newest.map(|newest| newest.status.state);
        match state {
            _ if self.fault.is_none() => Urgency::Follows,
            _ if self.axes[n].silent() >= SILENT_AFTER => Urgency::Unheard,
            Some(PowerState::OperationEnabled) => Urgency::Follows,
            Some(state) if state.has_torque() => Urgency::Brakes,
            Some(_) | None => Urgency::Free,
        }
    }

    fn set_point(&mut self, n: usize, now: TimeNs, together: bool) -> Frame {
        let command = self.command_for(n, now, together);
        let axis = &mut self.axes[n];
        let newest = axis.newest;
        let follows =
            newest.is_some_and(|newest| newest.status.state == PowerState::OperationEnabled);
        // Where a drive that does not follow yet is must be where it starts to.
        if let Some(newest) = newest.filter(|_| !follows) {
            axis.target = newest.position;
        }
        let [a, b] = Control::new(command).emit().to_le_bytes();
        let [c, d, e, f] = axis.target.to_le_bytes();
        let id = Cob::ReceivePdo(PdoNumber::FIRST, self.plan.axes[n].node).id();
        Frame::new(id, Payload::truncated(&[a, b, c, d, e, f]))
    }

    /// Whether all drives are ready to be enabled in the same cycle.
    fn together(&self) -> bool {
        self.states().iter().all(|state| {
            matches!(
                state,
                Some(PowerState::SwitchedOn | PowerState::OperationEnabled)
            )
        })
    }

    fn command_for(&self, axis: usize, now: TimeNs, together: bool) -> Command {
        let Some(newest) = self.axes[axis].newest else {
            return Command::DisableVoltage;
        };
        let state = newest.status.state;
        if let Some((_, since)) = self.fault {
            return if now.since(since) < HOLD_NS && state.has_torque() {
                Command::QuickStop
            } else {
                Command::DisableVoltage
            };
        }
        match self.goal {
            Goal::Disabled
                if state == PowerState::SwitchedOn
                    && self.axes[axis].brakes(now, self.plan.brake_ns) =>
            {
                Command::SwitchOn
            }
            Goal::Disabled => state.towards_disabled(),
            Goal::Enabled => match state.towards_enabled() {
                Some(Command::EnableOperation) if !together => Command::SwitchOn,
                Some(command) => command,
                None => Command::DisableVoltage,
            },
        }
    }
}
