//! Back-projection, mask and crop on frames of known planes and spheres.

use core::slice;

use hal::{CameraFrame, Pose};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use super::drawn::{distorted_frame, frame, plane, pose, project, sphere, wide};
use crate::perception::{
    CloudFrame, CloudOptions, CropBox, InstanceSet, Padding, PerceptionError, Point, Refused,
    point_cloud, shows_nothing,
};

const EVERYTHING: CropBox = CropBox::EVERYTHING;
const ALL: InstanceSet = InstanceSet::ALL;

#[test]
fn points_of_a_tilted_plane_lie_in_it() {
    let (through, normal) = (Point3::new(0.0, 0.01, 0.02), Vector3::new(0.2, -0.1, 0.9));
    let frames = [
        frame(pose(), plane(through, normal)),
        distorted_frame(pose(), plane(through, normal)),
    ];
    let points = project(&frames, CloudFrame::Scene, &EVERYTHING, &ALL).unwrap();
    assert_eq!(points.len(), 2 * 48 * 36, "every pixel looks at it");
    for point in &points {
        let off = (wide(point) - through).dot(&normal.normalize());
        assert!(off.abs() < 1e-7, "{point:?} is {off:e} m off");
    }
}

/// Points of a sphere are at its radius and on the camera's side.
#[test]
fn sphere_points_are_on_the_visible_side() {
    let (centre, radius) = (Point3::new(0.0, 0.0, 0.01), 0.03);
    let frame = frame(pose(), sphere(centre, radius));
    let points = project(&[frame], CloudFrame::Scene, &EVERYTHING, &ALL).unwrap();
    assert!(points.len() > 100, "{} points", points.len());
    let to_camera = Point3::from(pose().translation.vector) - centre;
    for point in &points {
        let from_centre = wide(point) - centre;
        assert!((from_centre.norm() - radius).abs() < 1e-7, "{point:?}");
        assert!(from_centre.dot(&to_camera) > 0.0, "{point:?}");
    }
}

/// The plane's points are where straight lines are straight, whatever the lens bends.
#[test]
fn a_distorted_pixel_projects_back_to_its_middle() {
    let frame = distorted_frame(pose(), plane(Point3::origin(), Vector3::z()));
    let lens = frame.intrinsics;
    let points = project(&[frame], CloudFrame::Scene, &EVERYTHING, &ALL).unwrap();
    let middles = (0..lens.height).flat_map(|row| (0..lens.width).map(move |column| (column, row)));
    for (point, (column, row)) in points.iter().zip(middles) {
        let seen = pose().inverse() * wide(point);
        let [x, y] = lens.pixel([seen.x / seen.z, seen.y / seen.z]);
        let off = (x - f64::from(column) - 0.5).hypot(y - f64::from(row) - 0.5);
        assert!(
            off < 1e-4,
            "column {column}, row {row}: off by {off:e} pixels"
        );
    }
}

#[test]
fn a_point_projects_back_to_the_middle_of_its_pixel() {
    let frame = frame(pose(), plane(Point3::origin(), Vector3::z()));
    let lens = frame.intrinsics;
    let points = project(&[frame], CloudFrame::Scene, &EVERYTHING, &ALL).unwrap();
    let middles = (0..lens.height).flat_map(|row| (0..lens.width).map(move |column| (column, row)));
    for (point, (column, row)) in points.iter().zip(middles) {
        let in_camera = pose().inverse() * wide(point);
        let x = lens.fx * in_camera.x / in_camera.z + lens.cx;
        let y = lens.fy * in_camera.y / in_camera.z + lens.cy;
        let off = (x - f64::from(column) - 0.5)
            .abs()
            .max((y - f64::from(row) - 0.5).abs());
        assert!(
            off < 1e-4,
            "column {column}, row {row}: off by {off:e} pixels"
        );
    }
}

/// In the camera's own frame depth is the third coordinate to the bit.
#[test]
fn depth_is_z_of_the_camera_frame_to_the_bit() {
    let frame = frame(pose(), plane(Point3::origin(), Vector3::z()));
    let depths = frame.depth_m.clone();
    let points = project(&[frame], CloudFrame::FirstCamera, &EVERYTHING, &ALL).unwrap();
    let third: Vec<f32> = points.iter().map(|point| point[2]).collect();
    assert_eq!(third, depths);
}

