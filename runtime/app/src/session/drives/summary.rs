//! What a run of emulated drives reports, in the form that scripts rely on.

use hal::{ARM_NAMES, TimeNs};
use serde::Serialize;

use super::stops::{Stop, StopCause};
use crate::session::summary::PercentilesUs;

/// One bus.
#[derive(Clone, Debug, Serialize)]
pub struct BusSummary {
    /// Its interface.
    pub interface: String,
    /// Frames that were on it.
    pub frames: u64,
    /// Share of the time for which it was busy at its bit rate.
    pub busy_share: f64,
}

/// One drive's stop. Times are the drives'.
#[derive(Clone, Debug, Serialize)]
pub struct StopSummary {
    /// `psm1` or `psm2`.
    pub arm: &'static str,
    /// Joint index, 6 for the jaw.
    pub axis: usize,
    /// Its node.
    pub node: u8,
    /// Why, in words.
    pub cause: String,
    /// The error code that it reported, if it did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub code: Option<u16>,
    /// When it left off following, s.
    pub at_s: f64,
    /// How long after the last SYNC that was, ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stop_after_sync_ms: Option<f64>,
    /// How long after the last SYNC the axis was at rest, ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rest_after_sync_ms: Option<f64>,
    /// Time that did not pass for the drives meanwhile, ms: what `stalled_s` has of this stop. With
    /// any the two times above are the drives' own and not a real machine's.
    pub stalled_ms: f64,
}

impl From<&Stop> for StopSummary {
    fn from(stop: &Stop) -> Self {
        let ms = |ns: u64| TimeNs(ns).seconds() * 1e3;
        let after = stop.after_sync_ns();
        Self {
            arm: ARM_NAMES[stop.arm],
            axis: stop.axis,
            node: stop.node.raw(),
            cause: stop.cause.to_string(),
            code: match stop.cause {
                StopCause::Error(code) => Some(code.0),
                StopCause::QuickStop
                | StopCause::SwitchedOff
                | StopCause::Left(_)
                | StopCause::Powerless => None,
            },
            at_s: stop.at.seconds(),
            stop_after_sync_ms: after.map(|(stop, _)| ms(stop)),
            rest_after_sync_ms: after.map(|(_, rest)| ms(rest)),
            stalled_ms: ms(stop.stalled_ns),
        }
    }
}

/// A run of drives.
#[derive(Clone, Debug, Serialize)]
pub struct DrivesSummary {
    /// Task name; absent without a world.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub task: Option<String>,
    /// Seed of the scene.
    pub seed: u64,
    /// How many arms.
    pub arms: usize,
    /// Time that passed for the drives, s.
    pub seconds: f64,
    /// Time that did not pass for them because the process was kept from running, s.
    pub stalled_s: f64,
    /// How long the process took to look at the buses and move the drives and the world on.
    pub turn_us: PercentilesUs,
    /// When all drives were enabled for the first time, s.
    pub begun_s: Option<f64>,
    /// Whether the task was done; absent without a world.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub success: Option<bool>,
    /// How the episode stood at the end, in words; absent without a world.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outcome: Option<String>,
    /// The buses.
    pub buses: Vec<BusSummary>,
    /// Frames that found no room, on the emulated wires or in the system.
    pub frames_lost: u64,
    /// Every stop of a drive after its arm had been enabled.
    pub stops: Vec<StopSummary>,
}
