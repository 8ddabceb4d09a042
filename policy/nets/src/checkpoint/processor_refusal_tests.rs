//! Processor files, statistics and recipes that LeRobot, or a longer run, would take for something
//! else than what is done here.

use super::refusal_tests::{refused_with, whole};
use super::tests::{config, recipe, refused, statistics};
use super::{SaveOptions, save};
use crate::act::Act;
use crate::parameters::ParameterSource;
use tch::Device;

const BEFORE: &str = "policy_preprocessor.json";
const AFTER: &str = "policy_postprocessor.json";

/// Processors that do something else are refused by file and field.
#[test]
fn unknown_processor_is_refused_by_file_and_field() {
    let folder = whole("processors");
    for (file, from, to, reason) in [
        (
            AFTER,
            "\"ACTION\": \"MEAN_STD\"",
            "\"ACTION\": \"IDENTITY\"",
            "norm_map.ACTION = \"IDENTITY\" is not supported, expected \"MEAN_STD\"",
        ),
        (
            BEFORE,
            "\"STATE\": \"MEAN_STD\"",
            "\"STATE\": \"MIN_MAX\"",
            "norm_map.STATE = \"MIN_MAX\"",
        ),
        (
            BEFORE,
            "1e-8",
            "1.0",
            "eps = 1.0 is not supported, expected 1e-8",
        ),
        (
            BEFORE,
            "\"rename_map\": {}",
            "\"rename_map\": {\"a\": \"observation.state\"}",
            "rename_map",
        ),
        (
            BEFORE,
            "64,\n              64",
            "96,\n              96",
            "has shape [3,96,96], but [3, 64, 64] in config.json",
        ),
    ] {
        refused_with(&folder, file, from, to, reason);
    }
}

#[test]
fn recipes_that_outlast_their_chunks_are_refused() {
    let folder = whole("recipes");
    for (file, from, to, reason) in [
        (
            "trocar.json",
            "\"query_every_steps\": 5",
            "\"query_every_steps\": 6",
            "query_every_steps = 6 in trocar.json, but a chunk has 5 steps",
        ),
        (
            "trocar.json",
            "\"step_ns\": 40000000",
            "\"step_ns\": 1",
            "step_ns = 1 is not supported, expected 1000000 to 1000000000",
        ),
        (
            "config.json",
            "\"n_action_steps\": 5",
            "\"n_action_steps\": 6",
            "n_action_steps = 6 is not supported, expected 1 to chunk_size, 5",
        ),
    ] {
        refused_with(&folder, file, from, to, reason);
    }
}

#[test]
fn statistics_beyond_any_arm_are_refused() {
    for (mean, std, reason) in [
        (
            9e9,
            1.0,
            "mean of dimension 0 is 9000000000, outside [-100, 100]",
        ),
        (0.0, 1e30, "deviation of dimension 0 is"),
    ] {
        let folder = whole("beyond");
        let mut statistics = statistics();
        statistics.action.mean[0] = mean;
        statistics.action.std[0] = std;
        let act = Act::new(config(), ParameterSource::seeded(1, Device::Cpu)).unwrap();
        save(
            &folder,
            &act,
            &statistics,
            &recipe(&config()),
            SaveOptions::default(),
        )
        .unwrap();
        let message = refused(&folder).to_string();
        assert!(message.contains(reason), "{message}");
    }
}
