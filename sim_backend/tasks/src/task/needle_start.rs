//! Where the needle lies when an episode begins.
//!
//! A place is three uniform numbers: x and y of the middle of the wire's arc, and the yaw. The
//! needle is laid along the slope under its arc's centre and lifted until its wire is clear of the
//! ground; `laying` then lets it settle. On a patient's organ places are drawn until one suits:
//! level enough, within reach, and the wire close to the organ all along.

use core::f64::consts::PI;
use core::iter;

use hal::Pose;
use hal::config::{ConfigError, Source};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use trocar_world::needle::NeedleShape;
use trocar_world::organ::Organ;
use trocar_world::rng::Rng;
use trocar_world::{Ground, RigidBody, Scenery};

/// The region that the needle is drawn from; the paper's is 2.5 cm by 1 cm either way, at one yaw.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NeedleStart {
    /// Middle of the region in which the middle of the needle's arc lies, scene x and y, m.
    pub centre_m: [f64; 2],
    /// Half the size of the region along scene x and y, m.
    pub range_m: [f64; 2],
    /// Rotation of the needle about the organ's normal, rad; at 0 its arc bulges towards +x.
    pub yaw_rad: f64,
    /// Half the range of a uniform error of the yaw, rad.
    pub yaw_jitter_rad: f64,
}

/// How far above the organ the needle is let go, m: it must not start inside.
const DROP_M: f64 = 0.000_1;

/// Places that are tried on a measured organ.
const PLACES_MAX: usize = 1000;
/// Cosine of the greatest slope that a needle is laid on there: 20 degrees, where friction still
/// holds it.
const LEVEL_MIN: f64 = 0.94;
/// Lowest place of its wire there, scene frame, m: fingers reach half a millimetre below a wire,
/// and no lower than -3.5 mm, since the workspaces of the tasks end at -5 mm.
const LOW_M: f64 = -0.002;
/// Greatest height of its wire above the organ there, m: more of it would hang over an edge.
const GAP_M_MAX: f64 = 0.004;

impl NeedleStart {
    /// The needle's pose at the start of the episode `seed`, just above the organ and flat on it.
    /// The first x, y and yaw of a seed are the same on any ground. On a measured organ without a
    /// place that suits it is taken as it is; `check_on` refuses such a scene when its file is
    /// read.
    #[must_use]
    pub fn draw(&self, seed: u64, needle: &NeedleShape, organ: &Organ) -> Pose {
        let mut rng = Rng::stream(seed, "needle");
        let first = self.place(&mut rng, needle, organ);
        match organ {
            Organ::Rolling(_) => first,
            Organ::Measured(_) => self.sample(&mut rng, first, needle, organ).unwrap_or(first),
        }
    }

    /// `first` or the next place at which the needle lies on a measured organ, within reach; none
    /// if there seems to be none.
    fn sample(
        &self,
        rng: &mut Rng,
        first: Pose,
        needle: &NeedleShape,
        organ: &Organ,
    ) -> Option<Pose> {
        let more = iter::repeat_with(|| self.place(rng, needle, organ));
        let mut places = iter::once(first).chain(more).take(PLACES_MAX);
        places.find(|pose| lies_well(pose, needle, organ))
    }

    /// A place, drawn uniformly over the region.
    fn place(&self, rng: &mut Rng, needle: &NeedleShape, organ: &Organ) -> Pose {
        let middle_x = self.centre_m[0] + rng.range(-self.range_m[0], self.range_m[0]);
        let middle_y = self.centre_m[1] + rng.range(-self.range_m[1], self.range_m[1]);
        let yaw = self.yaw_rad + rng.range(-self.yaw_jitter_rad, self.yaw_jitter_rad);
        let x = middle_x - needle.arc_radius_m * yaw.cos();
        let y = middle_y - needle.arc_radius_m * yaw.sin();
        flat_on(organ, needle, x, y, yaw)
    }

    /// The needle on `organ` at the start of the episode `seed`.
    pub(super) fn scenery(&self, seed: u64, needle: &NeedleShape, organ: &Organ) -> Scenery {
        let in_scene = self.draw(seed, needle, organ);
        Scenery {
            things: vec![RigidBody::needle(needle, in_scene)],
            ground: Ground::Organ(organ.clone()),
            flap: None,
        }
    }

    /// Whether `needle` can lie somewhere in the region; on made-up ground it can everywhere. Tries
    /// the places of the seed 0, whatever episode there will be.
    pub(super) fn has_place(&self, needle: &NeedleShape, organ: &Organ) -> bool {
        if matches!(organ, Organ::Rolling(_)) {
            return true;
        }
        let mut rng = Rng::stream(0, "needle");
        let first = self.place(&mut rng, needle, organ);
        self.sample(&mut rng, first, needle, organ).is_some()
    }

