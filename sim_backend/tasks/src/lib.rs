#![doc = include_str!("../README.md")]

pub mod cameras;
#[cfg(test)]
mod closed_loop;
pub mod disturbance;
mod error;
pub mod expert;
pub mod scene;
mod script;
pub mod simulation;
pub mod task;

pub use error::SimulationError;
