//! An emulated CiA 402 drive: a state machine that eats frames and instants and gives frames.
//!
//! It knows no socket and no clock. [`Node::on_frame`] takes what the bus brings, [`Node::on_time`]
//! lets time pass (call it at least every millisecond), and both put what the node says into an
//! [`Outbox`]. Between them, [`Node::feedback`] tells where the motor is and [`Node::demand`] where
//! it should be. Whatever comes over the bus, the demand stays inside the axis's range and below
//! its greatest speed.
//!
//! A frame goes: NMT and heartbeats by their default identifiers, SDO requests if the node is not
//! stopped, SYNC by the identifier in 1005h, process data by those of the RPDOs and in operational
//! alone. Whatever changes the drive writes the actual values and the status word into the
//! dictionary.
//!
//! Not emulated: LSS, TIME, guarding, remote frames, block transfers, profile position and the
//! other modes.

mod alarm;
mod axis;
mod drive;
mod motion;
mod process;
mod rules;
mod server;
mod watch;

use crate::dictionary::object::Object;
use crate::dictionary::{Area, Dictionary, table};
use trocar_canopen::cia301::emcy::ErrorCode;
use trocar_canopen::cia301::sync::Sync;
use trocar_canopen::cia301::{Cob, NmtCommand, NmtState, nmt};
use trocar_canopen::index;
use trocar_canopen::{CanId, Frame, NodeId, Outbox};

use hal::TimeNs;

use alarm::{Alarm, Alarms};
use drive::Drive;
use process::{Receive, Transmit};
use server::Transfer;
use watch::Watches;

pub use axis::AxisConfig;
pub use drive::{Demand, Feedback};

/// An emulated drive.
///
/// `state` is [`NmtState::BootUp`] until it is powered; in that state it neither hears nor says
/// anything.
#[derive(Clone, Debug)]
pub struct Node {
    id: NodeId,
    config: AxisConfig,
    dictionary: Dictionary,
    state: NmtState,
    /// The SDO server's; one client at a time.
    transfer: Transfer,
    /// RPDO 1 to 4.
    receive: [Receive; 4],
    /// TPDO 1 to 4.
    transmit: [Transmit; 4],
    watches: Watches,
    alarms: Alarms,
    drive: Drive,
    /// 1011h was written: the presets of the data sheet come back at the next reset.
    restore: bool,
}

impl Node {
    /// A drive without power. It says nothing until [`Self::power_on`].
    #[must_use]
    pub fn new(id: NodeId, config: &AxisConfig) -> Self {
        let objects: Vec<Object> = table::objects();
        let mut node = Self {
            id,
            config: *config,
            dictionary: Dictionary::new(&objects, id),
            state: NmtState::BootUp,
            transfer: Transfer::Idle,
            receive: [Receive::default(); 4],
            transmit: [Transmit::default(); 4],
            watches: Watches::default(),
            alarms: Alarms::default(),
            drive: Drive::default(),
            restore: false,
        };
        node.config.apply(&mut node.dictionary);
        node
    }

    /// Its number on the bus.
    #[must_use]
    pub const fn id(&self) -> NodeId {
        self.id
    }

    /// Its NMT state.
    #[must_use]
    pub const fn nmt_state(&self) -> NmtState {
        self.state
    }

    /// Its values.
    #[must_use]
    pub const fn dictionary(&self) -> &Dictionary {
        &self.dictionary
    }

    /// Its power state.
    #[must_use]
    pub const fn power_state(&self) -> trocar_canopen::cia402::PowerState {
        self.drive.state()
    }

    /// When the newest SYNC came, if one has come since the node became operational or stopped
    /// being so.
    #[must_use]
    pub const fn newest_sync(&self) -> Option<TimeNs> {
        self.watches.newest_sync()
    }

    /// Starts the node: boot-up, then pre-operational.
    ///
    /// The drive is not homed then: it has lost its reference, as with an incremental encoder.
    pub fn power_on(&mut self, now: TimeNs, out: &mut Outbox) {
        self.reset(Area::All, now, out);
    }

