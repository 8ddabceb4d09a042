//! ACT and ACT-PC in their folders, and the weights that a backbone starts from.

use std::fs;
use std::path::{Path, PathBuf};

use tch::Device;
use trocar_nets::act::{Act, ActConfig, ActPreset, BackboneNorm};
use trocar_nets::act_pc::{ActPc, ActPcConfig, ActPcPreset};
use trocar_nets::checkpoint::{
    self, BackboneWeights, CheckpointError, CloudStatistics, FeatureStatistics, PolicyPreset,
    Precision, Recipe, SaveOptions, Variants, load_act_pc, save_act_pc,
};
use trocar_nets::normalise::Statistics;
use trocar_nets::parameters::{ParameterSource, Parameters};

use crate::checkpoints::{check, recipe};
use crate::cloud::cloud;
use crate::common::{Folder, seeds, within_memory};
use crate::damage::damaged;
use crate::digits::renumbered;

const CAMERA: &str = "observation.images.endoscope";
const WEIGHTS: &str = "model.safetensors";

fn act_config() -> ActConfig {
    ActConfig {
        chunk_size: 5,
        dim_model: 32,
        n_heads: 4,
        dim_feedforward: 64,
        n_encoder_layers: 1,
        n_vae_encoder_layers: 1,
        image_height: 64,
        image_width: 64,
        ..ActConfig::preset(ActPreset::Small, &[CAMERA.to_owned()])
    }
}

fn numbers(scale: f32) -> Statistics {
    Statistics {
        mean: vec![0.0; 7],
        std: vec![scale; 7],
        min: vec![-scale; 7],
        max: vec![scale; 7],
    }
}

fn save_act(folder: &Path) {
    let act = Act::new(act_config(), ParameterSource::seeded(3, Device::Cpu)).unwrap();
    let statistics = FeatureStatistics {
        state: numbers(0.5),
        action: numbers(0.01),
    };
    let recipe = Recipe {
        preset: PolicyPreset::Small,
        variants: Variants {
            backbone_norm: act.config().backbone_norm,
            ..Variants::default()
        },
        ..recipe()
    };
    let options = SaveOptions {
        precision: Precision::F16,
        inference_only: true,
    };
    checkpoint::save(folder, &act, &statistics, &recipe, options).unwrap();
}

fn save_cloud_act(folder: &Path) {
    let preset = ActPcConfig::preset(ActPcPreset::Small, &[CAMERA.to_owned()]);
    let config = ActPcConfig {
        act: ActConfig {
            image_height: preset.act.image_height,
            image_width: preset.act.image_width,
            ..act_config()
        },
        points: 32,
        tokens: 8,
        neighbours: 4,
        ..preset
    };
    let network = ActPc::new(config, ParameterSource::seeded(3, Device::Cpu)).unwrap();
    let statistics = CloudStatistics {
        state: numbers(0.5),
        action: numbers(0.01),
        points: [[-0.1; 3], [0.1; 3]],
    };
    let recipe = Recipe {
        preset: PolicyPreset::Small,
        ..recipe()
    };
    save_act_pc(
        folder,
        &network,
        &cloud(),
        &statistics,
        &recipe,
        Precision::F32,
    )
    .unwrap();
}

/// What is loaded is finite throughout.
fn all_finite(parameters: &Parameters, numbers: [&Statistics; 2]) -> bool {
    let tensors = parameters
        .iter()
        .all(|(_, tensor)| bool::try_from(tensor.isfinite().all()).unwrap());
    let parts = numbers.into_iter().flat_map(|of| [&of.mean, &of.std]);
    tensors && parts.flatten().all(|value| value.is_finite())
}

/// Loads the folder; what comes is finite, or refused.
type Load = fn(&Path) -> Result<(), CheckpointError>;

fn load_act(folder: &Path) -> Result<(), CheckpointError> {
    let loaded = checkpoint::load(folder, Device::Cpu)?;
    let numbers = [&loaded.statistics.state, &loaded.statistics.action];
    assert!(all_finite(loaded.act.parameters(), numbers));
    Ok(())
}

fn load_cloud_act(folder: &Path) -> Result<(), CheckpointError> {
    let loaded = load_act_pc(folder, Device::Cpu)?;
    let numbers = [&loaded.statistics.state, &loaded.statistics.action];
    assert!(all_finite(loaded.network.parameters(), numbers));
    Ok(())
}

/// The folder's files but its weights, in order.
fn small_files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| !file.ends_with(WEIGHTS));
    files.sort();
    files
}

