#![doc = include_str!("../README.md")]

pub mod act;
pub mod act_pc;
pub mod act_pc_policy;
pub mod act_policy;
mod by_name;
pub mod checkpoint;
pub mod compute;
pub mod dataset;
pub mod dp3;
pub mod dp3_policy;
pub mod ensemble;
pub mod images;
pub mod import;
mod kernels;
mod layers;
pub mod loaded_policy;
pub mod normalise;
pub mod parameters;
pub mod perception;
mod recorded;
pub mod relative_action;
pub mod train;
