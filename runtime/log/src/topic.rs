//! The topics of the log and the schema of each.
//!
//! Field numbers of protobuf messages are in `messages`. JSON schemas are for people and viewers:
//! nothing here checks a message against them. A channel is announced in the file before its first
//! message.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::{McapResult, Writer};

/// The topic of shapes.
pub const SHAPES: &str = "/scene";

/// The topic of frames.
pub const TRANSFORMS: &str = "/tf";

/// The topic of what happens, in words.
pub const EVENTS: &str = "/events";

/// The topic of a simulated scene at its policy steps.
pub const TASK: &str = "/task";

/// The topic of CAN buses.
pub const BUSES: &str = "/buses";

/// A topic that every log has; that of buses has messages in logs of CAN alone, that of snapshots
/// in logs with a bound. Cameras come on top, one pair of topics each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Topic {
    /// What the arm measured.
    MeasuredJs,
    /// Its set-points.
    SetpointJs,
    /// Where its tip was.
    MeasuredCp,
    /// The jaw, measured and commanded.
    Jaw,
    /// Chunks, in the tick in which the controller was given them.
    Chunk,
    /// What the controller says about its answer.
    Safety,
    /// Host timing.
    Timing,
    /// The rest of what the controller was given; the first arm's is the last message of a tick.
    Tick,
    /// What happened, in words.
    Events,
    /// Where frames are in each other: remote centres and cameras in the scene, tips from their
    /// centres.
    Transforms,
    /// Where everything in a simulated scene is, and how its task stands.
    Task,
    /// How busy the CAN buses of the arms are, and what goes wrong on them.
    Buses,
    /// The controller's state before the first tick of a file that does not begin with the run.
    Snapshot,
}

/// How many topics [`Topic`] has.
pub(super) const TOPIC_COUNT: usize = 13;

impl Topic {
    /// All of them, in the order of their numbers.
    pub(super) const ALL: [Self; TOPIC_COUNT] = [
        Self::MeasuredJs,
        Self::SetpointJs,
        Self::MeasuredCp,
        Self::Jaw,
        Self::Chunk,
        Self::Safety,
        Self::Timing,
        Self::Tick,
        Self::Events,
        Self::Transforms,
        Self::Task,
        Self::Buses,
        Self::Snapshot,
    ];

    /// The names in the file, one for each arm; a single one where all arms share the topic.
    ///
    /// The first arm's names are the same whether there is another arm or not.
    pub(super) const fn names(self) -> &'static [&'static str] {
        match self {
            Self::MeasuredJs => &["/psm1/measured_js", "/psm2/measured_js"],
            Self::SetpointJs => &["/psm1/setpoint_js", "/psm2/setpoint_js"],
            Self::MeasuredCp => &["/psm1/measured_cp", "/psm2/measured_cp"],
            Self::Jaw => &["/psm1/jaw", "/psm2/jaw"],
            Self::Chunk => &["/policy/chunk", "/policy/chunk/psm2"],
            Self::Safety => &["/safety", "/safety/psm2"],
            Self::Timing => &["/timing"],
            Self::Tick => &["/psm1/tick", "/psm2/tick"],
            Self::Events => &[EVENTS],
            Self::Transforms => &[TRANSFORMS],
            Self::Task => &[TASK],
            Self::Buses => &[BUSES],
            Self::Snapshot => &["/snapshot"],
        }
    }

    /// The topic called `name`, and whose it is.
    pub(super) fn find(name: &str) -> Option<(Self, usize)> {
        Self::ALL.into_iter().find_map(|topic| {
            let arm = topic.names().iter().position(|known| *known == name)?;
            Some((topic, arm))
        })
    }

    /// How its messages are encoded.
    pub(super) const fn schema(self) -> Schema {
        match self {
            Self::MeasuredJs | Self::SetpointJs | Self::Jaw => {
                Schema::Protobuf("foxglove.JointStates")
            }
            Self::MeasuredCp => Schema::Protobuf("foxglove.PoseInFrame"),
            Self::Events => Schema::Protobuf("foxglove.Log"),
            Self::Transforms => Schema::Protobuf("foxglove.FrameTransforms"),
            Self::Chunk => Schema::Json("trocar.Chunk", CHUNK_SCHEMA),
            Self::Safety => Schema::Json("trocar.Safety", SAFETY_SCHEMA),
            Self::Timing => Schema::Json("trocar.Timing", TIMING_SCHEMA),
            Self::Tick => Schema::Json("trocar.Tick", TICK_SCHEMA),
            Self::Task => Schema::Json("trocar.Task", TASK_SCHEMA),
            Self::Buses => Schema::Json("trocar.Buses", BUSES_SCHEMA),
            Self::Snapshot => Schema::Json("trocar.Snapshot", SNAPSHOT_SCHEMA),
        }
    }
}

