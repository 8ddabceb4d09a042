//! `config.json` as LeRobot writes it: the architecture and the features.
//!
//! A file that LeRobot wrote is read whether or not it has our recipe beside it; a file written
//! here is read by LeRobot unless the backbone is one that it lacks. What it can express
//! differently from this program (dilation, several observation steps, other activations, other
//! normalisation) is refused by name.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::error::Cause;
use super::recipe::Variants;
use crate::act::{ActConfig, BackboneNorm, STAGES};

const STATE: &str = "observation.state";
const ACTION: &str = "action";

/// The backbone as LeRobot has it, its normalisation frozen.
const RESNET: &str = "resnet18";
/// The one whose group normalisation LeRobot does not have. Its keys are the other's but for two
/// that LeRobot can do without, so the name has to be one that LeRobot refuses: under its own it
/// would load the weights and answer nonsense.
const GROUP_NORM_RESNET: &str = "group_norm_resnet18";
/// What follows either name where the last stages are left out, and their number; LeRobot refuses
/// these too.
const STAGES_SUFFIX: &str = "_stages";

/// Kind and shape of a feature.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Feature {
    /// `VISUAL`, `STATE` or `ACTION`.
    #[serde(rename = "type")]
    kind: String,
    /// `[3, height, width]` of images, else a single width.
    shape: Vec<i64>,
}

impl Feature {
    fn new(kind: &str, shape: &[i64]) -> Self {
        Self {
            kind: kind.to_owned(),
            shape: shape.to_vec(),
        }
    }

    pub(super) fn shape(&self) -> &[i64] {
        &self.shape
    }
}

/// The fields that make the network. Others are LeRobot's business and pass unread. Types are those
/// of LeRobot's dataclass.
#[derive(Debug, Deserialize)]
struct ConfigFile {
    #[serde(rename = "type")]
    kind: String,
    n_obs_steps: i64,
    input_features: BTreeMap<String, Feature>,
    output_features: BTreeMap<String, Feature>,
    normalization_mapping: BTreeMap<String, String>,
    vision_backbone: String,
    replace_final_stride_with_dilation: Value,
    feedforward_activation: String,
    chunk_size: i64,
    n_action_steps: Option<i64>,
    pre_norm: bool,
    dim_model: i64,
    n_heads: i64,
    dim_feedforward: i64,
    n_encoder_layers: i64,
    n_decoder_layers: i64,
    use_vae: bool,
    latent_dim: i64,
    n_vae_encoder_layers: i64,
    dropout: f64,
    kl_weight: f64,
}

/// The features of `config` as LeRobot lists them: inputs, outputs.
pub(super) fn features(config: &ActConfig) -> [BTreeMap<String, Feature>; 2] {
    let image = [3, config.image_height, config.image_width];
    let mut inputs: BTreeMap<String, Feature> = config
        .cameras
        .iter()
        .map(|camera| (camera.clone(), Feature::new("VISUAL", &image)))
        .collect();
    inputs.insert(STATE.to_owned(), Feature::new("STATE", &[config.state_dim]));
    let outputs = BTreeMap::from([(
        ACTION.to_owned(),
        Feature::new("ACTION", &[config.action_dim]),
    )]);
    [inputs, outputs]
}

/// How features are normalised, by their kind.
pub(super) fn normalisation() -> Value {
    json!({"VISUAL": "MEAN_STD", "STATE": "MEAN_STD", "ACTION": "MEAN_STD"})
}

