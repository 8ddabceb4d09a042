//! One arm under garbage.

use super::{
    AXES, MotionState, Request, Rig, clearances, config, config_with, home, least, sample, shapes,
};
use crate::config::ControlConfig;
use crate::guard::clearance::FACES;
use crate::guard::planted::PlantedGuardFault;
use crate::guard::{Decision, Guard, GuardError};

/// What garbage made of an arm.
#[derive(Debug)]
struct Outcome {
    /// Least clearance of all, and of the regions alone, m.
    least_m: f64,
    region_m: f64,
    /// Highest shares of the limits of the tip's speed and turning speed.
    speed: f64,
    turn: f64,
    interventions: u32,
}

fn garbage(config: ControlConfig, seed: u64, ticks: u32, guarded: bool) -> Outcome {
    let mut rig = Rig::new(config, [home()], seed);
    if !guarded {
        rig.guard.plant(PlantedGuardFault::GuardSkipped);
    }
    let mut outcome = Outcome {
        least_m: f64::INFINITY,
        region_m: f64::INFINITY,
        speed: 0.0,
        turn: 0.0,
        interventions: 0,
    };
    for _ in 0..ticks {
        rig.shuffle();
        let intervened = if guarded {
            rig.step()[0].intervened
        } else {
            let requests = rig.candidates().map(Request::Follow);
            rig.states = rig
                .guard
                .next(&rig.states, &requests)
                .map(|next| next.state);
            false
        };
        outcome.interventions += u32::from(intervened);
        let sample = sample(&rig.config, 0, &rig.states[0]);
        outcome.least_m = outcome.least_m.min(least(&sample.clearances));
        outcome.region_m = outcome.region_m.min(least(&sample.clearances[FACES..]));
        let speed = sample.tip_speed_m_s / rig.config.tip_speed_m_s;
        let turn = sample.tip_turn_rad_s / rig.config.tip_angular_speed_rad_s;
        outcome.speed = outcome.speed.max(speed);
        outcome.turn = outcome.turn.max(turn);
    }
    outcome
}

#[test]
fn the_guard_alone_keeps_every_limit_under_garbage() {
    let config = config();
    let margin_m = config.margins.guard_m;
    let outcome = garbage(config, 51, 60_000, true);
    assert!(outcome.least_m >= margin_m - 1e-9, "{outcome:?}");
    assert!(outcome.speed <= 1.0 + 1e-9, "{outcome:?}");
    assert!(outcome.turn <= 1.0 + 1e-9, "{outcome:?}");
    // It went to all of these limits.
    assert!(outcome.least_m < margin_m + 1e-3, "{outcome:?}");
    assert!(outcome.speed > 0.9 && outcome.turn > 0.9, "{outcome:?}");
    assert!(outcome.interventions > 1_000, "{outcome:?}");
}

#[test]
fn every_shape_is_respected_under_garbage() {
    for (index, shape) in shapes().into_iter().enumerate() {
        let config = config_with(&[shape]);
        let margin_m = config.margins.guard_m;
        let (mut region_m, mut unguarded_m) = (f64::INFINITY, f64::INFINITY);
        for seed in 0..4 {
            let outcome = garbage(config.clone(), 520 + seed, 10_000, true);
            assert!(outcome.least_m >= margin_m - 1e-9, "{index}: {outcome:?}");
            region_m = region_m.min(outcome.region_m);
            let outcome = garbage(config.clone(), 520 + seed, 2_000, false);
            unguarded_m = unguarded_m.min(outcome.region_m);
        }
        assert!(region_m < margin_m + 1e-3, "{index} never met: {region_m}");
        assert!(unguarded_m < 0.0, "{index}: {unguarded_m}");
    }
}