/// The topic of a camera's images.
#[must_use]
pub fn image_topic(camera: &str) -> String {
    format!("/camera/{camera}")
}

/// The camera whose images `topic` has, if it has a camera's.
#[must_use]
pub fn camera_of(topic: &str) -> Option<&str> {
    let camera = topic.strip_prefix("/camera/")?;
    (!camera.contains('/')).then_some(camera)
}

/// The camera that `topic` says something of besides its images, and what: `calibration` or `pose`.
pub(super) fn beside_images(topic: &str) -> Option<(&str, &str)> {
    topic.strip_prefix("/camera/")?.split_once('/')
}

/// The topic of a camera's lens.
#[must_use]
pub fn lens_topic(camera: &str) -> String {
    format!("/camera/{camera}/calibration")
}

/// The topic of where a camera is.
pub(super) fn pose_topic(camera: &str) -> String {
    format!("/camera/{camera}/pose")
}

/// How the messages of a topic are encoded.
#[derive(Clone, Copy)]
pub(super) enum Schema {
    /// Protobuf message of this name.
    Protobuf(&'static str),
    /// JSON of this name and JSON schema.
    Json(&'static str, &'static str),
}

/// Registers a topic with its schema and gives its channel.
pub(super) fn add_channel<W: Write + Seek>(
    writer: &mut Writer<W>,
    name: &str,
    schema: Schema,
) -> McapResult<u16> {
    let none = BTreeMap::new();
    match schema {
        Schema::Protobuf(message) => {
            let descriptors = super::descriptor::file_descriptor_set();
            let id = writer.add_schema(message, "protobuf", &descriptors)?;
            writer.add_channel(id, name, "protobuf", &none)
        }
        Schema::Json(title, text) => {
            let id = writer.add_schema(title, "jsonschema", text.as_bytes())?;
            writer.add_channel(id, name, "json", &none)
        }
    }
}

/// Registers every topic of the arm `arm`: of the first one also what all share, for which other
/// arms get channel 0.
pub(super) fn add_channels<W: Write + Seek>(
    writer: &mut Writer<W>,
    arm: usize,
) -> McapResult<[u16; TOPIC_COUNT]> {
    let mut channels = [0; TOPIC_COUNT];
    for (channel, topic) in channels.iter_mut().zip(Topic::ALL) {
        if let Some(name) = topic.names().get(arm) {
            *channel = add_channel(writer, name, topic.schema())?;
        }
    }
    Ok(channels)
}

/// Notes in `names` what the channels of each arm are called.
pub(super) fn name_channels(channels: &[[u16; TOPIC_COUNT]], names: &mut BTreeMap<u16, String>) {
    for (arm, channels) in channels.iter().enumerate() {
        for (&channel, topic) in channels.iter().zip(Topic::ALL) {
            if let Some(name) = topic.names().get(arm) {
                names.insert(channel, (*name).to_owned());
            }
        }
    }
}

/// Describes `json::ChunkMessage`, and changes with it.
const CHUNK_SCHEMA: &str = r#"{"title": "trocar.Chunk", "type": "object",
"description": "A policy's answer. Target k is due at observed_at_ns + k * step_ns. Non-finite numbers are the strings inf, -inf, nan:<bits>.",
"properties": {
  "record": {"type": "integer", "description": "counts the chunks that the controller was given, from 0"},
  "sequence": {"type": "integer"}, "observed_at_ns": {"type": "integer"}, "step_ns": {"type": "integer"},
  "len": {"type": "integer"}, "reserved": {"type": "integer"},
  "targets": {"type": "array", "items": {"type": "array", "minItems": 8, "maxItems": 8,
    "items": {"type": ["number", "string"]},
    "description": "tip position x, y, z in the RCM frame, m; rotation quaternion x, y, z, w; jaw angle, rad"}}}}"#;

/// Describes `safety::SafetyMessage`, and changes with it.
const SAFETY_SCHEMA: &str = r#"{"title": "trocar.Safety", "type": "object",
"properties": {"tick": {"type": "integer"},
  "mode": {"enum": ["DISABLED", "ENABLED", "PAUSED", "FAULT"]}, "homed": {"type": "boolean"}, "busy": {"type": "boolean"},
  "gate": {"type": ["string", "null"], "description": "the input gate's verdict on a new chunk"},
  "qp": {"enum": ["passed", "solved", "failed"]}, "qp_iterations": {"type": "integer"},
  "rows_active": {"type": "integer"},
  "correction": {"type": ["number", "string"], "description": "length of the filter's change, in units of the velocity limits"},
  "guard_intervened": {"type": "boolean"},
  "target": {"type": ["array", "null"], "description": "aggregated target, as in trocar.Chunk"},
  "fault": {"type": ["object", "string", "null"]}}}"#;

