//! Tests of the expert on the simulated arm, with a numeric inverse instead of the controller.

use hal::{Arm, ArmCommand, ArmState, JointVector, Pose, SafeTail, TimeNs, psm};
use nalgebra::{Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};

use super::{CHUNK_LEN, Expert, STEP_NS};
use crate::simulation::{Rendering, SceneState, Simulation};
use crate::task::{Outcome, TaskConfig};

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
}

/// Drives `simulation` with the expert until it is decided; `disturb` may change what the arm is told.
fn run(task: &TaskConfig, seed: u64, mut disturb: impl FnMut(f64, &mut ArmCommand)) -> Episode {
    let mut simulation = Simulation::new(task, seed, Rendering::Off).expect("simulation");
    let mut expert = Expert::new(task, seed);
    let mut joints = task.joints0;
    let mut speed_m_s_max: f64 = 0.0;
    let mut attempts = 1;
    let mut tick = 0;
    while simulation.outcome() == Outcome::Running {
        let now = TimeNs::from_tick(tick);
        let chunk = expert.chunk(now, &simulation.scene_state(), tick / 40 + 1);
        attempts = expert.attempts;
        let targets = chunk.valid_targets();
        let (from, to) = (targets[0].tip_in_rcm(), targets[1].tip_in_rcm());
        speed_m_s_max =
            speed_m_s_max.max((to.translation.vector - from.translation.vector).norm() / 0.04);
        for step in 0..40_u32 {
            let share = f64::from(step) / 40.0;
            let wanted = from.lerp_slerp(&to, share);
            let before = joints;
            joints = inverse(&wanted, &before);
            let mut command = ArmCommand {
                stamp: TimeNs::from_tick(tick),
                position: joints,
                velocity: if tick == 0 {
                    JointVector::zeros()
                } else {
                    (joints - before) * 1000.0
                },
                acceleration: JointVector::zeros(),
                jaw_position: targets[0].jaw + (targets[1].jaw - targets[0].jaw) * share,
                jaw_velocity: (targets[1].jaw - targets[0].jaw) / 0.04,
                enabled: true,
            };
            disturb(now.seconds(), &mut command);
            let _: ArmState = simulation.read(TimeNs::from_tick(tick)).expect("measured");
            // Every step has its command, so that the tail is never played.
            simulation
                .write(&command, &SafeTail::hold(&command))
                .expect("written");
            simulation.step();
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
    }
}

#[test]
fn expert_lifts_the_needle() {
    let task = TaskConfig::needle_lift().unwrap();
    let mut lost = Vec::new();
    for seed in 0..10 {
        let episode = run(&task, seed, |_, _| {});
        assert!(
            episode.speed_m_s_max < 0.06,
            "seed {seed}: {} m/s",
            episode.speed_m_s_max
        );
        if episode.outcome == Outcome::Success {
            assert!(
                (3.5..9.0).contains(&episode.seconds),
                "seed {seed}: {} s",
                episode.seconds
            );
        } else {
            lost.push(format!(
                "seed {seed}: {} after {} attempts",
                episode.outcome, episode.attempts
            ));
        }
    }
    assert!(lost.len() <= 1, "{lost:#?}");
}

#[test]
fn same_seed_gives_the_same_episode_bit_for_bit() {
    let task = TaskConfig::needle_lift().unwrap();
    let hash = |seed| run(&task, seed, |_, _| {}).state_hash;
    assert_eq!(hash(3), hash(3));
    assert_ne!(hash(3), hash(4));
}

#[test]
fn needle_lift_is_the_known_episode() {
    // Recorded demonstrations and trained policies rest on these bits.
    let episode = run(&TaskConfig::needle_lift().unwrap(), 3, |_, _| {});
    assert!((episode.seconds - 4.72).abs() < 1e-9, "{}", episode.seconds);
    let known = (1, 0x8700_e7b2_7af6_cab7);
    assert_eq!(
        (episode.attempts, episode.state_hash),
        known,
        "{:#018x}",
        episode.state_hash
    );
}

#[test]
fn still_arm_does_not_succeed() {
    let task = TaskConfig::needle_lift().unwrap();
    let hold = ArmCommand {
        stamp: TimeNs(0),
        position: task.joints0,
        velocity: JointVector::zeros(),
        acceleration: JointVector::zeros(),
        jaw_position: -0.2,
        jaw_velocity: 0.0,
        enabled: true,
    };
    let episode = run(&task, 2, |_, command| *command = hold);
    assert!(
        matches!(episode.outcome, Outcome::Failure(_)),
        "{}",
        episode.outcome
    );
    assert!(episode.seconds >= task.success.time_limit_s);
}

#[test]
fn expert_tries_again_after_the_jaw_let_go() {
    let mut task = TaskConfig::needle_lift().unwrap();
    task.success.time_limit_s = 25.0;
    // Whatever it wants, the jaw opens between 4.0 and 4.3 s, in the middle of the lift.
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
fn chunk_starts_with_the_step_and_goes_on_smoothly() {
    let task = TaskConfig::needle_lift().unwrap();
    let needle_in_scene = task.needle_start.draw(0, &task.needle, &task.organ);
    let mut scene = SceneState {
        tip_in_rcm: forward(&task.joints0),
        needle_in_rcm: task.scene_from_rcm.inv_mul(&needle_in_scene),
        jaw: task.jaw0,
        grasp: crate::world::Grasp {
            left_force_n: 0.0,
            right_force_n: 0.0,
            both_touch: false,
            penetration_m: 0.0,
        },
    };
    let mut expert = Expert::new(&task, 0);
    let mut steps = Expert::new(&task, 0);
    let mut expected = None;
    for step in 0..60 {
        let now = TimeNs(step * STEP_NS);
        let chunk = expert.chunk(now, &scene, step + 1);
        let targets = chunk.valid_targets();
        assert_eq!(
            (targets.len(), chunk.step_ns, chunk.observed_at),
            (CHUNK_LEN, STEP_NS, now)
        );
        assert_eq!(targets[0], steps.step(now, &scene).target);
        // With an arm that keeps up, what was foreseen is what comes.
        assert!(
            expected.is_none_or(|target| target == targets[0]),
            "step {step}"
        );
        expected = Some(targets[1]);
        scene.tip_in_rcm = targets[0].tip_in_rcm();
        scene.jaw = targets[0].jaw;
    }
}
