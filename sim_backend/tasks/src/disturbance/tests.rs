//! Facts about disturbed demonstrations: what befalls them, that experts recover, and that nothing
//! else changes.

use std::collections::BTreeMap;
use std::ops::Range;

use super::*;
use crate::closed_loop::{Episode, run, run_with};
use crate::simulation::Rendering;
use crate::task::Outcome;

/// A built-in task with the time for recoveries that recordings give it.
fn patient(name: &str) -> TaskConfig {
    let mut task = TaskConfig::shipped(name);
    task.time_limit_s *= 2.0;
    task
}

/// The episode `seed` under a disturber that plans `planned`, and what happened.
fn disturbed(task: &TaskConfig, seed: u64, planned: Vec<Planned>) -> (Episode, Vec<Disturbance>) {
    let mut disturber = Disturber::draw(task, seed, 1.0).unwrap();
    disturber.planned = planned;
    let mut disturber = Some(disturber);
    let episode = run_with(task, seed, |_, _| {}, &mut disturber);
    (episode, disturber.unwrap().happened)
}

fn plan(activity: Activity, duration_s: f64, what: DisturbanceKind) -> Planned {
    Planned {
        arm: 0,
        activity,
        delay_s: 0.2,
        duration_s,
        what,
    }
}

fn kind(what: &DisturbanceKind) -> &'static str {
    match what {
        DisturbanceKind::Offset { .. } => "offset",
        DisturbanceKind::Miss { .. } => "miss",
        DisturbanceKind::Slip { .. } => "slip",
        DisturbanceKind::Nudge { .. } => "nudge",
    }
}

/// Checks that of the demonstrations `seeds` of the task `name`, all of them disturbed, at least
/// `least` succeed.
fn recovers(name: &str, seeds: Range<u64>, least: usize) {
    let task = patient(name);
    let (mut done, mut retried) = (0, 0);
    let mut kinds = BTreeMap::<&str, [u32; 2]>::new();
    let mut failures = Vec::new();
    for seed in seeds.clone() {
        let mut disturber = Disturber::draw(&task, seed, 1.0);
        let episode = run_with(&task, seed, |_, _| {}, &mut disturber);
        let happened = disturber.unwrap().happened;
        let success = episode.outcome == Outcome::Success;
        for disturbance in &happened {
            let counts = kinds.entry(kind(&disturbance.what)).or_default();
            counts[0] += 1;
            counts[1] += u32::from(!success);
        }
        if success {
            done += 1;
            retried += u32::from(episode.attempts > 1);
        } else {
            let (outcome, seconds) = (episode.outcome, episode.seconds);
            failures.push(format!(
                "seed {seed}: {outcome} after {seconds:.1} s: {happened:?}"
            ));
        }
    }
    let report = format!(
        "{name}, seeds {seeds:?}: {done} done, {retried} of them with another grasp; kinds, and those in losses: {kinds:?}; {failures:#?}"
    );
    assert!(done >= least, "{report}");
}

#[test]
fn expert_lifts_a_needle_when_disturbed() {
    recovers("needle-lift", 100..104, 3);
}

#[test]
fn experts_hand_a_needle_over_when_disturbed() {
    recovers("needle-handover", 100..104, 3);
}

#[test]
fn expert_lifts_a_flap_when_disturbed() {
    recovers("tissue-retraction", 100..104, 3);
}

#[test]
fn expert_drives_a_needle_when_disturbed() {
    recovers("suture-pad", 100..104, 3);
}

#[test]
fn expert_moves_a_block_when_disturbed() {
    recovers("block-transfer", 100..104, 3);
}

#[test]
#[ignore = "takes minutes"]
fn disturbed_experts_succeed_45_times_of_50() {
    std::thread::scope(|scope| {
        for name in TaskConfig::names() {
            scope.spawn(move || recovers(name, 0..50, 45));
        }
    });
}

/// The plan of an episode has nothing to do with the rest of it.
#[test]
fn nothing_planned_changes_nothing() {
    for name in TaskConfig::names() {
        let task = TaskConfig::shipped(name);
        let (episode, happened) = disturbed(&task, 3, Vec::new());
        let undisturbed = run(&task, 3, |_, _| {});
        assert_eq!(episode.state_hash, undisturbed.state_hash, "{name}");
        assert_eq!(happened, []);
    }
}

