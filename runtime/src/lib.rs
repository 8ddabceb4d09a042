//! The control runtime: kinematics, aggregation, safety, real-time loop, log, replay, and the `trocar` binary.

pub mod control;
pub mod doctor;
pub mod histogram;
pub mod kinematics;
pub mod log;
pub mod mailbox;
pub mod per_arm;
pub mod replay;
pub mod report;
pub mod rt;
pub mod session;
pub mod study;
pub mod verify;
