//! What is said about the time between two samples, against dense sampling.

use super::{CLEARANCES, config, config_with, home, shapes};
use crate::config::ControlConfig;
use crate::guard::bounds::Bounds;
use crate::guard::clearance::Boundaries;
use crate::guard::sample::Sample;
use crate::guard::sweep::{INTERVALS, travel_m};
use crate::guard::way::lowest;
use crate::instrument::LINKS;
use crate::motion::{AXES, JAW, MotionState};
use crate::stop::Stop;
use hal::random::SplitMix64;

const ALL: [bool; CLEARANCES] = [true; CLEARANCES];

fn random_state(config: &ControlConfig, random: &mut SplitMix64) -> MotionState {
    let mut state = home();
    for (axis, limits) in config.axes.iter().enumerate() {
        state.position[axis] += random.between(-0.3, 0.3) * if axis < 3 { 0.3 } else { 1.0 };
        state.velocity[axis] = random.between(-limits.velocity, limits.velocity);
        state.acceleration[axis] = random.between(-limits.acceleration, limits.acceleration);
    }
    // The fingers stop opening at zero and at the jaw's end.
    state.position[JAW] = match random.next_u64() % 3 {
        0 => random.between(-0.3, 0.3),
        1 => random.between(1.2, 1.5),
        _ => random.between(0.0, 1.3),
    };
    state
}

/// Calls `check` with every interval of random stops, the bounds for it, and samples within.
fn for_intervals(
    config: &ControlConfig,
    seed: u64,
    cases: u32,
    mut check: impl FnMut(u32, &Sample, &Sample, &Bounds, &[Sample]),
) {
    let boundaries = Boundaries::new(&config.arms[0]);
    let mut random = SplitMix64::new(seed);
    for case in 0..cases {
        let stop = Stop::new(&random_state(config, &mut random), &config.axes);
        // Some stops are cut more coarsely, so that bounds are tight in other places.
        let gap_s = stop.duration_s() / f64::from(INTERVALS) * [1.0, 3.0][case as usize % 2];
        for index in 0..INTERVALS {
            let from_s = gap_s * f64::from(index);
            let at = |time_s: f64| Sample::new(&stop.at(time_s), &boundaries, &ALL);
            let (before, after) = (at(from_s), at(from_s + gap_s));
            let bounds = Bounds::new(&config.axes, &stop, &before, &after, gap_s);
            let within: [Sample; 9] = core::array::from_fn(|part| {
                #[expect(clippy::cast_precision_loss, reason = "below ten")]
                let share = (part + 1) as f64 / 10.0;
                at(from_s + gap_s * share)
            });
            check(case, &before, &after, &bounds, &within);
        }
    }
}

#[test]
fn bounds_between_samples_hold_on_random_stops() {
    let mut config = config_with(&shapes());
    // Regions all around, so that links are beside, near, in and through them.
    let around = config.arms[0].forbidden.clone();
    config.arms[0].forbidden.extend(around);
    for region in &mut config.arms[0].forbidden[4..] {
        let nearer = hal::Pose::translation(0.0, 0.01, 0.02);
        region.shape = region.shape.moved(&nearer);
    }
    let boundaries = Boundaries::new(&config.arms[0]);
    let (mut by_bend, mut inside) = (0, 0);
    for_intervals(&config, 52, 200, |case, before, after, bounds, within| {
        let instruments = (&before.instrument, &after.instrument);
        for index in 0..CLEARANCES {
            let h = (before.clearances[index], after.clearances[index]);
            let low =
                boundaries.lowest_between(index, h, instruments, &bounds.ways(), f64::INFINITY);
            for sample in within {
                let here = sample.clearances[index];
                assert!(
                    here >= low - 1e-12,
                    "case {case} clearance {index}: {here} below {low}"
                );
            }
            if index >= 18 {
                let by_way = f64::midpoint(h.0, h.1) - bounds.ways()[(index - 18) % LINKS].half_m;
                by_bend += u32::from(low > by_way + 1e-6);
                inside += u32::from(h.0 < 0.0);
            }
        }
    });
    assert!(by_bend > 50_000 && inside > 5_000, "{by_bend} {inside}");
}

