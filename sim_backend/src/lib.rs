//! The simulated arm and the tasks: plant, contact physics, renderer, scripted experts.

pub mod visual;