/// The text of `config.json`. Decoder layers whose output does not matter are left out: LeRobot
/// would use the last. The optimiser's fields have LeRobot's defaults; uploads are off.
pub(super) fn write(config: &ActConfig) -> Value {
    let [inputs, outputs] = features(config);
    json!({
        "type": "act",
        "n_obs_steps": 1,
        "input_features": inputs,
        "output_features": outputs,
        "device": "cpu",
        "use_amp": false,
        "push_to_hub": false,
        "repo_id": null,
        "private": null,
        "tags": null,
        "license": null,
        "chunk_size": config.chunk_size,
        "n_action_steps": config.chunk_size,
        "normalization_mapping": normalisation(),
        "vision_backbone": backbone_name(config),
        "pretrained_backbone_weights": null,
        "replace_final_stride_with_dilation": 0,
        "pre_norm": config.pre_norm,
        "dim_model": config.dim_model,
        "n_heads": config.n_heads,
        "dim_feedforward": config.dim_feedforward,
        "feedforward_activation": "relu",
        "n_encoder_layers": config.n_encoder_layers,
        "n_decoder_layers": config.built_decoder_layers(),
        "use_vae": config.use_vae,
        "latent_dim": config.latent_dim,
        "n_vae_encoder_layers": config.n_vae_encoder_layers,
        "temporal_ensemble_coeff": null,
        "dropout": config.dropout,
        "kl_weight": config.kl_weight,
        "optimizer_lr": 1e-5,
        "optimizer_weight_decay": 1e-4,
        "optimizer_lr_backbone": 1e-5
    })
}

/// The network that `text` and, where there is one, our own recipe describe.
///
/// `camera_order` is the recipe's, since JSON objects have none; without it cameras are taken in
/// the order of their names.
pub(super) fn read(
    text: &str,
    variants: Variants,
    camera_order: Option<&[String]>,
) -> Result<ActConfig, Cause> {
    // The kind first: another policy's file lacks our fields, and that is not what is wrong with
    // it.
    let document: Value = serde_json::from_str(text).map_err(Cause::Json)?;
    let kind = document["type"].as_str().unwrap_or("").to_owned();
    if kind != "act" {
        return Err(Cause::PolicyType { actual: kind });
    }
    let file: ConfigFile = serde_json::from_value(document).map_err(Cause::Json)?;
    check_supported(&file)?;
    let (backbone_norm, backbone_stages) = backbone(&file, variants, camera_order.is_some())?;
    let (height, width, named) = image_features(&file)?;
    let cameras = match camera_order {
        Some(order) => {
            let mut sorted = order.to_vec();
            sorted.sort();
            if sorted != named {
                return Err(Cause::Inconsistent(format!(
                    "cameras are {named:?}, but the recipe names {order:?}"
                )));
            }
            order.to_vec()
        }
        None => named,
    };
    let config = ActConfig {
        chunk_size: file.chunk_size,
        dim_model: file.dim_model,
        n_heads: file.n_heads,
        dim_feedforward: file.dim_feedforward,
        n_encoder_layers: file.n_encoder_layers,
        n_decoder_layers: file.n_decoder_layers,
        n_vae_encoder_layers: file.n_vae_encoder_layers,
        latent_dim: file.latent_dim,
        pre_norm: file.pre_norm,
        use_vae: file.use_vae,
        dropout: file.dropout,
        kl_weight: file.kl_weight,
        decoder_output: crate::act::DecoderOutput::Last,
        loss_denominator: variants.loss_denominator,
        backbone_norm,
        backbone_stages,
        state_dim: width_of(&file.input_features, STATE)?,
        action_dim: width_of(&file.output_features, ACTION)?,
        cameras,
        image_height: height,
        image_width: width,
    };
    config
        .defect()
        .map_or(Ok(config), |defect| Err(Cause::Config(defect)))
}

/// Refuses what this program would compute differently; `n_action_steps` may be any part of the
/// chunk, since the controller decides how much of it is played.
fn check_supported(file: &ConfigFile) -> Result<(), Cause> {
    let dilated = !matches!(&file.replace_final_stride_with_dilation, Value::Bool(false))
        && file.replace_final_stride_with_dilation.as_i64() != Some(0);
    let checks = [
        ("n_obs_steps", file.n_obs_steps.to_string(), "1"),
        (
            "feedforward_activation",
            file.feedforward_activation.clone(),
            "relu",
        ),
        (
            "replace_final_stride_with_dilation",
            dilated.to_string(),
            "false",
        ),
    ];
    let mapping = file
        .normalization_mapping
        .iter()
        .map(|(kind, mode)| (kind.as_str(), mode.clone(), "MEAN_STD"));
    for (field, value, expected) in checks.into_iter().chain(mapping) {
        if value != expected {
            let (field, expected) = (field.to_owned(), expected.to_owned());
            return Err(Cause::Unsupported {
                field,
                value,
                expected,
            });
        }
    }
    if file.kind != "act" {
        return Err(Cause::PolicyType {
            actual: file.kind.clone(),
        });
    }
    let played = file.n_action_steps.unwrap_or(1);
    if file.chunk_size > 0 && !(1..=file.chunk_size).contains(&played) {
        return Err(Cause::Unsupported {
            field: "n_action_steps".to_owned(),
            value: played.to_string(),
            expected: format!("1 to chunk_size, {}", file.chunk_size),
        });
    }
    Ok(())
}

