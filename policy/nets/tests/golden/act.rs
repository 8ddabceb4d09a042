//! ACT: the chunk, the losses and the gradients.

use std::collections::BTreeMap;

use serde_json::Value;
use tch::{Device, Kind, Tensor};
use trocar_nets::act::{Act, ActConfig, Demonstration, FoldedAct, losses};
use trocar_nets::parameters::ParameterSource;

use crate::compare::{check_all, check_close};
use crate::regenerate::{input, integer, numbers, weight, whole_numbers};

/// A field of the case's configuration, or of the case itself.
pub(crate) fn field<'a>(case: &'a Value, name: &str) -> &'a Value {
    let nested = &case["config"][name];
    if nested.is_null() {
        &case[name]
    } else {
        nested
    }
}

/// A case's configuration: LeRobot's defaults where the case is silent.
fn act_config(name: &str, case: &Value) -> ActConfig {
    let field = |name: &str| field(case, name);
    let activation = field("feedforward_activation").as_str().unwrap_or("relu");
    assert_eq!(
        activation, "relu",
        "{name}: another activation is not built"
    );
    let cameras: Vec<String> = field("cameras")
        .as_array()
        .unwrap()
        .iter()
        .map(|name| name.as_str().unwrap().to_owned())
        .collect();
    let hw = whole_numbers(field("image_hw"));
    let state_dim = field("state_dim").as_i64().unwrap();
    let defaults = ActConfig::lerobot_defaults(
        state_dim,
        integer(
            field("action_dim"),
            integer(&case["output_shape"][2], state_dim),
        ),
        &cameras,
        hw[0],
        hw[1],
    );
    let size = |name: &str, default: i64| integer(field(name), default);
    let config = ActConfig {
        chunk_size: size(
            "chunk_size",
            integer(&case["output_shape"][1], defaults.chunk_size),
        ),
        dim_model: size("dim_model", defaults.dim_model),
        n_heads: size("n_heads", defaults.n_heads),
        dim_feedforward: size("dim_feedforward", defaults.dim_feedforward),
        n_encoder_layers: size("n_encoder_layers", defaults.n_encoder_layers),
        n_decoder_layers: size("n_decoder_layers", defaults.n_decoder_layers),
        n_vae_encoder_layers: size("n_vae_encoder_layers", defaults.n_vae_encoder_layers),
        latent_dim: size("latent_dim", defaults.latent_dim),
        pre_norm: field("pre_norm").as_bool().unwrap_or(defaults.pre_norm),
        use_vae: field("use_vae").as_bool().unwrap_or(defaults.use_vae),
        dropout: field("dropout").as_f64().unwrap_or(defaults.dropout),
        kl_weight: field("kl_weight").as_f64().unwrap_or(defaults.kl_weight),
        ..defaults
    };
    assert_eq!(config.defect(), None, "{name}");
    config
}

/// The case's network with regenerated weights, trainable ones tracking gradients.
fn act_network(config: &ActConfig, seed: u64) -> Act {
    let shapes = Act::new(config.clone(), ParameterSource::seeded(0, Device::Cpu)).unwrap();
    let weights: BTreeMap<String, Tensor> = shapes
        .parameters()
        .iter()
        .map(|(key, fresh)| {
            let regenerated = if key == "model.vae_encoder_pos_enc" {
                fresh.copy()
            } else {
                weight(key, seed, &fresh.size())
            };
            (
                key.to_owned(),
                regenerated.set_requires_grad(shapes.parameters().is_trainable(key)),
            )
        })
        .collect();
    Act::new(config.clone(), ParameterSource::given(weights)).unwrap()
}

fn observation(config: &ActConfig, seed: u64, batch: i64) -> (Tensor, Tensor) {
    let shape = [batch, 3, config.image_height, config.image_width];
    let images: Vec<Tensor> = config
        .cameras
        .iter()
        .map(|name| input(name, seed, &shape))
        .collect();
    (
        Tensor::stack(&images, 1),
        input("observation.state", seed, &[batch, config.state_dim]),
    )
}

pub(crate) fn check_chunk(name: &str, case: &Value, seed: u64) {
    let config = act_config(name, case);
    let act = act_network(&config, seed);
    let shape = whole_numbers(&case["output_shape"]);
    let (images, state) = observation(&config, seed, shape[0]);
    let chunk = tch::no_grad(|| act.infer(&images, &state)).unwrap();
    assert_eq!(chunk.size(), shape, "{name}");
    let what = format!("{name} chunk");
    check_all(&what, &chunk, &numbers(&case["output"]), 2e-6);
    // What policies run, with one thread.
    tch::set_num_threads(1);
    let mut folded = FoldedAct::new(&act, Kind::Float).unwrap();
    let chunk = tch::no_grad(|| folded.infer(&images, &state)).unwrap();
    assert_eq!(chunk.size(), shape, "{name}");
    let what = format!("{name} folded chunk");
    check_all(&what, &chunk, &numbers(&case["output"]), 2e-6);
}

pub(crate) fn check_training(name: &str, case: &Value, seed: u64) {
    let config = act_config(name, case);
    let act = act_network(&config, seed);
    let batch = case["batch"].as_i64().unwrap();
    let (images, state) = observation(&config, seed, batch);
    let actions = input(
        "action",
        seed,
        &[batch, config.chunk_size, config.action_dim],
    );
    let noise = input("latent_noise", seed, &[batch, config.latent_dim]);
    let pad_from = Tensor::from_slice(&whole_numbers(&case["pad_from"]));
    let is_pad = Tensor::arange(config.chunk_size, (Kind::Int64, Device::Cpu))
        .ge_tensor(&pad_from.unsqueeze(1));
    let demonstration = Demonstration {
        actions: &actions,
        is_pad: &is_pad,
        noise: &noise,
    };
    let (predicted, latent) = act.train(&images, &state, &demonstration).unwrap();
    let parts = losses(&config, &predicted, latent.as_ref(), &actions, &is_pad).unwrap();
    let named = [("l1_loss", &parts.l1), ("kld_loss", &parts.kl)];
    for (part, actual) in named {
        if let Some(expected) = case["parts"][part].as_f64() {
            check_close(
                &format!("{name} {part}"),
                actual.double_value(&[]),
                expected,
                1e-5,
            );
        }
    }
    let expected = case["loss"].as_f64().unwrap();
    check_close(
        &format!("{name} loss"),
        parts.total.double_value(&[]),
        expected,
        1e-5,
    );
    parts.total.backward();
    for (key, norm) in case["gradient_norms"].as_object().into_iter().flatten() {
        let parameter = act
            .parameters()
            .get(key)
            .unwrap_or_else(|| panic!("{name}: no parameter {key}"));
        let actual = parameter
            .grad()
            .to_kind(Kind::Double)
            .norm()
            .double_value(&[]);
        check_close(
            &format!("{name} gradient of {key}"),
            actual,
            norm.as_f64().unwrap(),
            1e-4,
        );
    }
}
