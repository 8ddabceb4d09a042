//! A tiny ACT-PC learns a tiny dataset with depth, the same way every time, and survives the disk
//! as a policy.

use std::fs;
use std::sync::PoisonError;

use hal::{Observation, Policy};
use tch::Device;

use super::dp3_tests::{cloud, dataset, folder, lens, recipe, seen};
use super::tests::ONE_AT_A_TIME;
use super::{Progress, Schedule, TrainError, TrainOptions, Trained, Trainer};
use trocar_data::dataset::Dataset;
use trocar_nets::act::{ActConfig, ActPreset};
use trocar_nets::act_pc::{ActPc, ActPcConfig, ActPcPreset};
use trocar_nets::act_pc_policy::ActPcPolicy;
use trocar_nets::checkpoint::{self, Precision};

pub(super) fn config() -> ActPcConfig {
    let cameras = ["observation.images.endoscope".to_owned()];
    let preset = ActPcConfig::preset(ActPcPreset::Small, &cameras);
    ActPcConfig {
        act: ActConfig {
            chunk_size: 4,
            dim_model: 32,
            n_heads: 4,
            dim_feedforward: 64,
            n_encoder_layers: 1,
            n_vae_encoder_layers: 1,
            ..preset.act
        },
        points: 32,
        tokens: 8,
        neighbours: 4,
        ..preset
    }
}

pub(super) fn options() -> TrainOptions {
    TrainOptions {
        steps: 24,
        schedule: Schedule::Constant,
        batch: 6,
        lr: 1e-3,
        lr_backbone: 1e-3,
        warm_up_steps: 2,
        log_every: 4,
        ema_decay: 0.5,
        threads: 1,
        ..TrainOptions::preset(ActPreset::Small)
    }
}

fn train(dataset: &Dataset, options: &TrainOptions) -> Result<Trained<ActPc>, TrainError> {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    Trainer::new(Device::Cpu).run_act_pc(
        &config(),
        &cloud(),
        options,
        dataset,
        &mut |_: &Progress| (),
    )
}

/// What it trained survives the disk.
#[test]
fn training_lowers_the_loss_and_repeats_itself() {
    let (data, dataset) = dataset("act-pc", Some(lens()));
    let first = train(&dataset, &options()).unwrap();
    let (start, end) = (first.curve.rows[0], *first.curve.last().unwrap());
    assert!(
        end.loss < 0.5 * start.loss && end.l1 < start.l1,
        "{start:?} {end:?}"
    );
    let short = TrainOptions {
        steps: 4,
        ..options()
    };
    let again = train(&dataset, &short).unwrap();
    assert_eq!(first.curve.rows[0], again.curve.rows[0]);

    let folder = folder("act-pc-disk");
    let (network, statistics) = (&first.network, &first.statistics);
    let precision = Precision::F32;
    checkpoint::save_act_pc(&folder, network, &cloud(), statistics, &recipe(), precision).unwrap();
    let loaded = checkpoint::load_act_pc(&folder, Device::Cpu).unwrap();
    assert_eq!((&loaded.cloud, &loaded.statistics), (&cloud(), statistics));
    let mut moved = false;
    for (key, tensor) in loaded.network.parameters().iter() {
        assert_eq!(first.network.parameters().get(key), Some(tensor), "{key}");
        moved |= key.ends_with("running_mean") && tensor.abs().max().double_value(&[]) > 0.0;
    }
    assert!(moved, "the statistics of the normalisations were learned");

    let mut policy = ActPcPolicy::load(&folder, Device::Cpu).unwrap();
    let mut answer = |step| {
        let (arm, frame) = seen(step);
        let frames = [frame.as_frame()];
        let (arms, frames) = (&[arm][..], &frames[..]);
        let chunks = policy.infer(&Observation { arms, frames }).unwrap();
        chunks[0].valid_targets().to_vec()
    };
    assert_eq!(answer(4).len(), 4);
    assert_eq!(answer(4), answer(4));
    assert_ne!(answer(4), answer(1));
    let file = folder.join("config.json");
    let text = fs::read_to_string(&file).unwrap();
    let other = text.replace(
        "\"points\": 32,\n    \"voxel_m\"",
        "\"points\": 31,\n    \"voxel_m\"",
    );
    assert_ne!(text, other);
    fs::write(&file, other).unwrap();
    let error = ActPcPolicy::load(&folder, Device::Cpu)
        .unwrap_err()
        .to_string();
    assert!(error.contains("cloud.points = 31"), "{error}");
    fs::remove_dir_all(&folder).unwrap();
    fs::remove_dir_all(&data).unwrap();
}
