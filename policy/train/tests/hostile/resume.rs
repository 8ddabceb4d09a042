//! The state of a training that was stopped: damaged, then read and resumed.

use std::fs;
use std::path::{Path, PathBuf};

use tch::Device;
use trocar_data::dataset::Dataset;
use trocar_nets::dp3::{Dp3, Dp3Config, Dp3Preset};
use trocar_train::{
    Progress, RunState, TrainError, TrainOptions, Trained, Trainer, TrainingObserver,
};

use crate::cloud::cloud;
use crate::common::{Folder, seeds, told, within_memory};
use crate::damage::damaged;
use crate::recorded::record;

const STEPS: u64 = 4;

/// Stops after two steps and keeps the state.
struct Stopper {
    asked: u64,
    file: PathBuf,
}

impl TrainingObserver for Stopper {
    fn progress(&mut self, _progress: &Progress) {}

    fn wants_stop(&mut self) -> bool {
        self.asked += 1;
        self.asked == 2
    }

    fn keep(&mut self, state: RunState) -> Result<(), TrainError> {
        state.write(&self.file)
    }
}

fn run(
    dataset: &Dataset,
    state: Option<RunState>,
    watch: &mut dyn TrainingObserver,
) -> Result<Trained<Dp3>, TrainError> {
    let config = Dp3Config {
        horizon: 8,
        n_action_steps: 4,
        down_dims: vec![8, 16],
        diffusion_step_embed_dim: 8,
        ..Dp3Config::preset(Dp3Preset::Simple, 7, 7)
    };
    let options = TrainOptions {
        batch: 2,
        threads: 1,
        log_every: 3,
        ..TrainOptions::dp3(STEPS)
    };
    let trainer = Trainer::new(Device::Cpu);
    let trainer = match state {
        Some(state) => trainer.resuming(state),
        None => trainer,
    };
    trainer.run_dp3(&config, &cloud(), &options, dataset, watch)
}

/// Goes on from `file`; a training that comes to its end is whole.
fn go_on(dataset: &Dataset, file: &Path, case: &str) -> Result<(), TrainError> {
    let state = RunState::read(file)?;
    assert!(state.curve().to_svg().len() < 1 << 20, "{case}");
    let trained = run(dataset, Some(state), &mut |_: &Progress| ())?;
    let last = trained.curve.last().expect(case);
    assert_eq!(last.step, STEPS, "{case}");
    assert!(last.loss.is_finite(), "{case}: {last:?}");
    for (key, tensor) in trained.network.parameters().iter() {
        assert!(
            bool::try_from(tensor.isfinite().all()).unwrap(),
            "{case}: {key}"
        );
    }
    Ok(())
}

#[test]
fn a_damaged_state_is_gone_on_with_or_refused_by_name() {
    let folder = Folder::new("resume");
    let data = folder.path().join("d");
    record(&data, "scope");
    let dataset = Dataset::open(&data).unwrap();
    let file = folder.path().join("training_state.safetensors");
    let mut stopper = Stopper {
        asked: 0,
        file: file.clone(),
    };
    let stopped = run(&dataset, None, &mut stopper).unwrap_err();
    assert!(
        matches!(stopped, TrainError::Stopped { step: 2 }),
        "{stopped}"
    );
    go_on(&dataset, &file, "it is whole").unwrap();
    let whole = fs::read(&file).unwrap();
    let header = usize::try_from(u64::from_le_bytes(whole[..8].try_into().unwrap())).unwrap();
    let small = small_parts(&whole, header);
    within_memory(|| {
        let mut refused = 0_u32;
        for seed in seeds(4) {
            let bytes = match seed % 3 {
                // What is said of the tensors, the tensors that are about the run, and anything.
                0 => [
                    damaged(&whole[..8 + header], seed),
                    whole[8 + header..].to_vec(),
                ]
                .concat(),
                1 => {
                    let (start, end) = small[usize::try_from(seed / 3).unwrap() % small.len()];
                    let mut bytes = whole.clone();
                    let other = damaged(&whole[start..end], seed);
                    let same = other.len().min(end - start);
                    bytes[start..start + same].copy_from_slice(&other[..same]);
                    bytes
                }
                _ => damaged(&whole, seed),
            };
            fs::write(&file, bytes).unwrap();
            if let Err(error) = go_on(&dataset, &file, &format!("seed {seed}")) {
                let text = told(&error);
                // Moments may be so large that the next step's numbers are none.
                let by_name = text.contains(&file.display().to_string());
                let diverged = matches!(error, TrainError::Diverged { .. });
                assert!(by_name || diverged, "seed {seed}: {text}");
                assert!(text.len() < 2000, "seed {seed}: {text}");
                refused += 1;
            }
        }
        assert!(refused > 0, "nothing was refused: is anything damaged?");
    });
}

/// Where the bytes are of the tensors that are not the network's.
fn small_parts(whole: &[u8], header: usize) -> Vec<(usize, usize)> {
    let header: serde_json::Value = serde_json::from_slice(&whole[8..8 + header]).unwrap();
    let data = whole.len() - end_of(&header);
    ["step", "curve", "run", "about", "since_row"]
        .iter()
        .filter_map(|name| place(&header[name]))
        .filter(|(start, end)| start < end)
        .map(|(start, end)| (data + start, data + end))
        .collect()
}

fn end_of(header: &serde_json::Value) -> usize {
    let tensors = header.as_object().unwrap().values();
    let ends = tensors.filter_map(|tensor| Some(place(tensor)?.1));
    ends.max().unwrap()
}

fn place(tensor: &serde_json::Value) -> Option<(usize, usize)> {
    let offset = |index: usize| usize::try_from(tensor["data_offsets"][index].as_u64()?).ok();
    Some((offset(0)?, offset(1)?))
}