#[test]
fn two_cameras_see_one_plane_in_either_frame() {
    let (through, normal) = (Point3::new(0.0, 0.0, 0.02), Vector3::new(0.1, 0.2, 1.0));
    let second = Pose::from_parts(
        Translation3::new(-0.1, 0.02, 0.25),
        UnitQuaternion::from_euler_angles(-2.9, 0.2, 1.4),
    );
    let frames = [
        frame(pose(), plane(through, normal)),
        frame(second, plane(through, normal)),
    ];
    let in_scene = project(&frames, CloudFrame::Scene, &EVERYTHING, &ALL).unwrap();
    let in_camera = project(&frames, CloudFrame::FirstCamera, &EVERYTHING, &ALL).unwrap();
    assert_eq!(in_scene.len(), 2 * 48 * 36);
    for (there, here) in in_scene.iter().zip(&in_camera) {
        let off = (wide(there) - through).dot(&normal.normalize());
        assert!(off.abs() < 1e-7, "{there:?}");
        let apart = (pose() * wide(here) - wide(there)).norm();
        assert!(apart < 1e-7, "{here:?} and {there:?} are {apart:e} m apart");
    }
}

#[test]
fn pixels_without_a_sensible_depth_give_no_point() {
    let mut frame = frame(pose(), plane(Point3::origin(), Vector3::z()));
    let kept = frame.depth_m.len() - 6;
    let senseless = [0.0, -0.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -0.1];
    frame.depth_m[7..13].copy_from_slice(&senseless);
    let points = project(&[frame], CloudFrame::Scene, &EVERYTHING, &ALL).unwrap();
    assert_eq!(points.len(), kept);
    assert!(points.iter().flatten().all(|x| x.is_finite()));
}

#[test]
fn a_depth_that_leaves_single_precision_gives_no_point() {
    let mut frame = frame(pose(), plane(Point3::origin(), Vector3::z()));
    frame.depth_m.fill(f32::MAX);
    frame.depth_m[0] = 0.2;
    // Off the axis a direction is longer than its depth.
    let points = project(&[frame], CloudFrame::Scene, &EVERYTHING, &ALL).unwrap();
    assert!(points.iter().flatten().all(|x| x.is_finite()));
}

#[test]
fn only_wanted_instances_are_seen() {
    let ball = sphere(Point3::new(0.0, 0.0, 0.01), 0.03);
    let ground = plane(Point3::origin(), Vector3::z());
    let frame = frame(pose(), |from, along| {
        ball(from, along).or_else(|| ground(from, along))
    });
    let count = |id| frame.instance.iter().filter(|&&other| other == id).count();
    let (balls, grounds) = (count(5), count(3));
    assert!(balls > 100 && grounds > 100);
    let frames = [frame];
    let seen = |set: &InstanceSet| project(&frames, CloudFrame::Scene, &EVERYTHING, set);
    assert_eq!(seen(&InstanceSet::only(&[5])).unwrap().len(), balls);
    assert_eq!(seen(&InstanceSet::without(&[5])).unwrap().len(), grounds);
    assert_eq!(
        seen(&InstanceSet::only(&[5, 3])).unwrap(),
        seen(&ALL).unwrap()
    );
}

#[test]
fn the_box_keeps_its_faces_and_drops_what_is_beyond() {
    let frame = frame(pose(), plane(Point3::origin(), Vector3::z()));
    let all = project(
        slice::from_ref(&frame),
        CloudFrame::Scene,
        &EVERYTHING,
        &ALL,
    )
    .unwrap();
    let crop = CropBox {
        min_m: [all[700][0], -0.03, -1e-3],
        max_m: [0.05, 0.04, 1e-3],
    };
    let kept = project(&[frame], CloudFrame::Scene, &crop, &ALL).unwrap();
    let inside = |p: &&Point| p[0] >= all[700][0] && p[0] <= 0.05 && p[1] >= -0.03 && p[1] <= 0.04;
    let expected: Vec<Point> = all.iter().filter(inside).copied().collect();
    assert!(expected.len() > 10 && expected.len() < all.len());
    assert_eq!(kept, expected);
}

#[test]
fn nothing_left_says_where_it_went() {
    let frame = frame(pose(), plane(Point3::origin(), Vector3::z()));
    let nothing = InstanceSet::only(&[9]);
    let error = project(
        slice::from_ref(&frame),
        CloudFrame::Scene,
        &EVERYTHING,
        &nothing,
    )
    .unwrap_err();
    let refused = Refused {
        pixels: 48 * 36,
        of_instance: 0,
        with_depth: 0,
    };
    assert_eq!(error, PerceptionError::Empty(refused));
    assert_eq!(
        error.to_string(),
        "no point is left: of 1728 pixels 0 show a wanted instance, 0 of these have a depth, and none lies in the box"
    );
    let far = CropBox {
        min_m: [1.0; 3],
        max_m: [2.0; 3],
    };
    let error = project(&[frame], CloudFrame::Scene, &far, &ALL).unwrap_err();
    assert!(matches!(
        error,
        PerceptionError::Empty(Refused {
            with_depth: 1728,
            ..
        })
    ));
}

