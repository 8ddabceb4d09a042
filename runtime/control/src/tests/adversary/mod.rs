//! Chunks made to do harm, operators, measurements and missed periods that make it worse, and a
//! filter that lies in 5 % of its answers: no command may break a limit. The judge is `verify`,
//! which shares nothing with the controller.
//!
//! `TROCAR_ADVERSARY_TICKS` says how long each attack lasts.

mod attack;
pub(super) mod eyes;
mod figures;
pub(super) mod judge;
pub(super) mod kinds;
mod opinions;
pub(super) mod rig;
mod trouble;

use attack::Attack;
use figures::Figures;
use kinds::Kind;

/// Plays the attack; nothing may be found, and the attack must have been one.
fn withstood<const ARMS: usize>(attack: &Attack) -> Figures {
    let (figures, violations) = attack.play::<ARMS>();
    println!("{:?} on {ARMS}: {figures}", attack.kind);
    assert!(
        violations.is_empty(),
        "{} violations, the first: {:#?}",
        violations.len(),
        &violations[..violations.len().min(8)]
    );
    let arms = ARMS as u64;
    let share = |part: u64| part as f64 / (arms * attack.ticks) as f64;
    assert!(
        share(figures.enabled) > 0.3,
        "too little time to do harm: {figures}"
    );
    assert!(
        share(figures.enabled - figures.still) > 0.2,
        "too little motion: {figures}"
    );
    assert!(
        figures.garbage > attack.ticks / 100,
        "the filter hardly lied: {figures}"
    );
    assert!(
        figures.interventions > attack.ticks / 200,
        "the guard had nothing to do: {figures}"
    );
    assert!(
        figures.faults > attack.ticks / 50_000,
        "nothing went wrong: {figures}"
    );
    assert!(figures.tails > attack.ticks / 1_100);
    figures
}

/// The filter was at work as well.
fn pressed<const ARMS: usize>(attack: &Attack) -> Figures {
    let figures = withstood::<ARMS>(attack);
    assert!(
        figures.solved > attack.ticks / 10,
        "no row was active: {figures}"
    );
    figures
}

macro_rules! attacks {
    ($($name:ident, $kind:ident, $seed:literal, $arms:literal, $withstands:ident;)*) => {
        $(
            #[test]
            fn $name() {
                $withstands::<$arms>(&Attack::new(Kind::$kind, $seed));
            }
        )*
    };
}

attacks! {
    bang_bang_breaks_no_limit, BangBang, 101, 1, pressed;
    jumps_break_no_limit, Jumps, 102, 1, pressed;
    drift_breaks_no_limit, Drift, 103, 1, pressed;
    a_climber_breaks_no_limit, Climber, 104, 1, pressed;
    a_walk_breaks_no_limit, Walk, 105, 1, pressed;
    all_in_turn_break_no_limit, All, 106, 1, pressed;
    nonsense_breaks_no_limit, Nonsense, 107, 1, withstood;
    bad_messages_break_no_limit, Messages, 108, 1, withstood;
    bang_bang_breaks_no_limit_of_two_arms, BangBang, 201, 2, pressed;
    jumps_break_no_limit_of_two_arms, Jumps, 202, 2, pressed;
    drift_breaks_no_limit_of_two_arms, Drift, 203, 2, pressed;
    a_climber_breaks_no_limit_of_two_arms, Climber, 204, 2, pressed;
    a_walk_breaks_no_limit_of_two_arms, Walk, 205, 2, pressed;
    all_in_turn_break_no_limit_of_two_arms, All, 206, 2, pressed;
    nonsense_breaks_no_limit_of_two_arms, Nonsense, 207, 2, withstood;
    bad_messages_break_no_limit_of_two_arms, Messages, 208, 2, withstood;
}

/// With the gate as it is shipped most of it gets no further than that.
fn refused<const ARMS: usize>(seed: u64) {
    let attack = Attack {
        open_gate: false,
        ..Attack::new(Kind::All, seed)
    };
    let (figures, violations) = attack.play::<ARMS>();
    println!("shipped gate on {ARMS}: {figures}");
    assert!(violations.is_empty(), "{violations:#?}");
    assert!(figures.refused > attack.ticks / 200, "{figures}");
    assert!(figures.accepted > attack.ticks / 2000, "{figures}");
}

#[test]
fn the_shipped_gate_refuses_most_of_it() {
    refused::<1>(301);
}

#[test]
fn the_shipped_gate_refuses_most_of_it_for_two_arms() {
    refused::<2>(302);
}

