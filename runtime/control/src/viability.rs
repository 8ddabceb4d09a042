//! How fast may an axis be and still stop in time? Hot path: bounded, no allocation, no I/O, no
//! lock.
//!
//! From speed `v` at zero acceleration the jerk-limited stop covers `v^2 / (2 a) + v a / (2 j)` if
//! it reaches the acceleration limit, that is if `v j >= a^2`, and `v sqrt(v / j)` otherwise. The
//! velocity falls symmetrically about half of it, so this is half the speed times the time,
//! `v / a + a / j` or `2 sqrt(v / j)`.

/// Distance that an axis needs to stop from `speed` at zero acceleration, rad (m), at full
/// `acceleration` and `jerk`.
#[must_use]
pub fn stop_distance(speed: f64, acceleration: f64, jerk: f64) -> f64 {
    if speed * jerk >= acceleration * acceleration {
        speed * speed / (2.0 * acceleration) + speed * acceleration / (2.0 * jerk)
    } else {
        speed * (speed / jerk).sqrt()
    }
}

/// Highest speed from which an axis stops within `distance`: the inverse of [`stop_distance`], 0
/// for negative distances.
///
/// With `c = a^2 / j`: `sqrt(c^2 / 4 + 2 a d) - c / 2` from `d = a c / j` on, `(d^2 j)^(1/3)`
/// below.
#[must_use]
pub fn viable_speed(distance: f64, acceleration: f64, jerk: f64) -> f64 {
    let distance = distance.max(0.0);
    let ramp = acceleration * acceleration / jerk;
    if distance >= ramp * acceleration / jerk {
        (0.25 * ramp * ramp + 2.0 * acceleration * distance).sqrt() - 0.5 * ramp
    } else {
        (distance * distance * jerk).cbrt()
    }
}

#[cfg(test)]
mod tests {
    use super::{stop_distance, viable_speed};
    use hal::random::SplitMix64;

    #[test]
    fn stop_distances_are_the_measured_ones() {
        assert!((stop_distance(0.6, 4.0, 80.0) - 0.060).abs() < 1e-12);
        assert!((stop_distance(0.1, 0.8, 16.0) - 0.008_75).abs() < 1e-12);
    }

    #[test]
    fn viable_speed_inverts_stop_distance() {
        let mut random = SplitMix64::new(7);
        for _ in 0..10_000 {
            let (v, a, j) = (
                random.between(0.0, 3.0),
                random.between(0.1, 20.0),
                random.between(1.0, 500.0),
            );
            let back = viable_speed(stop_distance(v, a, j), a, j);
            assert!(
                (back - v).abs() < 1e-9 * (1.0 + v),
                "v {v} a {a} j {j}: {back}"
            );
        }
        assert!(viable_speed(-1.0, 4.0, 80.0).abs() < 1e-300);
    }
}
