//! Depth and instance ids of a camera, kept to the bit: 16-bit and 8-bit PNG beside the colour
//! image.
//!
//! Depth goes in as whole units, not as metres: what is read back is what was written, and training
//! sees the same numbers as a policy at run time, whose depths are rounded in the same way.
//!
//! Columns of a camera NAME: `observation.depth.NAME` and `observation.instance.NAME`, each a
//! struct of `bytes` and `path`, and `observation.camera_pose.NAME`, seven `f64`. The lens is
//! constant for a dataset and stands in `info.json`, not in the rows.

use std::path::Path;

use hal::{CameraFrame, Distortion, Intrinsics};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageEncoder};
use serde_json::Value;

use super::{
    CameraSpec, DatasetError, DatasetSpec, TIP_POSE_WIDTH,
    check::input,
    error::mismatch,
    png::decode,
    schema::{CAMERA_POSE_PREFIX, DEPTH_PREFIX, INSTANCE_PREFIX, Info},
    table::Table,
};
use crate::perception::{DEPTH_UNIT_M, depth_from_units};
use crate::relative_action::pose_from_numbers;

/// What a camera saw of depth in one frame.
///
/// Both planes must have exactly the pixels of the [`CameraSpec`]; the pose must be finite.
#[derive(Clone, Copy, Debug)]
pub struct DepthFrame<'a> {
    /// Depths in units of [`DEPTH_UNIT_M`], row-major; 0 is none.
    pub units: &'a [u16],
    /// Instance ids, row-major.
    pub instance: &'a [u8],
    /// Where the camera was in the scene: x, y, z (m) and a unit quaternion x, y, z, w.
    pub camera_in_scene: [f64; TIP_POSE_WIDTH],
}

/// The same, read back.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedDepth {
    /// The lens.
    pub intrinsics: Intrinsics,
    /// Depths in units of [`DEPTH_UNIT_M`], row-major; 0 is none.
    pub units: Vec<u16>,
    /// Instance ids, row-major.
    pub instance: Vec<u8>,
    /// As [`DepthFrame::camera_in_scene`].
    pub camera_in_scene: [f64; TIP_POSE_WIDTH],
}

impl RecordedDepth {
    /// The frame that a policy would see, without colour.
    ///
    /// Depths are in metres, 0 where there is none. Stamp and sequence are 0, since a dataset has
    /// times of its own.
    #[must_use]
    pub fn into_frame(self) -> CameraFrame {
        CameraFrame {
            stamp: hal::TimeNs(0),
            sequence: 0,
            intrinsics: self.intrinsics,
            camera_in_scene: pose_from_numbers(&self.camera_in_scene),
            colour: Vec::new(),
            depth_m: self.units.into_iter().map(depth_from_units).collect(),
            instance: self.instance,
        }
    }
}

impl DatasetSpec {
    /// The cameras that keep depth, with their lenses.
    pub(super) fn depth_cameras(&self) -> impl Iterator<Item = (&CameraSpec, Intrinsics)> {
        self.cameras
            .iter()
            .filter_map(|camera| Some((camera, camera.depth?)))
    }
}

/// The depth of the episode in progress, of one camera.
///
/// One entry a frame in each list; the PNGs are encoded as frames come in, so memory holds no raw
/// planes.
#[derive(Clone, Debug, Default)]
pub(super) struct DepthColumns {
    /// PNG bytes, 16 bits a pixel, in units of [`DEPTH_UNIT_M`].
    pub(super) depth: Vec<Vec<u8>>,
    /// PNG bytes, 8 bits a pixel.
    pub(super) instance: Vec<Vec<u8>>,
    /// As [`DepthFrame::camera_in_scene`].
    pub(super) camera_in_scene: Vec<[f64; TIP_POSE_WIDTH]>,
}

/// One frame of it.
pub(super) struct DepthRow {
    depth: Vec<u8>,
    instance: Vec<u8>,
    camera_in_scene: [f64; TIP_POSE_WIDTH],
}

