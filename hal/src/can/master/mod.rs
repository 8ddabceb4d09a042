//! The master of an arm.

pub mod link;

pub use link::{Bus, Received, Trouble};
