//! Two arms that are driven at each other.

use super::{AXES, MotionState, Request, Rig, SplitMix64, bang, home, least, two_arms};
use crate::config::ControlConfig;
use crate::distance::distance_between_m;
use crate::guard::gaps::KINDS;
use crate::guard::planted::PlantedGuardFault;
use crate::instrument::{Instrument, KinematicState};
use hal::psm::SHAFT_RADIUS_M;

/// How far apart the remote centres of most tests are, m.
pub(super) const APART_M: f64 = 0.06;

fn in_scene(config: &ControlConfig, arm: usize, state: &MotionState) -> Instrument {
    let instrument = KinematicState::new(state).instrument;
    instrument.moved(&config.arms[arm].scene_from_rcm)
}

/// What is left of every gap between two arms, m.
pub(super) fn gaps(
    config: &ControlConfig,
    first: &MotionState,
    second: &MotionState,
) -> [f64; KINDS.len()] {
    let between = config.between_arms.unwrap();
    let a = in_scene(config, 0, first).links();
    let b = in_scene(config, 1, second).links();
    KINDS.map(|(link_a, link_b)| {
        let keep_m = if (link_a, link_b) == (0, 0) {
            between.shaft_to_shaft_m
        } else {
            between.tip_to_shaft_m
        };
        let ((a_from, a_to), (b_from, b_to)) = (&a[link_a], &b[link_b]);
        distance_between_m(a_from, a_to, b_from, b_to) - 2.0 * SHAFT_RADIUS_M - keep_m
    })
}

fn gap_m(config: &ControlConfig, states: &[MotionState; 2]) -> f64 {
    least(&gaps(config, &states[0], &states[1]))
}

/// The least gap between what is left of both stops, at all pairs of times.
fn stops_gap_m(rig: &Rig<2>) -> f64 {
    let at = |arm: usize, part: u32| {
        let (stop, played_s) = rig.guard.held()[arm];
        let left_s = (stop.duration_s() - played_s).max(0.0);
        stop.at(played_s + left_s * f64::from(part) / 30.0)
    };
    let mut least_m = f64::INFINITY;
    for i in 0..=30 {
        let first = at(0, i);
        for j in 0..=30 {
            least_m = least_m.min(gap_m(&rig.config, &[first, at(1, j)]));
        }
    }
    least_m
}

fn rig(seed: u64) -> Rig<2> {
    Rig::new(two_arms(APART_M), [home(); 2], seed)
}

/// Yaw towards the other arm, at full speed.
pub(super) fn towards(rig: &Rig<2>, arm: usize) -> f64 {
    let mut states = rig.states;
    states[arm].position[0] += 1e-4;
    let nearer = gap_m(&rig.config, &states) < gap_m(&rig.config, &rig.states);
    let speed = rig.config.axes[0].velocity;
    if nearer { speed } else { -speed }
}

#[test]
fn two_arms_driven_by_garbage_never_come_too_near() {
    let (mut least_m, mut intervened) = (f64::INFINITY, [0; 2]);
    for seed in 0..4 {
        let mut rig = rig(80 + seed);
        let margin_m = rig.config.margins.guard_m;
        for tick in 0..8_000 {
            rig.shuffle();
            if tick % 400 < 200 {
                // And straight at each other every now and then.
                for arm in 0..2 {
                    rig.velocity[arm][0] = towards(&rig, arm);
                }
            }
            for (count, decision) in intervened.iter_mut().zip(rig.step()) {
                *count += u32::from(decision.intervened);
            }
            let now_m = gap_m(&rig.config, &rig.states);
            assert!(now_m >= margin_m - 1e-9, "seed {seed} tick {tick}: {now_m}");
            least_m = least_m.min(now_m);
        }
    }
    assert!(least_m < 1e-3, "they never met: {least_m}");
    assert!(
        intervened.iter().all(|&count| count > 500),
        "{intervened:?}"
    );
}

#[test]
fn without_the_guard_they_collide() {
    let mut rig = rig(80);
    rig.guard.plant(PlantedGuardFault::GuardSkipped);
    let mut least_m = f64::INFINITY;
    for _ in 0..1_000 {
        for arm in 0..2 {
            rig.velocity[arm][0] = towards(&rig, arm);
        }
        let requests = rig.candidates().map(Request::Follow);
        rig.states = rig
            .guard
            .next(&rig.states, &requests)
            .map(|next| next.state);
        least_m = least_m.min(gap_m(&rig.config, &rig.states));
    }
    assert!(least_m < 0.0, "{least_m}");
}

