//! Camera frames as the log keeps them: the colour image as PNG, the lens, and where the camera
//! was.
//!
//! Depth is not kept. An image is written with the lens and the camera's pose of the same instant,
//! so each frame stands by itself.

use hal::{CameraFrame, Distortion, Intrinsics, Pose, TimeNs};
use image::{ExtendedColorType, ImageEncoder, codecs::png};

use super::error::LogError;
use super::frames::{SCENE, transform};
use super::messages::{
    CameraCalibration, CompressedImage, FrameTransforms, PoseInFrame, Timestamp,
};

/// A frame on its way to the writer thread.
pub(super) struct FrameItem {
    name: String,
    stamp: TimeNs,
    intrinsics: Intrinsics,
    camera_in_scene: Pose,
    /// RGB, 8 bits a channel, row by row from the top: `3 * width * height` bytes.
    colour: Vec<u8>,
}

/// A frame ready to be written.
pub(super) struct Encoded {
    /// The colour image as PNG.
    pub(super) image: CompressedImage,
    /// The lens.
    pub(super) lens: CameraCalibration,
    /// Where the camera was in the scene.
    pub(super) pose: PoseInFrame,
    /// The same among the frames.
    pub(super) place: FrameTransforms,
}

/// The channels of one camera.
#[derive(Clone, Copy)]
pub(super) struct Channels {
    pub(super) image: u16,
    pub(super) lens: u16,
    pub(super) pose: u16,
}

impl FrameItem {
    /// Copies what the log keeps of `frame`.
    pub(super) fn new(name: &str, frame: &CameraFrame) -> Self {
        Self {
            name: name.to_owned(),
            stamp: frame.stamp,
            intrinsics: frame.intrinsics,
            camera_in_scene: frame.camera_in_scene,
            colour: frame.colour.clone(),
        }
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// When the image was taken.
    pub(super) const fn stamp(&self) -> TimeNs {
        self.stamp
    }

    /// Compresses the image.
    ///
    /// # Errors
    /// [`LogError::Image`] when the pixels do not fill the image.
    pub(super) fn encode(&self) -> Result<Encoded, LogError> {
        let failed = |reason: String| LogError::Image {
            camera: self.name.clone(),
            reason,
        };
        let Intrinsics { width, height, .. } = self.intrinsics;
        let expected = 3 * self.intrinsics.pixel_count();
        if self.colour.len() != expected {
            return Err(failed(format!(
                "{} bytes of colour, expected {expected}",
                self.colour.len()
            )));
        }
        let mut data = Vec::new();
        png::PngEncoder::new_with_quality(
            &mut data,
            png::CompressionType::Fast,
            png::FilterType::Sub,
        )
        .write_image(&self.colour, width, height, ExtendedColorType::Rgb8)
        .map_err(|error| failed(error.to_string()))?;
        let timestamp = Some(Timestamp::new(self.stamp));
        let image = CompressedImage {
            timestamp,
            data,
            format: "png".to_owned(),
            frame_id: self.name.clone(),
        };
        let pose = PoseInFrame {
            timestamp,
            frame_id: SCENE.to_owned(),
            pose: Some((&self.camera_in_scene).into()),
        };
        let place = transform(self.stamp, (SCENE, &self.name), &self.camera_in_scene);
        Ok(Encoded {
            image,
            lens: lens(self.stamp, &self.name, &self.intrinsics),
            pose,
            place: FrameTransforms {
                transforms: vec![place],
            },
        })
    }
}

/// The model's name and its coefficients, as ROS has them; none of a pinhole.
///
/// `plumb_bob` has `k1, k2, p1, p2, k3` in this order; `k3` is 0 here.
fn described(distortion: &Distortion) -> (String, Vec<f64>) {
    if distortion.is_none() {
        return Default::default();
    }
    let [k1, k2, p1, p2] = distortion.coefficients();
    ("plumb_bob".to_owned(), vec![k1, k2, p1, p2, 0.0])
}

/// The lens that `message` says; none if it is not whole.
///
/// A lens with fewer than four coefficients counts as a pinhole.
pub(super) fn intrinsics(message: &CameraCalibration) -> Option<Intrinsics> {
    let &[fx, _, cx, _, fy, cy, ..] = &message.K[..] else {
        return None;
    };
    let distortion = match &message.D[..] {
        &[k1, k2, p1, p2, ..] => Distortion::new([k1, k2, p1, p2]),
        _ => Distortion::default(),
    };
    Some(Intrinsics {
        width: message.width,
        height: message.height,
        fx,
        fy,
        cx,
        cy,
        distortion,
    })
}

/// The lens of the camera `name`.
///
/// `K` is `[fx 0 cx; 0 fy cy; 0 0 1]`, `R` the identity, `P` is `K` with a column of zeros; all row
/// by row.
pub(super) fn lens(at: TimeNs, name: &str, intrinsics: &Intrinsics) -> CameraCalibration {
    let Intrinsics {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
        distortion,
    } = *intrinsics;
    let (distortion_model, coefficients) = described(&distortion);
    CameraCalibration {
        timestamp: Some(Timestamp::new(at)),
        width,
        height,
        distortion_model,
        D: coefficients,
        K: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        R: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        frame_id: name.to_owned(),
    }
}
