//! Two arms in real time: one loop, one period, one policy process for both.

use std::path::{Path, PathBuf};

use tch::Device;
use tests::{scratch, stderr, trocar};
use trocar_data::relative_action::REPRESENTATION;
use trocar_log::RunLog;
use trocar_nets::act::{Act, ActConfig, ActPreset};
use trocar_nets::checkpoint::{
    AggregationName, DatasetSummary, FeatureStatistics, RECIPE_FORMAT, Recipe,
    RecommendedAggregation, RecordedCamera, SaveOptions, Variants, save,
};
use trocar_nets::normalise::Statistics;
use trocar_nets::parameters::ParameterSource;

use super::{CHECKPOINT, Run, alone, checked_log, expect_a_stop, expect_nothing_left, send};

const TASK: &str = "needle-handover";

const CAMERA: &str = "observation.images.endoscope";

/// Saves a small untrained network of two arms: it wanders about with both.
fn untrained(test: &str) -> PathBuf {
    let folder = scratch(test).join("checkpoint");
    let config = ActConfig {
        chunk_size: 30,
        dim_model: 32,
        n_heads: 4,
        dim_feedforward: 64,
        n_encoder_layers: 1,
        use_vae: false,
        image_height: 64,
        image_width: 64,
        ..ActConfig::preset(ActPreset::Small, &[CAMERA.to_owned()]).for_arms(2)
    };
    let of = |mean: [f32; 7], std: [f32; 7]| {
        let one = Statistics {
            mean: mean.to_vec(),
            std: std.to_vec(),
            min: vec![],
            max: vec![],
        };
        Statistics::joined(&[one.clone(), one])
    };
    // Some millimetres and hundredths of a radian from where the tip is.
    let (length, angle) = (0.004, 0.02);
    let statistics = FeatureStatistics {
        state: of([0.0; 7], [0.5; 7]),
        action: of(
            [0.0, 0.0, 0.004, 0.0, 0.0, 0.0, 0.4],
            [length, length, length, angle, angle, angle, 0.1],
        ),
    };
    let recipe = Recipe {
        format: RECIPE_FORMAT,
        arms: 2,
        action_representation: REPRESENTATION.to_owned(),
        step_ns: 40_000_000,
        query_every_steps: 10,
        aggregation: RecommendedAggregation {
            mode: AggregationName::Newest,
            decay: 0.0,
        },
        cameras: vec![RecordedCamera {
            feature: CAMERA.to_owned(),
            width: 512,
            height: 512,
        }],
        preset: ActPreset::Small.into(),
        variants: Variants {
            backbone_norm: config.backbone_norm,
            loss_denominator: config.loss_denominator,
        },
        recipe: "untrained".to_owned(),
        dataset: DatasetSummary::default(),
        seed: 1,
        training: serde_json::Value::Null,
    };
    let act = Act::new(config, ParameterSource::seeded(1, Device::Cpu)).unwrap();
    save(&folder, &act, &statistics, &recipe, SaveOptions::default()).unwrap();
    folder
}

/// The log has two arms, and whenever one is given a chunk the other is given its part of the same
/// answer; gives their number.
fn answers(log: &RunLog) -> usize {
    let mut count = 0;
    for (tick, chunks) in log.ticks() {
        assert_eq!(tick.arms.count(), 2);
        let given = (chunks.first, chunks.second.flatten());
        if let (Some(first), Some(second)) = given {
            assert_eq!(first.observed_at, second.observed_at);
            assert_eq!(first.sequence, second.sequence);
            count += 1;
        } else {
            assert!(given.0.is_none() && given.1.is_none(), "half an answer");
        }
    }
    count
}

/// The expert hands the needle over and the log replays and verifies.
#[test]
fn expert_hands_over_and_the_log_verifies() {
    let _turn = alone();
    // A machine that is busy enough can make any one run fail, but not three.
    let handed_over = (3..=5).any(|seed| {
        let run = Run::start_task("realtime-handover", TASK, "expert", seed);
        let path = run.log.clone();
        let (code, result) = run.end();
        let log = checked_log(&path, &result);
        assert!(answers(&log) > 10);
        let success = result["success"] == true;
        assert_eq!(code, Some(i32::from(!success)), "{result}");
        if success {
            expect_a_stop(&log);
        }
        success
    });
    assert!(handed_over);
}

/// When the policy of two arms dies or the run is interrupted both stop.
#[test]
fn both_arms_stop_when_their_policy_dies() {
    let _turn = alone();
    let checkpoint = untrained("realtime-two-untrained").display().to_string();
    for (dies, expected) in [
        (true, "the policy process ended: signal: 9"),
        (false, "interrupted"),
    ] {
        let mut run = Run::start_task("realtime-two-stop", TASK, &checkpoint, 1);
        let path = run.log.clone();
        run.wait_until_under_way();
        let processes = run.processes();
        if dies {
            send("-KILL", processes[1]);
        } else {
            run.send("-INT");
        }
        let (code, result) = run.end();
        assert_eq!(code, Some(1));
        let reason = result["reason"].as_str().unwrap();
        assert!(reason.starts_with(expected), "{reason}");
        let log = checked_log(&path, &result);
        let answers = answers(&log);
        assert!(answers > 0);
        let policy = &result["policy"];
        assert_eq!(policy["queries"].as_u64(), u64::try_from(answers).ok());
        assert!(policy["refused"].as_u64().unwrap() < 2 * policy["queries"].as_u64().unwrap());
        expect_a_stop(&log);
        expect_nothing_left(&processes);
    }
}

/// A policy of another number of arms is refused before anything starts.
#[test]
fn policy_of_another_arm_count_is_refused() {
    let two = untrained("realtime-two-refused");
    for (task, policy, expected) in [
        (
            TASK,
            Path::new(CHECKPOINT),
            "arms = 1, task needle-handover has 2",
        ),
        (
            "needle-lift",
            two.as_path(),
            "arms = 2, task needle-lift has 1",
        ),
    ] {
        for (verb, option) in [
            ("run", "--log"),
            ("run", "--lockstep"),
            ("eval", "--trials"),
        ] {
            let log = scratch("realtime-refused").join("run.mcap");
            let mut command = trocar();
            command.args([verb, "--task", task, "--policy"]).arg(policy);
            match option {
                "--log" => command.arg(option).arg(&log),
                "--trials" => command.args([option, "1"]),
                _ => command.arg(option),
            };
            let output = command.output().unwrap();
            let message = stderr(&output);
            assert_eq!(output.status.code(), Some(2), "{verb} {option}: {message}");
            assert!(message.contains(expected), "{verb} {option}: {message}");
            assert!(!log.exists());
        }
    }
}
