#![doc = include_str!("../README.md")]

pub mod assets;
pub mod atlas;
mod balance;
pub mod build;
pub mod clean;
pub mod ct;
pub mod decimate;
pub mod dicom;
mod geometry;
pub mod grid;
pub mod groups;
mod hounsfield;
pub mod measure;
pub mod mesh;
pub mod nifti;
mod number;
pub mod overlap;
pub mod phantom;
mod smooth;
pub mod surface;
pub mod tetra;
pub mod texture;
pub mod volume;
