//! From pixels with depth to points in a stated frame.
//!
//! With `a = (column + 0.5 - cx) / fx` and `b = (row + 0.5 - cy) / fy`, of a distorting lens both
//! undistorted, computed in double precision and then rounded, and R and t the camera's rounded
//! pose, coordinate i of a pixel's point is `((R_i1 b + R_i2) + R_i0 a) depth + t_i`.

use hal::{FrameRef, Intrinsics, Pose};
use serde::{Deserialize, Serialize};

use super::Point;
use super::error::{PerceptionError, Refused};
use super::instances::InstanceSet;

/// In which frame a cloud is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CloudFrame {
    /// The scene's.
    #[default]
    Scene,
    /// The first camera's: x right, y down, z along the view. What a system has that knows no
    /// scene.
    FirstCamera,
}

/// A box along the axes of the cloud's frame; its faces belong to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CropBox {
    /// Lower ends, m; may be minus infinity.
    pub min_m: Point,
    /// Upper ends, m; may be infinity.
    pub max_m: Point,
}

impl CropBox {
    /// Drops nothing.
    pub const EVERYTHING: Self = Self {
        min_m: [f32::NEG_INFINITY; 3],
        max_m: [f32::INFINITY; 3],
    };

    /// Whether the finite `point` lies in it.
    #[must_use]
    pub fn contains(&self, point: &Point) -> bool {
        (0..3).all(|axis| point[axis] >= self.min_m[axis] && point[axis] <= self.max_m[axis])
    }

    fn check(&self) -> Result<(), PerceptionError> {
        for axis in 0..3 {
            let (min_m, max_m) = (self.min_m[axis], self.max_m[axis]);
            if min_m.is_nan() || max_m.is_nan() || min_m >= max_m {
                return Err(PerceptionError::Crop { axis, min_m, max_m });
            }
        }
        Ok(())
    }
}

