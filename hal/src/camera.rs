//! Camera frames: colour, metric depth and instance ids, with the camera that took them.

use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

use crate::{Pose, TimeNs};

mod distortion;

pub use distortion::Distortion;

/// Intrinsics in pixels; pixel centres lie at half-integers, x to the right, y down. All planes of
/// a frame share them: a distorted camera's depth and instance ids belong to its distorted picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/intrinsics/2")]
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
    /// How far the lens is from a pinhole.
    pub distortion: Distortion,
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
            distortion: Distortion::NONE,
        }
    }

    /// The same camera without its distortion: the pinhole.
    #[must_use]
    pub const fn pinhole(&self) -> Self {
        Self {
            distortion: Distortion::NONE,
            ..*self
        }
    }

    /// Where the ray through `x`, `y`, 1 in the camera frame falls in the picture, pixels. Behind a
    /// lens that folds rays over each other, see [`Distortion::keeps_order`], several fall there.
    #[must_use]
    pub fn pixel(&self, ray: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.distortion.distort(ray);
        [self.fx * x + self.cx, self.fy * y + self.cy]
    }

    /// The ray that falls on `pixel`: its x and y in the camera frame where z is 1. None if no ray
    /// does.
    #[must_use]
    pub fn ray(&self, [u, v]: [f64; 2]) -> Option<[f64; 2]> {
        let seen = [(u - self.cx) / self.fx, (v - self.cy) / self.fy];
        self.distortion.undistort(seen)
    }

    /// Least and greatest x, and least and greatest y, of the rays that fall on the centres of the
    /// picture's pixels, where z is
    /// 1. None if the lens folds some of them over each other, or no ray falls on some.
    #[must_use]
    pub fn field(&self) -> Option<[[f64; 2]; 2]> {
        let (across, down) = (f64::from(self.width), f64::from(self.height));
        let columns = (0..self.width).map(|column| f64::from(column) + 0.5);
        let rows = (0..self.height).map(|row| f64::from(row) + 0.5);
        // A lens that keeps rays in order has the outermost ones at the picture's rim.
        let rim = columns
            .flat_map(|u| [[u, 0.5], [u, down - 0.5]])
            .chain(rows.flat_map(|v| [[0.5, v], [across - 0.5, v]]));
        let mut field = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for pixel in rim {
            let ray = self.ray(pixel)?;
            if !self.distortion.keeps_order(ray) {
                return None;
            }
            for ([least, greatest], value) in field.iter_mut().zip(ray) {
                (*least, *greatest) = (least.min(value), greatest.max(value));
            }
        }
        Some(field)
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
