//! What the tests of the scripts share: the simulated arms, with a numeric inverse instead of the
//! controller.

use core::ops::Range;

use hal::{Arm, ArmCommand, ArmState, Chunk, JointVector, Pose, SafeTail, TimeNs, psm};
use nalgebra::{Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};

use crate::disturbance::Disturber;
use crate::expert::Expert;
use crate::simulation::{Rendering, Simulation};
use crate::task::{Criteria, Outcome, Reason, TaskConfig};

/// Tip in the RCM frame, straight from the rows of the arm's description.
pub(crate) fn forward(joints: &JointVector) -> Pose {
    let links = psm::DH.iter().zip(joints.iter()).map(|(row, &q)| {
        let (theta, d) = if row.prismatic {
            (row.theta, row.d + q)
        } else {
            (row.theta + q, row.d)
        };
        Pose::rotation(Vector3::x() * row.alpha)
            * Pose::translation(row.a, 0.0, 0.0)
            * Pose::rotation(Vector3::z() * theta)
            * Pose::translation(0.0, 0.0, d)
    });
    let rows = psm::TIP_FROM_WRIST_YAW;
    let tip = Matrix3::from_fn(|row, column| rows[row][column]);
    let tip = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(tip));
    links.fold(Pose::identity(), |chain, link| chain * link)
        * Pose::from_parts(Translation3::identity(), tip)
}

/// Newton's method from a nearby `guess`.
pub(crate) fn inverse(wanted: &Pose, guess: &JointVector) -> JointVector {
    let mut joints = *guess;
    for _ in 0..4 {
        let here = forward(&joints);
        let error = twist(&here, wanted);
        if error.norm() < 1e-10 {
            break;
        }
        let mut jacobian = Matrix6::zeros();
        for joint in 0..6 {
            let mut nudged = joints;
            nudged[joint] += 1e-6;
            jacobian.set_column(joint, &(twist(&here, &forward(&nudged)) / 1e-6));
        }
        joints += jacobian
            .lu()
            .solve(&error)
            .expect("arm away from singularities");
    }
    joints
}

fn twist(from: &Pose, to: &Pose) -> Vector6<f64> {
    let linear = to.translation.vector - from.translation.vector;
    let angular = (to.rotation * from.rotation.inverse()).scaled_axis();
    Vector6::new(
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
    )
}

/// How one episode went.
pub(crate) struct Episode {
    pub(crate) outcome: Outcome,
    pub(crate) seconds: f64,
    pub(crate) attempts: u32,
    pub(crate) speed_m_s_max: f64,
    pub(crate) state_hash: u64,
    /// How the judge's criteria were when the episode was decided.
    pub(crate) criteria: Criteria,
}

/// Runs the expert until the episode is decided; `disturb` may change the command of the first arm.
pub(crate) fn run(
    task: &TaskConfig,
    seed: u64,
    disturb: impl FnMut(f64, &mut ArmCommand),
) -> Episode {
    run_with(task, seed, disturb, &mut None)
}

/// The same, in which `disturber` changes what is executed.
pub(crate) fn run_with(
    task: &TaskConfig,
    seed: u64,
    mut disturb: impl FnMut(f64, &mut ArmCommand),
    disturber: &mut Option<Disturber>,
) -> Episode {
    let mut simulation = Simulation::new(task, seed, Rendering::Off).expect("simulation");
    let mut expert = Expert::new(task, seed);
    let mut joints: Vec<JointVector> = task.arms.iter().map(|arm| arm.joints).collect();
    let mut speed_m_s_max: f64 = 0.0;
    let mut attempts = 1;
    let mut tick = 0;
    let mut criteria = simulation.criteria();
    assert!(!criteria.are_met(), "{criteria:?} before anything is done");
    while simulation.outcome() == Outcome::Running {
        let now = TimeNs::from_tick(tick);
        let mut chunks = expert.chunks(now, &simulation.scene_state(), tick / 40 + 1);
        attempts = expert.attempts();
        if let Some(disturber) = disturber {
            chunks = disturber.step(now, expert.activities(), &chunks, &mut simulation);
        }
        for chunk in &chunks {
            let targets = chunk.valid_targets();
            let (from, to) = (targets[0].tip_in_rcm(), targets[1].tip_in_rcm());
            speed_m_s_max =
                speed_m_s_max.max((to.translation.vector - from.translation.vector).norm() / 0.04);
        }
        for step in 0..40_u32 {
            let share = f64::from(step) / 40.0;
            for (arm, chunk) in chunks.iter().enumerate() {
                let mut command = towards(chunk, share, tick, &mut joints[arm]);
                if arm == 0 {
                    disturb(now.seconds(), &mut command);
                }
                let mut arm = simulation.arm(arm).expect("arm");
                let _: ArmState = arm.read(TimeNs::from_tick(tick)).expect("measured");
                // Every step has its command, so that the tail is never played.
                arm.write(&command, &SafeTail::hold(&command))
                    .expect("written");
            }
            let decided = simulation.outcome() != Outcome::Running;
            simulation.step();
            if !decided && simulation.outcome() != Outcome::Running {
                criteria = simulation.criteria();
            }
            tick += 1;
        }
    }
    let seconds = TimeNs::from_tick(tick).seconds();
    Episode {
        outcome: simulation.outcome(),
        seconds,
        attempts,
        speed_m_s_max,
        state_hash: simulation.state_hash(),
        criteria,
    }
}

