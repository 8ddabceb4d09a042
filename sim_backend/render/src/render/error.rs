//! Why there is no image.
//!
//! [`RenderError::NoAdapter`] names what to install. [`RenderError::Device`] and
//! [`RenderError::Gpu`] are the driver's; all others are faults of the caller's input.

/// Why there is no image.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The Vulkan loader or every driver is missing.
    #[error(
        "no Vulkan device: install a GPU driver, or mesa-vulkan-drivers to render in software (see VK_DRIVER_FILES)"
    )]
    NoAdapter,
    /// The driver is there and refuses.
    #[error("the Vulkan device {adapter} can't be opened: {reason}")]
    Device {
        /// Which one.
        adapter: String,
        /// What it says.
        reason: String,
    },
    /// A mesh can't be drawn.
    #[error("mesh of {name}: {reason}")]
    Mesh {
        /// Name of the visual.
        name: &'static str,
        /// What is wrong.
        reason: &'static str,
    },
    /// The image is empty or larger than the device allows.
    #[error("image of {width} x {height} pixels: each side must be in 1..={max}")]
    ImageSize {
        /// Asked width.
        width: u32,
        /// Asked height.
        height: u32,
        /// Largest side.
        max: u32,
    },
    /// The caller's buffers do not fit the image.
    #[error("the buffers given are not for an image of {pixels} pixels")]
    Buffers {
        /// Pixels of the image.
        pixels: usize,
    },
    /// The camera can't be.
    #[error("camera: {0}")]
    Camera(&'static str),
    /// The light can't be.
    #[error("light: {0}")]
    Light(&'static str),
    /// One pose a visual is needed.
    #[error("{got} poses for {expected} visuals")]
    PoseCount {
        /// Visuals in the scene.
        expected: usize,
        /// Poses given.
        got: usize,
    },
    /// The device failed at work.
    #[error("Vulkan: {0}")]
    Gpu(String),
}