    /// Takes where the motor is.
    pub fn feedback(&mut self, feedback: Feedback) {
        self.drive.feedback(feedback);
    }

    /// Where the motor should be at `now`.
    #[must_use]
    pub fn demand(&self, now: TimeNs) -> Demand {
        self.drive.demand(now, &self.dictionary)
    }

    /// The drive fails for a reason of its own: `code`, with `register` among the bits of 1001h.
    pub fn fail(&mut self, now: TimeNs, code: ErrorCode, register: u8, out: &mut Outbox) {
        self.fault(now, code, register, out);
        self.refresh(now);
    }

    /// Takes a frame that another node sent.
    ///
    /// Frames of the node's own must not be handed back to it: a heartbeat under its number is
    /// taken for a second node with that number.
    pub fn on_frame(&mut self, now: TimeNs, frame: &Frame, out: &mut Outbox) {
        if self.state == NmtState::BootUp {
            return;
        }
        self.drive.step(now, &self.dictionary);
        match Cob::of(frame.id) {
            Cob::Nmt => self.on_nmt(now, frame, out),
            Cob::Heartbeat(node) if node == self.id => {
                self.alarm(now, Alarm::IdCollision, out);
            }
            Cob::Heartbeat(node) => self.on_heartbeat(now, node, frame.data()),
            Cob::SdoRequest(node) if node == self.id => {
                if self.state != NmtState::Stopped {
                    self.on_sdo(now, frame.data(), out);
                }
            }
            Cob::Sync
            | Cob::Time
            | Cob::Emergency(_)
            | Cob::TransmitPdo(..)
            | Cob::ReceivePdo(..)
            | Cob::SdoResponse(_)
            | Cob::SdoRequest(_)
            | Cob::Other(_) => {}
        }
        // Where the dictionary says which identifier it is, that counts and not the default
        // meaning.
        if self.state != NmtState::Stopped && Some(frame.id) == self.sync_id() {
            self.on_sync(now, frame.data(), out);
        }
        if self.state == NmtState::Operational {
            self.on_process_data(now, frame, out);
        }
        self.refresh(now);
    }

    /// Lets time pass until `now`.
    ///
    /// In this order: ramps and homing, the heartbeat, the watches over master and SYNC, the
    /// following error window, event-driven TPDOs, the SDO time-out, emergencies that waited for
    /// their inhibit time.
    pub fn on_time(&mut self, now: TimeNs, out: &mut Outbox) {
        if self.state == NmtState::BootUp {
            return;
        }
        self.drive.step(now, &self.dictionary);
        self.heartbeat_if_due(now, out);
        self.watch(now, out);
        if self.drive.leaves_its_window(now, &self.dictionary) {
            self.fault(
                now,
                ErrorCode::FOLLOWING_ERROR,
                trocar_canopen::cia301::emcy::register::PROFILE,
                out,
            );
        }
        self.refresh(now);
        if self.state == NmtState::Operational {
            self.send_events(now, out);
        }
        self.server_timeout(now, out);
        let blocked = self.state == NmtState::Stopped;
        self.alarms
            .flush(now, &mut self.dictionary, blocked, self.id, out);
    }

    /// An NMT command, if it is for this node.
    fn on_nmt(&mut self, now: TimeNs, frame: &Frame, out: &mut Outbox) {
        let view = nmt::NmtView(frame.data());
        let (Ok(command), Ok(target)) = (view.command(), view.target()) else {
            return;
        };
        if !target.includes(self.id) {
            return;
        }
        match command {
            NmtCommand::Start => self.enter(now, NmtState::Operational),
            NmtCommand::Stop => self.enter(now, NmtState::Stopped),
            NmtCommand::EnterPreOperational => self.enter(now, NmtState::PreOperational),
            NmtCommand::ResetNode => self.reset(Area::All, now, out),
            NmtCommand::ResetCommunication => self.reset(Area::Communication, now, out),
        }
    }

