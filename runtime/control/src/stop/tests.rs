//! Stops against their limits, a formula and dense sampling.

use super::AxisStop;
use crate::motion::AxisLimits;
use crate::viability::stop_distance;
use hal::random::SplitMix64;

fn random_case(random: &mut SplitMix64) -> (AxisLimits, f64, f64) {
    let limits = AxisLimits {
        low: -1.0,
        high: 1.0,
        velocity: random.between(0.05, 4.0),
        acceleration: random.between(0.5, 40.0),
        jerk: random.between(10.0, 800.0),
    };
    let a = random.between(-limits.acceleration, limits.acceleration);
    let v = random.between(-limits.velocity, limits.velocity);
    (limits, v, a)
}

#[test]
fn every_stop_ends_at_rest_within_the_limits() {
    let mut random = SplitMix64::new(11);
    for case in 0..20_000 {
        let (limits, v, a) = random_case(&mut random);
        let stop = AxisStop::new(0.1, v, a, &limits);
        let end_s = stop.duration_s();
        let (_, v_end, a_end) = stop.knots[2].after(end_s);
        assert!(
            v_end.abs() < 1e-12 && a_end.abs() < 1e-11,
            "case {case}: v {v} a {a} ends at {v_end} {a_end}"
        );
        let (low, high) = stop.position_range();
        for i in 0..=50 {
            let (p, v, a) = stop.at(end_s * f64::from(i) / 50.0);
            assert!(p >= low - 1e-12 && p <= high + 1e-12, "case {case}");
            assert!(v.abs() <= stop.peak_velocity() + 1e-12, "case {case}");
            assert!(a.abs() <= stop.peak_acceleration() + 1e-12, "case {case}");
        }
        assert!(
            stop.peak_acceleration() <= limits.acceleration + 1e-12,
            "case {case}"
        );
    }
}

#[test]
fn the_remainder_leads_to_the_same_rest() {
    let mut random = SplitMix64::new(14);
    for case in 0..5_000 {
        let (limits, v, a) = random_case(&mut random);
        let stop = AxisStop::new(0.1, v, a, &limits);
        let from_s = random.between(0.0, 1.2) * stop.duration_s();
        let rest = stop.remainder(from_s);
        let (mut p, mut v, mut a) = (rest.position, rest.velocity, rest.acceleration);
        let mut left_s = 0.0;
        for phase in rest.phases {
            let (t, j) = (phase.duration_s, phase.jerk);
            assert!(t >= 0.0 && j.abs() <= limits.jerk, "case {case}");
            p += t * (v + t * (a / 2.0 + t * j / 6.0));
            v += t * (a + t * j / 2.0);
            a += t * j;
            left_s += t;
        }
        let (end, ..) = stop.at(stop.duration_s());
        assert!((p - end).abs() < 1e-13, "case {case}: {p} {end}");
        assert!(v.abs() < 1e-12 && a.abs() < 1e-11, "case {case}: {v} {a}");
        let expected_s = (stop.duration_s() - from_s).max(0.0);
        assert!((left_s - expected_s).abs() < 1e-15, "case {case}");
    }
}

#[test]
fn stop_from_zero_acceleration_is_as_long_as_the_formula() {
    let mut random = SplitMix64::new(12);
    for _ in 0..5_000 {
        let (limits, v, _) = random_case(&mut random);
        let (low, high) = AxisStop::new(0.0, v, 0.0, &limits).position_range();
        let expected = stop_distance(v.abs(), limits.acceleration, limits.jerk);
        assert!((high - low - expected).abs() < 1e-12, "{v} {limits:?}");
    }
}

#[test]
fn range_is_the_one_found_by_dense_sampling() {
    let mut random = SplitMix64::new(13);
    for _ in 0..500 {
        let (limits, v, a) = random_case(&mut random);
        let stop = AxisStop::new(0.0, v, a, &limits);
        let (low, high) = stop.position_range();
        let (mut least, mut most) = (0.0_f64, 0.0_f64);
        for i in 0..=5_000 {
            let p = stop.at(stop.duration_s() * f64::from(i) / 5_000.0).0;
            (least, most) = (least.min(p), most.max(p));
        }
        assert!(
            (low - least).abs() < 1e-6 && (high - most).abs() < 1e-6,
            "{v} {a} {limits:?}"
        );
    }
}
