//! Checkpoints of policies that see point clouds, refused for the same reasons as the others.

use std::path::PathBuf;

use tch::Device;

use super::tests::{config, folder, recipe};
use super::{CloudStatistics, Precision, RECIPE_FORMAT, Recipe, load_dp3, save_dp3};
use crate::dp3::{Dp3, Dp3Config, Dp3Preset};
use crate::normalise::Statistics;
use crate::parameters::ParameterSource;
use trocar_data::perception::{CloudFrame, CloudRecipe, Padding};
use trocar_data::relative_action::ABSOLUTE_REPRESENTATION;

fn dp3_folder(
    test: &str,
    change: impl FnOnce(&mut CloudStatistics, &mut Recipe, &mut CloudRecipe),
) -> PathBuf {
    let network = Dp3Config {
        down_dims: vec![8, 16],
        ..Dp3Config::preset(Dp3Preset::Simple, 7, 7)
    };
    let network = Dp3::new(network, ParameterSource::seeded(1, Device::Cpu)).unwrap();
    let mut cloud = CloudRecipe {
        frame: CloudFrame::Scene,
        crop_m: None,
        dropped_instances: Vec::new(),
        voxel_m: None,
        points: 32,
        padding: Padding::FirstPoint,
    };
    let of = |scale: f32| Statistics {
        mean: vec![0.0; 7],
        std: vec![scale; 7],
        min: vec![-scale; 7],
        max: vec![scale; 7],
    };
    let mut statistics = CloudStatistics {
        state: of(0.5),
        action: of(0.01),
        points: [[-0.1; 3], [0.1; 3]],
    };
    let mut recipe = recipe(&config());
    change(&mut statistics, &mut recipe, &mut cloud);
    let folder = folder(&format!("refusal-{test}"));
    save_dp3(
        &folder,
        &network,
        &cloud,
        &statistics,
        &recipe,
        Precision::F32,
    )
    .unwrap();
    folder
}

#[test]
fn policies_from_point_clouds_are_refused_for_the_same_reasons() {
    load_dp3(&dp3_folder("clouds", |_, _, _| {}), Device::Cpu).expect("nothing is wrong with it");
    type Change = fn(&mut CloudStatistics, &mut Recipe, &mut CloudRecipe);
    let cases: [(Change, &str); 9] = [
        (
            |it, _, _| it.action.max[2] = f32::NAN,
            "dimension 2 goes from -0.01 to NaN",
        ),
        (
            |it, _, _| it.state.min[1] = 7.0,
            "dimension 1 goes from 7 to 0.5",
        ),
        (
            |it, _, _| it.action.min.clear(),
            "0 least and 7 greatest values",
        ),
        (
            |it, _, _| it.points[1][0] = f32::INFINITY,
            "dimension 0 goes from -0.1 to inf",
        ),
        (
            |it, _, _| it.state.std[6] = 0.0,
            "deviation of dimension 6 is 0",
        ),
        (
            |_, it, _| it.arms = 2,
            "observation.state has 7 numbers, expected 14",
        ),
        (
            |_, it, _| it.cameras.clear(),
            "no camera to take points from",
        ),
        (
            |_, it, _| it.format = RECIPE_FORMAT + 1,
            "format = 2 is not supported",
        ),
        (|_, _, it| it.points = 0, "cloud.points = 0"),
    ];
    for (change, reason) in cases {
        let message = load_dp3(&dp3_folder("clouds", change), Device::Cpu)
            .expect_err(reason)
            .to_string();
        assert!(message.contains(reason), "{message}, expected {reason}");
    }
}

#[test]
fn absolute_actions_are_for_act_only() {
    let clouds = dp3_folder("absolute-clouds", |_, it, _| {
        ABSOLUTE_REPRESENTATION.clone_into(&mut it.action_representation)
    });
    let message = load_dp3(&clouds, Device::Cpu).unwrap_err().to_string();
    assert!(
        message.contains("expected observation_relative"),
        "{message}"
    );
}