/// The points of every pixel that shows one of `instances`, has a finite positive depth and lies in
/// `crop`.
///
/// Ids and depth are tested first, the box last. O(pixels); allocates the list of points, and for
/// each frame a ray for each row and column.
///
/// # Errors
/// [`PerceptionError`] if a frame is not whole, the box has no inside, or no point is left.
pub fn back_project(
    frames: &[FrameRef<'_>],
    cloud_frame: CloudFrame,
    crop: &CropBox,
    instances: &InstanceSet,
) -> Result<Vec<Point>, PerceptionError> {
    let first = frames.first().ok_or(PerceptionError::NoFrame)?;
    crop.check()?;
    let mut points = Vec::new();
    let mut refused = Refused::default();
    for (index, frame) in frames.iter().enumerate() {
        check(index, frame)?;
        let camera_in_cloud = match cloud_frame {
            CloudFrame::Scene => frame.camera_in_scene,
            CloudFrame::FirstCamera => in_first(index, first, frame),
        };
        let view = View::new(&frame.intrinsics, &camera_in_cloud);
        refused.add(&view.project(frame, crop, instances, &mut points));
    }
    if points.is_empty() {
        return Err(PerceptionError::Empty(refused));
    }
    Ok(points)
}

/// The pose of the camera of `frame`, the `index`th, in that of the `first`.
fn in_first(index: usize, first: &FrameRef<'_>, frame: &FrameRef<'_>) -> Pose {
    // Exactly the identity, which a pose times its inverse is not.
    if index == 0 {
        return Pose::identity();
    }
    first.camera_in_scene.inverse() * frame.camera_in_scene
}

/// Planes of the image's size, focal lengths above 0, centre and pose finite. Single depths may be
/// anything: they are left out where they are no depth.
fn check(index: usize, frame: &FrameRef<'_>) -> Result<(), PerceptionError> {
    let lens = &frame.intrinsics;
    let expected = lens.pixel_count();
    let sizes = [
        ("depth", frame.depth_m.len()),
        ("instance ids", frame.instance.len()),
    ];
    for (what, actual) in sizes {
        if actual != expected {
            return Err(PerceptionError::Size {
                frame: index,
                what,
                expected,
                actual,
            });
        }
    }
    let camera = |what, value, allowed| PerceptionError::Camera {
        frame: index,
        what,
        value,
        allowed,
    };
    for (what, value) in [("fx", lens.fx), ("fy", lens.fy)] {
        if !(value.is_finite() && value > 0.0) {
            return Err(camera(what, value, "positive and finite"));
        }
    }
    let pose = &frame.camera_in_scene;
    let centre = [lens.cx, lens.cy];
    for (what, values) in [
        ("principal point", centre.as_slice()),
        ("camera position", pose.translation.vector.as_slice()),
        ("camera rotation", pose.rotation.coords.as_slice()),
    ] {
        if let Some(&value) = values.iter().find(|value| !value.is_finite()) {
            return Err(camera(what, value, "finite"));
        }
    }
    Ok(())
}

/// A camera's rays in its own frame, and where the camera is.
struct View {
    /// The lens, if it distorts: then no row or column has a ray of its own.
    bent: Option<Intrinsics>,
    /// `a` of each column, for a pinhole.
    across: Vec<f32>,
    /// `b` of each row, for a pinhole.
    down: Vec<f32>,
    /// Rows of the matrix that turns camera axes into the cloud's.
    rotation: [Point; 3],
    /// The camera's centre in the cloud's frame, m.
    translation: Point,
}

impl View {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "clouds are in single precision"
    )]
    fn new(lens: &Intrinsics, camera_in_cloud: &Pose) -> Self {
        let rays = |count: u32, centre: f64, focal: f64| {
            (0..count)
                .map(|pixel| ((f64::from(pixel) + 0.5 - centre) / focal) as f32)
                .collect()
        };
        let rotation = camera_in_cloud.rotation.to_rotation_matrix();
        let row = |axis: usize| core::array::from_fn(|column| rotation[(axis, column)] as f32);
        Self {
            bent: (!lens.distortion.is_none()).then_some(*lens),
            across: rays(lens.width, lens.cx, lens.fx),
            down: rays(lens.height, lens.cy, lens.fy),
            rotation: [row(0), row(1), row(2)],
            translation: core::array::from_fn(|axis| {
                camera_in_cloud.translation.vector[axis] as f32
            }),
        }
    }

    /// What all points of a row share.
    fn row(&self, down: f32) -> Point {
        core::array::from_fn(|i| self.rotation[i][1] * down + self.rotation[i][2])
    }

    /// What a pixel of a distorting lens has in the place of its row's share and its column's x.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "clouds are in single precision"
    )]
    fn bent_ray(&self, lens: &Intrinsics, u: u32, v: u32) -> Option<(Point, f32)> {
        let [x, y] = lens.ray([f64::from(u) + 0.5, f64::from(v) + 0.5])?;
        Some((self.row(y as f32), x as f32))
    }

    /// Appends the frame's points to `points`; says what came how far.
    fn project(
        &self,
        frame: &FrameRef<'_>,
        crop: &CropBox,
        instances: &InstanceSet,
        points: &mut Vec<Point>,
    ) -> Refused {
        let mut seen = Refused {
            pixels: frame.depth_m.len(),
            ..Refused::default()
        };
        let width = self.across.len().max(1);
        let rows = frame
            .depth_m
            .chunks_exact(width)
            .zip(frame.instance.chunks_exact(width));
        for (v, ((depths, ids), down)) in (0_u32..).zip(rows.zip(&self.down)) {
            let straight = self.row(*down);
            for (u, ((&depth, &id), across)) in
                (0_u32..).zip(depths.iter().zip(ids).zip(&self.across))
            {
                if !instances.contains(id) {
                    continue;
                }
                seen.of_instance += 1;
                // Neither zero, where nothing was hit, nor NaN passes.
                if !(depth > 0.0 && depth < f32::INFINITY) {
                    continue;
                }
                seen.with_depth += 1;
                let ray = match &self.bent {
                    None => Some((straight, *across)),
                    Some(lens) => self.bent_ray(lens, u, v),
                };
                // None where no ray falls, which is not in the picture either.
                let Some((row, across)) = ray else {
                    continue;
                };
                let point: Point = core::array::from_fn(|i| {
                    (row[i] + self.rotation[i][0] * across) * depth + self.translation[i]
                });
                if crop.contains(&point) && point.iter().all(|x| x.is_finite()) {
                    points.push(point);
                }
            }
        }
        seen
    }
}
