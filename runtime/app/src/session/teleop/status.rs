//! What pages are told of teleoperation, with each state.

use hal::Pose;
use serde::Serialize;

use super::Driver;
use super::latency::FrameAgeMs;

/// What there is to show.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct TeleopStatus {
    /// Whether the hands are devices at the run's own computer.
    pub(super) desk: bool,
    /// The motion scale, the tip's way over the hand's; none of a log that does not say.
    pub(super) scale: Option<f64>,
    /// Within which angle of its instrument a tracked controller engages, degrees; none of a log.
    pub(super) align_deg: Option<f64>,
    /// Who drives, if there is a policy beside the hands.
    pub(super) driver: Option<Driver>,
    pub(super) arms: Vec<ArmStatus>,
    pub(super) recording: Option<Recording>,
    /// What the demonstration under way is called.
    pub(super) label: String,
    /// How old pictures are when the page that steers shows them.
    pub(super) camera_to_page_ms: Option<FrameAgeMs>,
}

/// One arm.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ArmStatus {
    pub(super) engaged: bool,
    /// Why it was released by force, if it was.
    pub(super) lost: Option<String>,
    /// By how much the hand, which holds the clutch, is held otherwise than its instrument points,
    /// degrees, if that keeps it from engaging.
    pub(super) misaligned_deg: Option<f64>,
    /// Where the tip is commanded to be, in the picture's axes from the lens, m, and as a unit
    /// quaternion x, y, z, w; none of a log.
    pub(super) tip: Option<[f64; 7]>,
    /// How far the jaw is closed, 0 to 1 as the trigger says it.
    pub(super) jaw: f64,
}

/// How a recording stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Recording {
    pub(crate) phase: Phase,
    /// Episodes that are kept, and how many there are to be.
    pub(crate) kept: usize,
    pub(crate) wanted: usize,
    pub(crate) seed: u64,
}

/// What the recording waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Phase {
    /// The episode waits for its start; its time stands still.
    Waiting,
    /// The episode is under way.
    Running,
    /// The episode has ended and is written, or thrown away.
    Writing,
}

/// A pose as numbers to six places: what a page shows.
pub(super) fn numbers(pose: &Pose) -> [f64; 7] {
    let q = pose.rotation.coords;
    let p = pose.translation.vector;
    [p.x, p.y, p.z, q.x, q.y, q.z, q.w].map(|value| (value * 1e6).round() * 1e-6)
}
