//! DP3 and SimpleDP3: the encoder, one call of the U-Net, ten steps of diffusion with normalised
//! inputs and outputs.

use serde_json::Value;
use tch::{Device, Kind, Tensor};
use trocar_nets::dp3::{CloudObservation, Dp3, Dp3Config, Dp3Preset, FoldedDp3, LimitsNormaliser};
use trocar_nets::parameters::ParameterSource;

use crate::compare::check_all;
use crate::regenerate::{input, integer, numbers, weight, whole_numbers};

/// The published network of the case's kind, with whatever sizes the case gives.
fn config(name: &str, case: &Value) -> Dp3Config {
    let preset = match case["kind"].as_str() {
        Some("DP3") => Dp3Preset::Dp3,
        Some("SimpleDP3") => Dp3Preset::Simple,
        other => panic!("{name}: kind {other:?}"),
    };
    let field = |field: &str| {
        let nested = &case["config"][field];
        if nested.is_null() {
            &case[field]
        } else {
            nested
        }
    };
    let (state_dim, action_dim) = (
        integer(field("state_dim"), 0),
        integer(field("action_dim"), 0),
    );
    let published = Dp3Config::preset(preset, state_dim, action_dim);
    let size = |name: &str, published: i64| integer(field(name), published);
    let config = Dp3Config {
        horizon: size("horizon", published.horizon),
        n_obs_steps: size("n_obs_steps", published.n_obs_steps),
        n_action_steps: size("n_action_steps", published.n_action_steps),
        encoder_output_dim: size("encoder_output_dim", published.encoder_output_dim),
        diffusion_step_embed_dim: size(
            "diffusion_step_embed_dim",
            published.diffusion_step_embed_dim,
        ),
        kernel_size: size("kernel_size", published.kernel_size),
        n_groups: size("n_groups", published.n_groups),
        num_train_timesteps: size("num_train_timesteps", published.num_train_timesteps),
        num_inference_steps: size("num_inference_steps", published.num_inference_steps),
        down_dims: if field("down_dims").is_null() {
            published.down_dims.clone()
        } else {
            whole_numbers(field("down_dims"))
        },
        ..published
    };
    assert_eq!(config.defect(), None, "{name}");
    config
}

/// The case's network with regenerated weights, written over those of the beginning: they are too
/// many to have twice.
fn network(config: &Dp3Config, seed: u64) -> Dp3 {
    let network = Dp3::new(config.clone(), ParameterSource::seeded(0, Device::Cpu)).unwrap();
    for (key, tensor) in network.parameters().iter() {
        let regenerated = weight(key, seed, &tensor.size());
        tensor.shallow_clone().copy_(&regenerated);
    }
    network
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "normalisers are in single precision"
)]
fn normaliser(limits: &Value) -> LimitsNormaliser {
    let side = |name: &str| -> Vec<f32> {
        let limits = numbers(&limits[name]);
        limits.into_iter().map(|x| x as f32).collect()
    };
    LimitsNormaliser::new(&side("min"), &side("max")).unwrap()
}

pub(crate) fn check(name: &str, case: &Value, seed: u64) {
    tch::no_grad(|| check_parts(name, case, seed));
}

fn check_parts(name: &str, case: &Value, seed: u64) {
    let config = config(name, case);
    let network = network(&config, seed);
    let what = |part: &str| format!("{name} {part}");
    let (observations, batch) = (config.n_obs_steps, 1);
    let points = case["points"].as_i64().unwrap();
    let limits = |feature: &str| normaliser(&case["limits"][feature]);
    let cloud = input("point_cloud", seed, &[batch, observations, points, 3]);
    let state = input("agent_pos", seed, &[batch, observations, config.state_dim]);
    let observation = CloudObservation {
        points: &limits("point_cloud").apply(&cloud).unwrap(),
        state: &limits("agent_pos").apply(&state).unwrap(),
    };
    let features = network.features(&observation).unwrap();
    assert_eq!(
        features.size(),
        whole_numbers(&case["encoder_output_shape"]),
        "{name}"
    );
    check_all(
        &what("encoder"),
        &features,
        &numbers(&case["encoder_output"]),
        1e-5,
    );
    let shape = [batch, config.horizon, config.action_dim];
    let denoised = network.denoise(
        &input("unet_sample", seed, &shape),
        &Tensor::full(
            [batch],
            case["unet_timestep"].as_i64().unwrap(),
            (Kind::Int64, Device::Cpu),
        ),
        &input(
            "unet_condition",
            seed,
            &[batch, config.condition_features()],
        ),
    );
    check_all(
        &what("U-Net"),
        &denoised.unwrap(),
        &numbers(&case["unet_output"]),
        1e-5,
    );
    let noise = input("noise", seed, &shape) * 2.0_f64;
    check_actions(name, case, network, &observation, &noise);
}

/// Ten steps of diffusion by the network as it is trained and as policies run it.
fn check_actions(
    name: &str,
    case: &Value,
    network: Dp3,
    observation: &CloudObservation<'_>,
    noise: &Tensor,
) {
    let what = |part: &str| format!("{name} {part}");
    let normaliser = normaliser(&case["limits"]["action"]);
    let check = |part: &str, actual: &Tensor, expected: &str| {
        check_all(&what(part), actual, &numbers(&case[expected]), 1e-4);
    };
    let normalised = network.infer(observation, noise).unwrap();
    let actions = normaliser.invert(&normalised).unwrap();
    check("actions", &actions, "action_pred");
    let executed = network.executed(&actions).unwrap();
    let shape = whole_numbers(&case["action_shape"]);
    assert_eq!(executed.size(), shape, "{name}");
    check("executed", &executed, "action");
    let mut folded = FoldedDp3::new(network, Kind::Float).unwrap();
    let normalised = folded.infer(observation, noise).unwrap();
    let actions = normaliser.invert(&normalised).unwrap();
    check("folded actions", &actions, "action_pred");
}