#[test]
fn stops_keep_apart_at_all_pairs_of_times() {
    let mut rig = rig(85);
    let margin_m = rig.config.margins.guard_m;
    let mut near = 0;
    for tick in 0..6_000 {
        rig.shuffle();
        if tick % 400 < 200 {
            for arm in 0..2 {
                rig.velocity[arm][0] = towards(&rig, arm);
            }
        }
        rig.step();
        if tick % 20 == 0 {
            let now_m = stops_gap_m(&rig);
            assert!(now_m >= margin_m - 1e-9, "tick {tick}: {now_m}");
            near += u32::from(now_m < 0.003);
        }
    }
    assert!(near > 20, "{near}");
}

#[test]
fn either_arm_may_stop_alone_while_the_other_goes_on() {
    let mut random = SplitMix64::new(86);
    let mut met = 0;
    for case in 0..60 {
        let mut rig = rig(860 + case);
        let margin_m = rig.config.margins.guard_m;
        for _ in 0..(200 + random.next_u64() % 300) {
            rig.shuffle();
            for arm in 0..2 {
                rig.velocity[arm][0] = towards(&rig, arm);
            }
            rig.step();
        }
        let stops = usize::from(case % 2 == 1);
        for _ in 0..400 {
            rig.shuffle();
            rig.velocity[1 - stops][0] = towards(&rig, 1 - stops);
            let mut requests = rig.candidates().map(Request::Follow);
            requests[stops] = Request::Stop;
            assert!(!rig.ask(&requests)[stops].intervened);
            let now_m = gap_m(&rig.config, &rig.states);
            assert!(now_m >= margin_m - 1e-9, "case {case}: {now_m}");
            met += u32::from(now_m < 0.002);
        }
        assert!(rig.states[stops].is_at_rest());
    }
    assert!(met > 100, "{met}");
}

#[test]
fn neither_arm_starves() {
    // Each wants to go where the other is, then both want to get away along the wall between them.
    let mut rig = rig(87);
    let mut taken = [0_u32; 2];
    for tick in 0..6_000 {
        for arm in 0..2 {
            if rig.random.happens(0.02) {
                rig.velocity[arm] = bang(&rig.config, &mut rig.random);
            }
            if tick % 100 < 60 {
                rig.velocity[arm][0] = towards(&rig, arm);
            }
        }
        for (count, decision) in taken.iter_mut().zip(rig.step()) {
            *count += u32::from(!decision.intervened);
        }
    }
    let (most, fewest) = (taken[0].max(taken[1]), taken[0].min(taken[1]));
    assert!(4 * fewest > 3 * most && fewest > 2_000, "{taken:?}");
}

#[test]
fn an_arm_at_rest_near_the_other_holds_nobody_up() {
    let mut rig = rig(88);
    for _ in 0..2_000 {
        for arm in 0..2 {
            rig.velocity[arm] = [0.0; AXES];
            rig.velocity[arm][0] = towards(&rig, arm);
        }
        rig.step();
    }
    let met_m = gap_m(&rig.config, &rig.states);
    assert!(met_m < 0.002, "they met: {met_m}");
    for arm in 0..2 {
        // One goes away while the other still pushes, and comes back to where it is stopped again.
        let speed = towards(&rig, arm);
        for (ticks, side) in [(400, -0.5), (1_000, 1.0)] {
            let mut taken = 0;
            for _ in 0..ticks {
                rig.velocity[arm][0] = side * speed;
                rig.velocity[1 - arm][0] = 0.0;
                taken += u32::from(!rig.step()[arm].intervened);
            }
            assert!(taken > 250, "arm {arm}: {taken}");
        }
    }
}

