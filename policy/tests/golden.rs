//! Networks against numbers of the reference implementations, with weights and inputs regenerated from a seed.
//!
//! The file is `tests/golden/policies.json` of the repository, or the one that `TROCAR_GOLDEN` names. A case says by its
//! own fields what it is; cases of networks that are not built yet are counted and named.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking, its helpers too"
)]
#![expect(clippy::print_stdout, reason = "the margins are worth reading")]

use std::collections::BTreeMap;
use std::path::PathBuf;

use policy::act::{Act, ActConfig, Demonstration, losses};
use policy::parameters::ParameterSource;
use serde_json::Value;
use tch::{Device, Kind, Tensor};

/// The numbers -1 to 1 that belong to `key`: the recipe of the golden file, written down again on purpose.
fn regenerate(key: &str, seed: u64, count: i64) -> impl Iterator<Item = f64> {
    let mut state = 0xcbf2_9ce4_8422_2325_u64;
    for byte in key.bytes() {
        state = (state ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
    }
    state ^= seed;
    (0..u64::try_from(count).unwrap()).map(move |i| {
        let z = state.wrapping_add((i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        let z = z ^ (z >> 31);
        #[expect(clippy::cast_precision_loss, reason = "53 bits fit")]
        let unit = (z >> 11) as f64 * 2.0_f64.powi(-52) - 1.0;
        unit
    })
}

fn tensor(values: impl Iterator<Item = f64>, shape: &[i64]) -> Tensor {
    Tensor::from_slice(&values.collect::<Vec<f64>>())
        .to_kind(Kind::Float)
        .view(shape)
}

fn input(name: &str, seed: u64, shape: &[i64]) -> Tensor {
    tensor(
        regenerate(&format!("input/{name}"), seed, shape.iter().product()),
        shape,
    )
}

fn weight(key: &str, seed: u64, shape: &[i64]) -> Tensor {
    let draws = regenerate(key, seed, shape.iter().product());
    if key.ends_with("running_var") {
        return tensor(draws.map(|u| 1.0 + 0.5 * u), shape);
    }
    if shape.len() == 1 {
        let offset = if key.ends_with("weight") { 1.0 } else { 0.0 };
        return tensor(draws.map(|u| offset + 0.1 * u), shape);
    }
    let fan_in = f64::from(i32::try_from(shape[1..].iter().product::<i64>()).unwrap());
    tensor(draws.map(|u| u * (3.0 / fan_in).sqrt()), shape)
}

fn integer(value: &Value, default: i64) -> i64 {
    if value.is_null() {
        default
    } else {
        value.as_i64().unwrap()
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_f64().unwrap())
        .collect()
}

/// A case's configuration: LeRobot's defaults where the case is silent.
fn act_config(case: &Value) -> ActConfig {
    let config = &case["config"];
    let field = |name: &str| {
        if config[name].is_null() {
            &case[name]
        } else {
            &config[name]
        }
    };
    let cameras: Vec<String> = field("cameras")
        .as_array()
        .unwrap()
        .iter()
        .map(|name| name.as_str().unwrap().to_owned())
        .collect();
    let hw: Vec<i64> = field("image_hw")
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_i64().unwrap())
        .collect();
    let state_dim = field("state_dim").as_i64().unwrap();
    let defaults = ActConfig::lerobot_defaults(
        state_dim,
        integer(field("action_dim"), state_dim),
        &cameras,
        hw[0],
        hw[1],
    );
    ActConfig {
        chunk_size: integer(&config["chunk_size"], defaults.chunk_size),
        dim_model: integer(&config["dim_model"], defaults.dim_model),
        n_heads: integer(&config["n_heads"], defaults.n_heads),
        dim_feedforward: integer(&config["dim_feedforward"], defaults.dim_feedforward),
        n_encoder_layers: integer(&config["n_encoder_layers"], defaults.n_encoder_layers),
        n_decoder_layers: integer(&config["n_decoder_layers"], defaults.n_decoder_layers),
        n_vae_encoder_layers: integer(
            &config["n_vae_encoder_layers"],
            defaults.n_vae_encoder_layers,
        ),
        latent_dim: integer(&config["latent_dim"], defaults.latent_dim),
        pre_norm: config["pre_norm"].as_bool().unwrap_or(defaults.pre_norm),
        use_vae: config["use_vae"].as_bool().unwrap_or(defaults.use_vae),
        dropout: config["dropout"].as_f64().unwrap_or(defaults.dropout),
        kl_weight: config["kl_weight"].as_f64().unwrap_or(defaults.kl_weight),
        ..defaults
    }
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

fn check_chunk(name: &str, case: &Value, seed: u64) {
    let config = act_config(case);
    let act = act_network(&config, seed);
    let shape: Vec<i64> = case["output_shape"]
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_i64().unwrap())
        .collect();
    let (images, state) = observation(&config, seed, shape[0]);
    let chunk = tch::no_grad(|| act.infer(&images, &state)).unwrap();
    assert_eq!(chunk.size(), shape, "{name}");
    let expected = numbers(&case["output"]);
    let actual = Vec::<f64>::try_from(chunk.to_kind(Kind::Double).flatten(0, -1)).unwrap();
    let scale = expected.iter().fold(0.0_f64, |scale, x| scale.max(x.abs()));
    let error = expected
        .iter()
        .zip(&actual)
        .fold(0.0_f64, |worst, (a, b)| worst.max((a - b).abs()))
        / scale;
    println!("{name}: chunk off by {error:.2e} of its scale {scale:.2}");
    assert!(
        error <= 2e-6,
        "{name}: chunk is off by {error:e} of its scale"
    );
}

fn check_close(what: &str, actual: f64, expected: f64, relative: f64) {
    let error = (actual - expected).abs() / expected.abs();
    println!("{what}: {actual} against {expected}, off by {error:.2e}");
    assert!(
        error <= relative,
        "{what}: {actual} instead of {expected}, off by {error:e}"
    );
}

fn check_training(name: &str, case: &Value, seed: u64) {
    let config = act_config(case);
    let act = act_network(&config, seed);
    let batch = case["batch"].as_i64().unwrap();
    let (images, state) = observation(&config, seed, batch);
    let actions = input(
        "action",
        seed,
        &[batch, config.chunk_size, config.action_dim],
    );
    let noise = input("latent_noise", seed, &[batch, config.latent_dim]);
    let pad_from = Tensor::from_slice(
        &case["pad_from"]
            .as_array()
            .unwrap()
            .iter()
            .map(|v| v.as_i64().unwrap())
            .collect::<Vec<i64>>(),
    );
    let is_pad = Tensor::arange(config.chunk_size, (Kind::Int64, Device::Cpu))
        .ge_tensor(&pad_from.unsqueeze(1));
    let demonstration = Demonstration {
        actions: &actions,
        is_pad: &is_pad,
        noise: &noise,
    };
    let (predicted, latent) = act.train(&images, &state, &demonstration).unwrap();
    let parts = losses(&config, &predicted, latent.as_ref(), &actions, &is_pad).unwrap();
    check_close(
        &format!("{name} l1"),
        parts.l1.double_value(&[]),
        case["parts"]["l1_loss"].as_f64().unwrap(),
        1e-5,
    );
    check_close(
        &format!("{name} kl"),
        parts.kl.double_value(&[]),
        case["parts"]["kld_loss"].as_f64().unwrap(),
        1e-5,
    );
    check_close(
        &format!("{name} loss"),
        parts.total.double_value(&[]),
        case["loss"].as_f64().unwrap(),
        1e-5,
    );
    parts.total.backward();
    for (key, norm) in case["gradient_norms"].as_object().unwrap() {
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

#[test]
fn networks_agree_with_the_reference_implementations() {
    let default = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/golden/policies.json");
    let path = std::env::var_os("TROCAR_GOLDEN").map_or(default, PathBuf::from);
    let text = std::fs::read_to_string(&path)
        .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let golden: Value = serde_json::from_str(&text).unwrap();
    let seed = golden["seed"].as_u64().unwrap();
    let (mut checked, mut skipped) = (0, Vec::new());
    for (name, case) in golden["cases"].as_object().unwrap() {
        let seed = case["seed"].as_u64().unwrap_or(seed);
        if case["loss"].is_number() && case["gradient_norms"].is_object() {
            check_training(name, case, seed);
            checked += 1;
        } else if case["config"]["dim_model"].is_number() && case["output"].is_array() {
            check_chunk(name, case, seed);
            checked += 1;
        } else {
            skipped.push(name.clone());
        }
    }
    println!(
        "{checked} cases checked, {} skipped: {}",
        skipped.len(),
        skipped.join(", ")
    );
    assert!(
        checked > 0,
        "no case in {} could be checked",
        path.display()
    );
}
