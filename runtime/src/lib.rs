//! The control runtime: kinematics, aggregation, safety, real-time loop, log, replay, and the `trocar` binary.

pub mod doctor;
pub mod histogram;
pub mod mailbox;
pub mod rt;
