//! A training that is stopped and goes on ends with the bits of one that was not stopped.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{MutexGuard, PoisonError};

use tch::Device;

use super::tests::ONE_AT_A_TIME;
use super::{
    LossCurve, Progress, RunState, TrainError, TrainOptions, Trainer, TrainingObserver,
    act_pc_tests, dp3_tests, tests,
};
use trocar_nets::parameters::Parameters;

/// Stops after some steps and keeps the state in a file.
struct Stopper {
    steps: u64,
    file: PathBuf,
    kept: Vec<u64>,
}

impl TrainingObserver for Stopper {
    fn progress(&mut self, _progress: &Progress) {}

    fn wants_stop(&mut self) -> bool {
        self.steps = self.steps.saturating_sub(1);
        self.steps == 0
    }

    fn keep(&mut self, mut state: RunState) -> Result<(), TrainError> {
        self.kept.push(state.step);
        state.about = "begun so".to_owned();
        state.write(&self.file)
    }
}

pub(super) fn alone() -> MutexGuard<'static, ()> {
    ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A row of the curve begins before the stop and ends after it.
pub(super) fn four_steps(options: TrainOptions) -> TrainOptions {
    TrainOptions {
        steps: 4,
        log_every: 3,
        ..options
    }
}

pub(super) fn trainer(state: Option<&Path>) -> Trainer {
    let trainer = Trainer::new(Device::Cpu);
    match state {
        Some(file) => {
            let state = RunState::read(file).unwrap();
            assert_eq!((state.step, state.about.as_str()), (2, "begun so"));
            trainer.resuming(state)
        }
        None => trainer,
    }
}

fn same(one: (&Parameters, &LossCurve), other: (&Parameters, &LossCurve)) {
    assert_eq!(one.1, other.1);
    for (key, tensor) in one.0.iter() {
        assert_eq!(other.0.get(key), Some(tensor), "{key}");
    }
}

/// A run from a state, or from the start.
pub(super) type Run<'a, T> =
    dyn Fn(Option<&Path>, &mut dyn TrainingObserver) -> Result<T, TrainError> + 'a;

/// Runs four steps at once, then two and two; `run` takes the state to go on from.
pub(super) fn check<T: std::fmt::Debug>(
    folder: &Path,
    run: &Run<'_, T>,
    outcome: fn(&T) -> (&Parameters, &LossCurve),
) -> PathBuf {
    let _alone = alone();
    let mut quiet = |_: &Progress| ();
    let whole = run(None, &mut quiet).unwrap();
    let mut stopper = Stopper {
        steps: 2,
        file: folder.join("state.safetensors"),
        kept: Vec::new(),
    };
    let stopped = run(None, &mut stopper).unwrap_err();
    assert!(
        matches!(stopped, TrainError::Stopped { step: 2 }),
        "{stopped}"
    );
    assert_eq!(stopper.kept, [2]);
    let resumed = run(Some(&stopper.file), &mut quiet).unwrap();
    same(outcome(&whole), outcome(&resumed));
    stopper.file
}

/// Nothing else goes on with its state.
#[test]
fn act_resumes_to_the_same_bits_and_only_as_itself() {
    let dataset = tests::dataset("resume-act");
    let config = tests::config();
    let options = four_steps(tests::options());
    let run = |options: &TrainOptions, state: Option<&Path>, watch: &mut dyn TrainingObserver| {
        trainer(state).run(&config, options, &dataset.dataset, watch)
    };
    let file = check(
        &dataset.folder,
        &|state, watch| run(&options, state, watch),
        |trained| (trained.network.parameters(), &trained.curve),
    );
    let other = TrainOptions {
        lr: 2e-3,
        ..options
    };
    let _alone = alone();
    let mut quiet = |_: &Progress| ();
    let error = run(&other, Some(&file), &mut quiet)
        .unwrap_err()
        .to_string();
    assert!(error.contains("begun with another options"), "{error}");
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
    let error = RunState::read(&file).unwrap_err().to_string();
    assert!(error.contains("state.safetensors"), "{error}");
}

#[test]
fn act_pc_goes_on_to_the_same_bits() {
    let (folder, dataset) = dp3_tests::dataset("resume-pc", Some(dp3_tests::lens()));
    let (config, cloud) = (act_pc_tests::config(), dp3_tests::cloud());
    let options = four_steps(act_pc_tests::options());
    check(
        &folder,
        &|state, watch| trainer(state).run_act_pc(&config, &cloud, &options, &dataset, watch),
        |trained| (trained.network.parameters(), &trained.curve),
    );
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn dp3_goes_on_to_the_same_bits() {
    let (folder, dataset) = dp3_tests::dataset("resume-dp3", Some(dp3_tests::lens()));
    let (config, cloud) = (dp3_tests::config(), dp3_tests::cloud());
    let options = four_steps(dp3_tests::options());
    check(
        &folder,
        &|state, watch| trainer(state).run_dp3(&config, &cloud, &options, &dataset, watch),
        |trained| (trained.network.parameters(), &trained.curve),
    );
    fs::remove_dir_all(&folder).unwrap();
}
