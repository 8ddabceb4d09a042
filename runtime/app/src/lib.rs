#![doc = include_str!("../README.md")]

pub mod console;
pub mod digest;
pub mod doctor;
pub mod histogram;
pub mod mailbox;
pub mod monitor;
pub mod report;
mod rig;
pub mod rt;
pub mod session;
pub mod study;
