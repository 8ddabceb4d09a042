//! Where on an organ to work: the flattest places of its front.
//!
//! A place is a vertex of the organ and its normal. Seen along that, the organ's highest surface is
//! sampled every 4 mm within 60 mm either way: it must be there all over the radius, and must not
//! stand up by more than 15 mm beyond it. The root mean square of its heights about their mean says
//! how flat the place is. At most 500 vertices of the front are looked at, evenly spread over their
//! list; there is no random choice.

use hal::{Mesh, Pose};
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::Site;
use super::relief::Relief;

/// Radius of a patch for whatever lies on it and the fingers about it, m.
pub(in crate::task) const WIDE: &[f64] = &[0.030];
/// The same for needles: narrower where an organ does not reach that far around any place.
pub(super) const NARROW_TOO: &[f64] = &[0.030, 0.022, 0.016];
/// How far around a place nothing of the organ may stand up, m.
const AROUND_M: f64 = 0.060;
/// Greatest height of what is around above the tangent plane of the place, m.
const STANDS_UP_M: f64 = 0.015;
/// Distance of the heights that a place is judged by, m.
const SPACING_M: f64 = 0.004;
/// Cosine of the greatest angle between the surface and the patient's front: instruments come in
/// through the belly.
const FRONT_MIN: f64 = 0.5;
/// Most places that are looked at.
const PLACES_MAX: usize = 500;
/// Most places of each radius that a task may choose from.
const CHOICES: usize = 6;
/// Least distance between two of them, m.
const APART_M: f64 = 0.015;
/// Size of the body, m: no organ reaches further.
const ORGAN_M_MAX: f64 = 1.0;

/// A vertex and its normal.
type Place = (Point3<f64>, Vector3<f64>);

/// The place, as the pose that the patient has with it under the instruments.
pub(super) struct Patch {
    pub(super) scene_from_scan: Pose,
    /// How far the organ reaches all around, m.
    pub(super) radius_m: f64,
    /// Distance from flat, root of the mean square, m.
    pub(super) roughness_m: f64,
}

impl Patch {
    /// Places on the front of the organ `mesh` (RAS, m), the widest first, of the same width the
    /// flattest, each with its middle at the site's `centre_m`, in height in the mean; the same for
    /// the same mesh. Narrower ones are looked for once no wider one is taken.
    ///
    /// # Errors
    /// Why there is none.
    pub(super) fn choose(mesh: &Mesh, site: &Site) -> Result<impl Iterator<Item = Self>, String> {
        let extent_m = extent_m(mesh);
        if extent_m > ORGAN_M_MAX {
            let size = format!("it is {extent_m:.2} m long, of at most {ORGAN_M_MAX} m");
            return Err(size);
        }
        let front = front(mesh);
        let (centre_m, radii_m) = (site.centre_m, site.radii_m);
        let of_radius = move |radius_m: &f64| Self::flattest(mesh, &front, centre_m, *radius_m);
        let mut patches = radii_m.iter().flat_map(of_radius).peekable();
        if patches.peek().is_some() {
            return Ok(patches);
        }
        Err(too_narrow(mesh, radii_m))
    }

    /// The flattest patches of `radius_m` about vertices of the `front`, the flattest first.
    fn flattest(mesh: &Mesh, front: &[Place], centre_m: [f64; 3], radius_m: f64) -> Vec<Self> {
        let patches = sample(front).filter_map(|(at, normal)| {
            let patch = Self::at(mesh, at, normal, centre_m, radius_m)?;
            Some((*at, patch))
        });
        let mut patches: Vec<(Point3<f64>, Self)> = patches.collect();
        patches.sort_by(|(_, a), (_, b)| a.roughness_m.total_cmp(&b.roughness_m));
        let mut chosen: Vec<(Point3<f64>, Self)> = Vec::new();
        for (at, patch) in patches {
            let is_apart = |(other, _): &(Point3<f64>, Self)| (at - other).norm() >= APART_M;
            if chosen.len() < CHOICES && chosen.iter().all(is_apart) {
                chosen.push((at, patch));
            }
        }
        chosen.into_iter().map(|(_, patch)| patch).collect()
    }

