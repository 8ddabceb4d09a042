//! What can be wrong with an episode or its pictures.

use trocar_render::RenderError;

/// Why there is no episode or no image of it.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// The renderer can't be had or failed.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The episode runs without cameras.
    #[error("this simulation was made without rendering")]
    RenderingOff,
    /// The scene lacks the arm that carries the camera.
    #[error("camera {camera} is carried by arm {arm}, which is not there")]
    NoCarrier {
        /// The camera.
        camera: String,
        /// Its arm, counted from 0.
        arm: usize,
    },
    /// There is no such camera.
    #[error("camera {index} of {count}")]
    NoSuchCamera {
        /// The requested one.
        index: usize,
        /// How many there are.
        count: usize,
    },
}