impl DepthColumns {
    pub(super) fn push(&mut self, row: DepthRow) {
        self.depth.push(row.depth);
        self.instance.push(row.instance);
        self.camera_in_scene.push(row.camera_in_scene);
    }
}

/// The frame's depth as PNG, by camera. The frame is refused if it has depth of another number of
/// cameras than keep it.
pub(super) fn encode(
    spec: &DatasetSpec,
    frames: &[DepthFrame<'_>],
) -> Result<Vec<DepthRow>, DatasetError> {
    let wanted = spec.depth_cameras().count();
    if frames.len() != wanted {
        let found = format!("with depth of {} cameras", frames.len());
        return Err(input("the frame", &found, &format!("of {wanted}")));
    }
    let cameras = spec.depth_cameras().zip(frames);
    cameras
        .map(|((camera, _), frame)| encode_one(camera, frame))
        .collect()
}

/// Both planes must have the camera's pixels, and its pose must be finite.
fn check_frame(camera: &CameraSpec, frame: &DepthFrame<'_>) -> Result<(), DatasetError> {
    let pixels = camera.width as usize * camera.height as usize;
    let planes = [
        ("depth", frame.units.len()),
        ("instance ids", frame.instance.len()),
    ];
    for (what, found) in planes {
        if found != pixels {
            let what = format!("the {what} of {}", camera.name);
            let found = format!("{found} pixels");
            return Err(input(&what, &found, &pixels.to_string()));
        }
    }
    match frame.camera_in_scene.iter().find(|x| !x.is_finite()) {
        None => Ok(()),
        Some(value) => {
            let what = format!("the pose of {}", camera.name);
            Err(input(&what, &value.to_string(), "finite numbers"))
        }
    }
}

fn encode_one(camera: &CameraSpec, frame: &DepthFrame<'_>) -> Result<DepthRow, DatasetError> {
    check_frame(camera, frame)?;
    // The encoder wants the machine's own order of bytes.
    let units: Vec<u8> = frame.units.iter().flat_map(|x| x.to_ne_bytes()).collect();
    Ok(DepthRow {
        depth: png(camera, &units, ExtendedColorType::L16)?,
        instance: png(camera, frame.instance, ExtendedColorType::L8)?,
        camera_in_scene: frame.camera_in_scene,
    })
}

/// Lossless; filter and compression are chosen for speed, not for size.
fn png(
    camera: &CameraSpec,
    bytes: &[u8],
    colour: ExtendedColorType,
) -> Result<Vec<u8>, DatasetError> {
    let mut png = Vec::new();
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Up)
        .write_image(bytes, camera.width, camera.height, colour)
        .map_err(|source| DatasetError::Image {
            what: format!("the depth of {}", camera.name),
            source,
        })?;
    Ok(png)
}

/// The lens of a camera whose depth is kept; none if it is not.
///
/// A feature that is there but has another unit than [`DEPTH_UNIT_M`], another shape than
/// `[height, width, 1]` or an incomplete lens is refused: clouds made from it would be of another
/// scale.
pub(super) fn read_lens(
    path: &Path,
    info: &Info,
    camera: &CameraSpec,
) -> Result<Option<Intrinsics>, DatasetError> {
    let name = format!("{DEPTH_PREFIX}{}", camera.name);
    let Some((_, feature)) = info.features.iter().find(|(other, _)| *other == name) else {
        return Ok(None);
    };
    let odd = |what: &str, found: String, expected: String| {
        Err(mismatch(
            path.to_owned(),
            &format!("{what} of {name}"),
            found,
            expected,
        ))
    };
    let shape = [camera.height as usize, camera.width as usize, 1];
    if feature.dtype != "image" || feature.shape != shape {
        let found = format!("{} {:?}", feature.dtype, feature.shape);
        return odd("the type", found, format!("image {shape:?}"));
    }
    let described = feature.info.as_ref().unwrap_or(&Value::Null);
    let unit = described["depth_unit_m"].as_f64();
    if unit.map(f64::to_bits) != Some(DEPTH_UNIT_M.to_bits()) {
        return odd(
            "depth_unit_m",
            format!("{unit:?}"),
            DEPTH_UNIT_M.to_string(),
        );
    }
    let mut numbers = [0.0; 4];
    for (number, key) in numbers.iter_mut().zip(["fx", "fy", "cx", "cy"]) {
        let found = &described["intrinsics_px"][key];
        let Some(value) = found.as_f64().filter(|value| *value > 0.0) else {
            return odd(key, found.to_string(), "a positive number".to_owned());
        };
        *number = value;
    }
    let [fx, fy, cx, cy] = numbers;
    let distortion = if described["distortion"].is_null() {
        Some(Distortion::NONE)
    } else {
        coefficients(&described["distortion"])
    };
    let Some(distortion) = distortion else {
        let found = described["distortion"].to_string();
        return odd("distortion", found, "k1, k2, p1, p2".to_owned());
    };
    let (width, height) = (camera.width, camera.height);
    Ok(Some(Intrinsics {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
        distortion,
    }))
}

