//! Process data: packing and unpacking by the mapping, and when a PDO is sent or takes effect.
//!
//! CiA 301, sections 7.2.2 (services) and 7.5.2.35 to 38 (1400h to 1BFFh).
//!
//! A value goes over the bus as its type's bytes, lowest first, one mapped object after the other.
//! Up to eight objects of whole bytes fit a PDO: the drive has no bit mapping.

use super::alarm::Alarm;
use super::{Node, Outbox};
use crate::dictionary::Dictionary;
use crate::dictionary::object::DataType;
use crate::dictionary::table::MAPPED_MAX;
use hal::TimeNs;
use trocar_canopen::cia301::Address;
use trocar_canopen::cia301::pdo::{MappingEntry, PdoCob, Transmission};
use trocar_canopen::index;
use trocar_canopen::{Frame, Payload};

/// What came in an RPDO.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Receive {
    /// What waits for the SYNC.
    ///
    /// A newer frame before the SYNC replaces it.
    pending: Option<Payload>,
    /// When the newest came.
    ///
    /// The deadline (sub-index 5) counts from here; none before the first, which cannot be late.
    pub(super) last: Option<TimeNs>,
}

/// What went out in a TPDO.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Transmit {
    /// SYNCs since the last one.
    ///
    /// Of a cyclic type 1 to 240.
    syncs: u8,
    /// Whether the SYNC's start value has come.
    started: bool,
    /// When and what was sent last; any other byte counts as a change.
    last: Option<(TimeNs, Payload)>,
}

/// A PDO's communication record, if it is in use.
///
/// Sub-index 1 (COB-ID) and 2 (transmission type) of 1400h or 1800h and after. None with bit 31
/// set.
fn parameters(
    dictionary: &Dictionary,
    record: impl Fn(u8) -> Address,
) -> Option<(PdoCob, Transmission)> {
    let cob = PdoCob::parse(dictionary.get_as(record(1)))
        .ok()
        .filter(|cob| cob.valid)?;
    let kind: u8 = dictionary.get_as(record(2));
    Some((cob, Transmission::try_from(kind).ok()?))
}

/// The objects that a PDO holds, in order.
///
/// Sub-index 0 of 1600h or 1A00h and after says how many; each entry has index, sub-index and bits.
pub(super) fn mapped(
    dictionary: &Dictionary,
    record: impl Fn(u8) -> Address,
) -> impl Iterator<Item = MappingEntry> {
    let count: u8 = dictionary.get_as(record(0));
    (1..=count.min(MAPPED_MAX)).map(move |n| MappingEntry::parse(dictionary.get_as(record(n))))
}

/// The bytes of the TPDO `number` as the values are now.
fn pack(dictionary: &Dictionary, number: u8) -> Payload {
    let mut bytes = [0; 8];
    let mut end = 0;
    for entry in mapped(dictionary, |sub| index::tpdo_mapping(number, sub)) {
        let value = dictionary.encode(entry.address);
        for byte in value.as_slice() {
            if let Some(place) = bytes.get_mut(end) {
                *place = *byte;
                end += 1;
            }
        }
    }
    Payload::truncated(&bytes[..end])
}

impl Node {
    /// A frame that may be one of this node's RPDOs.
    pub(super) fn on_process_data(&mut self, now: TimeNs, frame: &Frame, out: &mut Outbox) {
        for n in 0..4_u8 {
            let Some((cob, kind)) = parameters(&self.dictionary, |sub| index::rpdo(n, sub)) else {
                continue;
            };
            if cob.id != frame.id {
                continue;
            }
            let bits: u32 = mapped(&self.dictionary, |sub| index::rpdo_mapping(n, sub))
                .map(|entry| u32::from(entry.bits))
                .sum();
            let length = u32::from(frame.payload.length()) * 8;
            if !self.is_long_enough(now, length, bits, out) {
                continue;
            }
            self.receive[usize::from(n)].last = Some(now);
            if kind.is_synchronous() {
                self.receive[usize::from(n)].pending = Some(frame.payload);
            } else {
                self.unpack(now, n, &frame.payload, out);
            }
        }
    }

    /// Whether an RPDO of `length` bits has the `bits` that its mapping wants; raises and resolves
    /// the alarms of its length.
    fn is_long_enough(&mut self, now: TimeNs, length: u32, bits: u32, out: &mut Outbox) -> bool {
        if length < bits {
            self.alarm(now, Alarm::PdoLength, out);
            return false;
        }
        self.resolve(now, Alarm::PdoLength, out);
        if length > bits {
            self.alarm(now, Alarm::PdoExcess, out);
        } else {
            self.resolve(now, Alarm::PdoExcess, out);
        }
        true
    }

