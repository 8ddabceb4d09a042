//! Examples that read no clock.

use crate::{own_arm, own_policy};

#[test]
fn an_own_arm_is_led_to_its_target() {
    let away_m = own_arm::run().unwrap();
    assert!(away_m < 2e-4, "{away_m}");
}

#[test]
fn an_own_policy_is_asked_and_its_chunks_are_taken() {
    let result = own_policy::run().unwrap();
    let summary = result.summary;
    assert_eq!(summary.policy.name, "circles");
    assert_eq!((result.ok, summary.success), (false, Some(false)));
    assert!(summary.policy.queries > 50, "{summary:?}");
    assert_eq!(summary.policy.refused, 0, "{summary:?}");
}

/// The trials are those of single runs, however many there are at a time: each begins with the
/// policy as it was at first.
#[test]
fn an_own_policy_is_evaluated() {
    let run = own_policy::run().unwrap().summary;
    let commands = |jobs: usize| {
        let evaluated = own_policy::evaluate(2, jobs).unwrap();
        assert_eq!(evaluated.policy, "circles");
        assert_eq!((evaluated.trials, evaluated.successes), (2, 0));
        let trials = evaluated.episodes.into_iter();
        let trials = trials.map(|trial| (trial.seed, trial.command_hash));
        trials.collect::<Vec<_>>()
    };
    let found = commands(1);
    let seeds: Vec<u64> = found.iter().map(|(seed, _)| *seed).collect();
    assert_eq!(seeds, [7, 8]);
    assert_eq!(found.first().unwrap().1, run.command_hash);
    assert_eq!(found, commands(2));
}
