//! Camera frames: colour, metric depth and instance ids, with the camera that took them.

use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

use crate::{Pose, TimeNs};

/// Pinhole intrinsics in pixels; pixel centres lie at half-integers, x to the right, y down.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/intrinsics/1")]
pub struct Intrinsics {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point x, pixels.
    pub cx: f64,
    /// Principal point y, pixels.
    pub cy: f64,
}

impl Intrinsics {
    /// Square pixels, principal point in the middle, the given vertical field of view.
    #[must_use]
    pub fn from_vertical_fov(width: u32, height: u32, fov_rad: f64) -> Self {
        let fy = 0.5 * f64::from(height) / (0.5 * fov_rad).tan();
        Self {
            width,
            height,
            fx: fy,
            fy,
            cx: 0.5 * f64::from(width),
            cy: 0.5 * f64::from(height),
        }
    }

    /// Pixels in one image.
    #[must_use]
    pub const fn pixel_count(&self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// One image from one camera, row-major from the top left.
#[derive(Clone, Debug)]
pub struct CameraFrame {
    /// When it was taken.
    pub stamp: TimeNs,
    /// Count of frames from this camera.
    pub sequence: u64,
    /// The lens.
    pub intrinsics: Intrinsics,
    /// Camera pose in the scene frame: x right, y down, z along the view.
    pub camera_in_scene: Pose,
    /// sRGB bytes, 3 a pixel.
    pub colour: Vec<u8>,
    /// Distance along the camera's z axis, metres; 0 where nothing was hit.
    pub depth_m: Vec<f32>,
    /// Instance id of what was hit; 0 is background.
    pub instance: Vec<u8>,
}

impl CameraFrame {
    /// A black frame with room for the image, to be filled in place.
    #[must_use]
    pub fn blank(intrinsics: Intrinsics) -> Self {
        let pixels = intrinsics.pixel_count();
        Self {
            stamp: TimeNs(0),
            sequence: 0,
            intrinsics,
            camera_in_scene: Pose::identity(),
            colour: vec![0; 3 * pixels],
            depth_m: vec![0.0; pixels],
            instance: vec![0; pixels],
        }
    }
}

/// A frame that lies elsewhere, in shared memory for example.
#[derive(Clone, Copy, Debug)]
pub struct FrameRef<'a> {
    /// When it was taken.
    pub stamp: TimeNs,
    /// Count of frames from this camera.
    pub sequence: u64,
    /// The lens.
    pub intrinsics: Intrinsics,
    /// Camera pose in the scene frame: x right, y down, z along the view.
    pub camera_in_scene: Pose,
    /// sRGB bytes, 3 a pixel.
    pub colour: &'a [u8],
    /// Distance along the camera's z axis, metres; 0 where nothing was hit.
    pub depth_m: &'a [f32],
    /// Instance id of what was hit; 0 is background.
    pub instance: &'a [u8],
}

impl CameraFrame {
    /// This frame, borrowed.
    #[must_use]
    pub fn as_frame(&self) -> FrameRef<'_> {
        FrameRef {
            stamp: self.stamp,
            sequence: self.sequence,
            intrinsics: self.intrinsics,
            camera_in_scene: self.camera_in_scene,
            colour: &self.colour,
            depth_m: &self.depth_m,
            instance: &self.instance,
        }
    }
}
