//! What is refused, and by which name.

use super::*;

#[test]
fn frames_of_another_size_or_number_are_refused() {
    let folder = saved("frames", SaveOptions::default());
    let mut policy = ActPolicy::load(&folder, Device::Cpu).unwrap();
    let arms = [arm(0.0)];
    let small = CameraFrame::blank(Intrinsics::from_vertical_fov(64, 64, 1.0));
    let frames = [small.as_frame()];
    let size = policy
        .infer(&Observation {
            arms: &arms,
            frames: &frames,
        })
        .unwrap_err();
    assert!(size.to_string().contains("expects 128x128"), "{size}");
    let count = policy
        .infer(&Observation {
            arms: &arms,
            frames: &[],
        })
        .unwrap_err();
    assert!(count.to_string().contains("expects 1 camera"), "{count}");
}

#[test]
fn missing_files_are_named() {
    for file in [
        "config.json",
        "model.safetensors",
        "policy_preprocessor.json",
        "policy_postprocessor.json",
    ] {
        let folder = saved("missing", SaveOptions::default());
        fs::remove_file(folder.join(file)).unwrap();
        let error = refused(&folder);
        assert!(
            matches!(error.cause, Cause::Missing) && error.file.ends_with(file),
            "{error}"
        );
    }
    let folder = saved("missing-recipe", SaveOptions::default());
    fs::remove_file(folder.join("trocar.json")).unwrap();
    let error = ActPolicy::load(&folder, Device::Cpu).expect_err("nothing says what actions mean");
    assert!(error.file.ends_with("trocar.json"), "{error}");
}

#[test]
fn truncated_weights_are_refused_at_every_length() {
    let folder = saved(
        "truncated",
        SaveOptions {
            precision: Precision::F16,
            inference_only: true,
        },
    );
    let file = folder.join("model.safetensors");
    let bytes = fs::read(&file).unwrap();
    for length in [0, 4, 8, 100, bytes.len() / 2, bytes.len() - 1] {
        fs::write(&file, &bytes[..length]).unwrap();
        let error = refused(&folder);
        assert!(
            matches!(error.cause, Cause::Safetensors(_)) && error.file == file,
            "{length}: {error}"
        );
    }
}

#[test]
fn weights_that_do_not_fit_the_architecture_are_named() {
    let folder = saved("misfit", SaveOptions::default());
    edit(
        &folder,
        "config.json",
        "\"dim_feedforward\": 64",
        "\"dim_feedforward\": 128",
    );
    let error = refused(&folder).to_string();
    assert!(
        error.contains("model.safetensors") && error.contains("linear1"),
        "{error}"
    );
    edit(
        &folder,
        "config.json",
        "\"dim_feedforward\": 128",
        "\"dim_feedforward\": 64",
    );
    edit(
        &folder,
        "config.json",
        "\"n_encoder_layers\": 1",
        "\"n_encoder_layers\": 2",
    );
    let error = refused(&folder).to_string();
    assert!(
        error.contains("model.encoder.layers.1") && error.contains("missing"),
        "{error}"
    );
}

#[test]
fn another_number_of_joints_is_refused() {
    let folder = folder("joints");
    let config = ActConfig {
        state_dim: 9,
        ..config()
    };
    let act = Act::new(config.clone(), ParameterSource::seeded(3, Device::Cpu)).unwrap();
    save(
        &folder,
        &act,
        &statistics(),
        &recipe(&config),
        SaveOptions::default(),
    )
    .unwrap();
    let error = refused(&folder);
    assert!(
        matches!(
            error.cause,
            Cause::JointCount {
                actual: 9,
                expected: 7,
                ..
            }
        ),
        "{error}"
    );
}

#[test]
fn useless_statistics_are_refused() {
    let config = config();
    let act = Act::new(config.clone(), ParameterSource::seeded(3, Device::Cpu)).unwrap();
    for bad in [0.0, f32::NAN, f32::INFINITY, -1.0] {
        let folder = folder("statistics");
        let mut statistics = statistics();
        statistics.action.std[3] = bad;
        save(
            &folder,
            &act,
            &statistics,
            &recipe(&config),
            SaveOptions::default(),
        )
        .unwrap();
        let error = refused(&folder);
        assert!(
            matches!(&error.cause, Cause::Statistics { feature, .. } if feature == "action"),
            "{error}"
        );
    }
    let folder = folder("no-statistics");
    let mut statistics = statistics();
    statistics.state.mean.clear();
    save(
        &folder,
        &act,
        &statistics,
        &recipe(&config),
        SaveOptions::default(),
    )
    .unwrap();
    assert!(
        refused(&folder)
            .to_string()
            .contains("observation.state: mean is missing")
    );
}

#[test]
fn unknown_types_and_variants_are_refused() {
    let folder = saved("variants", SaveOptions::default());
    edit(
        &folder,
        "config.json",
        "\"type\": \"act\"",
        "\"type\": \"diffusion\"",
    );
    assert!(
        matches!(refused(&folder).cause, Cause::PolicyType { actual } if actual == "diffusion")
    );
    let folder = saved("variants", SaveOptions::default());
    edit(&folder, "config.json", "group_norm_resnet18", "resnet50");
    assert!(
        matches!(refused(&folder).cause, Cause::Unsupported { field, .. } if field == "vision_backbone")
    );
    let folder = saved("variants", SaveOptions::default());
    edit(&folder, "trocar.json", "group_norm", "weight_norm");
    assert!(refused(&folder).to_string().contains("weight_norm"));
    let folder = saved("variants", SaveOptions::default());
    edit(&folder, "trocar.json", "observation_relative", "joints");
    assert!(
        refused(&folder)
            .to_string()
            .contains("action_representation")
    );
    let folder = saved("variants", SaveOptions::default());
    edit(&folder, "trocar.json", "\"width\": 128", "\"width\": 100");
    let error = ActPolicy::load(&folder, Device::Cpu).expect_err("100 is no multiple of 64");
    assert!(error.to_string().contains("no whole multiple"), "{error}");
}
