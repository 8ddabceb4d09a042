//! Checkpoints of two arms.

use super::*;

/// A policy of two arms. Its second arm's actions are a hundred times the first's.
fn saved_for_two(name: &str) -> PathBuf {
    let folder = folder(name);
    let config = config().for_arms(2);
    let act = Act::new(config.clone(), ParameterSource::seeded(3, Device::Cpu)).unwrap();
    let one = statistics();
    let far = Statistics {
        std: vec![0.2; 7],
        ..one.action.clone()
    };
    let statistics = FeatureStatistics {
        state: Statistics::joined(&[one.state.clone(), one.state]),
        action: Statistics::joined(&[one.action, far]),
    };
    let recipe = Recipe {
        arms: 2,
        ..recipe(&config)
    };
    save(&folder, &act, &statistics, &recipe, SaveOptions::default()).unwrap();
    folder
}

#[test]
fn a_policy_of_two_arms_answers_with_a_chunk_for_each() {
    let folder = saved_for_two("two-arms");
    let config: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.join("config.json")).unwrap()).unwrap();
    for (side, feature) in [
        ("input_features", "observation.state"),
        ("output_features", "action"),
    ] {
        assert_eq!(config[side][feature]["shape"], serde_json::json!([14]));
    }
    let mut policy = ActPolicy::load(&folder, Device::Cpu).unwrap();
    assert_eq!(policy.recipe().arms, 2);
    let frame = frame();
    let frames = [frame.as_frame()];
    let far = ArmObservation {
        tip_in_rcm: Pose::translation(0.0, 0.0, -0.2),
        ..arm(0.3)
    };
    let ask = |arms: &[ArmObservation], policy: &mut ActPolicy| {
        policy.infer(&Observation {
            arms,
            frames: &frames,
        })
    };
    let chunks = ask(&[arm(0.2), far], &mut policy).unwrap();
    assert_eq!(chunks.len(), 2);
    for chunk in &chunks {
        assert_eq!(
            (chunk.observed_at, chunk.sequence, chunk.len),
            (TimeNs(7), 1, 5)
        );
    }
    let worst = |index: usize, z: f64| {
        let targets = chunks[index].valid_targets().iter();
        targets.fold(0.0_f64, |worst, target| {
            worst.max((target.position_m[2] - z).abs())
        })
    };
    let worst = [worst(0, -0.1), worst(1, -0.2)];
    assert!(worst[0] < 0.02 && worst[1] > worst[0], "{worst:?}");
    // What the second arm measures goes in as well.
    let again = ask(&[arm(0.2), arm(-0.3)], &mut policy).unwrap();
    assert_eq!(again[0].sequence, 2);
    assert_ne!(again[0].targets, chunks[0].targets);

    for arms in [&[][..], &[arm(0.2)], &[arm(0.2); 3]] {
        let error = ask(arms, &mut policy).unwrap_err();
        assert!(
            matches!(error, PolicyError::ArmCount { expected: 2, actual } if actual == arms.len()),
            "{error}"
        );
    }
}

#[test]
fn a_recipe_says_for_how_many_arms_and_the_network_must_agree() {
    // Those from before there could be two do not say it.
    let folder = saved("arms", SaveOptions::default());
    edit(&folder, "trocar.json", "\"arms\": 1,", "");
    let old = load(&folder, Device::Cpu).unwrap();
    assert_eq!(old.recipe.unwrap().arms, 1);

    for (arms, expected) in [
        ("2", "observation.state has 7 numbers, expected 14"),
        ("0", "arms = 0 is not supported, expected 1 to 2"),
        ("3", "arms = 3 is not supported, expected 1 to 2"),
    ] {
        let folder = saved("arms", SaveOptions::default());
        edit(
            &folder,
            "trocar.json",
            "\"arms\": 1",
            &format!("\"arms\": {arms}"),
        );
        let message = refused(&folder).to_string();
        assert!(message.contains(expected), "{message}");
    }
    let folder = saved_for_two("arms-two");
    edit(&folder, "trocar.json", "\"arms\": 2", "\"arms\": 1");
    let message = refused(&folder).to_string();
    assert!(
        message.contains("observation.state has 14 numbers, expected 7"),
        "{message}"
    );
}
