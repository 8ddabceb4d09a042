//! Our side of the comparisons with other programs, which scripts in `tests/scripts/` and
//! `policy/convert/` start.
//!
//! `TROCAR_PEER` names a JSON list of jobs, each with a `do` and the paths that it needs. Tensors
//! travel as safetensors. Without the variable there is nobody to answer, so the test is ignored
//! unless a script asks for it.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking, its helpers too"
)]

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;
use tch::{Device, Tensor};
use trocar_data::dataset::Dataset;
use trocar_data::relative_action::REPRESENTATION;
use trocar_nets::act::{ActConfig, ActPreset, BackboneNorm};
use trocar_nets::checkpoint::{
    self, AggregationName, DatasetSummary, RECIPE_FORMAT, Recipe, RecommendedAggregation,
    RecordedCamera, SaveOptions, Variants,
};
use trocar_nets::dp3::CloudObservation;
use trocar_nets::normalise::ImageNormaliser;
use trocar_train::{TrainOptions, Trainer};

#[test]
#[ignore = "answers a script, which names its jobs in TROCAR_PEER"]
fn jobs_of_a_peer() {
    let file = std::env::var_os("TROCAR_PEER").unwrap();
    let jobs: Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    for job in jobs.as_array().unwrap() {
        match job["do"].as_str().unwrap() {
            "act" => tch::no_grad(|| answer_as_act(job)),
            "dp3" => tch::no_grad(|| answer_as_dp3(job)),
            "frames" => dump_frames(job),
            "train" => train(job),
            "refuse" => refuse(job),
            other => panic!("no such job: {other}"),
        }
    }
}

fn path<'a>(job: &'a Value, name: &str) -> &'a Path {
    Path::new(
        job[name]
            .as_str()
            .unwrap_or_else(|| panic!("{job} lacks {name}")),
    )
}

fn tensors(file: &Path) -> BTreeMap<String, Tensor> {
    Tensor::read_safetensors(file)
        .unwrap()
        .into_iter()
        .collect()
}

/// The chunks of an ACT checkpoint in SI units, for states and images in bytes `(batch, height,
/// width, 3)` a camera.
fn answer_as_act(job: &Value) {
    let loaded = checkpoint::load(path(job, "checkpoint"), Device::Cpu).unwrap();
    let inputs = tensors(path(job, "inputs"));
    let cameras = &loaded.act.config().cameras;
    let images: Vec<&Tensor> = cameras.iter().map(|name| &inputs[name]).collect();
    let images = ImageNormaliser::imagenet(Device::Cpu)
        .unwrap()
        .apply(&Tensor::stack(&images, 1))
        .unwrap();
    let state = loaded.statistics.state.normaliser();
    let state = state.apply(&inputs["observation.state"]).unwrap();
    let chunk = loaded.act.infer(&images, &state).unwrap();
    let action = loaded.statistics.action.normaliser().invert(&chunk);
    Tensor::write_safetensors(&[("action", action.unwrap())], path(job, "output")).unwrap();
}

/// What a DP3 checkpoint predicts in SI units, for clouds, states and the noise that it starts
/// from.
fn answer_as_dp3(job: &Value) {
    let loaded = checkpoint::load_dp3(path(job, "checkpoint"), Device::Cpu).unwrap();
    let inputs = tensors(path(job, "inputs"));
    let observation = CloudObservation {
        points: &loaded.points.apply(&inputs["point_cloud"]).unwrap(),
        state: &loaded.state.apply(&inputs["agent_pos"]).unwrap(),
    };
    let normalised = loaded.dp3.infer(&observation, &inputs["noise"]).unwrap();
    let actions = loaded.action.invert(&normalised).unwrap().contiguous();
    Tensor::write_safetensors(&[("action", actions)], path(job, "output")).unwrap();
}

