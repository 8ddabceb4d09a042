#![doc = include_str!("../README.md")]

pub mod act;
pub mod act_pc;
pub mod act_pc_policy;
pub mod act_policy;
pub mod by_name;
pub mod checkpoint;
pub mod compute;
pub mod cuda_graph;
pub mod dimension;
pub mod dp3;
pub mod dp3_policy;
pub mod ensemble;
pub mod generator;
pub mod images;
mod interface;
pub mod kernels;
mod layers;
pub mod loaded_policy;
pub mod normalise;
pub mod parameters;
pub mod segmenter;