/// What is hidden gives a cloud at the origin and a blind sensor none.
#[test]
fn empty_cloud_is_padded_and_a_blind_sensor_gives_none() {
    let shown = frame(pose(), plane(Point3::origin(), Vector3::z()));
    let options = CloudOptions {
        frame: CloudFrame::Scene,
        crop: EVERYTHING,
        instances: ALL,
        voxel_m: None,
        points: 7,
        padding: Padding::FirstPoint,
    };
    let cloud =
        |frame: &CameraFrame, options: &CloudOptions| point_cloud(&[frame.as_frame()], options);
    assert!(!shows_nothing(&cloud(&shown, &options).unwrap()));
    let elsewhere = CropBox {
        min_m: [1.0; 3],
        max_m: [2.0; 3],
    };
    let hidden = [
        CloudOptions {
            instances: InstanceSet::only(&[9]),
            ..options.clone()
        },
        CloudOptions {
            crop: elsewhere,
            ..options.clone()
        },
    ];
    for options in &hidden {
        let nothing = cloud(&shown, options).unwrap();
        assert_eq!(nothing, vec![[0.0; 3]; 7]);
        assert!(shows_nothing(&nothing));
    }
    let mut blind = shown;
    blind.depth_m.fill(0.0);
    assert!(matches!(
        cloud(&blind, &options).unwrap_err(),
        PerceptionError::Empty(_)
    ));
}

#[test]
fn frames_that_are_not_whole_are_refused() {
    let good = frame(pose(), plane(Point3::origin(), Vector3::z()));
    let check = |break_it: &dyn Fn(&mut CameraFrame), what: &str| {
        let mut broken = good.clone();
        break_it(&mut broken);
        let frames = [good.clone(), broken];
        let error = project(&frames, CloudFrame::Scene, &EVERYTHING, &ALL).unwrap_err();
        assert_eq!(error.to_string(), what);
    };
    check(
        &|f| f.depth_m.truncate(5),
        "frame 1: depth has 5 pixels, the image 1728",
    );
    check(
        &|f| f.instance.clear(),
        "frame 1: instance ids has 0 pixels, the image 1728",
    );
    check(
        &|f| f.intrinsics.fx = 0.0,
        "frame 1: fx = 0 is not positive and finite",
    );
    check(
        &|f| f.intrinsics.fy = f64::NAN,
        "frame 1: fy = NaN is not positive and finite",
    );
    check(
        &|f| f.intrinsics.cx = f64::NAN,
        "frame 1: principal point = NaN is not finite",
    );
    check(
        &|f| f.camera_in_scene.translation.vector.y = f64::INFINITY,
        "frame 1: camera position = inf is not finite",
    );
    assert_eq!(
        project(&[], CloudFrame::Scene, &EVERYTHING, &ALL).unwrap_err(),
        PerceptionError::NoFrame
    );
    let inverted = CropBox {
        min_m: [0.0, 1.0, 0.0],
        max_m: [1.0, 0.5, 1.0],
    };
    let error = project(&[good], CloudFrame::Scene, &inverted, &ALL).unwrap_err();
    assert_eq!(error.to_string(), "crop box: axis 1 goes from 1 m to 0.5 m");
}

#[test]
fn a_cloud_has_the_points_asked_for_and_says_how_it_is_padded() {
    let frame = frame(pose(), sphere(Point3::new(0.0, 0.0, 0.01), 0.03));
    let options = CloudOptions {
        frame: CloudFrame::Scene,
        crop: EVERYTHING,
        instances: InstanceSet::only(&[5]),
        voxel_m: None,
        points: 64,
        padding: Padding::FirstPoint,
    };
    let frames = [frame.as_frame()];
    let small = point_cloud(&frames, &options).unwrap();
    assert_eq!(small.len(), 64);
    let seen = frame.instance.iter().filter(|&&id| id == 5).count();
    let many = CloudOptions {
        points: seen + 3,
        ..options.clone()
    };
    let repeated = point_cloud(&frames, &many).unwrap();
    assert_eq!(repeated[..64], small, "fewer points are the first of more");
    assert_eq!(repeated[seen..], [repeated[0]; 3]);
    let padding = Padding::Origin;
    let zeros = point_cloud(&frames, &CloudOptions { padding, ..many }).unwrap();
    assert_eq!(zeros[..seen], repeated[..seen]);
    assert_eq!(zeros[seen..], [[0.0; 3]; 3]);
    let voxel_m = Some(0.01);
    let thinned = point_cloud(&frames, &CloudOptions { voxel_m, ..options }).unwrap();
    let cubes = |p: &Point| p.map(|x| (x / 0.01).floor());
    let mut distinct: Vec<_> = thinned.iter().map(|p| cubes(p).map(f32::to_bits)).collect();
    distinct.sort_unstable();
    distinct.dedup();
    assert!(distinct.len() > 20, "{} cubes", distinct.len());
}
