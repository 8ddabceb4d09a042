//! Where everything in a simulated scene is at one instant, for whoever draws it: Trocar's cameras
//! or anyone's.
//!
//! A run publishes a snapshot at each policy step that frames are wanted of, under the name of its
//! first arm; a world in another process at each policy step. A camera draws it and publishes a
//! frame with the snapshot's own stamp and number, which go with the arms' reports of that instant.

use iceoryx2::prelude::ZeroCopySend;

use super::{Line, Message, PoseMessage};
use hal::{ARMS_MAX, TimeNs};

/// Things that move in a scene.
pub const SCENE_THINGS_MAX: usize = 2;

/// Nodes of a soft flap.
pub const FLAP_NODES_MAX: usize = 208;

/// The parts of an instrument, in the scene frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/instrument_parts/1")]
pub struct InstrumentParts {
    /// Origin on the wrist-pitch axis, the shaft behind it along -z.
    pub shaft: PoseMessage,
    /// Origin on the wrist-pitch axis, the wrist-yaw axis at x = 9.1 mm.
    pub wrist: PoseMessage,
    /// Origin on the wrist-yaw axis, z along the finger, inner face in the xz-plane, body at y > 0.
    pub finger_left: PoseMessage,
    /// Like the left one with its body at y < 0.
    pub finger_right: PoseMessage,
    /// The tip frame, which cameras on the instrument are mounted in: origin on the wrist-yaw axis,
    /// z along the closed fingers.
    pub tip: PoseMessage,
}

/// A soft flap.
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/flap/1")]
pub struct Flap {
    /// Places of the nodes, row by row, scene frame, m; those past the flap's own number are zero.
    pub nodes_m: [[f32; 3]; FLAP_NODES_MAX],
    /// The mark in the material, m.
    pub mark_m: [f64; 2],
}

impl Default for Flap {
    fn default() -> Self {
        Self {
            nodes_m: [[0.0; 3]; FLAP_NODES_MAX],
            mark_m: [0.0; 2],
        }
    }
}

/// A scene at one instant, all places in the scene frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/scene_snapshot/1")]
pub struct SnapshotReport {
    /// When it was so, on the system's monotonic clock: the instant of the arms' measurement.
    pub stamp: TimeNs,
    /// The policy step of the run.
    pub sequence: u64,
    /// The task.
    pub task: Line,
    /// The beginning of a hash of the scene's configuration: with another one it is another scene.
    pub scene_hash: u64,
    /// The seed of the episode.
    pub seed: u64,
    /// The cameras that are wanted, a bit each by their place in the scene's configuration. Of
    /// policy steps all bits are set, and each camera that is there shows them.
    pub wanted: u64,
    /// Milliseconds since the episode began, which a sensor's noise and smoke are drawn from.
    pub moment_ms: u64,
    /// The things that move, as many as the task has.
    pub things: [PoseMessage; SCENE_THINGS_MAX],
    /// Where something is to be brought, if the task has such a place.
    pub goal: PoseMessage,
    /// How many of `arms` there are.
    pub arm_count: u64,
    /// The instruments.
    pub arms: [InstrumentParts; ARMS_MAX],
    /// Whether there is a soft flap.
    pub has_flap: u64,
    /// The flap.
    pub flap: Flap,
}

impl Message for SnapshotReport {
    const TOPIC: &'static str = "snapshot";
}

/// A sign of life of the process that draws.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/cameras_status/1")]
pub struct CamerasStatus {
    /// Counts the messages; a count that stands still is a process that hangs.
    pub sequence: u64,
    /// Snapshots drawn.
    pub drawn: u64,
    /// Time that the newest one took to draw, ns.
    pub draw_ns: u64,
}

impl Message for CamerasStatus {
    const TOPIC: &'static str = "cameras_status";
}