#[test]
fn a_miss_leads_to_a_second_grasp_in_every_task() {
    for name in TaskConfig::names() {
        let task = patient(name);
        let miss = DisturbanceKind::Miss {
            back_m: 0.006,
            beside_m: 0.001,
        };
        let (episode, happened) =
            disturbed(&task, 1, vec![plan(Activity::Grasp, MISS_S_MAX, miss)]);
        let outcome = episode.outcome;
        assert_eq!(outcome, Outcome::Success, "{name}: {outcome}");
        assert_eq!((episode.attempts, happened.len()), (2, 1), "{name}");
        assert_eq!(happened[0].what, miss);
        // It ends when the jaw has closed on nothing, not when its time is up.
        let lasted_s = happened[0].to_s - happened[0].from_s;
        assert!(
            (1.0..MISS_S_MAX - 0.1).contains(&lasted_s),
            "{name}: {lasted_s}"
        );
    }
}

#[test]
fn what_slips_out_of_the_jaw_is_fetched_again() {
    for name in TaskConfig::names() {
        let task = patient(name);
        let slip = plan(Activity::Lift, 0.3, DisturbanceKind::Slip { jaw_rad: 0.4 });
        let (episode, happened) = disturbed(&task, 2, vec![slip]);
        let outcome = episode.outcome;
        assert_eq!(outcome, Outcome::Success, "{name}: {outcome}");
        assert_eq!((episode.attempts, happened.len()), (2, 1), "{name}");
    }
}

/// The script of the needle lift in lockstep with a world in which nothing but the disturber acts.
#[test]
fn intentions_stay_and_what_is_executed_leaves_them_smoothly() {
    let task = TaskConfig::shipped("needle-lift");
    let mut simulation = Simulation::new(&task, 0, Rendering::Off).unwrap();
    let mut expert = crate::expert::Expert::new(&task, 0);
    let mut disturber = Disturber::draw(&task, 0, 1.0).unwrap();
    let peak_m = [0.004, -0.003, 0.002];
    disturber.planned = vec![plan(
        Activity::Reach,
        0.6,
        DisturbanceKind::Offset {
            in_scene_m: peak_m,
            in_tip_m: [0.0; 3],
            turn_rad: [0.0, 0.0, 0.1],
        },
    )];
    let (mut gap_m_max, mut turn_rad_max, mut before_m) = (0.0_f64, 0.0_f64, 0.0_f64);
    for step in 0..30_u64 {
        let now = TimeNs(step * crate::expert::STEP_NS);
        let intended = expert.chunks(now, &simulation.scene_state(), step + 1);
        let executed = disturber.step(now, expert.activities(), &intended, &mut simulation);
        let [wanted, done] = [&intended, &executed].map(|chunks| chunks[0].valid_targets()[0]);
        let off = wanted.tip_in_rcm().inv_mul(&done.tip_in_rcm());
        let gap_m = off.translation.vector.norm();
        assert!((gap_m - before_m).abs() < 0.002, "step {step}: {gap_m}");
        if !(0.2..=0.81).contains(&now.seconds()) {
            assert_eq!(intended, executed, "step {step}");
        }
        before_m = gap_m;
        gap_m_max = gap_m_max.max(gap_m);
        turn_rad_max = turn_rad_max.max(off.rotation.angle());
    }
    let peak_m = Vector3::from(peak_m).norm();
    assert!((gap_m_max - peak_m).abs() < 2e-4, "{gap_m_max}");
    assert!((turn_rad_max - 0.1).abs() < 4e-3, "{turn_rad_max}");
    let [only] = disturber.happened() else {
        panic!("{:?}", disturber.happened());
    };
    assert!((only.to_s - only.from_s - 0.6).abs() < 1e-9);
}

