//! The beginning of a period: SYNC, heartbeat, NMT stop, and what of it was handed to the buses.
//! Hot path: bounded, no allocation, no I/O, no lock.

use super::{Axis, Cycle, SILENT_AFTER};
use crate::cia301::nmt::NmtView;
use crate::cia301::sync::Sync;
use crate::cia301::{Cob, NmtCommand, NmtState, NmtTarget};
use crate::{Frame, Outbox};
use hal::TimeNs;
use hal::tail::TAIL_AXES;

impl Cycle {
    /// Begins the period at `now`: with a SYNC, which puts the set-points that were sent into
    /// effect, or as a pause.
    pub fn begin(&mut self, now: TimeNs) {
        self.began = Some(now);
        self.time_heartbeat(now);
        if core::mem::take(&mut self.pause) {
            self.pauses += 1;
            self.left_out += 1;
            return;
        }
        self.pauses = 0;
        self.sync = Some(now);
        for (axis, applied) in self.axes.iter_mut().zip(&mut self.applied) {
            axis.followed = *applied;
            *applied = axis.sent;
        }
        self.counter = if self.counter >= self.plan.sync_counter {
            1
        } else {
            self.counter + 1
        };
    }

    /// Decides whether our own heartbeat goes out in the period at `now`.
    fn time_heartbeat(&mut self, now: TimeNs) {
        let period_ns = u64::from(self.plan.heartbeat_ms) * 1_000_000;
        self.alive = self
            .heartbeat
            .is_none_or(|then| now.since(then) >= period_ns);
        if self.alive {
            self.heartbeat = Some(now);
        }
    }

    /// The commands that stop nodes on `line`, in this period, where set-points do not stop their
    /// drives.
    ///
    /// Where a second master commands our drives, all of them: of two set-points before a SYNC the
    /// later one counts, so ours could not stop a drive that another node goes on to command; a
    /// stopped node hears none, and its drive does what 6007h says. (That holds for NMT stopped and
    /// not for pre-operational, see CiA 402-2.) After any other fault, those that hear no
    /// set-points or may not: a node that went pre-operational by itself keeps the torque of its
    /// drive for as long as it hears our heartbeat.
    ///
    /// They go after the SYNC, or a quick stop that is to come into effect with it would be lost,
    /// and before any set-points: on a bus that a stranger's SYNCs have filled with answers those
    /// wait, and so does all behind them. First come those that found room least often: another
    /// node may start a node again that we have stopped, so each is sent NMT stop in every cycle,
    /// and in a short queue the last ones would never be.
    pub fn stop_nodes(&self, line: u8, out: &mut Outbox) {
        let mut order: [usize; TAIL_AXES] = core::array::from_fn(|n| n);
        order.sort_unstable_by_key(|&n| (self.axes[n].nmt_stops_sent, n));
        for n in order {
            let plan = &self.plan.axes[n];
            let unheard = self.fault.is_some() && hears_no_set_points(&self.axes[n], n);
            if plan.line == line && (self.second_master || unheard) {
                out.push(NmtCommand::Stop.emit(NmtTarget::Node(plan.node)));
            }
        }
    }

    /// What begins this period, the same for every bus: SYNC unless it is a pause, and the own
    /// heartbeat if it is due. Where a second master commands our drives there is none: they miss
    /// it and stop, should they not hear [`Self::stop_nodes`].
    pub fn emit_sync(&self, out: &mut Outbox) {
        let sync = Sync::counted(self.counter)
            .filter(|_| self.plan.sync_counter != 0)
            .unwrap_or(Sync::PLAIN);
        if self.pauses == 0 {
            out.push(sync.emit(self.plan.sync_id));
        }
        if self.alive && !self.second_master {
            out.push(NmtState::Operational.emit(self.plan.master));
        }
    }

    /// SYNCs that were left out so far, to find out which ones the answers belong to.
    #[must_use]
    pub const fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Whether some frame for `line` found no room in the cycle that was judged last.
    #[must_use]
    pub fn is_transmit_queue_full(&self, line: u8) -> bool {
        let health = self.lines.get(usize::from(line));
        health.is_some_and(|health| health.unsent > 0)
    }

    /// Notes how many of `frames`, which were handed over for `line`, found room.
    pub fn on_sent(&mut self, line: u8, frames: &[Frame], count: usize) {
        if let Some(health) = self.lines.get_mut(usize::from(line)) {
            health.short |= count < frames.len();
        }
        let failed = self.fault.is_some();
        for frame in frames.iter().take(count) {
            let nmt = NmtView(frame.data()).target();
            let (node, stops_node) = match (Cob::of(frame.id), nmt) {
                (Cob::ReceivePdo(_, node), _) => (node, false),
                (Cob::Nmt, Ok(NmtTarget::Node(node))) => (node, true),
                _ => continue,
            };
            if let Some(axis) = self.plan.axis_of(line, node) {
                let axis = &mut self.axes[axis];
                if stops_node {
                    axis.nmt_stops_sent = axis.nmt_stops_sent.saturating_add(1);
                } else {
                    // Nothing changes it between its set-point and this.
                    axis.sent = axis.target;
                    axis.stops_sent = axis.stops_sent.saturating_add(u32::from(failed));
                }
            }
        }
    }
}

/// After how many cycles a node that sends nothing is sent NMT stop again: one without power never
/// answers, and in a queue with little room the quick stops of the others need the place. More than
/// there are axes, so that each has a cycle of its own.
const STOP_AGAIN: u32 = 8;

/// Whether the node of the axis at `place` is to be sent NMT stop: it hears no set-points, as it
/// says itself, or may not, since nothing usable has come from it for too long. One that says that
/// it is stopped has heard that already.
fn hears_no_set_points(axis: &Axis, place: usize) -> bool {
    match axis.nmt_state {
        Some(NmtState::PreOperational | NmtState::BootUp) => true,
        Some(NmtState::Stopped) => false,
        Some(NmtState::Operational) | None => {
            let since = axis.silent().checked_sub(SILENT_AFTER);
            since.is_some_and(|since| usize::try_from(since % STOP_AGAIN) == Ok(place))
        }
    }
}