/// `resnet18`, `group_norm_resnet18`, or either with `_stages3` behind it.
fn backbone_name(config: &ActConfig) -> String {
    let name = match config.backbone_norm {
        BackboneNorm::FrozenBatchNorm => RESNET,
        BackboneNorm::GroupNorm => GROUP_NORM_RESNET,
    };
    let stages = config.backbone_stages;
    if stages == STAGES {
        name.to_owned()
    } else {
        format!("{name}{STAGES_SUFFIX}{stages}")
    }
}

/// The backbone's normalisation by its name and, where there is one, by the recipe, and its stages.
/// Files from before the second name have the first, and only the recipe tells.
fn backbone(
    file: &ConfigFile,
    variants: Variants,
    has_recipe: bool,
) -> Result<(BackboneNorm, usize), Cause> {
    let unknown = || Cause::Unsupported {
        field: "vision_backbone".to_owned(),
        value: file.vision_backbone.clone(),
        expected: format!(
            "{RESNET} or {GROUP_NORM_RESNET}, or one of them with {STAGES_SUFFIX}1 to {STAGES_SUFFIX}{} behind it",
            STAGES - 1
        ),
    };
    let (name, stages) = match file.vision_backbone.split_once(STAGES_SUFFIX) {
        None => (file.vision_backbone.as_str(), STAGES),
        Some((name, stages)) => {
            let stages = stages.parse().map_err(|_| unknown())?;
            (name, stages)
        }
    };
    if !(1..=STAGES).contains(&stages) {
        return Err(unknown());
    }
    match (name, variants.backbone_norm) {
        (RESNET, norm) => Ok((norm, stages)),
        (GROUP_NORM_RESNET, norm) if has_recipe && norm != BackboneNorm::GroupNorm => {
            Err(Cause::Inconsistent(format!(
                "vision_backbone = {name}, but the recipe's backbone_norm is another"
            )))
        }
        (GROUP_NORM_RESNET, _) => Ok((BackboneNorm::GroupNorm, stages)),
        _ => Err(unknown()),
    }
}

/// Height, width and names of the cameras; all must have the same size.
fn image_features(file: &ConfigFile) -> Result<(i64, i64, Vec<String>), Cause> {
    let images: Vec<_> = file
        .input_features
        .iter()
        .filter(|(_, feature)| feature.kind == "VISUAL")
        .collect();
    let Some((_, first)) = images.first() else {
        return Err(Cause::Config("there is no camera".to_owned()));
    };
    for (name, feature) in &images {
        if feature.shape.len() != 3 || feature.shape[0] != 3 || feature.shape != first.shape {
            return Err(Cause::Unsupported {
                field: (*name).clone(),
                value: format!("{:?}", feature.shape),
                expected: "the same [3, height, width] for all cameras".to_owned(),
            });
        }
    }
    Ok((
        first.shape[1],
        first.shape[2],
        images.iter().map(|(name, _)| (*name).clone()).collect(),
    ))
}

/// The only dimension of the feature `name`.
fn width_of(features: &BTreeMap<String, Feature>, name: &str) -> Result<i64, Cause> {
    match features.get(name).map(|feature| feature.shape.as_slice()) {
        Some(&[width]) => Ok(width),
        Some(shape) => Err(Cause::Config(format!(
            "{name} has shape {shape:?}, not one dimension"
        ))),
        None => Err(Cause::Config(format!("feature {name} is missing"))),
    }
}