/// Damages each of `files` in turn; every refusal names a file of the folder.
fn damage(folder: &Path, files: &[PathBuf], cases: std::ops::Range<u64>, load: Load) -> u32 {
    let whole: Vec<Vec<u8>> = files.iter().map(|file| fs::read(file).unwrap()).collect();
    let mut refused = 0;
    for seed in cases {
        let number = usize::try_from(seed).unwrap() % files.len();
        fs::write(&files[number], damaged(&whole[number], seed)).unwrap();
        let case = format!("seed {seed}, {}", files[number].display());
        if let Err(error) = load(folder) {
            check(&error, folder, &case);
            refused += 1;
        }
        fs::write(&files[number], &whole[number]).unwrap();
    }
    refused
}

/// Replaces every number of every JSON file in turn; of what is accepted, the weights do not fit.
fn renumber(folder: &Path, load: Load) {
    let mut files = small_files(folder);
    files.retain(|file| file.extension().is_some_and(|it| it == "json"));
    for file in files {
        let text = fs::read_to_string(&file).unwrap();
        for (case, other) in renumbered(&text) {
            fs::write(&file, other).unwrap();
            let case = format!("{}, {case}", file.display());
            check(&load(folder).expect_err(&case), folder, &case);
        }
        fs::write(&file, text).unwrap();
    }
}

/// Both kinds of damage, with the weights of another network in their place, so that much can be
/// tried: whatever the other files say is followed up to there.
fn damage_small_files(folder: &Path, load: Load) {
    load(folder).expect("it is whole");
    let weights = folder.join(WEIGHTS);
    let kept = fs::read(&weights).unwrap();
    let header = br#"{"a":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}"#;
    let length = u64::try_from(header.len()).unwrap().to_le_bytes();
    fs::write(&weights, [&length[..], header, &[0; 4]].concat()).unwrap();
    within_memory(|| {
        renumber(folder, load);
        damage(folder, &small_files(folder), seeds(1), load);
    });
    fs::write(&weights, kept).unwrap();
    load(folder).expect("it is whole again");
}

#[test]
fn a_damaged_act_is_read_or_refused_by_name() {
    let folder = Folder::new("act");
    save_act(folder.path());
    damage_small_files(folder.path(), load_act);
    // The weights have 22 MB.
    within_memory(|| {
        let mut files = small_files(folder.path());
        let refused = damage(folder.path(), &files, seeds(20), load_act);
        assert!(refused > 0, "nothing was refused: is anything damaged?");
        files = vec![folder.path().join(WEIGHTS)];
        damage(folder.path(), &files, seeds(20), load_act);
    });
}

#[test]
fn a_damaged_act_pc_is_read_or_refused_by_name() {
    let folder = Folder::new("act-pc");
    save_cloud_act(folder.path());
    damage_small_files(folder.path(), load_cloud_act);
    within_memory(|| {
        let mut files = small_files(folder.path());
        files.push(folder.path().join(WEIGHTS));
        let refused = damage(folder.path(), &files, seeds(1), load_cloud_act);
        assert!(refused > 0, "nothing was refused: is anything damaged?");
    });
}

#[test]
fn damaged_backbone_weights_are_read_or_refused_by_name() {
    let folder = Folder::new("backbone");
    let config = ActConfig {
        backbone_norm: BackboneNorm::FrozenBatchNorm,
        ..act_config()
    };
    let act = Act::new(config, ParameterSource::seeded(3, Device::Cpu)).unwrap();
    let file = folder.path().join("resnet18.safetensors");
    let prefix = "model.backbone.";
    let backbone: Vec<(String, tch::Tensor)> = act
        .parameters()
        .iter()
        .filter_map(|(key, tensor)| {
            let half = tensor.detach().to_kind(tch::Kind::Half).contiguous();
            Some((key.strip_prefix(prefix)?.to_owned(), half))
        })
        .collect();
    tch::Tensor::write_safetensors(&backbone, &file).unwrap();
    BackboneWeights::load(&file).expect("it is whole");
    let whole = fs::read(&file).unwrap();
    let header = usize::try_from(u64::from_le_bytes(whole[..8].try_into().unwrap())).unwrap();
    within_memory(|| {
        let mut refused = 0_u32;
        for seed in seeds(20) {
            // Every other time in the header, which has all that is said.
            let mut bytes = whole.clone();
            if seed % 2 == 0 {
                let rest = bytes.split_off(8 + header);
                bytes = [damaged(&bytes, seed), rest].concat();
            } else {
                bytes = damaged(&bytes, seed);
            }
            fs::write(&file, bytes).unwrap();
            if let Err(error) = BackboneWeights::load(&file) {
                check(&error, folder.path(), &format!("seed {seed}"));
                refused += 1;
            }
        }
        assert!(refused > 0, "nothing was refused: is anything damaged?");
    });
}
