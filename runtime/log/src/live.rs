//! The log's topics for whoever looks on, while the run goes on or at its log: channels with their
//! schemas, and messages one by one.
//!
//! The messages are made as those of the log; besides there are shapes, and images that a viewer
//! may get as JPEG. Nothing here sends anything. Each function allocates its answer.

use hal::{Intrinsics, Pose, TimeNs};
use prost::Message;

use super::camera;
use super::frames::{RCM_FRAMES, measured_tip, of_arms, transform};
use super::joints::JointMessages;
use super::json::{TimingMessage, encoded};
use super::level::Level;
use super::messages::{
    Color, CompressedImage, FrameTransforms, JointState, JointStates, ModelPrimitive, Point3,
    SceneEntity, SceneUpdate, Timestamp, TriangleListPrimitive, Vector3,
};
use super::record::TickRecord;
use super::safety::SafetyMessage;
use super::topic::{Schema, Topic, pose_topic};

pub use super::frames::SCENE;
pub use super::happened::StateChanges;
pub use super::topic::{
    BUSES, EVENTS, SHAPES, TASK, TRANSFORMS, camera_of, image_topic, lens_topic,
};

/// A topic, and how its messages are encoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Its name.
    pub topic: String,
    /// Of its messages: `protobuf` or `json`.
    pub encoding: &'static str,
    /// What its messages are called.
    pub schema_name: &'static str,
    /// Of the schema: `protobuf` or `jsonschema`.
    pub schema_encoding: &'static str,
    /// The schema itself.
    pub schema: Vec<u8>,
}

impl Channel {
    fn new(topic: &str, schema: Schema) -> Self {
        let (encoding, schema_name, schema_encoding, schema) = match schema {
            Schema::Protobuf(name) => {
                let descriptors = super::descriptor::file_descriptor_set();
                ("protobuf", name, "protobuf", descriptors)
            }
            Schema::Json(name, text) => ("json", name, "jsonschema", text.as_bytes().to_vec()),
        };
        Self {
            topic: topic.to_owned(),
            encoding,
            schema_name,
            schema_encoding,
            schema,
        }
    }
}

/// The topics of a run with so many arms and these cameras.
#[must_use]
pub fn of_run(arms: usize, cameras: &[String]) -> Vec<Channel> {
    let topics = [
        Topic::MeasuredJs,
        Topic::SetpointJs,
        Topic::MeasuredCp,
        Topic::Jaw,
        Topic::Safety,
        Topic::Timing,
        Topic::Events,
        Topic::Transforms,
    ];
    with_shapes(channels(&topics, arms, cameras))
}

/// The topics of emulated drives of so many arms, in a world with these cameras.
#[must_use]
pub fn of_drives(arms: usize, cameras: &[String]) -> Vec<Channel> {
    let topics = [
        Topic::MeasuredJs,
        Topic::SetpointJs,
        Topic::Events,
        Topic::Transforms,
    ];
    with_shapes(channels(&topics, arms, cameras))
}

/// The topics of a log of so many arms and these cameras, that of buses if these `are_told` of.
#[must_use]
pub fn of_log(arms: usize, cameras: &[String], are_told: bool) -> Vec<Channel> {
    let topics = Topic::ALL.into_iter();
    let topics = topics.filter(|topic| match topic {
        Topic::Buses => are_told,
        // Nobody but a replay reads it.
        Topic::Snapshot => false,
        Topic::MeasuredJs
        | Topic::SetpointJs
        | Topic::MeasuredCp
        | Topic::Jaw
        | Topic::Chunk
        | Topic::Safety
        | Topic::Timing
        | Topic::Tick
        | Topic::Events
        | Topic::Transforms
        | Topic::Task => true,
    });
    let mut channels = channels(&topics.collect::<Vec<_>>(), arms, cameras);
    let pose = Schema::Protobuf("foxglove.PoseInFrame");
    let poses = cameras.iter().map(|camera| pose_topic(camera));
    channels.extend(poses.map(|topic| Channel::new(&topic, pose)));
    channels
}

