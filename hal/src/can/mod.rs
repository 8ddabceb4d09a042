//! CANopen: the codecs, an emulated drive, a model of the bus and the master of an arm.
//!
//! Read in this order: [`frame`] is what is on the wire, [`cia301`] and [`cia402`] are what the frames mean, [`od`] are
//! the values that an emulated drive has to offer. Nothing here
//! opens a socket or reads a clock, and the codecs take no memory.

pub mod bus;
pub mod cia301;
pub mod cia402;
pub mod frame;
pub mod master;
pub mod node;
mod number;
pub mod od;
mod outbox;
pub mod socket;

pub use frame::{CanId, Frame, NodeId, Payload, WireError};
pub use outbox::Outbox;

#[cfg(test)]
mod random;
