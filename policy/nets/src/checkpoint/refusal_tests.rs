//! Checkpoints that are whole but not for this program, or whose parts are not for each other: each
//! is refused for its own reason, and the reason names what would do.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use hal::{Observation, Policy};
use tch::Device;

use super::tensors::{self, Plain, Precision};
use super::tests::{arm, config, edit, folder, frame, recipe, refused, saved, statistics};
use super::{FeatureStatistics, Recipe, SaveOptions, save};
use crate::act::{Act, ActConfig};
use crate::act_policy::ActPolicy;
use crate::normalise::Statistics;
use crate::parameters::ParameterSource;
use trocar_data::relative_action::ABSOLUTE_REPRESENTATION;

const CAMERA: &str = "observation.images.endoscope";
const BEFORE: &str = "policy_preprocessor_step_3_normalizer_processor.safetensors";
const AFTER: &str = "policy_postprocessor_step_0_unnormalizer_processor.safetensors";

/// The refusal's text, which must contain `file` and `reason`.
fn expect(folder: &Path, file: &str, reason: &str) {
    let message = refused(folder).to_string();
    assert!(
        message.contains(file) && message.contains(reason),
        "{message}, expected {file}: {reason}"
    );
}

/// A whole checkpoint, as small as it gets.
pub(super) fn whole(test: &str) -> PathBuf {
    let options = SaveOptions {
        precision: Precision::F16,
        inference_only: true,
    };
    saved(&format!("refusal-{test}"), options)
}

/// The folder with one piece of text in one file replaced is refused; then the file is put back.
pub(super) fn refused_with(folder: &Path, file: &str, from: &str, to: &str, reason: &str) {
    let path = folder.join(file);
    let text = fs::read(&path).unwrap();
    edit(folder, file, from, to);
    expect(folder, file, reason);
    fs::write(&path, text).unwrap();
}

#[test]
fn a_text_beyond_the_limit_is_refused_with_both_sizes() {
    let folder = whole("large");
    for file in ["trocar.json", "config.json", "policy_preprocessor.json"] {
        let path = folder.join(file);
        let text = fs::read(&path).unwrap();
        let opened = fs::File::options().write(true).open(&path).unwrap();
        opened.set_len((16 << 20) + 1).unwrap();
        let reason = "it has 16777217 bytes; the limit for a checkpoint's JSON is 16777216 bytes";
        expect(&folder, file, reason);
        fs::write(&path, text).unwrap();
    }
}

#[test]
fn architectures_that_are_not_built_are_refused_by_field() {
    let folder = whole("architecture");
    for (from, to, reason) in [
        (
            "\"n_obs_steps\": 1",
            "\"n_obs_steps\": 2",
            "n_obs_steps = 2",
        ),
        ("\"relu\"", "\"gelu\"", "feedforward_activation = gelu"),
        (
            "\"replace_final_stride_with_dilation\": 0",
            "\"replace_final_stride_with_dilation\": 1",
            "replace_final_stride_with_dilation = true",
        ),
        (
            "\"STATE\": \"MEAN_STD\"",
            "\"STATE\": \"MIN_MAX\"",
            "STATE = MIN_MAX is not supported, expected MEAN_STD",
        ),
        ("\"n_heads\": 4", "\"n_heads\": 5", "n_heads = 5"),
        ("\"dropout\": 0.1", "\"dropout\": 1.5", "dropout = 1.5"),
        ("\"chunk_size\": 5", "\"chunk_size\": 0", "chunk_size = 0"),
        (
            "\"chunk_size\": 5",
            "\"chunk_size\": 2000",
            "chunk_size = 2000",
        ),
        (
            "\"pre_norm\": false",
            "\"pre_norm\": 0",
            "expected a boolean",
        ),
        ("\"latent_dim\": 32,", "", "latent_dim"),
    ] {
        refused_with(&folder, "config.json", from, to, reason);
    }
}

