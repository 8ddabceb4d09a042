//! Tests of wrist cameras: they go where the arm goes, and the pose that they report is the one of
//! the picture.

use core::f64::consts::PI;

use hal::{Arm, ArmCommand, CameraFrame, JointVector, Pose, SafeTail, TimeNs};
use nalgebra::Point3;
use trocar_render::visual::instance;
use trocar_world::needle::NeedleShape;

use super::{Rendering, Simulation};
use crate::task::needle_lift::NeedleLift;
use crate::task::{TaskConfig, View};

/// Ticks of a motion and of its rest.
const WAY_TICKS: u32 = 400;
const REST_TICKS: u32 = 100;

/// Leads an arm by `way`, smoothly enough for its drives.
fn lead(simulation: &mut Simulation, arm: usize, way: &JointVector) {
    let found = simulation.arm(arm).unwrap().read(TimeNs(0)).unwrap();
    for tick in 1..=WAY_TICKS + REST_TICKS {
        let share = f64::from(tick.min(WAY_TICKS)) / f64::from(WAY_TICKS);
        let command = ArmCommand {
            stamp: TimeNs::from_tick(tick.into()),
            position: found.position + way * (0.5 - 0.5 * (PI * share).cos()),
            velocity: JointVector::zeros(),
            acceleration: JointVector::zeros(),
            jaw_position: found.jaw_position,
            jaw_velocity: 0.0,
            enabled: true,
        };
        let tail = SafeTail::hold(&command);
        simulation.arm(arm).unwrap().write(&command, &tail).unwrap();
        simulation.step();
    }
}

fn picture(simulation: &mut Simulation, camera: &str) -> CameraFrame {
    let cameras = simulation.cameras().unwrap();
    let index = cameras.find(camera).unwrap();
    let mut frame = cameras.blank_frame(index).unwrap();
    simulation.render(index, &mut frame).unwrap();
    frame
}

/// Pixel index and depth of a point of the scene, by the lens and the pose that `frame` reports;
/// none outside the image.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the point lies inside the image"
)]
fn project(frame: &CameraFrame, point_in_scene: &Point3<f64>) -> Option<(usize, f64)> {
    let lens = &frame.intrinsics;
    let p = frame
        .camera_in_scene
        .inverse_transform_point(point_in_scene);
    let (x, y) = (lens.fx * p.x / p.z + lens.cx, lens.fy * p.y / p.z + lens.cy);
    let inside = |v: f64, size: u32| (0.0..f64::from(size)).contains(&v);
    let seen = p.z > 0.0 && inside(x, lens.width) && inside(y, lens.height);
    seen.then_some((y as usize * lens.width as usize + x as usize, p.z))
}

/// How many of the needle's points the picture shows where the reported pose says; all others must
/// be hidden by the instrument or lie outside the image.
fn shown(frame: &CameraFrame, needle: &NeedleShape, needle_in_scene: &Pose) -> usize {
    let line = needle.centre_line(41);
    // The ends taper.
    let points = line[3..38].iter().map(|point| needle_in_scene * point);
    let mut shown = 0;
    for (pixel, depth_m) in points.filter_map(|point| project(frame, &point)) {
        match frame.instance[pixel] {
            instance::NEEDLE => {
                // The surface lies before the middle, further where the wire is seen along.
                let before = (depth_m - f64::from(frame.depth_m[pixel])) / needle.wire_radius_m;
                assert!((-0.3..3.0).contains(&before), "{before} radii at {pixel}");
                shown += 1;
            }
            instance::SHAFT | instance::WRIST | instance::JAW => {
                assert!(f64::from(frame.depth_m[pixel]) < depth_m, "at {pixel}");
            }
            other => panic!("the needle should be at {pixel}, {other} is"),
        }
    }
    shown
}

fn lift(task: &TaskConfig) -> &NeedleLift {
    task.scene().unwrap()
}

#[test]
fn the_pose_that_a_camera_reports_is_the_one_of_its_picture() {
    for (needle, view) in [
        ("N1", View::Train),
        ("N4", View::View1),
        ("N5", View::View2),
    ] {
        let task = TaskConfig::shipped("needle-lift");
        let task = task.with_needle(needle).unwrap().with_view(view).unwrap();
        let mut simulation = Simulation::new(&task, 5, Rendering::On).unwrap();
        for way in [[0.0; 6], [0.06, -0.05, 0.012, 0.5, 0.25, -0.2]] {
            lead(&mut simulation, 0, &JointVector::from(way));
            let there = simulation.snapshot().things[0];
            for camera in ["endoscope", "side", "wrist"] {
                let frame = picture(&mut simulation, camera);
                let count = shown(&frame, &lift(&task).needle, &there);
                assert!(count >= 12, "{needle} {camera}: {count} of 35 points");
            }
        }
    }
}