    /// Checks that `needle` can lie somewhere in the region on a measured organ.
    pub(super) fn check_on(
        &self,
        source: &Source,
        needle: &NeedleShape,
        organ: &Organ,
    ) -> Result<(), ConfigError> {
        if self.has_place(needle, organ) {
            return Ok(());
        }
        let [radius_mm, gap_mm] = [needle.arc_radius_m, GAP_M_MAX].map(|size_m| 1e3 * size_m);
        let slope_deg = LEVEL_MIN.acos().to_degrees();
        let reason = format!(
            "nowhere in it the organ is flat enough for a needle of {radius_mm:.1} mm radius, which lies with a slope of {slope_deg:.0} degrees at most and all of its wire within {gap_mm:.0} mm of the organ; a smaller one may lie"
        );
        let found = format!("{:?}", self.range_m);
        Err(source.refused("needle_start.range_m", &found, &reason))
    }

    /// Checks every number.
    pub(super) fn check(&self, source: &Source) -> Result<(), ConfigError> {
        for axis in 0..2 {
            source.check_range(
                &format!("needle_start.centre_m.{axis}"),
                self.centre_m[axis],
                -0.05,
                0.05,
            )?;
            source.check_range(
                &format!("needle_start.range_m.{axis}"),
                self.range_m[axis],
                0.0,
                0.05,
            )?;
        }
        source.check_range("needle_start.yaw_rad", self.yaw_rad, -PI, PI)?;
        source.check_range("needle_start.yaw_jitter_rad", self.yaw_jitter_rad, 0.0, PI)
    }
}

/// Whether a needle at `pose` lies wholly on `organ`, not too steep and within reach. 25 points of
/// the wire are looked at.
fn lies_well(pose: &Pose, needle: &NeedleShape, organ: &Organ) -> bool {
    let level = (pose * Vector3::z()).z >= LEVEL_MIN;
    let mut wire = needle.centre_line(25).into_iter().map(|point| pose * point);
    level
        && wire.all(|point| {
            // Far above where there is no organ.
            let gap_m = point.z - organ.height_m(point.x, point.y);
            point.z >= LOW_M && gap_m <= GAP_M_MAX
        })
}

/// The pose in which a needle centred over `x` and `y` lies along the organ's slope without
/// touching it. `x` and `y` are those of the arc's centre, m; `yaw` is that of the direction of its
/// bulge, seen from above, rad. The needle's z is the surface's normal below that centre, where
/// there is no wire; hence the lift along the scene's z by the deepest of 25 points of the wire.
fn flat_on(organ: &Organ, needle: &NeedleShape, x: f64, y: f64, yaw: f64) -> Pose {
    let normal = organ.normal(x, y).into_inner();
    let ahead = Vector3::new(yaw.cos(), yaw.sin(), 0.0);
    let across = normal.cross(&ahead).normalize();
    let columns = Matrix3::from_columns(&[across.cross(&normal), across, normal]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns));
    let resting = Pose::from_parts(Translation3::new(x, y, organ.height_m(x, y)), rotation);
    // Lift until the deepest point of the wire is clear.
    let lift_m = needle
        .centre_line(25)
        .into_iter()
        .map(|point| resting * point)
        .map(|point| organ.height_m(point.x, point.y) + needle.wire_radius_m + DROP_M - point.z)
        .fold(f64::NEG_INFINITY, f64::max);
    Translation3::new(0.0, 0.0, lift_m) * resting
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use crate::task::needle_lift::NeedleLift;

    fn middles(task: &NeedleLift, seeds: core::ops::Range<u64>) -> Vec<Point3<f64>> {
        let middle = Point3::new(task.needle.arc_radius_m, 0.0, 0.0);
        seeds
            .map(|seed| task.start.draw(seed, &task.needle, &task.organ) * middle)
            .collect()
    }

    #[test]
    fn start_covers_its_region_and_stays_in_it() {
        let task = NeedleLift::shipped();
        let start = &task.start;
        let middles = middles(&task, 0..2000);
        for axis in 0..2 {
            let (centre, range) = (start.centre_m[axis], start.range_m[axis]);
            let shares: Vec<f64> = middles
                .iter()
                .map(|middle| (middle[axis] - centre) / range)
                .collect();
            // The slope of the organ moves the middle of a tilted needle by a few tenths of a
            // millimetre.
            assert!(
                shares.iter().all(|share| share.abs() < 1.06),
                "axis {axis} leaves its range"
            );
            assert!(
                shares.iter().any(|share| *share > 0.97)
                    && shares.iter().any(|share| *share < -0.97)
            );
            let mean = shares.iter().sum::<f64>() / 2000.0;
            assert!(mean.abs() < 0.06, "axis {axis} is off centre by {mean}");
        }
    }

    #[test]
    fn same_seed_gives_the_same_start_bit_for_bit() {
        let task = NeedleLift::shipped();
        assert_eq!(middles(&task, 5..9), middles(&task, 5..9));
        assert_ne!(middles(&task, 5..6), middles(&task, 6..7));
    }

    #[test]
    fn wire_starts_clear_of_the_organ_and_close_to_it() {
        let task = NeedleLift::shipped();
        for seed in 0..50 {
            let pose = task.start.draw(seed, &task.needle, &task.organ);
            let gaps = task.needle.centre_line(41).into_iter().map(|point| {
                let point = pose * point;
                point.z - task.organ.height_m(point.x, point.y) - task.needle.wire_radius_m
            });
            let lowest = gaps.fold(f64::INFINITY, f64::min);
            assert!((0.0..0.000_3).contains(&lowest), "seed {seed}: {lowest}");
        }
    }
}
