#![doc = include_str!("../README.md")]

pub mod arm;
pub mod camera;
pub mod chunk;
pub mod config;
pub mod count;
pub mod files;
pub mod joints;
pub mod mesh;
pub mod per_arm;
pub mod policy;
pub mod psm;
pub mod random;
pub mod rig;
pub mod tail;
pub mod time;

pub use arm::{ARM_NAMES, Arm, ArmCommand, ArmError, ArmState, arm_names};
pub use camera::{CameraFrame, Distortion, FrameRef, Intrinsics};
pub use chunk::{Chunk, TipTarget};
pub use joints::{JOINT_COUNT, JointVector, Pose};
pub use mesh::Mesh;
pub use per_arm::{ARMS_MAX, PerArm};
pub use policy::{ArmObservation, Observation, POLICY_STEP_NS, Policy, PolicyError};
pub use rig::{Measured, Period, Rig, Setpoint};
pub use tail::SafeTail;
pub use time::{TICK_NS, TICK_S, TimeNs};
