//! Facts about the safety filter.

use super::Filter;
use crate::control::config::ControlConfig;
use crate::control::motion::{AXES, MotionState};
use crate::control::random::SplitMix64;
use crate::control::report::QpOutcome;
use crate::control::rows::Rows;
use crate::kinematics::Frames;
use hal::JointVector;
use nalgebra::Matrix6;

fn config() -> ControlConfig {
    ControlConfig::load(
        &ControlConfig::default_control(),
        &ControlConfig::needle_lift_safety(),
    )
    .unwrap()
}

fn random_velocity(random: &mut SplitMix64, filter: &Filter, share: f64) -> JointVector {
    JointVector::from_fn(|joint, _| random.between(-share, share) * filter.scale[joint])
}

/// A configuration in or near the needle-lift workspace, with the arm moving.
fn random_rows(random: &mut SplitMix64, config: &ControlConfig) -> (Rows, Matrix6<f64>) {
    let mut state = MotionState {
        position: [0.0; AXES],
        velocity: [0.0; AXES],
        acceleration: [0.0; AXES],
    };
    let centre = [0.0, 0.0, 0.13, 0.0, 0.0, 0.0];
    let spread = [0.5, 0.4, 0.04, 4.0, 1.3, 1.3];
    for joint in 0..hal::JOINT_COUNT {
        state.position[joint] = centre[joint] + random.between(-spread[joint], spread[joint]);
        state.velocity[joint] = random.between(-0.3, 0.3) * config.axes[joint].velocity;
    }
    let frames = Frames::at(&state.joints());
    (Rows::new(config, &state, &frames), frames.tip_jacobian())
}

fn cost(filter: &Filter, change: &JointVector, jacobian: &Matrix6<f64>) -> f64 {
    let twist = jacobian * change;
    let task = twist.component_mul(&twist).dot(&filter.twist_weight);
    task + filter.joint_weight * change.component_div(&filter.scale).norm_squared()
}

#[test]
fn a_velocity_within_the_rows_passes_unchanged() {
    let config = config();
    let mut filter = Filter::new(&config).unwrap();
    let mut random = SplitMix64::new(41);
    let mut passed = 0;
    for _ in 0..5_000 {
        let (rows, jacobian) = random_rows(&mut random, &config);
        let nominal = random_velocity(&mut random, &filter, 0.2);
        if rows.hold(&nominal, &filter.scale, 0.0) {
            let filtered = filter.filter(&nominal, &rows, &jacobian);
            assert_eq!(
                (filtered.velocity, filtered.outcome),
                (nominal, QpOutcome::NotNeeded)
            );
            passed += 1;
        }
    }
    assert!(passed > 200, "{passed}");
}

#[test]
fn every_answer_satisfies_the_rows_and_no_other_velocity_is_nearer() {
    let config = config();
    let mut filter = Filter::new(&config).unwrap();
    let mut random = SplitMix64::new(42);
    let (mut solved, mut rivals) = (0, 0);
    for case in 0..1_500 {
        let (rows, jacobian) = random_rows(&mut random, &config);
        let nominal = random_velocity(&mut random, &filter, 1.5);
        let filtered = filter.filter(&nominal, &rows, &jacobian);
        assert_ne!(filtered.outcome, QpOutcome::Failed, "case {case}");
        assert!(
            rows.hold(&filtered.velocity, &filter.scale, 1e-6),
            "case {case}"
        );
        if filtered.outcome == QpOutcome::NotNeeded {
            continue;
        }
        solved += 1;
        assert!(filtered.rows_active > 0, "case {case}");
        let best = cost(&filter, &(filtered.velocity - nominal), &jacobian);
        for _ in 0..20 {
            let size = 0.1 * random.between(0.0, 1.0).powi(3);
            let rival = filtered.velocity + random_velocity(&mut random, &filter, size);
            if rows.hold(&rival, &filter.scale, 0.0) {
                rivals += 1;
                assert!(
                    cost(&filter, &(rival - nominal), &jacobian) > best - 1e-5 * (1.0 + best),
                    "case {case}"
                );
            }
        }
    }
    assert!(solved > 1_000 && rivals > 500, "{solved} {rivals}");
}

#[test]
fn nan_stops_the_arm_and_the_next_problem_is_solved_again() {
    let config = config();
    let mut filter = Filter::new(&config).unwrap();
    let mut random = SplitMix64::new(43);
    let (rows, jacobian) = random_rows(&mut random, &config);
    let mut nominal = random_velocity(&mut random, &filter, 3.0);
    let before = filter.filter(&nominal, &rows, &jacobian);
    let good = nominal;
    nominal[2] = f64::NAN;
    let broken = filter.filter(&nominal, &rows, &jacobian);
    assert_eq!(
        (broken.velocity, broken.outcome),
        (JointVector::zeros(), QpOutcome::Failed)
    );
    assert_eq!(filter.filter(&good, &rows, &jacobian), before);
}
