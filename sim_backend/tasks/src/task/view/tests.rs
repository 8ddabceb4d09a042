//! Facts about views: how far they move what, on what that hangs, and what they leave alone.

use super::*;
use crate::task::Calibration;
use nalgebra::{Point3, Vector3};
use trocar_render::look_at;

fn tasks() -> impl Iterator<Item = TaskConfig> {
    TaskConfig::names().map(TaskConfig::shipped)
}

fn file_pose(camera: &CameraConfig) -> Pose {
    let [eye, target] = [camera.eye_m, camera.target_m].map(Point3::from);
    look_at(eye, target, Vector3::from(camera.up))
}

/// The endoscope of the needle lift, and how the first view moves it in the episode `seed`.
fn shifts() -> impl Fn(u64) -> Pose {
    let endoscope = TaskConfig::shipped("needle-lift").cameras[0].clone();
    move |seed| View::View1.shift(&endoscope, seed)
}

#[test]
fn view1_moves_within_its_bounds_and_uses_all_of_them() {
    let shift = shifts();
    let mut extremes = [[0.0_f64; 2]; 6];
    for seed in 0..2_000 {
        let moved = shift(seed);
        let t = moved.translation.vector / VIEW1_SHIFT_M;
        let (a, b, c) = moved.rotation.euler_angles();
        let turns = [a, b, c].map(|angle| angle / VIEW1_TURN_RAD);
        for (value, [low, high]) in [t.x, t.y, t.z].into_iter().chain(turns).zip(&mut extremes) {
            assert!(value.abs() <= 1.0 + 1e-9, "seed {seed}: {value}");
            *low = low.min(value);
            *high = high.max(value);
        }
    }
    for [low, high] in extremes {
        assert!(low < -0.98 && high > 0.98, "{low} {high}");
    }
}

#[test]
fn view1_hangs_on_seed_and_name_alone() {
    let shift = shifts();
    assert_eq!(shift(7), shift(7));
    assert_ne!(shift(7), shift(8));
    let task = TaskConfig::shipped("needle-lift");
    let side = task.cameras.iter().find(|camera| camera.name == SIDE);
    assert_ne!(View::View1.shift(side.unwrap(), 7), shift(7));
    assert_eq!(View::Train.shift(&task.cameras[0], 7), Pose::identity());
}

#[test]
fn wrist_cameras_stay_in_every_view() {
    for task in tasks() {
        for view in View::ALL {
            let seen = task.clone().with_view(view).unwrap();
            let wrists = |task: &TaskConfig| -> Vec<CameraConfig> {
                let cameras = task.cameras.iter();
                cameras
                    .filter(|camera| camera.mount == Mount::Wrist)
                    .cloned()
                    .collect()
            };
            assert_eq!(wrists(&seen), wrists(&task));
            assert_eq!(wrists(&task).len(), task.arms.len(), "{}", task.name);
            for wrist in wrists(&seen) {
                assert_eq!(view.shift(&wrist, 3), Pose::identity());
            }
        }
    }
}

#[test]
fn view2_swaps_places_and_lenses_and_keeps_names_and_sizes() {
    for task in tasks() {
        let swapped = task.clone().with_view(View::View2).unwrap();
        let find = |task: &TaskConfig, name| {
            let mut cameras = task.cameras.iter();
            cameras.find(|camera| camera.name == name).unwrap().clone()
        };
        for (name, other) in [(ENDOSCOPE, SIDE), (SIDE, ENDOSCOPE)] {
            let (now, there) = (find(&swapped, name), find(&task, other));
            assert_eq!(file_pose(&now), file_pose(&there));
            assert_eq!(now.intrinsics(), there.intrinsics());
            assert_ne!(file_pose(&now), file_pose(&find(&task, name)));
        }
        let names = |task: &TaskConfig| -> Vec<String> {
            task.cameras
                .iter()
                .map(|camera| camera.name.clone())
                .collect()
        };
        assert_eq!(names(&swapped), names(&task));
    }
}

/// A calibrated lens shows the same in pictures of the other camera's size.
#[test]
fn view2_swaps_calibrated_lenses() {
    let mut task = TaskConfig::shipped("needle-lift");
    let [endoscope, side] = [ENDOSCOPE, SIDE].map(|name| task.standing(name).unwrap());
    task.cameras[side].resize(256, 128);
    let camera = &mut task.cameras[endoscope];
    camera.vertical_fov_rad = None;
    camera.calibration = Some(Calibration {
        fx_px: 700.0,
        fy_px: 690.0,
        cx_px: 250.0,
        cy_px: 265.0,
    });
    camera.vignette = 0.25;
    let before = camera.intrinsics();
    let seen = task.with_view(View::View2).unwrap().cameras[side].clone();
    let after = seen.intrinsics();
    assert_eq!(seen.vignette.to_bits(), 0.25_f64.to_bits());
    assert_eq!((after.width, after.height), (256, 128));
    let ray = [0.1, -0.2];
    let ([u, v], [small_u, small_v]) = (before.pixel(ray), after.pixel(ray));
    assert!((small_u - 0.5 * u).abs() < 1e-9 && (small_v - 0.25 * v).abs() < 1e-9);
}

#[test]
fn a_swap_without_a_side_camera_is_refused() {
    let mut task = TaskConfig::shipped("needle-lift");
    task.cameras.retain(|camera| camera.name != SIDE);
    let error = task.clone().with_view(View::View2).unwrap_err().to_string();
    assert_eq!(
        error,
        "needle-lift has no camera \"side\", which view2 swaps"
    );
    assert!(task.with_view(View::View1).is_ok());
}

/// The light is at the endoscope's place wherever it stands in the file.
#[test]
fn light_is_at_the_endoscope() {
    for mut task in tasks() {
        let lit = |task: &TaskConfig| task.cameras[task.light_camera()].eye_m;
        let expected = lit(&task);
        let lens = |task: &TaskConfig| lit(&task.clone().with_view(View::View2).unwrap());
        let swapped = lens(&task);
        task.cameras.reverse();
        assert_eq!(
            (lit(&task), lens(&task)),
            (expected, swapped),
            "{}",
            task.name
        );
        assert_eq!(task.cameras[task.light_camera()].name, "endoscope");
    }
}