#[test]
fn speed_bounds_between_samples_hold_on_random_stops() {
    let config = config();
    for_intervals(&config, 53, 300, |case, before, after, bounds, within| {
        let speed = f64::midpoint(before.tip_speed_m_s, after.tip_speed_m_s) + bounds.tip_rise_m_s;
        let turn = before.tip_turn_rad_s.max(after.tip_turn_rad_s) + bounds.turn_rise_rad_s;
        for sample in within {
            assert!(sample.tip_speed_m_s <= speed + 1e-12, "case {case}");
            assert!(sample.tip_turn_rad_s <= turn + 1e-12, "case {case}");
        }
    });
}

#[test]
fn points_go_no_further_than_their_ways() {
    let config = config();
    for_intervals(&config, 54, 300, |case, before, after, bounds, within| {
        let ends = |sample: &Sample| sample.instrument.links().map(|(_, to_m)| to_m);
        for sample in within {
            for (link, here_m) in ends(sample).into_iter().enumerate() {
                let way = bounds.ways()[link];
                let (one, other) = (here_m - ends(before)[link], here_m - ends(after)[link]);
                let nearest_m = one.norm().min(other.norm());
                assert!(nearest_m <= way.half_m + 1e-12, "case {case} link {link}");
                // The way round along the straight line is no shorter than the bend says.
                let straight = ends(after)[link] - ends(before)[link];
                let off_m = one.cross(&straight).norm() / straight.norm().max(1e-300);
                let bend_m = way.bend_m + way.kink_m;
                assert!(
                    straight.norm() < 1e-9 || off_m <= bend_m + 1e-12,
                    "case {case} link {link}: {off_m} {bend_m}"
                );
            }
        }
    });
}

#[test]
fn a_whole_stop_stays_within_its_travel() {
    let config = config();
    let boundaries = Boundaries::new(&config.arms[0]);
    let mut random = SplitMix64::new(56);
    for case in 0..500 {
        let state = random_state(&config, &mut random);
        let stop = Stop::new(&state, &config.axes);
        let ranges = core::array::from_fn(|axis: usize| stop.axes()[axis].position_range());
        let at = |time_s: f64| Sample::new(&stop.at(time_s), &boundaries, &ALL);
        let start = at(0.0);
        let travel_m = travel_m(start.wrist_distance_m, &ranges);
        for part in 0..=40 {
            let here = at(stop.duration_s() * f64::from(part) / 40.0);
            let links = here.instrument.links().into_iter();
            for (link, (now, then)) in links.zip(start.instrument.links()).enumerate() {
                let moved_m = (now.1 - then.1).norm();
                assert!(moved_m <= travel_m[link] + 1e-12, "case {case} link {link}");
            }
        }
    }
}

#[test]
fn the_lowest_value_is_that_of_the_sharpest_parabola() {
    let mut random = SplitMix64::new(57);
    for case in 0..2_000 {
        let (start, end) = (random.between(-1.0, 1.0), random.between(-1.0, 1.0));
        let bend = random.between(0.0, 1.0);
        let low = lowest(start, end, bend);
        let mut least = f64::INFINITY;
        for part in 0..=1_000 {
            let x = f64::from(part) / 1_000.0;
            least = least.min(start + (end - start) * x - 4.0 * bend * x * (1.0 - x));
        }
        assert!(low <= least + 1e-12 && least - low < 1e-5, "case {case}");
    }
    assert!((lowest(0.3, 0.1, 0.0) - 0.1).abs() < 1e-15);
}

#[test]
fn joints_alone_move_every_axis() {
    // The tests above would prove nothing about an axis that never moves.
    let config = config();
    let state = random_state(&config, &mut SplitMix64::new(58));
    assert!((0..AXES).all(|axis| state.velocity[axis].abs() > 1e-6));
}