/// Channels of `topics` for so many arms, then image and lens of each camera.
fn channels(topics: &[Topic], arms: usize, cameras: &[String]) -> Vec<Channel> {
    let names = topics.iter().flat_map(|topic| {
        let names = topic.names().iter().take(arms);
        names.map(move |name| Channel::new(name, topic.schema()))
    });
    let mut channels: Vec<Channel> = names.collect();
    for camera in cameras {
        let image = Schema::Protobuf("foxglove.CompressedImage");
        let lens = Schema::Protobuf("foxglove.CameraCalibration");
        channels.push(Channel::new(&image_topic(camera), image));
        channels.push(Channel::new(&lens_topic(camera), lens));
    }
    channels
}

/// Shapes are no topic of the log: a log names the scene by its task.
fn with_shapes(mut channels: Vec<Channel>) -> Vec<Channel> {
    let shapes = Schema::Protobuf("foxglove.SceneUpdate");
    channels.push(Channel::new(SHAPES, shapes));
    channels
}

/// What `/events` says.
#[must_use]
pub fn event(at: TimeNs, level: Level, text: &str) -> Vec<u8> {
    level.line(at, text.to_owned()).encode_to_vec()
}

/// An axis of drives: its name, where it is and where it is wanted, rad or m, as far as that is
/// known.
pub type Axis<'a> = (&'a str, Option<f64>, Option<f64>);

/// Where the axes of the arm `arm` are, and where its drives want them, each message with its
/// topic.
#[must_use]
pub fn axes<'a>(
    at: TimeNs,
    arm: usize,
    axes: impl Iterator<Item = Axis<'a>> + Clone,
) -> Vec<(&'static str, Vec<u8>)> {
    let joints = |position: fn(Axis<'a>) -> Option<f64>| {
        let positions = axes.clone().map(|axis| (axis.0, position(axis)));
        joint_states(at, positions)
    };
    let messages = [
        (Topic::MeasuredJs, joints(|(_, position, _)| position)),
        (Topic::SetpointJs, joints(|(_, _, wanted)| wanted)),
    ];
    let named = messages.into_iter().filter_map(|(topic, joints)| {
        let name = topic.names().get(arm)?;
        Some((*name, joints.encode_to_vec()))
    });
    named.collect()
}

/// Joints by name and position, rad or m, as far as that is known.
fn joint_states<'a>(
    at: TimeNs,
    positions: impl Iterator<Item = (&'a str, Option<f64>)>,
) -> JointStates {
    let joints = positions.map(|(name, position)| JointState {
        name: name.to_owned(),
        position,
        ..JointState::default()
    });
    JointStates {
        timestamp: Some(Timestamp::new(at)),
        joints: joints.collect(),
    }
}

/// What `tick` says of the safety of each arm, with its topic.
///
/// JSON; equal reports have equal bytes.
pub fn safety(tick: &TickRecord) -> impl Iterator<Item = (&'static str, Vec<u8>)> {
    let arms = tick.arms.iter().zip(Topic::Safety.names());
    arms.map(|(arm, name)| {
        let safety = SafetyMessage::new(tick.tick, &arm.report);
        (*name, encoded(&safety))
    })
}

/// The messages of `tick`, each with its topic; the one before in this stream was at `previous`,
/// and the arms' remote centres are at `rcms_in_scene`.
///
/// Unlike in the log, coordinate frames come with every tick.
#[must_use]
pub fn tick(
    tick: &TickRecord,
    previous: TimeNs,
    rcms_in_scene: &[Pose],
) -> Vec<(&'static str, Vec<u8>)> {
    let mut messages = Vec::new();
    add_arms(tick, &mut messages);
    messages.extend(safety(tick));
    let timing = TimingMessage::new(tick, previous);
    let timing = encoded(&timing);
    messages.extend(Topic::Timing.names().first().map(|name| (*name, timing)));
    let transforms = of_arms(tick, rcms_in_scene).encode_to_vec();
    messages.push((TRANSFORMS, transforms));
    messages
}

