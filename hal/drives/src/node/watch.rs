//! What a node does by the clock: its own heartbeat, and the watch over those that lead it.
//!
//! CiA 301: 1016h and 1017h (heartbeats), 1400h:05 (deadline of an RPDO), 1029h (error behaviour).
//! The watch over the SYNC is the vendor's: after 2000h periods without one the axis stops.

use super::alarm::Alarm;
use super::{Node, Outbox};
use crate::dictionary::Dictionary;
use crate::dictionary::table::CONSUMER_COUNT;
use hal::TimeNs;
use trocar_canopen::NodeId;
use trocar_canopen::cia301::{Address, NmtState};
use trocar_canopen::index;

/// A millisecond, ns.
const MS: u64 = 1_000_000;

/// Last signs of life.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Watches {
    /// None with 1017h at 0.
    heartbeat_due: Option<TimeNs>,
    /// By entry of 1016h. None until the node was heard: CiA 301 starts the time with the first
    /// heartbeat.
    last_heartbeat: [Option<TimeNs>; CONSUMER_COUNT as usize],
    /// The time-out was acted on, which happens once until the node is heard again.
    silent: [bool; CONSUMER_COUNT as usize],
    /// None until the first SYNC in this NMT state, before which none can be lost.
    sync: Option<TimeNs>,
}

impl Watches {
    /// The own heartbeat's next time.
    pub(super) fn schedule_heartbeat(&mut self, now: TimeNs, dictionary: &Dictionary) {
        let period_ns = milliseconds(dictionary.get_as(index::HEARTBEAT));
        self.heartbeat_due = (period_ns > 0).then(|| now.plus_ns(period_ns));
    }

    /// The newest SYNC since the watch over it began.
    pub(super) const fn newest_sync(&self) -> Option<TimeNs> {
        self.sync
    }

    /// A SYNC came.
    pub(super) fn on_sync(&mut self, now: TimeNs) {
        self.sync = Some(now);
    }

    /// Watches over the SYNC begin anew.
    pub(super) fn restart(&mut self) {
        self.sync = None;
    }

    /// Watches over heartbeats begin anew.
    pub(super) fn forget_heartbeats(&mut self) {
        self.last_heartbeat = Default::default();
        self.silent = Default::default();
    }
}

/// A value in ms as ns.
const fn milliseconds(value: u64) -> u64 {
    value * MS
}

/// Node and time of an entry of 1016h; none if it is not in use.
///
/// Bits 16 to 23 are the node, bits 0 to 15 the time in ms; ns here.
pub(super) fn consumer(raw: i64) -> Option<(NodeId, u64)> {
    let [low, high, node, _] = u32::try_from(raw).ok()?.to_le_bytes();
    let time_ns = u64::from(u16::from_le_bytes([low, high])) * MS;
    NodeId::new(node)
        .filter(|_| time_ns > 0)
        .map(|node| (node, time_ns))
}

/// The entry `n`, from 0, of the heartbeat consumers.
fn watched(n: u8) -> Address {
    Address::new(0x1016, n + 1)
}

impl Node {
    /// Sends the heartbeat when its period (1017h) is over.
    pub(super) fn heartbeat_if_due(&mut self, now: TimeNs, out: &mut Outbox) {
        if self.watches.heartbeat_due.is_some_and(|due| now >= due) {
            out.push(self.state.emit(self.id));
            self.watches.schedule_heartbeat(now, &self.dictionary);
        }
    }

    /// A heartbeat restarts the consumer times (1016h) of its node.
    pub(super) fn on_heartbeat(&mut self, now: TimeNs, node: NodeId, data: &[u8]) {
        if NmtState::parse(data).is_err() {
            return;
        }
        for n in 0..CONSUMER_COUNT {
            let entry = consumer(self.dictionary.get(watched(n)));
            if entry.is_some_and(|(watched, _)| watched == node) {
                self.watches.last_heartbeat[usize::from(n)] = Some(now);
                self.watches.silent[usize::from(n)] = false;
            }
        }
    }

    /// Checks the heartbeat consumer times.
    pub(super) fn watch(&mut self, now: TimeNs, out: &mut Outbox) {
        self.watch_heartbeats(now, out);
        if self.state == NmtState::Operational {
            self.watch_sync(now, out);
            self.watch_rpdos(now, out);
        }
    }

    /// A consumer time that has run out: emergency 8130h, and the reaction of 6007h and 1029h.
    fn watch_heartbeats(&mut self, now: TimeNs, out: &mut Outbox) {
        for n in 0..CONSUMER_COUNT {
            let place = usize::from(n);
            let (Some((_, time_ns)), Some(last_heartbeat)) = (
                consumer(self.dictionary.get(watched(n))),
                self.watches.last_heartbeat[place],
            ) else {
                continue;
            };
            if !self.watches.silent[place] && now.since(last_heartbeat) > time_ns {
                self.watches.silent[place] = true;
                self.alarm(now, Alarm::Heartbeat, out);
                self.lose_connection(now);
                self.communication_error(now);
            }
        }
        if !self.watches.silent.contains(&true) {
            self.resolve(now, Alarm::Heartbeat, out);
        }
    }

    /// The NMT state that 1029h asks for.
    ///
    /// 1029h:01: 0 pre-operational if it was operational, 1 no change, 2 stopped.
    fn communication_error(&mut self, now: TimeNs) {
        let operational = self.state == NmtState::Operational;
        match self.dictionary.get(index::ERROR_BEHAVIOUR) {
            0 if operational => self.enter(now, NmtState::PreOperational),
            2 => self.enter(now, NmtState::Stopped),
            _ => {}
        }
    }

    /// In a cyclic mode too many periods without a SYNC are a fault.
    fn watch_sync(&mut self, now: TimeNs, out: &mut Outbox) {
        let Some(last) = self.watches.sync.filter(|_| self.drive.follows_sync()) else {
            return;
        };
        let periods: u64 = self.dictionary.get_as(index::SYNC_LOSS);
        let period_ns = super::drive::interpolation_ns(&self.dictionary);
        if now.since(last) > periods * period_ns {
            self.alarm(now, Alarm::SyncLoss, out);
            self.lose_connection(now);
        }
    }

    /// The event timer of an RPDO (sub-index 5) is the deadline of its set-points.
    fn watch_rpdos(&mut self, now: TimeNs, out: &mut Outbox) {
        let mut overdue = false;
        for n in 0..4_u8 {
            let deadline_ns = milliseconds(self.dictionary.get_as(index::rpdo(n, 5)));
            let last = self.receive[usize::from(n)].last;
            overdue |= deadline_ns > 0 && last.is_some_and(|last| now.since(last) > deadline_ns);
        }
        if overdue {
            if !self.alarms.is_active(Alarm::RpdoTimeout) {
                self.alarm(now, Alarm::RpdoTimeout, out);
                self.lose_connection(now);
            }
        } else {
            self.resolve(now, Alarm::RpdoTimeout, out);
        }
    }
}
