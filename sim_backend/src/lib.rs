#![doc = include_str!("../README.md")]

pub mod block;
pub mod cameras;
pub mod disturbance;
pub mod expert;
pub mod needle;
pub mod organ;
pub mod plant;
pub mod render;
pub mod rng;
pub mod shapes;
pub mod simulation;
pub mod task;
pub mod tissue;
pub mod visual;
pub mod world;
