//! What a lens does to straight lines.

use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// Lens distortion after Brown and Conrady: OpenCV's and ROS' first four coefficients, without
/// units. A ray through `x`, `y`, 1 falls where a pinhole has the one through `x (1 + k1 r^2 + k2
/// r^4) + 2 p1 x y + p2 (r^2 + 2 x^2)` and `y (1 + k1 r^2 + k2 r^4) + p1 (r^2 + 2 y^2) + 2 p2 x y`,
/// with `r^2 = x^2 + y^2`.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/distortion/1")]
pub struct Distortion {
    /// Radial, of the second power: a barrel below 0, a cushion above.
    pub k1: f64,
    /// Radial, of the fourth power.
    pub k2: f64,
    /// Tangential, along y.
    pub p1: f64,
    /// Tangential, along x.
    pub p2: f64,
}

/// Steps of Newton's method: each doubles the digits, and the first already has two.
const STEPS: usize = 12;

/// How near to the wanted point a ray must fall, in units of the focal length.
const CLOSE: f64 = 1e-10;

/// At how many places between the axis and a ray its order is checked.
const PLACES: u32 = 16;

impl Distortion {
    /// A pinhole's.
    pub const NONE: Self = Self {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
    };

    /// From `k1`, `k2`, `p1`, `p2`.
    #[must_use]
    pub const fn new([k1, k2, p1, p2]: [f64; 4]) -> Self {
        Self { k1, k2, p1, p2 }
    }

    /// `k1`, `k2`, `p1`, `p2`, in the order of OpenCV.
    #[must_use]
    pub const fn coefficients(&self) -> [f64; 4] {
        [self.k1, self.k2, self.p1, self.p2]
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::NONE
    }

    /// Where the ray through `x`, `y`, 1 falls, in units of the focal length from the principal
    /// point.
    #[must_use]
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let Self { k1, k2, p1, p2 } = *self;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * k2);
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    }

    /// The ray that falls at `seen`: the inverse of [`Self::distort`]. None if no ray does.
    #[must_use]
    pub fn undistort(&self, seen: [f64; 2]) -> Option<[f64; 2]> {
        if self.is_none() {
            return Some(seen);
        }
        let mut ray = seen;
        for _ in 0..STEPS {
            let fallen = self.distort(ray);
            let (across, down) = (fallen[0] - seen[0], fallen[1] - seen[1]);
            let [a, b, d] = self.slopes(ray);
            if across.hypot(down) < CLOSE {
                // Beyond where rays fold, others fall there too, which no lens lets through.
                return (a > 0.0 && a * d > b * b).then_some(ray);
            }
            let size = a * d - b * b;
            ray[0] -= (d * across - b * down) / size;
            ray[1] -= (a * down - b * across) / size;
        }
        None
    }

    /// Whether rays between the axis and `ray` fall in the order in which they come: beyond where
    /// they don't, the picture would show things twice.
    #[must_use]
    pub fn keeps_order(&self, [x, y]: [f64; 2]) -> bool {
        let places = (0..=PLACES).map(|place| f64::from(place) / f64::from(PLACES));
        self.is_none()
            || places
                .map(|share| self.slopes([share * x, share * y]))
                .all(|[a, b, d]| a > 0.0 && a * d > b * b)
    }

    /// The derivative of [`Self::distort`], which is symmetric: xx, xy, yy.
    fn slopes(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let Self { k1, k2, p1, p2 } = *self;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * k2);
        let growth = 2.0 * (k1 + 2.0 * k2 * r2);
        [
            radial + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
            growth * x * y + 2.0 * (p1 * x + p2 * y),
            radial + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;

    const ENDOSCOPE: Distortion = Distortion::new([-0.31, 0.09, 0.0012, -0.0018]);

    /// One coefficient at a time, worked out by hand; r is a half.
    #[test]
    fn a_ray_falls_where_the_formula_says() {
        let [x, y] = Distortion::new([0.1, 0.0, 0.0, 0.0]).distort([0.3, 0.4]);
        assert!((x - 0.3 * 1.025).abs() < 1e-15 && (y - 0.4 * 1.025).abs() < 1e-15);
        let [x, y] = Distortion::new([0.0, 0.2, 0.0, 0.0]).distort([0.3, 0.4]);
        assert!((x - 0.3 * 1.0125).abs() < 1e-15 && (y - 0.4 * 1.0125).abs() < 1e-15);
        let [x, y] = Distortion::new([0.0, 0.0, 0.01, 0.0]).distort([0.3, 0.4]);
        assert!((x - 0.3024).abs() < 1e-15 && (y - 0.4057).abs() < 1e-15);
        let [x, y] = Distortion::new([0.0, 0.0, 0.0, 0.01]).distort([0.3, 0.4]);
        assert!((x - 0.3043).abs() < 1e-15 && (y - 0.4024).abs() < 1e-15);
    }

    #[test]
    fn what_is_undistorted_is_the_ray() {
        for lens in [ENDOSCOPE, Distortion::new([0.4, 0.2, -0.003, 0.002])] {
            for step in 0..400_u32 {
                let (column, row) = (step % 20, step / 20);
                let ray = [column, row].map(|it| 0.05 * f64::from(it) - 0.475);
                let back = lens.undistort(lens.distort(ray)).unwrap();
                assert!((back[0] - ray[0]).hypot(back[1] - ray[1]) < 1e-8);
            }
        }
    }

    #[test]
    fn no_ray_falls_beyond_a_barrels_rim() {
        let barrel = Distortion::new([-0.5, 0.0, 0.0, 0.0]);
        // The furthest is at r = sqrt(1 / 1.5), which falls at two thirds of that.
        let rim = (1.0_f64 / 1.5).sqrt();
        assert!(barrel.undistort([0.99 * rim / 1.5, 0.0]).is_some());
        assert_eq!(barrel.undistort([1.01 * rim / 1.5, 0.0]), None);
        assert!(barrel.keeps_order([0.99 * rim, 0.0]));
        assert!(!barrel.keeps_order([1.01 * rim, 0.0]));
    }

    #[test]
    fn a_field_is_that_of_all_pixels() {
        let mut lens = Intrinsics::from_vertical_fov(60, 40, 0.9);
        let [[left, right], [up, down]] = lens.field().unwrap();
        assert!((right - 29.5 / lens.fx).abs() < 1e-12 && (left + right).abs() < 1e-12);
        assert!((down - 19.5 / lens.fy).abs() < 1e-12 && (up + down).abs() < 1e-12);
        lens.distortion = ENDOSCOPE;
        let [[left, right], [up, down]] = lens.field().unwrap();
        for pixel in 0..60 * 40_u32 {
            let place = [f64::from(pixel % 60) + 0.5, f64::from(pixel / 60) + 0.5];
            let [x, y] = lens.ray(place).unwrap();
            assert!(x >= left && x <= right && y >= up && y <= down);
            let [u, v] = lens.pixel([x, y]);
            assert!((u - place[0]).abs() < 1e-6 && (v - place[1]).abs() < 1e-6);
        }
        lens.distortion = Distortion::new([-2.0, 0.0, 0.0, 0.0]);
        assert_eq!(lens.field(), None);
    }
}
