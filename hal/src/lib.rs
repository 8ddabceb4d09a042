#![doc = include_str!("../README.md")]

pub mod arm;
pub mod camera;
pub mod chunk;
pub mod config;
pub mod joints;
pub mod policy;
pub mod psm;
pub mod random;
pub mod tail;
pub mod time;

pub use arm::{ARM_NAMES, Arm, ArmCommand, ArmError, ArmState};
pub use camera::{CameraFrame, FrameRef, Intrinsics};
pub use chunk::{Chunk, TipTarget};
pub use joints::{JOINT_COUNT, JointVector, Pose};
pub use policy::{Observation, Policy, PolicyError, SeenArm};
pub use tail::SafeTail;
pub use time::{TICK_NS, TimeNs};