    /// Enters an NMT state. Timers and process data start anew; an axis without process data stops
    /// as 6007h says.
    ///
    /// PDOs that wait for a SYNC are dropped, and SYNC counts of TPDOs begin at zero.
    fn enter(&mut self, now: TimeNs, state: NmtState) {
        if state == self.state {
            return;
        }
        // Without process data no master commands this axis any more.
        let unled = match (self.state, state) {
            (NmtState::Operational, NmtState::Stopped) => true,
            (NmtState::Operational, _) => self.config.stops_in_pre_operational,
            // It may have kept its torque in pre-operational.
            (_, NmtState::Stopped) => self.drive.state().has_torque(),
            _ => false,
        };
        if unled {
            self.lose_connection(now);
        }
        self.state = state;
        self.watches.restart();
        self.receive = [Receive::default(); 4];
        self.transmit = [Transmit::default(); 4];
        self.transfer = if state == NmtState::Stopped {
            Transfer::Idle
        } else {
            self.transfer
        };
    }

    /// A reset of the node or of its communication: presets, pre-operational, boot-up message.
    fn reset(&mut self, area: Area, now: TimeNs, out: &mut Outbox) {
        if core::mem::take(&mut self.restore) {
            self.dictionary = Dictionary::new(&table::objects(), self.id);
            self.config.apply(&mut self.dictionary);
        }
        self.dictionary.reset(area);
        self.state = NmtState::PreOperational;
        self.transfer = Transfer::Idle;
        self.receive = [Receive::default(); 4];
        self.transmit = [Transmit::default(); 4];
        self.watches = Watches::default();
        self.watches.schedule_heartbeat(now, &self.dictionary);
        self.alarms = Alarms::default();
        match area {
            Area::All => self.drive.power_on(),
            Area::Communication => self.drive.lose_connection(now, &self.dictionary),
        }
        out.push(NmtState::BootUp.emit(self.id));
        self.refresh(now);
    }

    /// The identifier of the SYNC (1005h).
    fn sync_id(&self) -> Option<CanId> {
        let raw: u32 = self.dictionary.get_as(index::SYNC_COB);
        trocar_canopen::cia301::pdo::CobView(raw & 0x1FFF_FFFF)
            .id()
            .ok()
    }

    /// A SYNC: the set-points of synchronous RPDOs take effect, then synchronous TPDOs are sent.
    ///
    /// A SYNC has a counter byte if and only if 1019h is not 0; another length is ignored and
    /// raises an emergency. In pre-operational only its time is noted, until another state is
    /// entered.
    fn on_sync(&mut self, now: TimeNs, data: &[u8], out: &mut Outbox) {
        let counted = self.dictionary.get(index::SYNC_COUNTER) != 0;
        let sync = match Sync::parse(data) {
            Ok(sync) if sync.counter().is_some() == counted => sync,
            Ok(_) | Err(_) => return self.alarm(now, Alarm::SyncLength, out),
        };
        self.resolve(now, Alarm::SyncLength, out);
        self.resolve(now, Alarm::SyncLoss, out);
        self.watches.on_sync(now);
        if self.state != NmtState::Operational {
            return;
        }
        self.take_synchronous(now, out);
        self.drive.on_sync(now, &self.dictionary);
        self.refresh(now);
        self.send_synchronous(now, sync.counter(), out);
    }

    /// The connection to the master is lost: what 6007h says.
    fn lose_connection(&mut self, now: TimeNs) {
        self.drive.lose_connection(now, &self.dictionary);
    }

    /// The values that the node itself changes.
    ///
    /// The status word's remote bit (9) is set in operational alone, its warning bit (7) while an
    /// alarm of the communication lasts.
    fn refresh(&mut self, now: TimeNs) {
        let remote = self.state == NmtState::Operational;
        let warning = self.alarms.register() != 0;
        self.drive
            .report(now, remote, warning, &mut self.dictionary);
        let register = self.alarms.register() | self.drive.fault_register();
        self.dictionary.set(index::ERROR_REGISTER, register.into());
    }
}

#[cfg(test)]
mod tests;
