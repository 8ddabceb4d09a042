#![doc = include_str!("../README.md")]

pub mod arbitrary;
pub mod bus_load;
pub mod bytes;
pub mod cia301;
pub mod cia402;
pub mod frame;
pub mod index;
pub mod master;
pub mod number;
mod outbox;
pub mod socket;

pub use frame::{CanId, Frame, NodeId, Payload, WireError};
pub use outbox::Outbox;