#[test]
fn arms_enabled_too_near_come_no_nearer_and_apart() {
    for (case, start_m) in [(0, 2e-4), (1, -1e-4), (2, -2e-3), (3, -5e-3)] {
        let config = two_arms(APART_M);
        let mut states = [home(); 2];
        let probe = Rig::new(config.clone(), states, 0);
        let sides = [0, 1].map(|arm| towards(&probe, arm).signum());
        // Both lean towards the other until they are that near.
        while gap_m(&config, &states) > start_m {
            for (state, side) in states.iter_mut().zip(sides) {
                state.position[0] += 1e-4 * side;
            }
            assert!(states[0].position[0].abs() < 1.0);
        }
        let mut rig = Rig::new(config.clone(), states, 890 + case);
        let starts_m = gaps(&config, &states[0], &states[1]);
        let recovery_m = config.margins.recovery_m;
        let away = [0, 1].map(|arm| -towards(&rig, arm));
        for tick in 0..4_000 {
            if tick < 2_000 {
                rig.shuffle();
                for arm in 0..2 {
                    rig.velocity[arm][0] = towards(&rig, arm);
                }
            } else {
                for (velocity, away) in rig.velocity.iter_mut().zip(away) {
                    *velocity = [0.0; AXES];
                    velocity[0] = away;
                }
            }
            rig.step();
            let now_m = gaps(&config, &rig.states[0], &rig.states[1]);
            for (kind, (&now_m, &start_m)) in now_m.iter().zip(&starts_m).enumerate() {
                let keep_m = if start_m < 0.0 {
                    start_m - recovery_m
                } else {
                    0.0
                };
                assert!(
                    now_m >= keep_m.min(config.margins.guard_m),
                    "case {case} tick {tick} kind {kind}: {now_m} from {start_m}"
                );
            }
        }
        let end_m = gap_m(&config, &rig.states);
        assert!(end_m > 0.01, "case {case}: {end_m}");
    }
}

#[test]
fn one_arm_may_be_seeded_while_the_other_moves() {
    let mut rig = rig(89);
    let margin_m = rig.config.margins.guard_m;
    let mut at = home();
    for tick in 0..6_000 {
        rig.shuffle();
        // A hand swings the first arm, which is disabled; the second goes for it.
        if tick < 5_000 {
            at.position[0] = 0.05 * (f64::from(tick) * 2e-3).sin();
        }
        rig.states[0] = at;
        rig.guard.seed(0, &at);
        rig.velocity[1][0] = towards(&rig, 1);
        let candidate = rig.candidates()[1];
        let before_m = gap_m(&rig.config, &rig.states);
        let decisions = rig
            .guard
            .next(&rig.states, &[Request::Stop, Request::Follow(candidate)]);
        rig.states[1] = decisions[1].state;
        assert_eq!(decisions[0].state, at);
        let now_m = gap_m(&rig.config, &rig.states);
        // The hand may bring the arm as near as it likes; the other one then goes no nearer.
        assert!(
            now_m >= margin_m.min(before_m - 1e-4),
            "{tick}: {now_m} {before_m}"
        );
        if tick > 5_500 {
            assert!(now_m >= 0.0_f64.min(before_m), "{tick}: {now_m} {before_m}");
        }
    }
}

#[test]
fn an_arm_that_trembles_without_torque_gives_the_other_no_way() {
    for (case, start_m) in [(0, 1e-3), (1, 1e-4), (2, -1e-3)] {
        let config = two_arms(APART_M);
        let mut states = [home(); 2];
        let probe = Rig::new(config.clone(), states, 0);
        let sides = [0, 1].map(|arm| towards(&probe, arm).signum());
        while gap_m(&config, &states) > start_m {
            for (state, side) in states.iter_mut().zip(sides) {
                state.position[0] += 1e-5 * side;
            }
        }
        let mut rig = Rig::new(config.clone(), states, 95 + case);
        let starts_m = gap_m(&config, &states);
        for tick in 0..3_000 {
            let mut trembling = states[0];
            for (axis, position) in trembling.position.iter_mut().enumerate() {
                let size = if axis == 2 { 1e-6 } else { 1e-5 };
                *position += rig.random.between(-size, size);
            }
            rig.states[0] = trembling;
            rig.guard.seed(0, &trembling);
            rig.velocity[1][0] = towards(&rig, 1);
            let candidate = rig.candidates()[1];
            let requests = [Request::Stop, Request::Follow(candidate)];
            rig.states[1] = rig.guard.next(&rig.states, &requests)[1].state;
            let still_m = gap_m(&config, &[states[0], rig.states[1]]);
            let keep_m = starts_m.min(0.0) - config.margins.recovery_m;
            // Once the recovery, and what the trembling itself is.
            assert!(
                still_m > keep_m - 4e-6,
                "case {case} tick {tick}: {still_m} from {starts_m}"
            );
        }
    }
}