    /// The place `at` with the outward `normal`, at `centre_m` in the scene; none if the organ does
    /// not reach all around, or stands up beyond. Costs a pass over the whole mesh.
    fn at(
        mesh: &Mesh,
        at: &Point3<f64>,
        normal: &Vector3<f64>,
        centre_m: [f64; 3],
        radius_m: f64,
    ) -> Option<Self> {
        let facing = facing(at, normal);
        let relief = Relief::of(mesh, &facing, [AROUND_M; 2], SPACING_M);
        let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for (x, y, height_m) in relief.points() {
            if x.hypot(y) <= radius_m {
                // NaN where there is no surface, and then the sums are.
                (count, sum, squares) =
                    (count + 1.0, sum + height_m, squares + height_m * height_m);
            } else if height_m > STANDS_UP_M {
                return None;
            }
        }
        let mean_m: f64 = sum / count;
        let roughness_m = (squares / count - mean_m * mean_m).max(0.0).sqrt();
        let [x, y, z] = centre_m;
        mean_m.is_finite().then(|| Self {
            scene_from_scan: Translation3::new(x, y, z - mean_m) * facing,
            radius_m,
            roughness_m,
        })
    }
}

/// The pose of the scan in a frame about `at` whose z is `normal` and whose y leads to the
/// patient's head.
fn facing(at: &Point3<f64>, normal: &Vector3<f64>) -> Pose {
    let head = Vector3::z();
    let ahead = (head - normal * normal.dot(&head)).normalize();
    let columns = Matrix3::from_columns(&[ahead.cross(normal), ahead, *normal]);
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns));
    Pose::from_parts(Translation3::from(at.coords), turn).inverse()
}

/// Vertices with their normals.
fn places(mesh: &Mesh) -> impl Iterator<Item = Place> + '_ {
    let pairs = mesh.positions.iter().zip(&mesh.normals);
    pairs.map(|(at, normal)| {
        let normal = Vector3::from(normal.map(f64::from));
        (Point3::from(at.map(f64::from)), normal.normalize())
    })
}

/// Those on the patient's front.
fn front(mesh: &Mesh) -> Vec<Place> {
    let places = places(mesh);
    let on_front = places.filter(|(_, normal)| normal.y >= FRONT_MIN);
    on_front.collect()
}

/// Those that are looked at.
fn sample(front: &[Place]) -> impl Iterator<Item = &Place> {
    let step = front.len().div_ceil(PLACES_MAX).max(1);
    front.iter().step_by(step)
}

/// How far the organ reaches all around a place, m: its nearest edge, up to 4 mm further than it
/// is.
fn reach_m(mesh: &Mesh, (at, normal): &Place) -> f64 {
    let relief = Relief::of(mesh, &facing(at, normal), [AROUND_M; 2], SPACING_M);
    let edges = relief.points().filter(|(_, _, height_m)| height_m.is_nan());
    let distances_m = edges.map(|(x, y, _)| x.hypot(y));
    distances_m.fold(f64::INFINITY, f64::min)
}

/// Why `mesh` has no patch of any of `radii_m`.
fn too_narrow(mesh: &Mesh, radii_m: &[f64]) -> String {
    let needed_m = radii_m.iter().copied().fold(f64::INFINITY, f64::min);
    let needed = format!(
        "no place on its front has {:.0} mm of surface around it, as the task needs, and nothing beside that stands up",
        1e3 * needed_m
    );
    let front = front(mesh);
    let reaches = sample(&front).map(|place| (reach_m(mesh, place), place.0));
    let widest = reaches.max_by(|(a, _), (b, _)| a.total_cmp(b));
    let Some((reach_m, at)) = widest else {
        return format!("{needed}: nothing of it faces the front");
    };
    let at = in_scan(at.into());
    if reach_m > needed_m {
        let high_mm = 1e3 * STANDS_UP_M;
        return format!(
            "{needed}: about the widest, {at}, it stands up by more than {high_mm:.0} mm"
        );
    }
    let reach_mm = 1e3 * reach_m;
    format!("{needed}: the widest, {at}, is less than {reach_mm:.0} mm from its edge")
}

/// A point of the scan in words.
pub(super) fn in_scan(point_m: [f64; 3]) -> String {
    let [x, y, z] = point_m.map(|along_m| 1e3 * along_m);
    format!("({x:.0}, {y:.0}, {z:.0}) mm in the scan")
}

/// The longest side of the box around it, m.
fn extent_m(mesh: &Mesh) -> f64 {
    let side = |axis: usize| {
        let along = || mesh.positions.iter().map(|p| f64::from(p[axis]));
        along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)
    };
    (0..3).map(side).fold(0.0, f64::max)
}
