#![doc = include_str!("../README.md")]

pub mod dataset;
pub mod export;
pub mod import;
pub mod perception;
pub mod relative_action;