/// All that a dataset's reader gives: vectors of all frames, and the images of every
/// `image_stride`-th.
fn dump_frames(job: &Value) {
    let dataset = Dataset::open(path(job, "dataset")).unwrap();
    let stride = usize::try_from(job["image_stride"].as_u64().unwrap()).unwrap();
    let (frames, arms) = (dataset.len(), dataset.arms());
    let rows = |of: &dyn Fn(usize, usize) -> Vec<f64>| {
        let all: Vec<f64> = (0..frames)
            .flat_map(|frame| (0..arms).flat_map(move |arm| of(frame, arm)))
            .collect();
        Tensor::from_slice(&all).view([i64::try_from(frames).unwrap(), -1])
    };
    let mut named = vec![
        (
            "observation.state".to_owned(),
            rows(&|frame, arm| dataset.state(frame, arm).map(f64::from).to_vec()),
        ),
        (
            "observation.tip_pose".to_owned(),
            rows(&|frame, arm| dataset.tip_pose(frame, arm).to_vec()),
        ),
        (
            "action".to_owned(),
            rows(&|frame, arm| dataset.action(frame, arm).to_vec()),
        ),
    ];
    let starts = dataset.episodes().iter().map(|episode| episode.start);
    let starts: Vec<i64> = starts.map(|start| i64::try_from(start).unwrap()).collect();
    named.push(("episode_start".to_owned(), Tensor::from_slice(&starts)));
    for (camera, name) in dataset.camera_names().iter().enumerate() {
        let images: Vec<Tensor> = (0..frames)
            .step_by(stride)
            .map(|frame| {
                let image = dataset.image_rgb(frame, camera).unwrap();
                let (width, height) = image.dimensions();
                let shape = [i64::from(height), i64::from(width), 3];
                Tensor::from_slice(image.as_raw()).view(shape)
            })
            .collect();
        let feature = format!("observation.images.{name}");
        named.push((feature, Tensor::stack(&images, 0)));
    }
    Tensor::write_safetensors(&named, path(job, "output")).unwrap();
}

/// Trains a small network for a few steps, its backbone normalised as the job says, and saves all
/// of it in single precision.
fn train(job: &Value) {
    let dataset = Dataset::open(path(job, "dataset")).unwrap();
    let features = dataset.camera_names().iter();
    let features: Vec<String> = features
        .map(|name| format!("observation.images.{name}"))
        .collect();
    let backbone_norm: BackboneNorm = serde_json::from_value(job["backbone_norm"].clone()).unwrap();
    let config = ActConfig {
        chunk_size: 20,
        dim_model: 64,
        n_heads: 4,
        dim_feedforward: 128,
        n_encoder_layers: 2,
        n_vae_encoder_layers: 1,
        image_height: 128,
        image_width: 128,
        backbone_norm,
        ..ActConfig::preset(ActPreset::Lerobot, &features)
    }
    .for_arms(dataset.arms());
    let options = TrainOptions {
        steps: 2,
        batch: 2,
        ..TrainOptions::preset(ActPreset::Small)
    };
    let trained = Trainer::new(Device::Cpu)
        .run(
            &config,
            &options,
            &dataset,
            &mut |_: &trocar_train::Progress| {},
        )
        .unwrap();
    let recipe = recipe(&config, &dataset);
    let options = SaveOptions::default();
    let (out, statistics) = (path(job, "out"), &trained.statistics);
    checkpoint::save(out, &trained.network, statistics, &recipe, options).unwrap();
}

fn recipe(config: &ActConfig, dataset: &Dataset) -> Recipe {
    let cameras = dataset.spec().cameras.iter().zip(&config.cameras);
    Recipe {
        format: RECIPE_FORMAT,
        arms: dataset.arms(),
        action_representation: REPRESENTATION.to_owned(),
        step_ns: 1_000_000_000 / u64::from(dataset.fps()),
        query_every_steps: 10,
        aggregation: RecommendedAggregation {
            mode: AggregationName::WholeChunk,
            decay: 0.0,
        },
        cameras: cameras
            .map(|(camera, feature)| RecordedCamera {
                feature: feature.clone(),
                width: camera.width,
                height: camera.height,
            })
            .collect(),
        preset: ActPreset::Lerobot.into(),
        variants: Variants {
            backbone_norm: config.backbone_norm,
            loss_denominator: config.loss_denominator,
        },
        recipe: "two steps for the comparison with LeRobot".to_owned(),
        dataset: DatasetSummary::default(),
        seed: 1000,
        training: Value::Null,
    }
}

/// A checkpoint that must be refused; the reason goes to the output as text.
fn refuse(job: &Value) {
    let error = match trocar_nets::loaded_policy::LoadedPolicy::load(
        path(job, "checkpoint"),
        Device::Cpu,
    ) {
        Ok(_) => panic!("{job} was not refused"),
        Err(error) => error.to_string(),
    };
    std::fs::write(path(job, "output"), error).unwrap();
}
