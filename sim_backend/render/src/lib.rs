#![doc = include_str!("../README.md")]

mod render;
pub mod shapes;
pub mod visual;

pub use render::{Camera, Light, Optics, Planes, RenderError, Renderer, Shading, look_at};
