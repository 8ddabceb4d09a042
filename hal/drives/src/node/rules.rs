//! What may be written when, and what a write sets off.
//!
//! CiA 301, section 7.5.2: the procedures for changing 1005h, 1014h, 1016h, 1019h and the PDO
//! records.
//!
//! The object's own type, access and range are the dictionary's to check (`Dictionary::check`);
//! here is what depends on other objects. Process data pass through the same door as SDO writes.

use super::watch::consumer;
use super::{Node, Outbox};
use crate::dictionary::object::Mapping;
use crate::dictionary::table::{CONSUMER_COUNT, HISTORY_LENGTH, HOMING_METHODS, MAPPED_MAX};
use hal::TimeNs;
use trocar_canopen::cia301::pdo::{MappingEntry, PdoCob, Transmission};
use trocar_canopen::cia301::{AbortCode, Address};
use trocar_canopen::cia402::Mode;
use trocar_canopen::index;

/// "save", lowest byte first.
const SAVE: i64 = 0x6576_6173;
/// "load", lowest byte first.
const LOAD: i64 = 0x6461_6F6C;
/// This node makes the SYNC.
const SYNC_PRODUCER: i64 = 1 << 30;
/// Bit 31 of a COB-ID: not in use.
const INVALID: i64 = 1 << 31;
/// Bits of a COB-ID that may change only while it is not in use: 0 to 29. Bit 30 of a TPDO (no
/// remote frames) may at any time, and means nothing here, where frames are none of these: Lely's
/// dcfgen writes it clear.
const IDENTIFIER: i64 = 0x3FFF_FFFF;

impl Node {
    /// Writes an object, as a client or process data ask, if it may be written now.
    ///
    /// # Errors
    /// The code to abort with.
    pub(super) fn store(
        &mut self,
        now: TimeNs,
        address: Address,
        data: &[u8],
        out: &mut Outbox,
    ) -> Result<(), AbortCode> {
        let number = self.dictionary.check(address, data)?;
        if let Some(number) = number {
            self.allowed(address, number)?;
        }
        // A signature is a command, not a value.
        if address == index::STORE {
            self.dictionary.store();
            return Ok(());
        }
        if address == index::RESTORE {
            self.restore = true;
            return Ok(());
        }
        self.dictionary.write(address, data)?;
        self.act_on(now, address, out);
        Ok(())
    }

    /// Whether `number` may be written now: what depends on other objects or on the state, beyond
    /// the object's own limits.
    ///
    /// # Errors
    /// 0609 0030h for a value that is not allowed, 0800 0022h for a state that forbids it now,
    /// 0800 0020h for a wrong signature in 1010h or 1011h, 0604 0043h for a second consumer of one
    /// node, 0609 0036h for limits that cross, and those of a mapping.
    fn allowed(&self, address: Address, number: i64) -> Result<(), AbortCode> {
        let need = |fine: bool, code: AbortCode| if fine { Ok(()) } else { Err(code) };
        match (address.index, address.sub) {
            (0x1003, 0) => need(number == 0, AbortCode::VALUE),
            (0x1005, 0) => {
                need(number & SYNC_PRODUCER == 0, AbortCode::VALUE)?;
                identifier(number)
            }
            (0x1010, 1) => need(number == SAVE, AbortCode::CANNOT_STORE),
            (0x1011, 1) => need(number == LOAD, AbortCode::CANNOT_STORE),
            (0x1014, 0) => {
                self.unchanged_while_valid(address, number)?;
                identifier(number)
            }
            (0x1016, sub) => self.heartbeat_once(sub, number),
            (0x1019, 0) => {
                let silent = self.dictionary.get(index::SYNC_PERIOD) == 0;
                need(silent, AbortCode::DEVICE_STATE)?;
                need(number != 1, AbortCode::VALUE)
            }
            (0x1400..=0x1403 | 0x1800..=0x1803, sub) => self.communication(address, sub, number),
            (record @ 0x1600..=0x1603, sub) => {
                self.mapping(record, sub, number, 0x1400, Mapping::Receive)
            }
            (record @ 0x1A00..=0x1A03, sub) => {
                self.mapping(record, sub, number, 0x1800, Mapping::Transmit)
            }
            (0x605A, 0) => need(!(3..=4).contains(&number), AbortCode::VALUE),
            (0x6060, 0) => need(self.has_mode(number), AbortCode::VALUE),
            (0x607D, 1) => need(
                number <= self.dictionary.get(index::LIMIT_MAX),
                AbortCode::MAX_BELOW_MIN,
            ),
            (0x607D, 2) => need(
                number >= self.dictionary.get(index::LIMIT_MIN),
                AbortCode::MAX_BELOW_MIN,
            ),
            (0x6098, 0) => need(HOMING_METHODS.contains(&number), AbortCode::VALUE),
            _ => Ok(()),
        }
    }

    /// Whether 6502h has the mode of operation `number`.
    fn has_mode(&self, number: i64) -> bool {
        let mode = i8::try_from(number)
            .ok()
            .and_then(|raw| Mode::try_from(raw).ok());
        let supported = self.dictionary.get(index::SUPPORTED_MODES);
        mode.is_some_and(|mode| {
            mode == Mode::None || supported & i64::from(mode.supported_bit()) != 0
        })
    }

    /// Two entries of 1016h may not have the same node.
    fn heartbeat_once(&self, sub: u8, number: i64) -> Result<(), AbortCode> {
        let Some((node, _)) = consumer(number) else {
            return Ok(());
        };
        let twice = (1..=CONSUMER_COUNT)
            .filter(|&other| other != sub)
            .filter_map(|other| consumer(self.dictionary.get(Address::new(0x1016, other))))
            .any(|(other, _)| other == node);
        if twice {
            Err(AbortCode::INCOMPATIBLE)
        } else {
            Ok(())
        }
    }

