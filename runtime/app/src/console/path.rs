//! Where the newest chunk wants the tips to go from now on: in the scene, and in the pictures of
//! the cameras.

use std::collections::BTreeMap;

use hal::{Chunk, Intrinsics, PerArm, Pose, TimeNs};
use nalgebra::Point3;
use serde::Serialize;

/// Points of a path: as many as one sees apart.
const POINTS_MAX: usize = 24;

/// Nearer to a camera than this nothing is in its picture, m.
const NEAR_M: f64 = 0.001;

/// Cameras by their place among those that pages are told of: the lens, and where it is in the
/// scene, looking along z with y down.
pub(super) type Lenses = BTreeMap<u8, (Intrinsics, Pose)>;

/// One arm's.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Path {
    /// Points in the scene, m.
    points: Vec<[f64; 3]>,
    /// The same in each camera's picture, as parts of its width and height from its upper left
    /// corner; those behind it are left out.
    pictures: BTreeMap<u8, Vec<[f64; 2]>>,
}

/// The path through these `points` in the scene, of which it shows as many as one sees apart; the
/// last one stays.
pub(super) fn through(points: &[Point3<f64>], lenses: &Lenses) -> Path {
    path(&thinned(points), lenses)
}

/// The paths of `chunks` after `now`, of arms whose remote centres are at `rcms_in_scene`; one for
/// each arm, empty when its chunk is over.
pub(super) fn paths(
    chunks: &PerArm<Chunk>,
    now: TimeNs,
    rcms_in_scene: &[Pose],
    lenses: &Lenses,
) -> Vec<Path> {
    let arms = chunks.iter().zip(rcms_in_scene);
    arms.map(|(chunk, base)| path(&points(chunk, now, base), lenses))
        .collect()
}

fn path(points: &[Point3<f64>], lenses: &Lenses) -> Path {
    let pictures = lenses.iter().map(|(camera, (lens, pose))| {
        let seen = points.iter().filter_map(|point| project(lens, pose, point));
        (*camera, seen.collect())
    });
    Path {
        pictures: pictures.collect(),
        points: points
            .iter()
            .map(|point| rounded(point.coords.into()))
            .collect(),
    }
}

/// What is left of a chunk, thinned out; its last target stays.
fn points(chunk: &Chunk, now: TimeNs, base: &Pose) -> Vec<Point3<f64>> {
    let targets = chunk.valid_targets();
    let first = (0..targets.len()).find(|&index| chunk.due(index) >= now);
    let left = targets.get(first.unwrap_or(targets.len())..);
    let left = thinned(left.unwrap_or_default()).into_iter();
    left.map(|target| base * Point3::from(target.position_m))
        .collect()
}

/// Every so many of `all` that they are few; the last one stays.
fn thinned<T: Copy>(all: &[T]) -> Vec<T> {
    let every = all.len().div_ceil(POINTS_MAX).max(1);
    all.iter().rev().step_by(every).rev().copied().collect()
}

fn project(lens: &Intrinsics, camera_in_scene: &Pose, point: &Point3<f64>) -> Option<[f64; 2]> {
    let seen = camera_in_scene.inverse_transform_point(point);
    let ray = [seen.x / seen.z, seen.y / seen.z];
    let [u, v] = lens.pixel(ray);
    let parts = [u / f64::from(lens.width), v / f64::from(lens.height)];
    (seen.z > NEAR_M && lens.distortion.keeps_order(ray)).then(|| rounded(parts))
}

fn rounded<const N: usize>(numbers: [f64; N]) -> [f64; N] {
    numbers.map(|number| (number * 1e5).round() * 1e-5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::TipTarget;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    /// A camera 0.1 m above the origin that looks down; x is to the right of its picture, and y up.
    fn lens_above() -> (Intrinsics, Pose) {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let pose = Pose::from_parts(Translation3::new(0.0, 0.0, 0.1), turn);
        (Intrinsics::from_vertical_fov(200, 100, 1.0), pose)
    }

    #[test]
    fn what_is_left_of_a_chunk_is_where_the_camera_sees_it() {
        let target = |step: u32| {
            let x = f64::from(step) * 0.001;
            TipTarget::new(&Translation3::new(x, 0.0, 0.0).into(), 0.0)
        };
        let targets: Vec<TipTarget> = (0..50).map(target).collect();
        let chunk = Chunk::new(TimeNs(0), 1, 40_000_000, &targets);
        let base = [Pose::translation(0.0, 0.01, 0.0)];
        let lenses = Lenses::from([(3, lens_above())]);
        let now = TimeNs(10 * 40_000_000);
        let [path] = &paths(&PerArm::one(chunk), now, &base, &lenses)[..] else {
            panic!("one arm");
        };
        assert!(path.points.len() <= POINTS_MAX);
        assert_eq!(path.points.last(), Some(&[0.049, 0.01, 0.0]));
        assert!(path.points[0][0] >= 0.01);
        let seen = path.pictures[&3].last().unwrap();
        // Half a picture is 0.1 m times the tangent of half a radian high; twice as wide.
        let half_m = 0.1 * 0.5_f64.tan();
        assert!(
            (seen[0] - (0.5 + 0.049 / (4.0 * half_m))).abs() < 1e-4,
            "{seen:?}"
        );
        assert!(
            (seen[1] - (0.5 - 0.01 / (2.0 * half_m))).abs() < 1e-4,
            "{seen:?}"
        );
        let over = paths(&PerArm::one(chunk), TimeNs(u64::MAX / 2), &base, &lenses);
        assert!(over[0].points.is_empty() && over[0].pictures[&3].is_empty());
    }

    #[test]
    fn what_is_behind_a_camera_is_not_in_its_picture() {
        let (lens, pose) = lens_above();
        assert_eq!(project(&lens, &pose, &Point3::new(0.0, 0.0, 0.2)), None);
        assert_eq!(project(&lens, &pose, &Point3::origin()), Some([0.5, 0.5]));
    }
}
