//! CANopen: the codecs, an emulated drive, a model of the bus, and the master of an arm.
//!
//! Read in this order: [`frame`] is what is on the wire, [`cia301`] and [`cia402`] are what the frames mean, in codecs that
//! take no memory. [`od`] are the values that an emulated drive has to offer and [`node`] is the drive, a state machine
//! without clock or socket. [`bus`] is the time that frames take, and drives on such buses. [`master`] leads drives, be
//! they emulated or real, and makes a [`hal::Arm`](crate::Arm) of seven of them. [`socket`] are the buses of Linux; it
//! alone makes system calls, and nothing here reads a clock.

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
