//! Soft tissue: an elastic flap over an organ, grasped by area.

mod bending;
mod config;
mod contact;
mod flap;
mod grasp;
mod ground;
mod jaw;
mod mark;
mod material;
mod membrane;
mod report;
mod retraction;
mod samples;
mod sheet;
mod surface;

pub use config::TissueConfig;
pub use flap::Tissue;
pub use grasp::GraspConfig;
pub use ground::{Ground, Touch};
pub use jaw::{JawInput, Wrench};
pub use mark::MarkConfig;
pub use material::Material;
pub use report::{Grasp, JawReport, TissueReport};
pub use retraction::{Retraction, RetractionConfig, RetractionFailure, RetractionMonitor};
pub use sheet::{Sheet, SheetShape};
pub use surface::Surface;

#[cfg(test)]
mod tests;