#[test]
fn cameras_that_do_not_fit_are_refused() {
    let folder = whole("cameras");
    let other = "observation.images.side";
    let refused_with = |file, from, to, reason| refused_with(&folder, file, from, to, reason);
    refused_with("config.json", CAMERA, other, "but the recipe names");
    refused_with("config.json", "\"VISUAL\"", "\"ENV\"", "there is no camera");
    let recipe = fs::read(folder.join("trocar.json")).unwrap();
    edit(&folder, "trocar.json", CAMERA, other);
    expect(&folder, "config.json", "but the recipe names");
    fs::write(folder.join("trocar.json"), recipe).unwrap();
    let shape = "expected the same [3, height, width] for all cameras";
    refused_with("config.json", "[\n        3,", "[\n        1,", shape);
    refused_with("config.json", "[\n        3,", "[\n        64,", shape);
    let (size, width) = ("64,\n        64", "64,\n        16");
    refused_with("config.json", size, width, "image width = 16");
    // The network could be built, but the frames are no multiple of its pictures.
    edit(&folder, "config.json", size, "96,\n        96");
    let inside = "64,\n              64";
    edit(
        &folder,
        "policy_preprocessor.json",
        inside,
        "96,\n              96",
    );
    let error = ActPolicy::load(&folder, Device::Cpu).expect_err("128 is no multiple of 96");
    assert!(error.to_string().contains("no whole multiple"), "{error}");
}

#[test]
fn two_cameras_of_different_sizes_are_refused() {
    let cameras = [CAMERA.to_owned(), "observation.images.side".to_owned()];
    let config = ActConfig {
        cameras: cameras.to_vec(),
        ..config()
    };
    let act = Act::new(config.clone(), ParameterSource::seeded(3, Device::Cpu)).unwrap();
    let mut recipe = recipe(&config);
    let mut second = recipe.cameras[0].clone();
    second.feature.clone_from(&cameras[1]);
    recipe.cameras.push(second);
    let folder = folder("two-sizes");
    save(
        &folder,
        &act,
        &statistics(),
        &recipe,
        SaveOptions::default(),
    )
    .unwrap();
    let path = folder.join("config.json");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(
        &path,
        text.replacen("64,\n        64", "96,\n        96", 1),
    )
    .unwrap();
    expect(
        &folder,
        "config.json",
        "the same [3, height, width] for all cameras",
    );
}

/// The folder with one statistics file changed is refused; then the file is put back.
fn refused_with_statistics(
    folder: &Path,
    file: &str,
    reason: &str,
    change: impl FnOnce(&mut BTreeMap<String, Plain>),
) {
    let path = folder.join(file);
    let bytes = fs::read(&path).unwrap();
    let mut values = tensors::read(&path).unwrap();
    change(&mut values);
    tensors::write(&path, &values, Precision::F32).unwrap();
    expect(folder, file, reason);
    fs::write(&path, bytes).unwrap();
}

/// Statistics that are missing or of another width are refused by feature.
#[test]
fn bad_statistics_are_refused_by_feature() {
    let folder = whole("statistics");
    for (file, key, feature) in [
        (
            BEFORE,
            "observation.state.mean",
            "observation.state: mean is missing",
        ),
        (
            BEFORE,
            "observation.state.std",
            "observation.state: std is missing",
        ),
        (AFTER, "action.mean", "action: mean is missing"),
        (AFTER, "action.std", "action: std is missing"),
    ] {
        refused_with_statistics(&folder, file, feature, |values| {
            values.remove(key).unwrap();
        });
        refused_with_statistics(&folder, file, "not 7", |values| {
            let plain = values.get_mut(key).unwrap();
            *plain = Plain {
                shape: vec![6],
                values: vec![1.0; 6],
            };
        });
        for bad in [f32::NAN, f32::INFINITY] {
            refused_with_statistics(&folder, file, "dimension 4 is", |values| {
                values.get_mut(key).unwrap().values[4] = bad;
            });
        }
    }
}

