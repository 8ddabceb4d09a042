//! A camera of a task: where it stands and what its lens is like.

use core::f64::consts::PI;

use hal::Intrinsics;
use hal::config::{ConfigError, Source};
use serde::Deserialize;

/// A fixed camera.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Name, as observations and datasets call it.
    pub name: String,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Vertical field of view, rad.
    pub vertical_fov_rad: f64,
    /// Where the lens is, scene frame, m.
    pub eye_m: [f64; 3],
    /// The point in the middle of the image, scene frame, m.
    pub target_m: [f64; 3],
    /// The direction that is up in the image, scene frame.
    pub up: [f64; 3],
}

impl CameraConfig {
    /// The lens.
    #[must_use]
    pub fn intrinsics(&self) -> Intrinsics {
        Intrinsics::from_vertical_fov(self.width, self.height, self.vertical_fov_rad)
    }

    /// Checks every number; `index` counts the cameras of the file from 0.
    pub(super) fn check(&self, source: &Source, index: usize) -> Result<(), ConfigError> {
        let key = |name: &str| format!("camera.{index}.{name}");
        source.check_range(&key("width"), f64::from(self.width), 16.0, 4096.0)?;
        source.check_range(&key("height"), f64::from(self.height), 16.0, 4096.0)?;
        source.check_range(
            &key("vertical_fov_rad"),
            self.vertical_fov_rad,
            0.05,
            0.9 * PI,
        )?;
        for axis in 0..3 {
            source.check_range(&key(&format!("eye_m.{axis}")), self.eye_m[axis], -2.0, 2.0)?;
            source.check_range(
                &key(&format!("target_m.{axis}")),
                self.target_m[axis],
                -2.0,
                2.0,
            )?;
            source.check_range(&key(&format!("up.{axis}")), self.up[axis], -1.0, 1.0)?;
        }
        let view = nalgebra::Vector3::from(self.target_m) - nalgebra::Vector3::from(self.eye_m);
        let up = nalgebra::Vector3::from(self.up);
        if view.cross(&up).norm() < 1e-3 * view.norm().max(1e-3) {
            return Err(source.out_of_range(
                &key("up"),
                &format!("{:?}", self.up),
                "directions across the view",
            ));
        }
        Ok(())
    }
}