/// The command at `share` of the way from the chunk's first target to its second.
fn towards(chunk: &Chunk, share: f64, tick: u64, joints: &mut JointVector) -> ArmCommand {
    let targets = chunk.valid_targets();
    let (from, to) = (targets[0].tip_in_rcm(), targets[1].tip_in_rcm());
    let wanted = from.lerp_slerp(&to, share);
    let before = *joints;
    *joints = inverse(&wanted, &before);
    ArmCommand {
        stamp: TimeNs::from_tick(tick),
        position: *joints,
        velocity: if tick == 0 {
            JointVector::zeros()
        } else {
            (*joints - before) * 1000.0
        },
        acceleration: JointVector::zeros(),
        jaw_position: targets[0].jaw + (targets[1].jaw - targets[0].jaw) * share,
        jaw_velocity: (targets[1].jaw - targets[0].jaw) / 0.04,
        enabled: true,
    }
}

/// A command that holds the first arm where it starts, jaw closed.
pub(crate) fn hold(task: &TaskConfig) -> ArmCommand {
    ArmCommand {
        stamp: TimeNs(0),
        position: task.arms[0].joints,
        velocity: JointVector::zeros(),
        acceleration: JointVector::zeros(),
        jaw_position: -0.2,
        jaw_velocity: 0.0,
        enabled: true,
    }
}

/// Runs the expert over `seeds`; gives what went wrong.
pub(crate) fn failures(task: &TaskConfig, seeds: Range<u64>) -> Vec<String> {
    let mut failed = Vec::new();
    for seed in seeds {
        let episode = run(task, seed, |_, _| {});
        assert!(
            episode.speed_m_s_max < 0.06,
            "seed {seed}: {} m/s",
            episode.speed_m_s_max
        );
        let criteria = &episode.criteria;
        assert_eq!(
            criteria.are_met(),
            episode.outcome == Outcome::Success,
            "{criteria:?}"
        );
        if episode.outcome != Outcome::Success {
            failed.push(format!(
                "seed {seed}: {} after {:.1} s and {} attempts",
                episode.outcome, episode.seconds, episode.attempts
            ));
        }
    }
    failed
}

/// Checks that the expert does `task` with each of `seeds`.
pub(crate) fn succeeds(task: &TaskConfig, seeds: Range<u64>) {
    let failed = failures(task, seeds);
    assert!(failed.is_empty(), "{}: {failed:#?}", task.name);
}

/// Checks that the same seed gives the same episode bit for bit, and another seed another one.
pub(crate) fn repeats(task: &TaskConfig) {
    let hash = |seed| run(task, seed, |_, _| {}).state_hash;
    let before = hash(3);
    assert_eq!(before, hash(3), "{}", task.name);
    assert_ne!(before, hash(4), "{}", task.name);
}

/// Checks that time runs out on a first arm that holds still.
pub(crate) fn needs_its_hand(task: &TaskConfig) {
    let hold = hold(task);
    let episode = run(task, 2, |_, command| *command = hold);
    assert!(
        matches!(episode.outcome, Outcome::Failure(Reason::TimeLimit { .. })),
        "{}: {}",
        task.name,
        episode.outcome
    );
    assert!(episode.seconds >= task.time_limit_s, "{}", task.name);
}

/// Checks that the expert does `task` in more than one attempt, within `limit_s`, after the first
/// arm's jaw stood at `jaw_rad` during `window_s`, whatever its command.
pub(crate) fn recovers(task: &TaskConfig, limit_s: f64, window_s: Range<f64>, jaw_rad: f64) {
    let mut task = task.clone();
    task.time_limit_s = limit_s;
    let episode = run(&task, 1, |seconds, command| {
        if window_s.contains(&seconds) {
            command.jaw_position = jaw_rad;
            command.jaw_velocity = 0.0;
        }
    });
    let (outcome, attempts) = (episode.outcome, episode.attempts);
    assert_eq!(outcome, Outcome::Success, "{outcome}, {attempts} attempts");
    assert!(attempts > 1);
}

#[test]
fn every_task_that_ships_has_an_expert_that_does_it() {
    for name in TaskConfig::names() {
        succeeds(&TaskConfig::shipped(name), 20..21);
    }
}
