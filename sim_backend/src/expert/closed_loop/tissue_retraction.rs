//! The tissue retraction's expert.

use super::{failures, hold, run};
use crate::task::{Outcome, Reason, TaskConfig};

fn task() -> TaskConfig {
    TaskConfig::parse(&TaskConfig::source("tissue-retraction").unwrap()).unwrap()
}

#[test]
fn expert_retracts_the_flap() {
    let failed = failures(&task(), 0..6);
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
#[ignore = "takes minutes"]
fn expert_retracts_the_flap_fifty_times() {
    let failed = failures(&task(), 100..150);
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn same_seed_gives_the_same_retraction_bit_for_bit() {
    let task = task();
    let hash = |seed| run(&task, seed, |_, _| {}).state_hash;
    assert_eq!(hash(3), hash(3));
    assert_ne!(hash(3), hash(4));
}

#[test]
fn still_arm_retracts_nothing() {
    let task = task();
    let hold = hold(&task);
    let episode = run(&task, 2, |_, command| *command = hold);
    assert!(matches!(
        episode.outcome,
        Outcome::Failure(Reason::TimeLimit { .. })
    ));
}

#[test]
fn expert_takes_the_flap_again_after_the_jaw_let_go() {
    let mut task = task();
    task.time_limit_s = 30.0;
    // Whatever it wants, the jaw opens for a moment while the flap is lifted.
    let episode = run(&task, 1, |seconds, command| {
        if (4.0..4.3).contains(&seconds) {
            command.jaw_position = 0.6;
            command.jaw_velocity = 0.0;
        }
    });
    assert_eq!(
        episode.outcome,
        Outcome::Success,
        "{} after {} attempts",
        episode.outcome,
        episode.attempts
    );
    assert!(episode.attempts > 1);
}

#[test]
#[ignore = "trace"]
fn trace() {
    use super::{inverse, towards};
    use crate::expert::Expert;
    use crate::simulation::{Rendering, Simulation};
    use hal::{Arm, ArmState, JointVector, SafeTail, TimeNs};
    let task = task();
    let seed: u64 = std::env::var("SEED").unwrap().parse().unwrap();
    let mut simulation = Simulation::new(&task, seed, Rendering::Off).unwrap();
    let mut expert = Expert::new(&task, seed);
    let mut joints: JointVector = task.arms[0].joints;
    let mut tick = 0;
    while simulation.outcome() == Outcome::Running {
        let now = TimeNs::from_tick(tick);
        let state = simulation.scene_state();
        let chunks = expert.chunks(now, &state, tick / 40 + 1);
        let base = task.arms[0].scene_from_rcm;
        let tip = base * state.first.tip_in_rcm;
        let mark = base * state.first.thing_in_rcm;
        let want = base * chunks[0].valid_targets()[0].tip_in_rcm();
        let t = tip.translation.vector * 1e3;
        let w = want.translation.vector * 1e3;
        let m = mark.translation.vector * 1e3;
        let r = simulation.world.tissue().unwrap().report();
        let j = simulation.world.tissue().unwrap().jaw(0);
        let inp = simulation.world.jaw_of(0);
        println!(
            "{:.2} att {} tip {:.1} {:.1} {:.1} err {:.2} jaw {:.3} want {:.3} mark {:.1} {:.1} {:.1} | grip {:.2} press {:.3} {:.3} w {:.3} depth {:.2} gr {:?} f {:.3} sm {:.3} st {:.2} v {:.2} rise {:.1}",
            now.seconds(),
            expert.attempts(),
            t.x,
            t.y,
            t.z,
            (t - w).norm(),
            state.first.jaw,
            chunks[0].valid_targets()[0].jaw,
            m.x,
            m.y,
            m.z,
            inp.grip_n,
            j.pressed_n[0],
            j.pressed_n[1],
            j.pressed_n[2],
            j.depth_m * 1e3,
            j.grasp
                .map(|g| (g.area_m2 * 1e6, g.force_n, g.beside_mark_m * 1e3)),
            r.force_n,
            r.smooth_force_n,
            r.stretch,
            r.speed_m_s,
            r.mark_rise_m * 1e3
        );
        for step in 0..40_u32 {
            let command = towards(&chunks[0], f64::from(step) / 40.0, tick, &mut joints);
            let mut arm = simulation.arm(0).unwrap();
            let _: ArmState = arm.read(TimeNs::from_tick(tick)).unwrap();
            arm.write(&command, &SafeTail::hold(&command)).unwrap();
            simulation.step();
            tick += 1;
        }
    }
    println!("{}", simulation.outcome());
    let _ = inverse;
}