#[test]
fn a_nudge_moves_the_thing_and_stops_at_what_is_in_its_way() {
    let moved_m = |name: &str, velocity_m_s| {
        let task = TaskConfig::shipped(name);
        let mut simulation = Simulation::new(&task, 0, Rendering::Off).unwrap();
        let place = |simulation: &Simulation| {
            simulation
                .scene_state()
                .first
                .thing_in_rcm
                .translation
                .vector
        };
        let before = place(&simulation);
        assert!(
            simulation.nudge(Nudge::new(velocity_m_s, 0.0, 60)),
            "{name}"
        );
        for _ in 0..200 {
            simulation.step();
        }
        assert_eq!(simulation.outcome(), Outcome::Running, "{name}");
        (place(&simulation) - before).norm()
    };
    let slid_m = moved_m("needle-lift", [0.0, 0.1]);
    assert!((0.004..0.012).contains(&slid_m), "{slid_m}");
    // The block stands around a peg.
    for (sin, cos) in [0.0_f64, 1.6, 3.1, 4.7].map(f64::sin_cos) {
        let slid_m = moved_m("block-transfer", [0.1 * cos, 0.1 * sin]);
        assert!((0.000_1..0.005).contains(&slid_m), "{slid_m}");
    }
    let task = TaskConfig::shipped("tissue-retraction");
    let mut simulation = Simulation::new(&task, 0, Rendering::Off).unwrap();
    assert!(!simulation.nudge(Nudge::new([0.1, 0.0], 0.0, 60)));
}

#[test]
fn plans_keep_to_their_bounds_and_to_the_share() {
    for name in TaskConfig::names() {
        let task = TaskConfig::shipped(name);
        let mut kinds = BTreeMap::<&str, u32>::new();
        let mut drawn = 0_u32;
        for seed in 0..1000 {
            assert!(Disturber::draw(&task, seed, 0.0).is_none());
            assert!(Disturber::draw(&task, seed, 1.0).is_some());
            let Some(disturber) = Disturber::draw(&task, seed, 0.3) else {
                continue;
            };
            drawn += 1;
            for planned in &disturber.planned {
                *kinds.entry(kind(&planned.what)).or_default() += 1;
                assert!(planned.arm < task.arms.len());
                check(planned);
            }
        }
        assert!((250..350).contains(&drawn), "{name}: {drawn}");
        let has_flap = name == "tissue-retraction";
        let expected: &[&str] = if has_flap {
            &["miss", "offset", "slip"]
        } else {
            &["miss", "nudge", "offset", "slip"]
        };
        assert_eq!(
            kinds.keys().copied().collect::<Vec<_>>(),
            expected,
            "{name}"
        );
        assert!(kinds.values().all(|count| *count > 50), "{name}: {kinds:?}");
    }
}

fn check(planned: &Planned) {
    match planned.what {
        DisturbanceKind::Offset {
            in_scene_m,
            in_tip_m,
            turn_rad,
        } => {
            assert!((0.3..1.0).contains(&planned.duration_s));
            let [x, y, z] = in_scene_m;
            assert!(x.abs() <= 0.006 && y.abs() <= 0.006 && (0.0..=0.004).contains(&z));
            let [beside, across, along] = in_tip_m;
            assert!(beside.abs() <= 0.001 && across.abs() <= 0.000_5);
            assert!((-0.004..=0.0).contains(&along));
            assert!(turn_rad.iter().all(|turn| turn.abs() <= 0.1));
        }
        DisturbanceKind::Miss { back_m, beside_m } => {
            assert!((0.005..0.008).contains(&back_m) && beside_m.abs() <= 0.002);
        }
        DisturbanceKind::Slip { jaw_rad } => {
            assert!((0.25..0.45).contains(&jaw_rad));
            assert!((0.2..0.35).contains(&planned.duration_s));
        }
        DisturbanceKind::Nudge { velocity_m_s, .. } => {
            let speed_m_s = Vector3::new(velocity_m_s[0], velocity_m_s[1], 0.0).norm();
            assert!(speed_m_s * planned.duration_s <= 0.008 + 1e-12);
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_disturbances() {
    let task = patient("needle-lift");
    let happened = |seed| {
        let mut disturber = Disturber::draw(&task, seed, 1.0);
        let episode = run_with(&task, seed, |_, _| {}, &mut disturber);
        (episode.state_hash, disturber.unwrap().happened)
    };
    assert_eq!(happened(5), happened(5));
    assert_ne!(happened(5).1, happened(6).1);
}
