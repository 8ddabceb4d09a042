//! The shared vocabulary of Trocar.
//!
//! Read in this order: [`time`] and [`joints`] name what is counted and measured, [`psm`] is the arm as data,
//! [`arm`] is the seam to a robot and [`tail`] the stop that it can finish alone, [`camera`] and [`chunk`] are what a
//! policy sees and says, and [`policy`] is the seam to whatever does the saying. This crate knows no physics, no networks
//! and no control. [`can`] is the arm on a CAN bus and the drives that one finds there.

pub mod arm;
pub mod camera;
pub mod can;
pub mod chunk;
pub mod config;
pub mod joints;
pub mod policy;
pub mod psm;
pub mod tail;
pub mod time;

pub use arm::{ARM_NAMES, Arm, ArmCommand, ArmError, ArmState};
pub use camera::{CameraFrame, FrameRef, Intrinsics};
pub use chunk::{Chunk, TipTarget};
pub use joints::{JOINT_COUNT, JointVector, Pose};
pub use policy::{Observation, Policy, PolicyError, SeenArm};
pub use tail::SafeTail;
pub use time::{TICK_NS, TimeNs};