/// Four coefficients. `k1, k2, p1, p2` of the Brown-Conrady model; none for another number of them.
fn coefficients(given: &Value) -> Option<Distortion> {
    let numbers = given.as_array()?.iter().map(Value::as_f64);
    let numbers: [f64; 4] = numbers.collect::<Option<Vec<_>>>()?.try_into().ok()?;
    Some(Distortion::new(numbers))
}

/// Every depth column must be there.
pub(super) fn require(table: &Table, spec: &DatasetSpec) -> Result<(), DatasetError> {
    for (camera, _) in spec.depth_cameras() {
        for prefix in [DEPTH_PREFIX, INSTANCE_PREFIX, CAMERA_POSE_PREFIX] {
            table.require(&format!("{prefix}{}", camera.name))?;
        }
    }
    Ok(())
}

/// A camera's depth in one row of `table`. Two PNGs are read and decoded on each call; nothing is
/// kept.
pub(super) fn read(
    table: &Table,
    camera: &CameraSpec,
    row: usize,
) -> Result<RecordedDepth, DatasetError> {
    let feature = |prefix: &str| format!("{prefix}{}", camera.name);
    let Some(intrinsics) = camera.depth else {
        let (path, name) = (table.path().to_owned(), feature(DEPTH_PREFIX));
        return Err(DatasetError::Missing { path, name });
    };
    let depth = plane(table, camera, &feature(DEPTH_PREFIX), row)?;
    let ids = plane(table, camera, &feature(INSTANCE_PREFIX), row)?;
    let (DynamicImage::ImageLuma16(depth), DynamicImage::ImageLuma8(ids)) = (depth, ids) else {
        let found = "of other bit depths".to_owned();
        let expected = "16 bits of depth and 8 of ids".to_owned();
        return Err(table.mismatch(&feature(DEPTH_PREFIX), found, expected));
    };
    Ok(RecordedDepth {
        intrinsics,
        units: depth.into_raw(),
        instance: ids.into_raw(),
        camera_in_scene: table.vector(&feature(CAMERA_POSE_PREFIX), row)?,
    })
}

/// The PNG in one cell, decoded and checked against the camera's size; of whatever bit depth it
/// has.
fn plane(
    table: &Table,
    camera: &CameraSpec,
    feature: &str,
    row: usize,
) -> Result<DynamicImage, DatasetError> {
    let png = table.image(feature, row)?;
    let image = decode(&png).map_err(|source| {
        let what = format!("{feature} in {}", table.path().display());
        DatasetError::Image { what, source }
    })?;
    if (image.width(), image.height()) != (camera.width, camera.height) {
        let found = format!("{} x {}", image.width(), image.height());
        let expected = format!("{} x {}", camera.width, camera.height);
        return Err(table.mismatch(feature, found, expected));
    }
    Ok(image)
}
