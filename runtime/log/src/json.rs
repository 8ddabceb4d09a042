//! The log's own messages, in JSON.
//!
//! A chunk, host timing, and what the controller was given besides. Together with
//! `/psm1/measured_js` and `/psm1/jaw` these are all inputs of a tick. The schemas are in `topic`.

use hal::chunk::CHUNK_STEPS_MAX;
use hal::{ArmError, Chunk, TimeNs};
use serde::{Deserialize, Serialize};

use super::exact::{EXACT_BYTES_MAX, Exact, numbers, target};
use super::record::TickRecord;
use trocar_control::OperatorEvent;

/// A message of the log as JSON.
#[expect(
    clippy::expect_used,
    reason = "numbers, texts and lists always have a JSON form; an empty message would be a false record"
)]
pub(super) fn encoded(message: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(message).expect("a message has a JSON form")
}

/// Bytes of a chunk's target at most: its numbers, each with a comma, in brackets, and a comma.
pub(super) const TARGET_BYTES_MAX: usize = 8 * (EXACT_BYTES_MAX + 1) + 3;

/// `/policy/chunk`.
///
/// Written before the tick that is given it.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct ChunkMessage {
    /// Counts all chunks of the run from 0, those of both arms and dropped ones.
    pub(super) record: u64,
    sequence: u64,
    observed_at_ns: u64,
    step_ns: u64,
    len: u32,
    reserved: u32,
    /// As `exact::numbers` has them.
    targets: Vec<[Exact; 8]>,
}

impl ChunkMessage {
    /// A chunk as the log's number `record`. Targets past its length, which mean nothing, are left
    /// out.
    pub(super) fn new(record: u64, chunk: &Chunk) -> Self {
        Self {
            record,
            sequence: chunk.sequence,
            observed_at_ns: chunk.observed_at.0,
            step_ns: chunk.step_ns,
            len: chunk.len,
            reserved: chunk.reserved,
            targets: chunk.valid_targets().iter().map(numbers).collect(),
        }
    }

    /// The chunk; `None` if there are more targets than a chunk holds.
    pub(super) fn chunk(&self) -> Option<Chunk> {
        if self.targets.len() > CHUNK_STEPS_MAX {
            return None;
        }
        let targets: Vec<_> = self.targets.iter().map(target).collect();
        let mut chunk = Chunk::new(
            TimeNs(self.observed_at_ns),
            self.sequence,
            self.step_ns,
            &targets,
        );
        chunk.len = self.len;
        chunk.reserved = self.reserved;
        Some(chunk)
    }
}

/// `/timing`.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct TimingMessage {
    pub(super) tick: u64,
    /// Since the tick before in the log, ns.
    pub(super) period_ns: u64,
    /// Wake-up later than planned, ns.
    pub(super) wake_ns: u64,
    /// Time spent in the controller, ns.
    pub(super) compute_ns: u64,
}

impl TimingMessage {
    /// Of `tick`; the one before in the same log or stream was at `previous`.
    pub(super) const fn new(tick: &TickRecord, previous: TimeNs) -> Self {
        Self {
            tick: tick.tick,
            period_ns: tick.now.since(previous),
            wake_ns: tick.timing.wake_ns,
            compute_ns: tick.timing.compute_ns,
        }
    }
}

/// `/psm1/tick`, one for each arm.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct TickMessage {
    /// Counts the ticks that were handed over from 0, dropped ones included.
    pub(super) record: u64,
    /// The driver's own count, in which skipped periods are numbers that no tick has.
    pub(super) tick: u64,
    /// Time of the tick.
    pub(super) now_ns: u64,
    /// Why nothing was measured.
    pub(super) error: Option<ErrorMessage>,
    /// The operator's event of this tick.
    pub(super) operator: Option<OperatorMessage>,
    /// The chunk that the arm was given.
    pub(super) chunk: Option<ChunkRef>,
    /// Whether the drives were commanded to hold torque.
    pub(super) enabled: bool,
}

/// Which chunk a tick was given.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct ChunkRef {
    /// The policy's own number of the chunk.
    pub(super) sequence: u64,
    /// Number of the chunk's own message; `None` if the queue was full.
    pub(super) record: Option<u64>,
}

/// Why nothing was measured.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum ErrorMessage {
    MeasurementLost { age_ns: u64 },
    DriveFault { axis: u8, code: u16 },
    EndOfRecording,
}

impl From<ArmError> for ErrorMessage {
    fn from(error: ArmError) -> Self {
        match error {
            ArmError::MeasurementLost { age_ns } => Self::MeasurementLost { age_ns },
            ArmError::DriveFault { axis, code } => Self::DriveFault { axis, code },
            ArmError::EndOfRecording => Self::EndOfRecording,
        }
    }
}

impl From<ErrorMessage> for ArmError {
    fn from(message: ErrorMessage) -> Self {
        match message {
            ErrorMessage::MeasurementLost { age_ns } => Self::MeasurementLost { age_ns },
            ErrorMessage::DriveFault { axis, code } => Self::DriveFault { axis, code },
            ErrorMessage::EndOfRecording => Self::EndOfRecording,
        }
    }
}

/// The operator's event.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum OperatorMessage {
    Enable,
    Disable,
    Pause,
    Resume,
    Clear,
    Speed { percent: u8 },
    TakeOver,
    HandBack,
    GoOn,
}

impl From<OperatorEvent> for OperatorMessage {
    fn from(event: OperatorEvent) -> Self {
        match event {
            OperatorEvent::Enable => Self::Enable,
            OperatorEvent::Disable => Self::Disable,
            OperatorEvent::Pause => Self::Pause,
            OperatorEvent::Resume => Self::Resume,
            OperatorEvent::Clear => Self::Clear,
            OperatorEvent::Speed { percent } => Self::Speed { percent },
            OperatorEvent::TakeOver => Self::TakeOver,
            OperatorEvent::HandBack => Self::HandBack,
            OperatorEvent::GoOn => Self::GoOn,
        }
    }
}

impl From<OperatorMessage> for OperatorEvent {
    fn from(message: OperatorMessage) -> Self {
        match message {
            OperatorMessage::Enable => Self::Enable,
            OperatorMessage::Disable => Self::Disable,
            OperatorMessage::Pause => Self::Pause,
            OperatorMessage::Resume => Self::Resume,
            OperatorMessage::Clear => Self::Clear,
            OperatorMessage::Speed { percent } => Self::Speed { percent },
            OperatorMessage::TakeOver => Self::TakeOver,
            OperatorMessage::HandBack => Self::HandBack,
            OperatorMessage::GoOn => Self::GoOn,
        }
    }
}
