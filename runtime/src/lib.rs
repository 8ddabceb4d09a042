#![doc = include_str!("../README.md")]

pub mod doctor;
pub mod histogram;
pub mod log;
pub mod mailbox;
pub mod replay;
pub mod report;
pub mod rt;
pub mod session;
pub mod study;
pub mod verify;

pub use trocar_control as control;
pub use trocar_control::{kinematics, per_arm};
