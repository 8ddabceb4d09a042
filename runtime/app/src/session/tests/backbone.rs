//! ACT with a backbone that was trained elsewhere: what is refused, and what a training leaves
//! behind.

use std::collections::BTreeMap;

use tch::{Kind, Tensor};
use trocar_nets::act::{Act, ActConfig, ActPreset};
use trocar_nets::checkpoint;
use trocar_nets::parameters::ParameterSource;

use super::clouds::record_lift;
use super::*;

const BACKBONE: &str = "model.backbone.";

/// A backbone that cannot be is refused before anything is made.
#[test]
fn impossible_backbone_is_refused_first() {
    let folder = Scratch::new("session-backbone");
    let out = folder.0.join("act");
    let weights = folder.0.join("resnet18.safetensors");
    let act = TrainingOptions {
        backbone: BackboneNorm::FrozenBatchNorm,
        ..training_options(folder.0.join("data"), out.clone())
    };
    let dp3 = TrainingOptions {
        network: NetworkChoice::Dp3,
        preset: "paper".to_owned(),
        backbone: BackboneNorm::GroupNorm,
        backbone_weights: Some(weights.clone()),
        ..act.clone()
    };
    let group = TrainingOptions {
        network: NetworkChoice::Act,
        preset: "small".to_owned(),
        ..dp3.clone()
    };
    let absent = TrainingOptions {
        backbone_weights: Some(weights),
        ..act
    };
    for (options, reason) in [
        (dp3, "act-pc and dp3 have none"),
        (group, "of --backbone frozen_batch_norm"),
        (absent, "resnet18.safetensors: file is missing"),
    ] {
        let error = train(&options, &mut |_| {}).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
        assert!(!out.exists());
    }
}

/// A ResNet-18 as torchvision names it, with statistics that are not the neutral ones.
fn foreign() -> BTreeMap<String, Tensor> {
    let config = ActConfig {
        backbone_norm: BackboneNorm::FrozenBatchNorm,
        ..ActConfig::preset(
            ActPreset::Small,
            &["observation.images.endoscope".to_owned()],
        )
    };
    let act = Act::new(config, ParameterSource::seeded(9, Device::Cpu)).unwrap();
    let named = act.parameters().iter().filter_map(|(key, tensor)| {
        let name = key.strip_prefix(BACKBONE)?;
        let moved = match name.rsplit('.').next() {
            Some("running_mean") => tensor + 0.125,
            // More than half precision can hold.
            Some("running_var") => tensor * 131_072.0,
            _ => tensor.copy(),
        };
        Some((name.to_owned(), moved))
    });
    named.collect()
}

/// The tensors of LeRobot's variational encoder of four layers, by its names.
fn variational_encoder() -> Vec<String> {
    let of_layer = [
        "self_attn.in_proj_weight",
        "self_attn.in_proj_bias",
        "self_attn.out_proj.weight",
        "self_attn.out_proj.bias",
        "linear1.weight",
        "linear1.bias",
        "linear2.weight",
        "linear2.bias",
        "norm1.weight",
        "norm1.bias",
        "norm2.weight",
        "norm2.bias",
    ];
    let around = [
        "_cls_embed.weight",
        "_robot_state_input_proj.weight",
        "_robot_state_input_proj.bias",
        "_action_input_proj.weight",
        "_action_input_proj.bias",
        "_latent_output_proj.weight",
        "_latent_output_proj.bias",
        "_pos_enc",
    ];
    let layers = (0..4).flat_map(|layer| of_layer.map(|name| format!(".layers.{layer}.{name}")));
    let all = layers.chain(around.map(str::to_owned));
    let mut all: Vec<String> = all.map(|name| format!("model.vae_encoder{name}")).collect();
    all.sort();
    all
}

#[test]
fn a_policy_of_lerobot_s_kind_is_kept_whole_and_to_the_bit() {
    let folder = Scratch::new("session-whole");
    let (data, out) = (folder.0.join("data"), folder.0.join("act"));
    record_lift(&data, false, 256);
    let weights = folder.0.join("resnet18.safetensors");
    let foreign = foreign();
    Tensor::write_safetensors(&foreign.iter().collect::<Vec<_>>(), &weights).unwrap();
    let options = TrainingOptions {
        backbone: BackboneNorm::FrozenBatchNorm,
        backbone_weights: Some(weights),
        ..training_options(data, out.clone())
    };
    assert!(train(&options, &mut |_| {}).unwrap().loss.is_finite());

    let kept = Tensor::read_safetensors(out.join("model.safetensors")).unwrap();
    let kept: BTreeMap<String, Tensor> = kept.into_iter().collect();
    let encoder = kept
        .keys()
        .filter(|key| key.starts_with("model.vae_encoder"));
    let encoder: Vec<String> = encoder.cloned().collect();
    assert_eq!(encoder, variational_encoder());
    assert!(kept.values().all(|tensor| tensor.kind() == Kind::Float));
    for (name, given) in &foreign {
        if name.contains("running_") {
            assert_eq!(&kept[&format!("{BACKBONE}{name}")], given, "{name}");
        }
    }
    // Refuses what is missing or left over; the encoder is there to train further.
    let loaded = checkpoint::load(&out, Device::Cpu).unwrap();
    for (key, tensor) in &kept {
        assert_eq!(loaded.act.parameters().get(key), Some(tensor), "{key}");
    }
    // It was trained before, and so moves as slowly as its authors say.
    let recipe = loaded.recipe.unwrap();
    let rates = ["lr", "lr_backbone"].map(|name| recipe.training["options"][name].as_f64());
    assert_eq!(rates, [Some(1e-4), Some(1e-5)]);
}

#[test]
fn a_wanted_learning_rate_leaves_a_trained_backbone_slow() {
    let rates = |pretrained: bool, published, lr| {
        let options = TrainingOptions {
            backbone: BackboneNorm::FrozenBatchNorm,
            backbone_weights: pretrained.then(PathBuf::new),
            published,
            lr,
            ..training_options(PathBuf::new(), PathBuf::new())
        };
        let options = train_options(&options, ActPreset::Small);
        (options.lr, options.lr_backbone)
    };
    assert_eq!(rates(false, false, None), (1e-4, 1e-4));
    assert_eq!(rates(false, false, Some(3e-4)), (3e-4, 3e-4));
    for published in [false, true] {
        assert_eq!(rates(true, published, Some(3e-4)), (3e-4, 1e-5));
        assert_eq!(rates(true, published, Some(2e-6)), (2e-6, 2e-6));
    }
}
