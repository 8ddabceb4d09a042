//! From a 512x512 depth image to a point cloud, on one core, and farthest-point sampling against
//! the plain algorithm and against libtorch.

#![expect(
    clippy::expect_used,
    reason = "a bench can't go on without its subject"
)]

mod support;

use std::hint::black_box;

use criterion::Criterion;
use hal::{CameraFrame, Intrinsics, Pose, TimeNs};
use nalgebra::{Translation3, UnitQuaternion};
use tch::{Device, Kind, Tensor};
use trocar::rt::MonotonicClock;
use trocar_data::perception::{
    CloudFrame, CloudOptions, CropBox, InstanceSet, Padding, Point, back_project, farthest_points,
    point_cloud,
};

const SIDE_PIXELS: u32 = 512;
const RUNS: u32 = 20;
const VOXEL_M: f32 = 0.001;
/// A cloud of thinned points: a fraction of a step.
const THINNED_MS: f64 = 10.0;
/// A cloud of all points: a step.
const STEP_MS: f64 = 40.0;

/// A camera 15 cm above a wavy ground, with a bar across it.
#[expect(
    clippy::cast_possible_truncation,
    reason = "depth images are in single precision"
)]
fn frame() -> CameraFrame {
    let lens = Intrinsics::from_vertical_fov(SIDE_PIXELS, SIDE_PIXELS, 0.62);
    let mut frame = CameraFrame::blank(lens);
    frame.camera_in_scene = Pose::from_parts(
        Translation3::new(0.0, 0.0, 0.15),
        UnitQuaternion::from_euler_angles(core::f64::consts::PI, 0.0, 0.0),
    );
    for row in 0..SIDE_PIXELS {
        for column in 0..SIDE_PIXELS {
            let (x, y) = (f64::from(column) / 512.0, f64::from(row) / 512.0);
            let bar = (x - 0.5 * y - 0.3).abs() < 0.05;
            let ground = 0.15 - 0.01 * (9.0 * x).sin() * (7.0 * y).cos();
            let depth = if bar { 0.11 + 0.02 * y } else { ground };
            let pixel = (row * SIDE_PIXELS + column) as usize;
            frame.depth_m[pixel] = depth as f32;
            frame.instance[pixel] = if bar { 2 } else { 1 };
        }
    }
    frame
}

fn options(points: usize, voxel_m: Option<f32>) -> CloudOptions {
    CloudOptions {
        frame: CloudFrame::Scene,
        crop: CropBox {
            min_m: [-0.2; 3],
            max_m: [0.2; 3],
        },
        instances: InstanceSet::ALL,
        voxel_m,
        points,
        padding: Padding::FirstPoint,
    }
}

/// Every point's distance in every round.
fn plain(points: &[Point], count: usize) -> Vec<usize> {
    let mut nearest = vec![f32::INFINITY; points.len()];
    let mut taken = vec![0];
    let mut newest = 0;
    while taken.len() < count {
        let sample = points[newest];
        let mut best = (0, f32::NEG_INFINITY);
        for ((index, point), nearest) in points.iter().enumerate().zip(&mut nearest) {
            let [x, y, z]: Point = core::array::from_fn(|axis| point[axis] - sample[axis]);
            *nearest = nearest.min((x * x + y * y) + z * z);
            if *nearest > best.1 {
                best = (index, *nearest);
            }
        }
        newest = best.0;
        taken.push(newest);
    }
    taken
}

/// The same with libtorch, as Python code does it.
fn with_libtorch(points: &Tensor, count: usize) -> Vec<usize> {
    let mut nearest = Tensor::full(
        [points.size()[0]],
        f64::INFINITY,
        (Kind::Float, Device::Cpu),
    );
    let mut taken = vec![0];
    let mut newest = 0;
    while taken.len() < count {
        let apart = points - points.select(0, newest);
        let squares = (&apart * &apart).sum_dim_intlist([1].as_slice(), false, Kind::Float);
        nearest = nearest.minimum(&squares);
        newest = nearest.argmax(0, false).int64_value(&[]);
        taken.push(usize::try_from(newest).expect("an index"));
    }
    taken
}

/// Median of `work` over some runs, ms.
fn median_ms(criterion: &mut Criterion, name: &str, runs: u32, work: &dyn Fn() -> usize) -> f64 {
    let clock = MonotonicClock::new();
    let times = support::measure(criterion, &format!("perception/{name}"), runs, || {
        let before = clock.now();
        black_box(work());
        clock.now().since(before)
    });
    TimeNs(times.percentile(0.5)).seconds() * 1e3
}

fn clouds(criterion: &mut Criterion, frame: &CameraFrame) {
    let frames = [frame.as_frame()];
    for (points, voxel_m) in [
        (1024, Some(VOXEL_M)),
        (2048, Some(VOXEL_M)),
        (1024, None),
        (2048, None),
    ] {
        let options = options(points, voxel_m);
        let thinned = if voxel_m.is_some() {
            ", 1 mm cubes"
        } else {
            ""
        };
        let name = format!("512x512 to {points}{thinned}");
        let took_ms = median_ms(criterion, &name, RUNS, &|| {
            point_cloud(&frames, &options).expect("a cloud").len()
        });
        let figure = format!("cloud {name}, one core: p50 {took_ms:.1} ms");
        let target_ms = if voxel_m.is_some() {
            THINNED_MS
        } else {
            STEP_MS
        };
        let target = format!("within {target_ms} ms");
        support::report(&figure, &target, target_ms / took_ms);
    }
}

fn sampling(criterion: &mut Criterion, frame: &CameraFrame) {
    let options = options(1024, None);
    let seen = back_project(
        &[frame.as_frame()],
        options.frame,
        &options.crop,
        &options.instances,
    )
    .expect("points");
    let flat = Tensor::from_slice(seen.as_flattened()).view([-1, 3]);
    let count = options.points;
    let exact = farthest_points(&seen, count).expect("points");
    assert_eq!(exact, plain(&seen, count), "the same points");
    let ours_ms = median_ms(criterion, "sampling, ours", RUNS, &|| {
        farthest_points(&seen, count).expect("points").len()
    });
    let plain_ms = median_ms(criterion, "sampling, plain", 3, &|| {
        plain(&seen, count).len()
    });
    let torch_ms = median_ms(criterion, "sampling, libtorch", 3, &|| {
        with_libtorch(&flat, count).len()
    });
    let figure = format!(
        "1024 farthest of {} points: p50 {ours_ms:.1} ms",
        seen.len()
    );
    for (other, took_ms) in [("the plain algorithm", plain_ms), ("libtorch", torch_ms)] {
        let target = format!("{took_ms:.0} ms with {other}");
        support::report(&figure, &target, took_ms / ours_ms);
    }
}

fn main() {
    tch::set_num_threads(1);
    let mut criterion = support::criterion();
    let frame = frame();
    clouds(&mut criterion, &frame);
    sampling(&mut criterion, &frame);
    criterion.final_summary();
}