/// A filter that lies in every second answer makes the arm slow, not unsafe.
fn half_garbage<const ARMS: usize>(seed: u64) {
    let attack = Attack {
        garbage: 0.5,
        ..Attack::new(Kind::All, seed)
    };
    let (figures, violations) = attack.play::<ARMS>();
    println!("half of the answers are garbage, on {ARMS}: {figures}");
    assert!(
        violations.is_empty(),
        "{:#?}",
        &violations[..violations.len().min(8)]
    );
    assert!(figures.garbage > attack.ticks / 4 && figures.interventions > attack.ticks / 50);
}

#[test]
fn half_of_all_answers_may_be_garbage() {
    half_garbage::<1>(351);
}

#[test]
fn half_of_all_answers_may_be_garbage_for_two_arms() {
    half_garbage::<2>(352);
}

/// The judge sees what the guard prevents: without it the same attacks break limits, whether the
/// filter lies or not.
fn broken<const ARMS: usize>(garbage: f64) {
    let mut all = 0;
    let mut in_space = 0;
    for kind in [Kind::BangBang, Kind::Jumps, Kind::Climber, Kind::Walk] {
        let attack = Attack {
            garbage,
            guard_removed: true,
            trouble: false,
            ticks: 20_000,
            ..Attack::new(kind, 401)
        };
        let (figures, violations) = attack.play::<ARMS>();
        let places = [
            "workspace",
            "forbidden",
            "tip_speed",
            "tip_angular",
            "between",
        ];
        let found = violations
            .iter()
            .filter(|text| places.iter().any(|limit| text.contains(limit)))
            .count();
        println!(
            "{kind:?} on {ARMS} without the guard, garbage {garbage}: {} violations, {found} of them in space; {figures}",
            violations.len()
        );
        all += violations.len();
        in_space += found;
    }
    assert!(all > 200, "{all}");
    assert!(in_space > 100, "{in_space}");
}

#[test]
fn without_the_guard_the_same_attacks_break_limits() {
    broken::<1>(0.05);
}

#[test]
fn without_the_guard_the_same_attacks_break_limits_of_two_arms() {
    broken::<2>(0.05);
}

#[test]
fn filter_and_smoother_alone_break_limits() {
    broken::<1>(0.0);
}

#[test]
fn filter_and_smoother_alone_break_limits_of_two_arms() {
    broken::<2>(0.0);
}

/// Arms that lag 10 ms behind their setpoints, more than a millimetre at full speed, and whose yaw
/// is off by 0.7 mm at the tip.
fn late() -> Attack {
    Attack {
        follows: 0.1,
        off_rad: 0.006,
        trouble: false,
        garbage: 0.5,
        ..Attack::new(Kind::All, 501)
    }
}

/// An arm that lags as the simulated drives do, by 4 ms, and gains as much speed during a stop as
/// its margin allows; off as well.
fn quick() -> Attack {
    Attack {
        quick: true,
        follows: 0.2,
        ..late()
    }
}

/// How near to their boundaries the arms of `attack` come, mm.
fn lagging<const ARMS: usize>(attack: &Attack, lag_ignored: bool) -> f64 {
    let kinds = [Kind::BangBang, Kind::Jumps, Kind::Climber, Kind::Walk];
    let nearest = kinds.map(|kind| {
        let attack = Attack {
            kind,
            lag_ignored,
            // That a sabotaged guard lets the arms in is seen soon.
            ticks: if lag_ignored { 20_000 } else { attack.ticks },
            ..*attack
        };
        let (figures, violations) = attack.play::<ARMS>();
        println!(
            "{kind:?} on {ARMS}, lag ignored {lag_ignored}: measured {:.3} mm; {figures}",
            figures.measured_mm
        );
        let measured = |text: &String| text.contains("measured.");
        assert!(
            lag_ignored || !violations.iter().any(measured),
            "{violations:#?}"
        );
        figures.measured_mm
    });
    nearest.into_iter().fold(f64::INFINITY, f64::min)
}

#[test]
fn no_measured_arm_that_lags_behind_enters_a_region() {
    let [kept, ignored] = [false, true].map(|ignored| lagging::<1>(&late(), ignored));
    assert!(kept > 0.0 && ignored < 0.0, "{kept} {ignored}");
}

#[test]
fn no_two_measured_arms_that_lag_behind_meet() {
    let [kept, ignored] = [false, true].map(|ignored| lagging::<2>(&late(), ignored));
    assert!(kept > 0.0 && ignored < 0.0, "{kept} {ignored}");
}

/// What an arm falls further behind during a stop is within the least margin that the configuration
/// accepts for it.
#[test]
fn no_measured_arm_with_quick_axes_enters_a_region() {
    let [kept, ignored] = [false, true].map(|ignored| lagging::<1>(&quick(), ignored));
    assert!(kept > 0.0 && ignored < 0.0, "{kept} {ignored}");
}
