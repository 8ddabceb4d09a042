//! Studies: a grid of recordings, trainings and evaluations, made cell by cell by child processes
//! of this program.
//!
//! A cell's address is the hash of everything that makes it, so that what is done is never done
//! again, in whichever study or shard it is needed; one that was cut off goes on; one that fails
//! hinders only what depends on it.

pub mod address;
pub mod axis;
mod check;
pub mod child;
pub mod commands;
mod error;
pub mod estimate;
mod expand;
pub mod file;
pub mod files;
pub mod gpu;
pub mod job;
mod materials;
mod places;
pub mod plan;
mod result;
pub mod run;
mod scenes;
pub mod schedule;
pub mod session;
pub mod store;
pub mod work;

#[cfg(test)]
mod tests;

pub use error::StudyError;
pub use expand::expand;
pub use materials::{Materials, code_of};
