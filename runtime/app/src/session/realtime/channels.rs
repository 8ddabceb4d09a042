//! Queues and mailboxes between the threads of a run without a simulation in its process.

use std::sync::Arc;

use hal::{ArmState, Chunk, PerArm};
use rtrb::{Consumer, Producer, RingBuffer};
use trocar_log::{LogFile, Recorder, SceneLog, SideLog, TickLog};

use super::remote_arms::{BusLog, CanEventLog};
use super::signals::Signals;
use super::{CHUNK_QUEUE, listen, split};
use crate::console::Console;
use crate::mailbox::{MailboxReader, MailboxWriter, mailbox};
use crate::rig::can::Noticed;
use crate::rt::MonotonicClock;
use crate::session::operator::{Listener, OperatorPort};
use crate::session::source::ChunkSource;

/// A policy of this process with the queue for its chunks.
pub(super) type Local = Option<(ChunkSource, Producer<PerArm<Chunk>>)>;

/// Channels between the threads.
pub(super) struct ThreadChannels {
    pub(super) control: ControlChannels,
    /// For the rig: what it measures, and what happened to it.
    ///
    /// Written once a period; the newest replaces the others.
    pub(super) measured: MailboxWriter<PerArm<ArmState>>,
    pub(super) noticed: MailboxWriter<Noticed>,
    pub(super) seen: ObserverChannels,
    /// For whoever answers: a local policy, hands, or the first thread for a process.
    pub(super) chunk_in: Producer<PerArm<Chunk>>,
    /// For a world that says where everything is.
    pub(super) scenes: Option<SceneLog>,
    pub(super) log: Option<LogFile>,
    pub(super) listener: Option<Listener>,
}

/// The control thread's ends.
pub(super) struct ControlChannels {
    /// One is taken a period.
    pub(super) chunks: Consumer<PerArm<Chunk>>,
    pub(super) log: Option<TickLog>,
    pub(super) signals: Arc<Signals>,
    pub(super) operator: OperatorPort,
    pub(super) clock: MonotonicClock,
}

/// Channel ends of the thread that observes the arms for the policy.
pub(super) struct ObserverChannels {
    pub(super) measured: MailboxReader<PerArm<ArmState>>,
    /// Silent where no arm is on CAN.
    pub(super) news: CanEventLog,
    /// The buses of arms on CAN, for the log.
    pub(super) buses: Option<BusLog>,
    pub(super) log: Option<SideLog>,
    pub(super) signals: Arc<Signals>,
    pub(super) clock: MonotonicClock,
}

impl ObserverChannels {
    /// Writes into the log what has happened to arms, buses and policy.
    ///
    /// To be called in each turn of the observing thread; cheap without news.
    pub(super) fn tell(&mut self) {
        self.news.tell(&self.signals);
        if let (Some(buses), Some(log)) = (&mut self.buses, &mut self.log) {
            buses.tell(self.clock.now(), log);
        }
        self.signals.write_told(self.log.as_mut());
    }
}

impl ThreadChannels {
    /// Those of a run by `clock`, by which its pictures have their time on the console.
    ///
    /// Allocates all buffers of the run. The operator may not enable arms again here: drives on CAN
    /// are enabled once, at the beginning.
    pub(super) fn new(
        (recorder, console): (Option<Recorder>, Option<&Console>),
        clock: MonotonicClock,
    ) -> Self {
        if let Some(console) = console {
            console.follow(clock);
        }
        let (chunk_in, chunks) = RingBuffer::<PerArm<Chunk>>::new(CHUNK_QUEUE);
        let (measured_in, measured) = mailbox();
        let (noticed_in, noticed) = mailbox();
        let signals = Arc::new(Signals::of(console));
        let (listener, operator) = listen(false);
        let (tick_log, side_log, scenes, log) = split(recorder);
        Self {
            control: ControlChannels {
                chunks,
                log: tick_log,
                signals: Arc::clone(&signals),
                operator,
                clock,
            },
            measured: measured_in,
            noticed: noticed_in,
            seen: ObserverChannels {
                measured,
                news: CanEventLog::new(noticed),
                buses: None,
                log: side_log,
                signals,
                clock,
            },
            chunk_in,
            scenes,
            log,
            listener,
        }
    }
}