/// Adds measurement and set-point of each arm to `messages`.
///
/// Without a measurement these are set-point and jaw alone; the pose of the tip needs a finite one.
fn add_arms(tick: &TickRecord, messages: &mut Vec<(&'static str, Vec<u8>)>) {
    let mut joints = JointMessages::new();
    for (index, arm) in tick.arms.iter().enumerate() {
        let mut add = |topic: Topic, bytes: Vec<u8>| {
            messages.extend(topic.names().get(index).map(|name| (*name, bytes)));
        };
        let measured = arm.measured.as_ref().ok();
        joints.set_measured(measured);
        joints.set_command(&arm.command);
        if let Some(state) = measured {
            add(Topic::MeasuredJs, joints.measured.encode_to_vec());
            if let (true, Some(frame)) = (state.is_finite(), RCM_FRAMES.get(index)) {
                let tip = measured_tip(frame, state);
                add(Topic::MeasuredCp, tip.encode_to_vec());
            }
        }
        add(Topic::SetpointJs, joints.setpoint.encode_to_vec());
        add(Topic::Jaw, joints.jaw.encode_to_vec());
    }
}

/// Where frames are in the scene at `at`.
#[must_use]
pub fn transforms<'a>(at: TimeNs, frames: impl Iterator<Item = (&'a str, Pose)>) -> Vec<u8> {
    let transforms = frames.map(|(name, pose)| transform(at, (SCENE, name), &pose));
    let transforms = transforms.collect();
    FrameTransforms { transforms }.encode_to_vec()
}

/// An image of `camera`, compressed as `format` says (`jpeg` or `png`).
#[must_use]
pub fn image(at: TimeNs, camera: &str, format: &str, data: &[u8]) -> Vec<u8> {
    let image = CompressedImage {
        timestamp: Some(Timestamp::new(at)),
        data: data.to_vec(),
        format: format.to_owned(),
        frame_id: camera.to_owned(),
    };
    image.encode_to_vec()
}

/// The lens of `camera`.
#[must_use]
pub fn lens(at: TimeNs, camera: &str, intrinsics: &Intrinsics) -> Vec<u8> {
    camera::lens(at, camera, intrinsics).encode_to_vec()
}

/// Shapes, each a binary glTF file in a frame of its own that it moves with.
#[must_use]
pub fn shapes<'a>(at: TimeNs, shapes: impl Iterator<Item = (&'a str, &'a [u8])>) -> Vec<u8> {
    let one = Vector3 {
        x: 1.0,
        y: 1.0,
        z: 1.0,
    };
    let entities = shapes.map(|(frame, file)| SceneEntity {
        models: vec![ModelPrimitive {
            pose: Some((&Pose::identity()).into()),
            scale: Some(one),
            media_type: "model/gltf-binary".to_owned(),
            data: file.to_vec(),
        }],
        ..entity(at, frame)
    });
    let entities = entities.collect();
    SceneUpdate { entities }.encode_to_vec()
}

/// A shape that bends, as it is at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct BentShape<'a> {
    /// Its frame, which its vertices are in.
    pub frame: &'a str,
    /// Vertices, m.
    pub positions: Vec<[f32; 3]>,
    /// Three indices a triangle.
    pub indices: &'a [u32],
    /// sRGB, 0 to 1.
    pub colour: [f32; 3],
}

/// Shapes that bend, as they are at `at`, each in place of the same shape of before.
#[must_use]
pub fn bent<'a>(at: TimeNs, shapes: impl Iterator<Item = BentShape<'a>>) -> Vec<u8> {
    let entities = shapes.map(|shape| {
        let points = shape.positions.iter().map(|position| {
            let [x, y, z] = position.map(f64::from);
            Point3 { x, y, z }
        });
        let [r, g, b] = shape.colour.map(f64::from);
        let triangles = TriangleListPrimitive {
            pose: Some((&Pose::identity()).into()),
            points: points.collect(),
            color: Some(Color { r, g, b, a: 1.0 }),
            indices: shape.indices.to_vec(),
        };
        SceneEntity {
            triangles: vec![triangles],
            ..entity(at, shape.frame)
        }
    });
    let entities = entities.collect();
    SceneUpdate { entities }.encode_to_vec()
}

/// What moves with `frame`, and is called by its name; nothing yet.
fn entity(at: TimeNs, frame: &str) -> SceneEntity {
    SceneEntity {
        timestamp: Some(Timestamp::new(at)),
        frame_id: frame.to_owned(),
        id: frame.to_owned(),
        frame_locked: true,
        ..SceneEntity::default()
    }
}
