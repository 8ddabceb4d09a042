//! Learned policies: perception, networks, checkpoints, datasets, training.

pub mod act;
pub mod act_policy;
pub mod checkpoint;
pub mod dataset;
pub mod images;
pub mod normalise;
pub mod parameters;
pub mod perception;
pub mod relative_action;
pub mod rng;
pub mod train;
