//! Anatomy.

pub mod grid;
pub mod groups;
pub mod nifti;
pub mod phantom;
pub mod volume;
pub mod clean;
pub mod surface;
pub mod complex;
mod smooth;
mod balance;
pub mod decimate;
mod geometry;
pub mod mesh;
pub mod atlas;
pub mod measure;
pub mod assets;
pub mod build;
mod number;
