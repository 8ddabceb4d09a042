//! What is wrong at the moment, the history of it, and the emergencies that tell about it.
//!
//! A condition is reported once when it begins, with an emergency and an entry in 1003h, and lasts
//! until it is resolved. When the last one is over, and no fault of the drive lasts, an emergency
//! with code 0000h says so. The inhibit time 1015h, in 100 µs, is between any two.

use super::{Node, Outbox};
use crate::dictionary::Dictionary;
use crate::dictionary::table::HISTORY_LENGTH;
use hal::TimeNs;
use trocar_canopen::NodeId;
use trocar_canopen::cia301::Address;
use trocar_canopen::cia301::Emergency;
use trocar_canopen::cia301::emcy::{ErrorCode, register};
use trocar_canopen::cia301::pdo::PdoCob;
use trocar_canopen::index;

/// Emergencies that wait for the inhibit time.
const WAITING_MAX: usize = 8;

/// A condition of the communication. Faults of the drive are the power state machine's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Alarm {
    /// Heartbeat consumer time-out.
    Heartbeat,
    /// No SYNC.
    SyncLoss,
    /// A SYNC of the wrong length.
    SyncLength,
    /// An RPDO is overdue.
    RpdoTimeout,
    /// An RPDO was too short.
    PdoLength,
    /// An RPDO was too long.
    PdoExcess,
    /// Another node has this node's number.
    IdCollision,
}

impl Alarm {
    /// The emergency error code (CiA 301, CiA 402).
    const fn code(self) -> ErrorCode {
        match self {
            Self::Heartbeat => ErrorCode::HEARTBEAT,
            Self::SyncLoss => ErrorCode::SYNC_CONTROLLER,
            Self::SyncLength => ErrorCode::SYNC_LENGTH,
            Self::RpdoTimeout => ErrorCode::RPDO_TIMEOUT,
            Self::PdoLength => ErrorCode::PDO_LENGTH,
            Self::PdoExcess => ErrorCode::PDO_EXCESS,
            Self::IdCollision => ErrorCode::ID_COLLISION,
        }
    }

    /// Its bit in the set of active alarms.
    const fn bit(self) -> u8 {
        1 << self as u8
    }
}

/// What is wrong, and what waits to be sent.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Alarms {
    /// A bit for each [`Alarm`].
    active: u8,
    /// Oldest first, without gaps.
    waiting: [Option<Emergency>; WAITING_MAX],
    last_sent: Option<TimeNs>,
}

impl Alarms {
    /// The error register's bits for the communication.
    pub(super) const fn register(&self) -> u8 {
        if self.active == 0 {
            0
        } else {
            register::GENERIC | register::COMMUNICATION
        }
    }

    /// Whether `alarm` lasts.
    pub(super) const fn is_active(&self, alarm: Alarm) -> bool {
        self.active & alarm.bit() != 0
    }

    /// Queues an emergency; one that finds the queue full is lost.
    fn queue(&mut self, emergency: Emergency) {
        if let Some(place) = self.waiting.iter_mut().find(|place| place.is_none()) {
            *place = Some(emergency);
        }
    }

    /// Sends what the inhibit time allows.
    ///
    /// `blocked` in NMT stopped, where emergencies wait. With an invalid COB-ID (bit 31 of 1014h)
    /// they count as sent.
    pub(super) fn flush(
        &mut self,
        now: TimeNs,
        dictionary: &mut Dictionary,
        blocked: bool,
        node: NodeId,
        out: &mut Outbox,
    ) {
        let inhibit_100_us: u64 = dictionary.get_as(index::EMERGENCY_INHIBIT);
        let cob = PdoCob::parse(dictionary.get_as(index::EMERGENCY_COB)).ok();
        while let Some(emergency) = self.waiting[0] {
            let early = self
                .last_sent
                .is_some_and(|last| now.since(last) < inhibit_100_us * 100_000);
            if blocked || early {
                return;
            }
            if let Some(cob) = cob.filter(|cob| cob.valid) {
                let mut frame = emergency.emit(node);
                frame.id = cob.id;
                out.push(frame);
            }
            self.note_sent(now);
        }
    }

    /// The oldest of the waiting emergencies has been sent.
    fn note_sent(&mut self, now: TimeNs) {
        self.last_sent = Some(now);
        self.waiting.rotate_left(1);
        self.waiting[WAITING_MAX - 1] = None;
    }
}

impl Node {
    /// A condition begins: reported once, until it is over.
    pub(super) fn alarm(&mut self, now: TimeNs, alarm: Alarm, out: &mut Outbox) {
        if self.alarms.active & alarm.bit() != 0 {
            return;
        }
        self.alarms.active |= alarm.bit();
        self.tell(now, alarm.code(), out);
    }

    /// A condition is over.
    pub(super) fn resolve(&mut self, now: TimeNs, alarm: Alarm, out: &mut Outbox) {
        if self.alarms.active & alarm.bit() == 0 {
            return;
        }
        self.alarms.active &= !alarm.bit();
        if self.alarms.active == 0 && self.drive.fault_register() == 0 {
            self.send_emergency(now, ErrorCode::RESET, out);
        }
    }

    /// Nothing is wrong any more: after a fault reset.
    pub(super) fn tell_reset(&mut self, now: TimeNs, out: &mut Outbox) {
        if self.alarms.active == 0 {
            self.send_emergency(now, ErrorCode::RESET, out);
        }
    }

    /// The drive fails.
    pub(super) fn fault(&mut self, now: TimeNs, code: ErrorCode, bits: u8, out: &mut Outbox) {
        let bits = bits | register::GENERIC;
        if self.drive.fault(now, bits, &self.dictionary) {
            self.tell(now, code, out);
        }
    }

    /// Enters `code` into the history, 603Fh, and sends it.
    fn tell(&mut self, now: TimeNs, code: ErrorCode, out: &mut Outbox) {
        let sub = |n| Address::new(0x1003, n);
        for n in (2..=HISTORY_LENGTH).rev() {
            let older = self.dictionary.get(sub(n - 1));
            self.dictionary.set(sub(n), older);
        }
        self.dictionary.set(sub(1), code.0.into());
        let count = self.dictionary.get(index::ERROR_COUNT);
        let count = (count + 1).min(HISTORY_LENGTH.into());
        self.dictionary.set(index::ERROR_COUNT, count);
        self.dictionary.set(index::ERROR_CODE, code.0.into());
        self.send_emergency(now, code, out);
    }

    /// Queues an emergency with the error register as it is now, and sends what the inhibit time
    /// allows.
    fn send_emergency(&mut self, now: TimeNs, code: ErrorCode, out: &mut Outbox) {
        self.alarms.queue(Emergency {
            code,
            register: self.alarms.register() | self.drive.fault_register(),
            vendor: [0; 5],
        });
        let blocked = self.state == trocar_canopen::cia301::NmtState::Stopped;
        self.alarms
            .flush(now, &mut self.dictionary, blocked, self.id, out);
    }
}