#[test]
fn images_that_were_not_normalised_as_here_are_refused() {
    let folder = whole("images");
    for part in ["mean", "std"] {
        let key = format!("{CAMERA}.{part}");
        refused_with_statistics(&folder, BEFORE, "not ImageNet's", |values| {
            values.get_mut(&key).unwrap().values[1] += 0.01;
        });
        refused_with_statistics(&folder, BEFORE, "not ImageNet's", |values| {
            values.remove(&key).unwrap();
        });
    }
}

#[test]
fn processors_without_their_step_are_refused() {
    let folder = whole("processors");
    for file in ["policy_preprocessor.json", "policy_postprocessor.json"] {
        let (from, to) = ("normalizer_processor\"", "other_processor\"");
        refused_with(&folder, file, from, to, "with a state file");
    }
}

/// Absolute actions are targets as they are and have eight numbers.
#[test]
fn absolute_actions_are_targets_of_eight_numbers() {
    let config = ActConfig {
        action_dim: 8,
        ..config()
    };
    let act = Act::new(config.clone(), ParameterSource::seeded(3, Device::Cpu)).unwrap();
    // A quaternion of twice the unit length, and hardly any deviation: the answer is the mean.
    let mean = vec![0.01, 0.02, -0.12, 0.0, 0.0, 2.0, 0.0, 0.3];
    let statistics = FeatureStatistics {
        action: Statistics {
            std: vec![1e-7; 8],
            mean,
            min: vec![],
            max: vec![],
        },
        ..statistics()
    };
    let recipe = Recipe {
        action_representation: ABSOLUTE_REPRESENTATION.to_owned(),
        ..recipe(&config)
    };
    let folder = folder("absolute");
    save(&folder, &act, &statistics, &recipe, SaveOptions::default()).unwrap();
    let mut policy = ActPolicy::load(&folder, Device::Cpu).unwrap();
    let (frame, arm) = (frame(), arm(0.2));
    let observation = Observation {
        arms: &[arm],
        frames: &[frame.as_frame()],
    };
    let [chunk] = policy.infer(&observation).unwrap()[..] else {
        panic!("one arm, one chunk");
    };
    assert_eq!(chunk.len, 5);
    for target in chunk.valid_targets() {
        let [x, y, z, qx, qy, qz, qw] = target.pose_numbers();
        let found = [x, y, z, qx, qy, qz.abs(), qw, target.jaw];
        let expected = [0.01, 0.02, -0.12, 0.0, 0.0, 1.0, 0.0, 0.3];
        let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs());
        assert!(worst.fold(0.0, f64::max) < 1e-5, "{found:?}");
    }

    edit(
        &folder,
        "trocar.json",
        ABSOLUTE_REPRESENTATION,
        "observation_relative",
    );
    expect(&folder, "config.json", "action has 8 numbers, expected 7");
}

/// A policy that LeRobot trained on fourteen joints says what it is for.
#[test]
fn policy_for_fourteen_joints_is_refused_with_its_use() {
    // Without a recipe there is one arm; the widths say that this is not for it.
    let config = config().for_arms(2);
    let act = Act::new(config.clone(), ParameterSource::seeded(3, Device::Cpu)).unwrap();
    let one = statistics();
    let twice = |one: &Statistics| Statistics::joined(&[one.clone(), one.clone()]);
    let statistics = FeatureStatistics {
        state: twice(&one.state),
        action: twice(&one.action),
    };
    let folder = folder("fourteen");
    save(
        &folder,
        &act,
        &statistics,
        &recipe(&config),
        SaveOptions::default(),
    )
    .unwrap();
    fs::remove_file(folder.join("trocar.json")).unwrap();
    expect(
        &folder,
        "config.json",
        "observation.state has 14 numbers, expected 7",
    );
}
