//! Procedural patients: a seed gives a torso with organs, vessels and bones, as a CT and its
//! labels.
//!
//! Shapes stand in one nominal anatomy. A patient varies sizes and places of organs, as far as no
//! two of them come to overlap, and then maps the whole by a smooth invertible deformation, which
//! can't make disjoint shapes meet.

mod anatomy;
mod paint;
mod patient;
mod shape;

#[cfg(test)]
mod tests;

pub use paint::{PartVolume, Phantom, Scan, Size, scan, write};
pub use patient::Patient;