    /// What is mapped into the RPDO `number`, in order.
    fn mapping_of(&self, number: u8) -> [Option<MappingEntry>; MAPPED_MAX as usize] {
        let mut entries = [None; MAPPED_MAX as usize];
        let all = mapped(&self.dictionary, |sub| index::rpdo_mapping(number, sub));
        for (place, entry) in entries.iter_mut().zip(all) {
            *place = Some(entry);
        }
        entries
    }

    /// Puts the values of the RPDO `number` where its mapping says, the control word last: it acts
    /// on the others.
    ///
    /// Each value passes the checks of an SDO write: a mode that the drive lacks is ignored here, a
    /// target beyond 607Dh is cut in the drive.
    fn unpack(&mut self, now: TimeNs, number: u8, payload: &Payload, out: &mut Outbox) {
        let mut control = None;
        let mut rest = payload.as_slice();
        for entry in self.mapping_of(number).into_iter().flatten() {
            let Some((value, after)) = rest.split_at_checked(usize::from(entry.bits / 8)) else {
                return;
            };
            rest = after;
            if DataType::dummy(entry.address).is_some() {
                continue;
            }
            if entry.address == index::CONTROL {
                control = Some(value);
            } else {
                // What may not be written now is not: a PDO has no answer.
                let _ = self.store(now, entry.address, value, out);
            }
        }
        if let Some(value) = control {
            let _ = self.store(now, index::CONTROL, value, out);
        }
    }

    /// At SYNC: what has come since the last one takes effect.
    pub(super) fn take_synchronous(&mut self, now: TimeNs, out: &mut Outbox) {
        for n in 0..4_u8 {
            if let Some(payload) = self.receive[usize::from(n)].pending.take() {
                self.unpack(now, n, &payload, out);
            }
        }
    }

    /// At SYNC, after it took effect: what is due.
    ///
    /// Type 0 sends at a SYNC if a byte has changed, types 1 to 240 at every nth. A start value
    /// (sub-index 6) holds the TPDO back until the SYNC with that counter.
    pub(super) fn send_synchronous(&mut self, now: TimeNs, counter: Option<u8>, out: &mut Outbox) {
        for n in 0..4_u8 {
            let Some((cob, kind)) = parameters(&self.dictionary, |sub| index::tpdo(n, sub)) else {
                continue;
            };
            let start: u8 = self.dictionary.get_as(index::tpdo(n, 6));
            let place = &mut self.transmit[usize::from(n)];
            if !place.started && counter.is_some() && start != 0 && counter != Some(start) {
                continue;
            }
            let first = !place.started;
            place.started = true;
            let payload = pack(&self.dictionary, n);
            let due = match kind {
                Transmission::SyncCyclic(count) => {
                    place.syncs = place.syncs.saturating_add(1);
                    // With a start value the first one goes at once, without after a whole count.
                    let due = place.syncs >= count.raw() || (first && start != 0);
                    if due {
                        place.syncs = 0;
                    }
                    due
                }
                Transmission::SyncAcyclic => place.last.is_none_or(|(_, old)| old != payload),
                Transmission::RtrSync
                | Transmission::RtrEvent
                | Transmission::EventVendor
                | Transmission::EventProfile => false,
            };
            if due {
                place.last = Some((now, payload));
                out.push(Frame::new(cob.id, payload));
            }
        }
    }

    /// Event-driven TPDOs: on a change, not before the inhibit time, and after the event time in
    /// any case.
    ///
    /// Inhibit time is sub-index 3, in 100 µs; the event timer sub-index 5, in ms, 0 for none. The
    /// first one goes at once.
    pub(super) fn send_events(&mut self, now: TimeNs, out: &mut Outbox) {
        for n in 0..4_u8 {
            let Some((cob, kind)) = parameters(&self.dictionary, |sub| index::tpdo(n, sub)) else {
                continue;
            };
            if !matches!(kind, Transmission::EventVendor | Transmission::EventProfile) {
                continue;
            }
            let get = |sub| self.dictionary.get_as::<u64>(index::tpdo(n, sub));
            let (inhibit_ns, event_ns) = (get(3) * 100_000, get(5) * 1_000_000);
            let payload = pack(&self.dictionary, n);
            let due = self.transmit[usize::from(n)]
                .last
                .is_none_or(|(then, old)| {
                    let age_ns = now.since(then);
                    (old != payload && age_ns >= inhibit_ns) || (event_ns > 0 && age_ns >= event_ns)
                });
            if due {
                self.transmit[usize::from(n)].last = Some((now, payload));
                out.push(Frame::new(cob.id, payload));
            }
        }
    }
}