const TIMING_SCHEMA: &str = r#"{"title": "trocar.Timing", "type": "object",
"properties": {"tick": {"type": "integer"},
  "period_ns": {"type": "integer", "description": "since the previous tick in the log"},
  "wake_ns": {"type": "integer", "description": "wake-up later than planned"},
  "compute_ns": {"type": "integer", "description": "time spent in the controller"}}}"#;

const TICK_SCHEMA: &str = r#"{"title": "trocar.Tick", "type": "object",
"description": "What the controller was given, apart from joint values and chunks; the last message of a tick.",
"properties": {
  "record": {"type": "integer", "description": "counts the ticks handed to the log, from 0; a gap is a loss"},
  "tick": {"type": "integer"}, "now_ns": {"type": "integer"},
  "error": {"type": ["object", "string", "null"], "description": "why nothing was measured"},
  "operator": {"description": "event of the operator"},
  "chunk": {"type": ["object", "null"], "properties": {"sequence": {"type": "integer"},
    "record": {"type": ["integer", "null"], "description": "record of the chunk message; null if it was lost"}}},
  "enabled": {"type": "boolean", "description": "whether the drives were commanded to hold torque"}}}"#;

/// Describes `scene::SceneRecord`, and changes with it.
const TASK_SCHEMA: &str = r#"{"title": "trocar.Task", "type": "object",
"description": "Where everything in a simulated scene is at a policy step, and how its task stands. A pose has rotation (quaternion x, y, z, w) and translation (m), in the scene frame.",
"properties": {
  "moment_ms": {"type": "integer", "description": "age of the scene"},
  "things": {"type": "array", "items": {"type": "object"}}, "goal": {"type": "object"},
  "arms": {"type": "array", "items": {"type": "array", "minItems": 5, "maxItems": 5, "items": {"type": "object"},
    "description": "shaft, wrist, left finger, right finger, tip"}},
  "flap": {"type": ["object", "null"], "properties": {
    "nodes_m": {"type": "array", "items": {"type": "array", "minItems": 3, "maxItems": 3, "items": {"type": "number"}}},
    "mark_m": {"type": "array", "items": {"type": "number"}, "description": "in the material"}}},
  "task": {"type": "object", "properties": {
    "missing": {"type": "string", "description": "what success lacks, in words"},
    "criteria": {"type": "array", "items": {"type": "object", "properties": {
      "name": {"type": "string"}, "unit": {"type": "string"}, "value": {"type": ["number", "null"]},
      "goal": {"type": "number"}, "at_least": {"type": "boolean"}, "met": {"type": "boolean"}}}}}}}}"#;

const BUSES_SCHEMA: &str = r#"{"title": "trocar.Buses", "type": "object",
"description": "What the kernel counts on the CAN interfaces of the arms.",
"properties": {"buses": {"type": "array", "items": {"type": "object", "properties": {
  "interface": {"type": "string"},
  "frames_per_s": {"type": "number", "description": "of the last second, both ways"},
  "load": {"type": "number", "description": "share of the last second for which frames kept the bus busy at most, at its bit rate"},
  "errors": {"type": "integer", "description": "errors and dropped frames since the interface is there"}}}}}}"#;

/// Describes `snapshot::SnapshotMessage`, and changes with it.
const SNAPSHOT_SCHEMA: &str = r#"{"title": "trocar.Snapshot", "type": "object",
"description": "The controller's complete state between two ticks, from which a replay goes on: first in a file whose log's bound left out what came before, last in the file before it. Hexadecimal numbers have 16 digits.",
"properties": {
  "record": {"type": "integer", "description": "of the tick that follows"},
  "input_hash": {"type": "string", "description": "of everything that the controller was given before"},
  "command_hash": {"type": "string", "description": "of all commands before"},
  "layout": {"type": "string", "description": "hash over names, types and order of what is in the state"},
  "state": {"type": "string", "description": "words of 64 bits in hexadecimal, numbers by their bits"},
  "chunks": {"type": "array", "description": "chunks that may still count", "items": {"type": "object", "properties": {
    "arm": {"type": "integer", "description": "from 0"}, "slot": {"type": "integer", "description": "where the controller holds it"},
    "chunk": {"type": "object", "description": "as in trocar.Chunk"}}}}}}"#;
