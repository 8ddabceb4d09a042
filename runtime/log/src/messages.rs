//! The Foxglove messages that the log and live viewers use, as protobuf structs.
//!
//! Field numbers as in the schema files of `foxglove-sdk` (`schemas/proto/foxglove/*.proto`,
//! Foxglove SDK 0.30). They are stated here alone: [`super::descriptor`] tells readers the same
//! from [`FIELDS`].

use hal::TimeNs;
use hal::count::{count_u32, index};
use nalgebra::{Translation3, UnitQuaternion};
use prost::Message;

/// A message's fields as they are written here: name, kind with number, type.
pub(super) type Fields = &'static [(&'static str, &'static str, &'static str)];

/// Makes structs of messages, and keeps how their fields are written.
macro_rules! messages {
    ($($(#[$about:meta])* struct $name:ident { $(#[prost($($kind:tt)+)] $field:ident: $type:ty,)+ })+) => {
        $($(#[$about])* pub(super) struct $name { $(#[prost($($kind)+)] pub(super) $field: $type,)+ })+

        /// Every message by name, with its fields.
        pub(super) const FIELDS: &[(&str, Fields)] = &[
            $((stringify!($name), &[$((stringify!($field), stringify!($($kind)+), stringify!($type))),+]),)+
        ];
    };
}

messages! {
    /// A point in time: `google.protobuf.Timestamp`.
    #[derive(Clone, Copy, PartialEq, Message)]
    struct Timestamp {
        #[prost(int64, tag = "1")]
        seconds: i64,
        #[prost(int32, tag = "2")]
        nanos: i32,
    }

    /// One joint. Every value is `optional` on the wire, so that zero, negative zero and "not
    /// known" stay apart.
    #[derive(Clone, PartialEq, Message)]
    struct JointState {
        #[prost(string, tag = "1")]
        name: String,
        #[prost(double, optional, tag = "2")]
        position: Option<f64>,
        #[prost(double, optional, tag = "3")]
        velocity: Option<f64>,
        #[prost(double, optional, tag = "4")]
        acceleration: Option<f64>,
        #[prost(double, optional, tag = "5")]
        effort: Option<f64>,
    }

    /// Several joints at one time.
    #[derive(Clone, PartialEq, Message)]
    struct JointStates {
        #[prost(message, optional, tag = "1")]
        timestamp: Option<Timestamp>,
        #[prost(message, repeated, tag = "2")]
        joints: Vec<JointState>,
    }

    /// A point or a displacement.
    #[derive(Clone, Copy, PartialEq, Message)]
    struct Vector3 {
        #[prost(double, tag = "1")]
        x: f64,
        #[prost(double, tag = "2")]
        y: f64,
        #[prost(double, tag = "3")]
        z: f64,
    }

    /// A rotation.
    #[derive(Clone, Copy, PartialEq, Message)]
    struct Quaternion {
        #[prost(double, tag = "1")]
        x: f64,
        #[prost(double, tag = "2")]
        y: f64,
        #[prost(double, tag = "3")]
        z: f64,
        #[prost(double, tag = "4")]
        w: f64,
    }

    /// A pose.
    #[derive(Clone, Copy, PartialEq, Message)]
    struct Pose {
        #[prost(message, optional, tag = "1")]
        position: Option<Vector3>,
        #[prost(message, optional, tag = "2")]
        orientation: Option<Quaternion>,
    }

    /// A pose in a named frame at one time.
    #[derive(Clone, PartialEq, Message)]
    struct PoseInFrame {
        #[prost(message, optional, tag = "1")]
        timestamp: Option<Timestamp>,
        #[prost(string, tag = "2")]
        frame_id: String,
        #[prost(message, optional, tag = "3")]
        pose: Option<Pose>,
    }

    /// Where one frame is in another.
    #[derive(Clone, PartialEq, Message)]
    struct FrameTransform {
        #[prost(message, optional, tag = "1")]
        timestamp: Option<Timestamp>,
        #[prost(string, tag = "2")]
        parent_frame_id: String,
        #[prost(string, tag = "3")]
        child_frame_id: String,
        #[prost(message, optional, tag = "4")]
        translation: Option<Vector3>,
        #[prost(message, optional, tag = "5")]
        rotation: Option<Quaternion>,
    }

    /// Several of them.
    ///
    /// A log has them every 40 ticks and with each camera frame.
    #[derive(Clone, PartialEq, Message)]
    struct FrameTransforms {
        #[prost(message, repeated, tag = "1")]
        transforms: Vec<FrameTransform>,
    }

    /// A shape as a file.
    ///
    /// Binary glTF here: the bytes in `data`, the type in `media_type`.
    #[derive(Clone, PartialEq, Message)]
    struct ModelPrimitive {
        #[prost(message, optional, tag = "1")]
        pose: Option<Pose>,
        #[prost(message, optional, tag = "2")]
        scale: Option<Vector3>,
        #[prost(string, tag = "6")]
        media_type: String,
        #[prost(bytes = "vec", tag = "7")]
        data: Vec<u8>,
    }

    /// A point, m.
    #[derive(Clone, Copy, PartialEq, Message)]
    struct Point3 {
        #[prost(double, tag = "1")]
        x: f64,
        #[prost(double, tag = "2")]
        y: f64,
        #[prost(double, tag = "3")]
        z: f64,
    }

    /// A colour, sRGB, and how much it hides.
    #[derive(Clone, Copy, PartialEq, Message)]
    struct Color {
        #[prost(double, tag = "1")]
        r: f64,
        #[prost(double, tag = "2")]
        g: f64,
        #[prost(double, tag = "3")]
        b: f64,
        #[prost(double, tag = "4")]
        a: f64,
    }

    /// A shape as triangles, three indices each.
    #[derive(Clone, PartialEq, Message)]
    struct TriangleListPrimitive {
        #[prost(message, optional, tag = "1")]
        pose: Option<Pose>,
        #[prost(message, repeated, tag = "2")]
        points: Vec<Point3>,
        #[prost(message, optional, tag = "3")]
        color: Option<Color>,
        #[prost(fixed32, repeated, tag = "5")]
        indices: Vec<u32>,
    }

    /// What is in a frame.
    ///
    /// A later one with the same `id` takes its place. With `frame_locked` it moves along with its
    /// frame.
    #[derive(Clone, PartialEq, Message)]
    struct SceneEntity {
        #[prost(message, optional, tag = "1")]
        timestamp: Option<Timestamp>,
        #[prost(string, tag = "2")]
        frame_id: String,
        #[prost(string, tag = "3")]
        id: String,
        #[prost(bool, tag = "5")]
        frame_locked: bool,
        #[prost(message, repeated, tag = "12")]
        triangles: Vec<TriangleListPrimitive>,
        #[prost(message, repeated, tag = "14")]
        models: Vec<ModelPrimitive>,
    }

    /// Things that are new.
    #[derive(Clone, PartialEq, Message)]
    struct SceneUpdate {
        #[prost(message, repeated, tag = "2")]
        entities: Vec<SceneEntity>,
    }

    /// An image as a file's bytes.
    ///
    /// `format` is `png` in a log.
    #[derive(Clone, PartialEq, Message)]
    struct CompressedImage {
        #[prost(message, optional, tag = "1")]
        timestamp: Option<Timestamp>,
        #[prost(bytes = "vec", tag = "2")]
        data: Vec<u8>,
        #[prost(string, tag = "3")]
        format: String,
        #[prost(string, tag = "4")]
        frame_id: String,
    }

    /// The lens that took an image.
    #[expect(non_snake_case, reason = "the schema's names")]
    #[derive(Clone, PartialEq, Message)]
    struct CameraCalibration {
        #[prost(message, optional, tag = "1")]
        timestamp: Option<Timestamp>,
        #[prost(fixed32, tag = "2")]
        width: u32,
        #[prost(fixed32, tag = "3")]
        height: u32,
        #[prost(string, tag = "4")]
        distortion_model: String,
        #[prost(double, repeated, tag = "5")]
        D: Vec<f64>,
        #[prost(double, repeated, tag = "6")]
        K: Vec<f64>,
        #[prost(double, repeated, tag = "7")]
        R: Vec<f64>,
        #[prost(double, repeated, tag = "8")]
        P: Vec<f64>,
        #[prost(string, tag = "9")]
        frame_id: String,
    }

    /// A line of text.
    #[derive(Clone, PartialEq, Message)]
    struct Log {
        #[prost(message, optional, tag = "1")]
        timestamp: Option<Timestamp>,
        #[prost(enumeration = "LogLevel", tag = "2")]
        level: i32,
        #[prost(string, tag = "3")]
        message: String,
        #[prost(string, tag = "4")]
        name: String,
        #[prost(string, tag = "5")]
        file: String,
        #[prost(fixed32, tag = "6")]
        line: u32,
    }
}

/// How bad a [`Log`] is.
///
/// `foxglove.Log.Level`, by its numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, prost::Enumeration)]
#[repr(i32)]
pub(super) enum LogLevel {
    Unknown = 0,
    Debug = 1,
    Info = 2,
    Warning = 3,
    Error = 4,
    Fatal = 5,
}

/// Nanoseconds a second.
const NANOS: u64 = 1_000_000_000;

impl Timestamp {
    /// The same time; exact for every `TimeNs`.
    pub(super) fn new(time: TimeNs) -> Self {
        const { assert!(u64::MAX / NANOS < 1 << 35 && NANOS < 1 << 30) };
        Self {
            seconds: (time.0 / NANOS).cast_signed(),
            nanos: count_u32(index(time.0 % NANOS)).cast_signed(),
        }
    }

    /// Back to run time; `None` for a time before the run began or past the range.
    pub(super) fn time(self) -> Option<TimeNs> {
        let seconds = u64::try_from(self.seconds).ok()?;
        let nanos = u64::try_from(self.nanos).ok()?;
        Some(TimeNs(seconds.checked_mul(NANOS)?.checked_add(nanos)?))
    }
}

impl Pose {
    /// The same as numbers to compute with; `None` if a part of it is missing.
    ///
    /// The quaternion is normalised.
    pub(super) fn pose(&self) -> Option<hal::Pose> {
        let (at, turn) = (self.position?, self.orientation?);
        let turn = nalgebra::Quaternion::new(turn.w, turn.x, turn.y, turn.z);
        Some(hal::Pose::from_parts(
            Translation3::new(at.x, at.y, at.z),
            UnitQuaternion::new_normalize(turn),
        ))
    }
}

impl From<&hal::Pose> for Pose {
    fn from(pose: &hal::Pose) -> Self {
        let (p, q) = (pose.translation.vector, pose.rotation.coords);
        Self {
            position: Some(Vector3 {
                x: p.x,
                y: p.y,
                z: p.z,
            }),
            orientation: Some(Quaternion {
                x: q.x,
                y: q.y,
                z: q.z,
                w: q.w,
            }),
        }
    }
}
