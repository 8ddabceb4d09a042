//! Frames of planes and spheres, drawn by hand in double precision.

use hal::{CameraFrame, Distortion, Intrinsics, Pose};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use crate::perception::{CloudFrame, CropBox, InstanceSet, PerceptionError, Point, back_project};

/// A lens with nothing symmetric about it.
fn lens() -> Intrinsics {
    Intrinsics {
        width: 48,
        height: 36,
        fx: 61.0,
        fy: 57.0,
        cx: 22.7,
        cy: 19.1,
        distortion: Distortion::NONE,
    }
}

/// A camera above the scene that looks at its origin, tilted.
pub(super) fn pose() -> Pose {
    let position = Vector3::new(0.04, -0.07, 0.21);
    let rotation = UnitQuaternion::face_towards(&-position, &Vector3::new(0.3, 1.0, 0.1));
    Pose::from_parts(Translation3::from(position), rotation)
}

/// Camera and direction, in the scene, of the ray through the middle of a pixel; the direction has
/// z = 1 in the camera.
fn ray(
    lens: &Intrinsics,
    camera_in_scene: &Pose,
    column: u32,
    row: u32,
) -> (Point3<f64>, Vector3<f64>) {
    let [x, y] = lens
        .ray([f64::from(column) + 0.5, f64::from(row) + 0.5])
        .unwrap();
    (
        Point3::from(camera_in_scene.translation.vector),
        camera_in_scene.rotation * Vector3::new(x, y, 1.0),
    )
}

/// A frame whose every pixel has the depth and instance that `hit` says for its ray.
pub(super) fn frame(
    camera_in_scene: Pose,
    hit: impl Fn(&Point3<f64>, &Vector3<f64>) -> Option<(f64, u8)>,
) -> CameraFrame {
    frame_through(lens(), camera_in_scene, hit)
}

/// The same through a lens that distorts.
pub(super) fn distorted_frame(
    camera_in_scene: Pose,
    hit: impl Fn(&Point3<f64>, &Vector3<f64>) -> Option<(f64, u8)>,
) -> CameraFrame {
    let distortion = Distortion::new([-0.32, 0.11, 0.002, -0.003]);
    let lens = Intrinsics {
        distortion,
        ..lens()
    };
    frame_through(lens, camera_in_scene, hit)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "depth images are in single precision"
)]
fn frame_through(
    lens: Intrinsics,
    camera_in_scene: Pose,
    hit: impl Fn(&Point3<f64>, &Vector3<f64>) -> Option<(f64, u8)>,
) -> CameraFrame {
    let mut frame = CameraFrame::blank(lens);
    frame.camera_in_scene = camera_in_scene;
    for row in 0..lens.height {
        for column in 0..lens.width {
            let (from, along) = ray(&lens, &camera_in_scene, column, row);
            if let Some((depth, instance)) = hit(&from, &along) {
                let pixel = (row * lens.width + column) as usize;
                frame.depth_m[pixel] = depth as f32;
                frame.instance[pixel] = instance;
            }
        }
    }
    frame
}

/// The plane through `through` with `normal`, instance 3.
pub(super) fn plane(
    through: Point3<f64>,
    normal: Vector3<f64>,
) -> impl Fn(&Point3<f64>, &Vector3<f64>) -> Option<(f64, u8)> {
    move |from, along| {
        let depth = (through - from).dot(&normal) / along.dot(&normal);
        (depth > 0.0).then_some((depth, 3))
    }
}

/// The near side of a sphere, instance 5.
pub(super) fn sphere(
    centre: Point3<f64>,
    radius: f64,
) -> impl Fn(&Point3<f64>, &Vector3<f64>) -> Option<(f64, u8)> {
    move |from, along| {
        let to_centre = centre - from;
        let half = along.dot(&to_centre) / along.norm_squared();
        let rest = (to_centre.norm_squared() - radius * radius) / along.norm_squared();
        let root = half * half - rest;
        (root > 0.0).then(|| (half - root.sqrt(), 5))
    }
}

pub(super) fn wide(point: &Point) -> Point3<f64> {
    Point3::from(point.map(f64::from))
}

pub(super) fn project(
    frames: &[CameraFrame],
    cloud: CloudFrame,
    crop: &CropBox,
    instances: &InstanceSet,
) -> Result<Vec<Point>, PerceptionError> {
    let frames: Vec<_> = frames.iter().map(CameraFrame::as_frame).collect();
    back_project(&frames, cloud, crop, instances)
}