#[test]
fn a_wrist_camera_goes_with_its_arm_and_no_other_does() {
    let task = TaskConfig::shipped("needle-handover");
    let mut simulation = Simulation::new(&task, 2, Rendering::On).unwrap();
    let names = ["wrist_right", "wrist_left", "endoscope", "side"];
    let look = |simulation: &mut Simulation| names.map(|name| picture(simulation, name));
    let before = look(&mut simulation);
    let tip_before = simulation.world.tip_in_scene(0);
    lead(
        &mut simulation,
        0,
        &JointVector::new(0.1, 0.1, 0.01, -0.6, 0.4, 0.3),
    );
    let after = look(&mut simulation);
    let tip_after = simulation.world.tip_in_scene(0);
    // What the arm did, the camera did.
    let moved = tip_after * tip_before.inverse();
    let expected = moved * before[0].camera_in_scene;
    let off = expected.inv_mul(&after[0].camera_in_scene);
    assert!(off.translation.vector.norm() < 1e-12 && off.rotation.angle() < 1e-7);
    let went = before[0].camera_in_scene.inv_mul(&after[0].camera_in_scene);
    assert!(went.translation.vector.norm() > 0.01 && went.rotation.angle() > 0.3);
    // The other arm only holds its place.
    let held = before[1].camera_in_scene.inv_mul(&after[1].camera_in_scene);
    assert!(held.translation.vector.norm() < 1e-4, "{held}");
    for fixed in [2, 3] {
        assert_eq!(before[fixed].camera_in_scene, after[fixed].camera_in_scene);
    }
}

#[test]
fn wrist_cameras_show_both_fingers_and_what_lies_below() {
    for name in TaskConfig::names() {
        let task = TaskConfig::shipped(name);
        let mut simulation = Simulation::new(&task, 1, Rendering::On).unwrap();
        let jaws = [instance::JAW, instance::SECOND_JAW];
        for camera in task
            .cameras
            .iter()
            .filter(|camera| camera.carrier().is_some())
        {
            let frame = picture(&mut simulation, &camera.name);
            let count = |id: u8| frame.instance.iter().filter(|&&seen| seen == id).count();
            let jaw = jaws[camera.carrier().unwrap()];
            assert!(count(jaw) > 1_500, "{name} {}: {}", camera.name, count(jaw));
            assert!(count(instance::ORGAN) > 20_000, "{name} {}", camera.name);
            // The ends of both fingers are in the picture.
            let arm = simulation.snapshot().arms[camera.carrier().unwrap()].unwrap();
            for finger in [arm.finger_left, arm.finger_right] {
                let end = finger * Point3::new(0.0, 0.0, 0.95 * hal::psm::FINGER_M);
                let (pixel, _) = project(&frame, &end).unwrap();
                assert_eq!(frame.instance[pixel], jaw, "{name} {}", camera.name);
            }
        }
    }
}

/// A new episode moves the cameras of the first view by its seed.
#[test]
fn cameras_of_view1_move_by_the_seed() {
    let task = TaskConfig::shipped("needle-lift");
    let moving = task.clone().with_view(View::View1).unwrap();
    let poses = |task: &TaskConfig, seeds: [u64; 2]| {
        let mut simulation = Simulation::new(task, seeds[0], Rendering::On).unwrap();
        let first = ["endoscope", "side", "wrist"]
            .map(|name| picture(&mut simulation, name).camera_in_scene);
        let cameras = simulation.into_cameras().unwrap();
        let mut simulation = Simulation::with_cameras(task, seeds[1], cameras);
        let second = ["endoscope", "side", "wrist"]
            .map(|name| picture(&mut simulation, name).camera_in_scene);
        [first, second]
    };
    let [plain, other] = poses(&task, [1, 2]);
    assert_eq!(plain, other);
    let [first, second] = poses(&moving, [1, 2]);
    let [_, first_again] = poses(&moving, [2, 1]);
    assert_eq!(first, first_again);
    assert_eq!(first[2], plain[2]);
    for camera in [0, 1] {
        assert_ne!(first[camera], second[camera]);
        let off = plain[camera].inv_mul(&first[camera]);
        assert!(off.translation.vector.amax() <= 0.01);
        assert!(off.rotation.angle() > 1e-3 && off.rotation.angle() < 0.16);
    }
}