#[test]
fn all_shapes_at_once_are_respected_under_garbage() {
    let config = config_with(&shapes());
    let margin_m = config.margins.guard_m;
    let outcome = garbage(config, 54, 30_000, true);
    assert!(outcome.least_m >= margin_m - 1e-9, "{outcome:?}");
    assert!(outcome.region_m < margin_m + 1e-3, "{outcome:?}");
}

#[test]
fn garbage_without_the_guard_breaks_them() {
    let outcome = garbage(config(), 51, 5_000, false);
    assert!(outcome.least_m < 0.0, "{outcome:?}");
    assert!(outcome.speed > 1.0 && outcome.turn > 1.0, "{outcome:?}");
}

#[test]
fn a_jump_is_refused_and_the_held_stop_played() {
    let state = home();
    let mut guard = Guard::new(&config(), &[state], super::TICK_S).unwrap();
    let mut ask = |request: Request| guard.next(&[state], &[request])[0];
    let refused = Decision {
        state,
        intervened: true,
    };
    let follow = |change: fn(&mut MotionState)| {
        let mut candidate = state;
        change(&mut candidate);
        Request::Follow(Some(candidate))
    };
    assert_eq!(ask(follow(|next| next.position[0] += 1e-6)), refused);
    assert_eq!(ask(follow(|next| next.velocity[2] += 1e-4)), refused);
    assert_eq!(ask(follow(|next| next.acceleration[1] = 1.0)), refused);
    assert_eq!(ask(follow(|next| next.velocity[4] = f64::NAN)), refused);
    assert_eq!(
        ask(follow(|next| next.position[6] = f64::INFINITY)),
        refused
    );
    assert_eq!(ask(Request::Follow(None)), refused);
    let granted = Decision {
        state,
        intervened: false,
    };
    assert_eq!(ask(Request::Follow(Some(state))), granted);
    assert_eq!(ask(Request::Stop), granted);
}

#[test]
fn asked_to_stop_an_arm_plays_what_it_holds_and_rests() {
    let mut rig = Rig::new(config(), [home()], 55);
    rig.velocity = [[0.2; AXES]];
    for _ in 0..100 {
        rig.step();
    }
    let [(held, played_s)] = rig.guard.held();
    let held = *held;
    assert!(held.duration_s() > 0.05);
    for tick in 1..300_u32 {
        let decision = rig.ask(&[Request::Stop])[0];
        assert!(!decision.intervened);
        let expected = held.at(played_s + f64::from(tick) * super::TICK_S);
        for axis in 0..AXES {
            let off = decision.state.position[axis] - expected.position[axis];
            assert!(off.abs() < 1e-12, "tick {tick}: {off}");
        }
        assert!(clearances(&rig.config, &decision.state)[8] >= rig.config.margins.guard_m);
    }
    assert!(rig.states[0].is_at_rest());
}

#[test]
fn a_guard_needs_each_of_its_arms_in_the_configuration() {
    let config = config();
    let error = Guard::new(&config, &[home(); 2], super::TICK_S).unwrap_err();
    let missing = GuardError::Missing {
        configured: 1,
        wanted: 2,
    };
    assert_eq!(error, missing);
    let eight = [shapes(), shapes()].concat();
    let mut crowded = config_with(&eight);
    assert!(Guard::new(&crowded, &[home()], super::TICK_S).is_ok());
    let one_more = crowded.arms[0].forbidden[0].clone();
    crowded.arms[0].forbidden.push(one_more);
    let error = Guard::new(&crowded, &[home()], super::TICK_S).unwrap_err();
    assert_eq!(error, GuardError::Regions(9));
    let mut two = super::two_arms(0.12);
    assert!(Guard::new(&two, &[home()], super::TICK_S).is_ok());
    two.between_arms = None;
    let error = Guard::new(&two, &[home(); 2], super::TICK_S).unwrap_err();
    assert_eq!(error, GuardError::BetweenArms);
    let error = Guard::new(&two, &[], super::TICK_S).unwrap_err();
    assert_eq!(error, GuardError::Arms(0));
}