    /// A COB-ID may change only while its valid bit (31) says "invalid": the write before has set
    /// it, not the one that changes.
    fn unchanged_while_valid(&self, address: Address, number: i64) -> Result<(), AbortCode> {
        let old = self.dictionary.get(address);
        if old & INVALID == 0 && old & IDENTIFIER != number & IDENTIFIER {
            return Err(AbortCode::VALUE);
        }
        Ok(())
    }

    /// Communication parameters of a PDO: inhibit time and SYNC start value only while it is not
    /// valid.
    fn communication(&self, address: Address, sub: u8, number: i64) -> Result<(), AbortCode> {
        let cob = Address::new(address.index, 1);
        let valid = self.dictionary.get(cob) & INVALID == 0;
        match sub {
            1 => {
                self.unchanged_while_valid(address, number)?;
                identifier(number)
            }
            2 => transmission(number),
            3 | 6 if valid => Err(AbortCode::DEVICE_STATE),
            _ => Ok(()),
        }
    }

    /// A mapping may change only while its PDO is not valid and it has no entries (sub-index 0 is
    /// 0), as CiA 301 says.
    fn mapping(
        &self,
        record: u16,
        sub: u8,
        number: i64,
        communication: u16,
        direction: Mapping,
    ) -> Result<(), AbortCode> {
        let cob = Address::new(communication + (record & 3), 1);
        if self.dictionary.get(cob) & INVALID == 0 {
            return Err(AbortCode::DEVICE_STATE);
        }
        if sub == 0 {
            let count = u8::try_from(number).map_err(|_| AbortCode::VALUE)?;
            return self.whole_mapping(record, count, direction);
        }
        if self.dictionary.get(Address::new(record, 0)) != 0 {
            return Err(AbortCode::ACCESS);
        }
        self.one_mapping(number, direction).map(|_| ())
    }

    /// All entries of a mapping must be mappable, and have 64 bits at most together.
    fn whole_mapping(&self, record: u16, count: u8, direction: Mapping) -> Result<(), AbortCode> {
        let mut bits = 0;
        for n in 1..=count.min(MAPPED_MAX) {
            let number = self.dictionary.get(Address::new(record, n));
            bits += u32::from(self.one_mapping(number, direction)?);
        }
        if bits > 64 {
            return Err(AbortCode::MAPPING_LENGTH);
        }
        Ok(())
    }

    /// Length in bits of a mapped object; the entry has to say the same.
    ///
    /// An entry is index (16 bits), sub-index (8) and length in bits (8), as in 1600h and 1A00h.
    fn one_mapping(&self, number: i64, direction: Mapping) -> Result<u8, AbortCode> {
        let raw = u32::try_from(number).map_err(|_| AbortCode::VALUE)?;
        let entry = MappingEntry::parse(raw);
        let bits = self.dictionary.mappable(entry.address, direction)?;
        if bits == entry.bits {
            Ok(bits)
        } else {
            Err(AbortCode::NOT_MAPPABLE)
        }
    }

    /// Empties 1003h, as writing 0 to its number of entries does.
    fn clear_error_history(&mut self) {
        for n in 1..=HISTORY_LENGTH {
            self.dictionary.set(Address::new(0x1003, n), 0);
        }
    }

    /// What follows from a value that was written.
    ///
    /// A write to 1016h restarts all consumer times, each with its node's next heartbeat; a written
    /// communication record of a PDO forgets what was pending and sent.
    fn act_on(&mut self, now: TimeNs, address: Address, out: &mut Outbox) {
        match (address.index, address.sub) {
            (0x1003, 0) => self.clear_error_history(),
            (0x1016, _) => self.watches.forget_heartbeats(),
            (0x1017, 0) => self.watches.schedule_heartbeat(now, &self.dictionary),
            (0x1400..=0x1403, _) => {
                self.receive[usize::from(address.index & 3)] = super::Receive::default();
            }
            (0x1800..=0x1803, _) => {
                self.transmit[usize::from(address.index & 3)] = super::Transmit::default();
            }
            (0x6040, 0) => {
                if self.drive.on_control(now, &self.dictionary) {
                    self.tell_reset(now, out);
                }
                self.refresh(now);
            }
            (0x6060, 0) => {
                self.drive.on_mode(now, &self.dictionary);
                self.refresh(now);
            }
            _ => {}
        }
    }
}

/// Whether the drive has the transmission type `number` of a PDO: all but those on remote frames.
fn transmission(number: i64) -> Result<(), AbortCode> {
    let raw = u8::try_from(number).map_err(|_| AbortCode::VALUE)?;
    match Transmission::try_from(raw) {
        Ok(Transmission::RtrSync | Transmission::RtrEvent) | Err(_) => Err(AbortCode::VALUE),
        Ok(
            Transmission::SyncAcyclic
            | Transmission::SyncCyclic(_)
            | Transmission::EventVendor
            | Transmission::EventProfile,
        ) => Ok(()),
    }
}

/// Whether a COB-ID has eleven bits and, if it is valid, is none that CiA 301 keeps for other
/// services.
fn identifier(number: i64) -> Result<(), AbortCode> {
    let cob = u32::try_from(number)
        .ok()
        .and_then(|raw| PdoCob::parse(raw).ok())
        .ok_or(AbortCode::VALUE)?;
    let reserved = matches!(
        cob.id.raw(),
        0x000..=0x07F | 0x101..=0x180 | 0x581..=0x5FF | 0x601..=0x67F | 0x6E0..=0x6FF | 0x701..=0x7FF
    );
    if cob.valid && reserved {
        return Err(AbortCode::VALUE);
    }
    Ok(())
}
