//! Anatomy.

pub mod grid;
pub mod groups;
pub mod nifti;
mod number;
pub mod phantom;
