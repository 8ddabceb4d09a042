//! Soft ground: heights and normals of a surface that gives way under points.
//!
//! Rigid solids go through the detector; soft ground is a height field and is met by balls. The gap
//! is the first-order distance from the surface, `(z - height) n_z - radius`: exact on a plane, and
//! good where the surface curves little within the gap. Below 0 it is minus the penetration depth.

use nalgebra::Vector3;

use super::detect::Found;
use super::scenery::Ground;
use crate::organ::{Organ, OrganShape};
use crate::tissue;

/// Top of the table that an organ lies on, m; a needle pushed over the edge stops there.
const TABLE_HEIGHT_M: f64 = -0.02;

/// Ground that gives way.
pub(super) trait SoftGround {
    /// Height of its surface over (`x`, `y`), scene frame, m; none where it ends.
    fn height_m(&self, x: f64, y: f64) -> Option<f64>;

    /// Unit normal of the surface there, up; to be asked only where there is a height.
    fn normal(&self, x: f64, y: f64) -> Vector3<f64>;
}

impl SoftGround for OrganShape {
    fn height_m(&self, x: f64, y: f64) -> Option<f64> {
        self.covers(x, y).then(|| Self::height_m(self, x, y))
    }

    fn normal(&self, x: f64, y: f64) -> Vector3<f64> {
        Self::normal(self, x, y).into_inner()
    }
}

impl SoftGround for tissue::Ground {
    fn height_m(&self, x: f64, y: f64) -> Option<f64> {
        Self::height_m(self, x, y)
    }

    fn normal(&self, x: f64, y: f64) -> Vector3<f64> {
        Self::normal(self, x, y).unwrap_or_else(Vector3::z)
    }
}

/// Where a ball of `radius_m` about `centre` meets the soft `ground`, if it is within `reach_m`;
/// none of a bed's flap.
pub(super) fn meet(
    ground: &Ground,
    centre: &Vector3<f64>,
    radius_m: f64,
    reach_m: f64,
) -> Option<Found> {
    match ground {
        Ground::Organ(organ) => meet_organ(organ, centre, radius_m, reach_m),
        Ground::OrganWithSolids(soft, _) => meet_organ(&soft.organ, centre, radius_m, reach_m),
        Ground::Bed(bed) => meet_surface(bed, centre, radius_m, reach_m),
        Ground::Solids(_) => None,
    }
}

/// A rolling organ ends at its rim, beyond which there is the table; a measured one has nothing
/// beyond.
fn meet_organ(organ: &Organ, centre: &Vector3<f64>, radius_m: f64, reach_m: f64) -> Option<Found> {
    match organ {
        Organ::Rolling(organ) => {
            // No wave is higher than this, so most points are far above.
            if centre.z - radius_m - organ.amplitude_m > reach_m {
                return None;
            }
            meet_surface(organ, centre, radius_m, reach_m)
                .or_else(|| meet_table(centre, radius_m, reach_m))
        }
        Organ::Measured(table) => meet_surface(&**table, centre, radius_m, reach_m),
    }
}

/// None where the surface ends or is more than `reach_m` away. The point is in the middle of the
/// gap.
fn meet_surface(
    surface: &impl SoftGround,
    centre: &Vector3<f64>,
    radius_m: f64,
    reach_m: f64,
) -> Option<Found> {
    let height_m = surface.height_m(centre.x, centre.y)?;
    let normal = surface.normal(centre.x, centre.y);
    let gap_m = (centre.z - height_m) * normal.z - radius_m;
    Some(Found {
        point: centre - normal * (radius_m + 0.5 * gap_m),
        normal,
        gap_m,
    })
    .filter(|found| found.gap_m <= reach_m)
}

/// The same of the flat table, which has no rim.
fn meet_table(centre: &Vector3<f64>, radius_m: f64, reach_m: f64) -> Option<Found> {
    let gap_m = centre.z - TABLE_HEIGHT_M - radius_m;
    let normal = Vector3::z();
    Some(Found {
        point: centre - normal * (radius_m + 0.5 * gap_m),
        normal,
        gap_m,
    })
    .filter(|found| found.gap_m <= reach_m)
}
