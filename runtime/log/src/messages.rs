//! The Foxglove messages that the log uses, as protobuf structs.
//!
//! Field numbers as in the schema files of `foxglove-sdk` (`schemas/proto/foxglove/*.proto`, Foxglove SDK 0.30);
//! [`super::descriptor`] states the same numbers for readers; change both together.

use hal::TimeNs;
use hal::count::{count_u32, index};
use prost::Message;

/// A point in time: `google.protobuf.Timestamp`.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Timestamp {
    /// Whole seconds since the run began.
    #[prost(int64, tag = "1")]
    pub(super) seconds: i64,
    /// The rest, ns.
    #[prost(int32, tag = "2")]
    pub(super) nanos: i32,
}

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

/// One joint. Every value is `optional` on the wire, so that zero, negative zero and "not known" stay apart.
#[derive(Clone, PartialEq, Message)]
pub(super) struct JointState {
    #[prost(string, tag = "1")]
    pub(super) name: String,
    #[prost(double, optional, tag = "2")]
    pub(super) position: Option<f64>,
    #[prost(double, optional, tag = "3")]
    pub(super) velocity: Option<f64>,
    #[prost(double, optional, tag = "4")]
    pub(super) acceleration: Option<f64>,
    #[prost(double, optional, tag = "5")]
    pub(super) effort: Option<f64>,
}

/// Several joints at one time.
#[derive(Clone, PartialEq, Message)]
pub(super) struct JointStates {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(message, repeated, tag = "2")]
    pub(super) joints: Vec<JointState>,
}

/// A point or a displacement.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Vector3 {
    #[prost(double, tag = "1")]
    pub(super) x: f64,
    #[prost(double, tag = "2")]
    pub(super) y: f64,
    #[prost(double, tag = "3")]
    pub(super) z: f64,
}

/// A rotation.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Quaternion {
    #[prost(double, tag = "1")]
    pub(super) x: f64,
    #[prost(double, tag = "2")]
    pub(super) y: f64,
    #[prost(double, tag = "3")]
    pub(super) z: f64,
    #[prost(double, tag = "4")]
    pub(super) w: f64,
}

/// A pose.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Pose {
    #[prost(message, optional, tag = "1")]
    pub(super) position: Option<Vector3>,
    #[prost(message, optional, tag = "2")]
    pub(super) orientation: Option<Quaternion>,
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

/// A pose in a named frame at one time.
#[derive(Clone, PartialEq, Message)]
pub(super) struct PoseInFrame {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    #[prost(message, optional, tag = "3")]
    pub(super) pose: Option<Pose>,
}

/// Where one frame is in another.
#[derive(Clone, PartialEq, Message)]
pub(super) struct FrameTransform {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) parent_frame_id: String,
    #[prost(string, tag = "3")]
    pub(super) child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    pub(super) translation: Option<Vector3>,
    #[prost(message, optional, tag = "5")]
    pub(super) rotation: Option<Quaternion>,
}

/// Several of them.
#[derive(Clone, PartialEq, Message)]
pub(super) struct FrameTransforms {
    #[prost(message, repeated, tag = "1")]
    pub(super) transforms: Vec<FrameTransform>,
}

/// A shape as a file.
#[derive(Clone, PartialEq, Message)]
pub(super) struct ModelPrimitive {
    #[prost(message, optional, tag = "1")]
    pub(super) pose: Option<Pose>,
    #[prost(message, optional, tag = "2")]
    pub(super) scale: Option<Vector3>,
    #[prost(string, tag = "6")]
    pub(super) media_type: String,
    #[prost(bytes = "vec", tag = "7")]
    pub(super) data: Vec<u8>,
}

/// What is in a frame.
#[derive(Clone, PartialEq, Message)]
pub(super) struct SceneEntity {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    #[prost(string, tag = "3")]
    pub(super) id: String,
    #[prost(bool, tag = "5")]
    pub(super) frame_locked: bool,
    #[prost(message, repeated, tag = "14")]
    pub(super) models: Vec<ModelPrimitive>,
}

/// Things that are new.
#[derive(Clone, PartialEq, Message)]
pub(super) struct SceneUpdate {
    #[prost(message, repeated, tag = "2")]
    pub(super) entities: Vec<SceneEntity>,
}

/// An image as a file's bytes.
#[derive(Clone, PartialEq, Message)]
pub(super) struct CompressedImage {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(bytes = "vec", tag = "2")]
    pub(super) data: Vec<u8>,
    #[prost(string, tag = "3")]
    pub(super) format: String,
    #[prost(string, tag = "4")]
    pub(super) frame_id: String,
}

/// The lens that took an image. The one-letter names are the schema's.
#[derive(Clone, PartialEq, Message)]
pub(super) struct CameraCalibration {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(fixed32, tag = "2")]
    pub(super) width: u32,
    #[prost(fixed32, tag = "3")]
    pub(super) height: u32,
    #[prost(string, tag = "4")]
    pub(super) distortion_model: String,
    #[prost(double, repeated, tag = "5")]
    pub(super) d: Vec<f64>,
    #[prost(double, repeated, tag = "6")]
    pub(super) k: Vec<f64>,
    #[prost(double, repeated, tag = "7")]
    pub(super) r: Vec<f64>,
    #[prost(double, repeated, tag = "8")]
    pub(super) p: Vec<f64>,
    #[prost(string, tag = "9")]
    pub(super) frame_id: String,
}

/// A line of text. `level` is 2 for information, 3 for a warning, 4 for an error.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Log {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(int32, tag = "2")]
    pub(super) level: i32,
    #[prost(string, tag = "3")]
    pub(super) message: String,
    #[prost(string, tag = "4")]
    pub(super) name: String,
    #[prost(string, tag = "5")]
    pub(super) file: String,
    #[prost(fixed32, tag = "6")]
    pub(super) line: u32,
}
