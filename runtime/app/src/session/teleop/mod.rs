//! Teleoperation: an operator's hands, which a page of the console or devices here (`desk`) tell
//! of, as a source of chunks like any policy.
//!
//! ```text
//!  page ── hands, 125 a second ─> console's thread: `message` checks, `Hands` holds the newest and each arm's `Clutch`
//!                                                      │ looked at every 8 ms
//!  control thread ── newest command (mailbox) ──> `Teleop`: chunk ──> gate, filter, smoother, guard
//! ```
//!
//! A hand moves its arm only while it holds the clutch. At each clutch-in, position and orientation
//! start from what the arm is commanded to be at, so nothing jumps; a controller engages once it is
//! held as its instrument points (`alignment`). Hands without input for [`STALE_NS`], a page that
//! goes, is hidden or loses the right to steer, and anything that makes no sense release the clutch
//! by force (`ReleaseCause`): then the arm holds until the operator has let the clutch go and takes
//! it again.
//!
//! **Intervention.** Beside a policy the hands drive nothing until one of them takes its clutch:
//! then they drive all arms, from where those are, until the operator hands back (`Intervention`).
//! Whatever is lost meanwhile, the arms hold: the policy drives again when a person says so, and
//! with chunks alone that it makes of what it sees from then on.
//!
//! **Frame.** A hand moves in the axes of the endoscope's picture, of a robot without a task in
//! those that were configured: x to the right, y up, z towards the viewer (those of WebXR, whose
//! viewer looks along -z). What one sees moves and turns the way the hand does.

mod alignment;
mod clutch;
mod demonstration;
mod desk;
mod hands;
mod held;
mod intervention;
mod latency;
mod logged;
mod mark;
mod message;
mod operator;
mod source;
mod status;
mod view;

#[cfg(test)]
mod tests;

use hal::{JointVector, PerArm, TimeNs, TipTarget};
use trocar_control::{OperatingState, OperatorEvent};
use trocar_log::TickRecord;

pub use alignment::{ALIGNS_DEG, DEFAULT_ALIGN_DEG};
pub(crate) use clutch::ReleaseCause;
pub(crate) use demonstration::Demonstrating;
pub use demonstration::{Demonstration, DemonstrationStep, EpisodeCommand};
pub(crate) use desk::attend;
pub(crate) use hands::Hands;
pub(crate) use intervention::{Intervention, TeleopCommand};
pub use latency::{FrameAgeMs, HandDevice, InterventionSummary, TeleopSummary};
pub(crate) use logged::{HandsNotice, LoggedHands};
pub(crate) use message::{HandsMessage, HandsMessageError};
pub use operator::{DELAYS_MS, OperatorFigures, SimulatedOperator, TREMORS_MM};
pub use source::Teleop;
pub(crate) use status::{Phase, Recording, TeleopStatus};
pub(crate) use view::{picture, rcms_from_view};

/// By how much longer an operator may take than the task allows its policies.
pub const TIME_FACTOR: f64 = 10.0;

/// Hands that are older than this are not followed, ns.
pub const STALE_NS: u64 = 100_000_000;

/// What part of a hand's way the tip makes, unless the operator chooses another.
pub const DEFAULT_SCALE: f64 = 0.4;

/// Which parts can be chosen.
pub const SCALES: std::ops::RangeInclusive<f64> = 0.1..=1.0;

/// Ticks from one chunk to the next.
pub(crate) const CHUNK_TICKS: u64 = 8;

/// What the controller last commanded of the arms. Plain data, which the control thread hands over.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Commanded {
    /// The newest chunk that the controller was given, and the time of the tick that it was given
    /// to.
    pub(crate) sequence: u64,
    pub(crate) at: TimeNs,
    /// Whose chunks the controller is given.
    pub(crate) driver: Driver,
    pub(crate) arms: PerArm<ArmCommanded>,
}

/// The newest chunk that the controller was given, when, and whose its chunks are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Given {
    sequence: u64,
    at: TimeNs,
    driver: Driver,
}

impl Given {
    /// Nothing yet, as a run begins.
    pub(crate) const fn nothing() -> Self {
        Self {
            sequence: 0,
            at: TimeNs(0),
            driver: Driver::Policy,
        }
    }
}

impl Commanded {
    /// What the controller commands after the tick of `record`; `given` is what it was given till
    /// then.
    pub(crate) fn after(record: &TickRecord, given: &mut Given) -> Self {
        if let Some(sequence) = record.arms.first.chunk_sequence {
            (given.sequence, given.at) = (sequence, record.now);
        }
        match record.arms.first.operator {
            Some(OperatorEvent::TakeOver) => given.driver = Driver::Operator,
            Some(OperatorEvent::HandBack) => given.driver = Driver::Policy,
            Some(_) | None => {}
        }
        let Given {
            sequence,
            at,
            driver,
        } = *given;
        let arms = record.arms.map(|arm| ArmCommanded {
            position: arm.command.position,
            velocity: arm.command.velocity,
            jaw: arm.command.jaw_position,
            target: arm.report.target,
            follows: arm.report.mode.state == OperatingState::Enabled,
        });
        Self {
            sequence,
            at,
            driver,
            arms,
        }
    }
}

/// Who drives the arms of a run that has a policy and an operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Driver {
    /// The policy.
    Policy,
    /// The operator's hands.
    Operator,
}

/// One arm of [`Commanded`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArmCommanded {
    /// Joint positions and velocities, rad and m, rad/s and m/s.
    pub(crate) position: JointVector,
    pub(crate) velocity: JointVector,
    /// Angle between the jaw fingers, rad.
    pub(crate) jaw: f64,
    /// Where the chunks wanted the tip to be, if they reach so far.
    pub(crate) target: Option<TipTarget>,
    /// Whether the arm is enabled and follows chunks.
    pub(crate) follows: bool,
}
