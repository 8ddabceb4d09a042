#![doc = include_str!("../README.md")]

pub mod dictionary;
pub mod motor;
pub mod network;
pub mod node;
pub mod station;
pub mod wire;

pub use motor::{IdealMotor, Motor, Terminal};
pub use network::{Network, Tampering};
pub use node::{AxisConfig, Demand, Feedback, Node};
pub use station::Station;
pub use wire::Wire;

#[cfg(test)]
mod tests;
