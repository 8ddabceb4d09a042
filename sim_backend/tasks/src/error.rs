//! What can be wrong with an episode or its pictures.

use trocar_render::RenderError;

/// Why there is no episode or no image of it.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// The renderer can't be had or failed.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// An image was asked of an episode that runs without cameras.
    #[error("this simulation was made without rendering")]
    RenderingOff,
    /// A wrist camera was asked for an image of a scene without its arm.
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
        /// The one asked for.
        index: usize,
        /// How many there are.
        count: usize,
    },
}
