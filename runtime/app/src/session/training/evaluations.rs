//! Evaluation during a training: held-out trials with the weights as they are, and the best of
//! these weights kept.

#[cfg(test)]
mod tests;

use core::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tch::Device;
use trocar_data::dataset::{CameraSpec, Dataset};

use super::options::{TrainingEval, TrainingOptions};
use crate::rt;
use crate::session::eval::{EvalOptions, evaluate};
use crate::session::policy_choice::PolicyChoice;
use crate::session::run::write_json;
use crate::session::score::Score;
use crate::session::{Plan, SessionError, Setup};

/// The folder with the best weights, in the checkpoint's.
pub const BEST: &str = "best";
/// The table of all evaluations, beside `loss.csv`.
const TABLE_FILE: &str = "evaluations.csv";
/// What the best weights did, beside them.
const RESULT_FILE: &str = "evaluation.json";
/// Weights that are being evaluated.
const PART: &str = "best.part";
/// The best weights before these, while they are replaced.
const OLD: &str = "best.old";

/// How one evaluation went.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Steps of training.
    pub step: u64,
    /// Trials that count.
    pub trials: usize,
    /// How many of them succeeded.
    pub successes: usize,
    /// `successes / trials`.
    pub rate: f64,
    /// Wilson's 95 % interval of the rate.
    pub wilson95: [f64; 2],
}

impl Evaluation {
    /// Invalid trials are in neither number.
    fn of(step: u64, score: Score) -> Self {
        Self {
            step,
            trials: score.trials(),
            successes: score.successes,
            rate: score.rate(),
            wilson95: score.wilson95(),
        }
    }
}

/// How an evaluation in progress stands: after which step, trials done, of how many, and their
/// score.
pub(super) type OnTrial<'a> = dyn FnMut(u64, usize, usize, Score) + 'a;

/// The evaluations of a training.
#[derive(Debug)]
pub(super) struct Evaluations {
    /// How often, how many trials, from which seed on.
    plan: TrainingEval,
    /// The dataset's unless another was asked for.
    task: String,
    /// The checkpoint's folder, which holds table and best weights.
    out: PathBuf,
    device: Device,
    /// In order of the steps.
    rows: Vec<Evaluation>,
    best: Option<Evaluation>,
}

impl Evaluations {
    /// Those that `options` ask for, if any, of which `rows` are done.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if there is no such task, or if it does not fit the dataset.
    pub(super) fn new(
        options: &TrainingOptions,
        dataset: &Dataset,
        rows: Vec<Evaluation>,
    ) -> Result<Option<Self>, SessionError> {
        let Some(plan) = options.eval.clone() else {
            return Ok(None);
        };
        let recorded = dataset.task();
        let task = plan.task.clone().unwrap_or_else(|| recorded.to_owned());
        check_task(&task, dataset)?;
        let out = options.out.clone();
        let evaluations = Self {
            plan,
            task,
            best: best_in(&out)?,
            out,
            device: options.device,
            rows,
        };
        if !evaluations.rows.is_empty() {
            evaluations.write_table()?;
        }
        Ok(Some(evaluations))
    }

    /// Whether the weights after `step` of `steps` are to be evaluated.
    ///
    /// Every so many steps and after the last one; never twice for one step, as after a resume.
    pub(super) fn wants(&self, step: u64, steps: u64) -> bool {
        let due = step.is_multiple_of(self.plan.every.max(1)) || step == steps;
        due && self.rows.iter().all(|row| row.step != step)
    }

    /// How many there will be after `step` of `steps`.
    pub(super) fn left(&self, step: u64, steps: u64) -> u64 {
        let every = self.plan.every.max(1);
        let last = u64::from(!steps.is_multiple_of(every) && step < steps);
        (steps / every).saturating_sub(step / every) + last
    }

    /// Evaluates the checkpoint that `save` writes into a folder, and keeps it if none was better
    /// before. Nothing is kept of an evaluation that is interrupted.
    pub(super) fn run(
        &mut self,
        step: u64,
        save: &dyn Fn(&Path) -> Result<(), SessionError>,
        on_trial: &mut OnTrial<'_>,
    ) -> Result<Option<Evaluation>, SessionError> {
        let part = self.out.join(PART);
        remove(&part)?;
        save(&part)?;
        // Policies set the number of the whole process.
        let threads = tch::get_num_threads();
        let score = self.evaluate(step, &part, on_trial);
        tch::set_num_threads(threads);
        let Some(score) = score? else {
            remove(&part)?;
            return Ok(None);
        };
        let row = Evaluation::of(step, score);
        self.settle(&part, row)?;
        Ok(Some(row))
    }

    /// Writes down how the checkpoint `part` did, and keeps it if none was better before.
    ///
    /// Of two with the same rate the later one is kept.
    fn settle(&mut self, part: &Path, row: Evaluation) -> Result<(), SessionError> {
        if self.best.is_none_or(|best| row.rate >= best.rate) {
            self.keep(part, row)?;
        } else {
            remove(part)?;
        }
        self.rows.push(row);
        self.write_table()
    }

    fn plan_of(&self, checkpoint: &Path) -> Result<Plan, SessionError> {
        let policy = PolicyChoice::Checkpoint(checkpoint.to_owned());
        Ok(Plan {
            seed: self.plan.seed,
            latency_ms: self.plan.latency_ms,
            compute: self.device.into(),
            ..Plan::load(&self.task, policy)?
        })
    }

    /// None if it was interrupted.
    fn evaluate(
        &self,
        step: u64,
        checkpoint: &Path,
        on_trial: &mut OnTrial<'_>,
    ) -> Result<Option<Score>, SessionError> {
        let TrainingEval { trials, jobs, .. } = self.plan;
        let plan = self.plan_of(checkpoint)?;
        let options = EvalOptions {
            trials,
            jobs,
            keep: None,
        };
        let (mut score, mut done) = (Score::default(), 0);
        on_trial(step, done, trials, score);
        let summary = evaluate(&plan, &options, &rt::interrupted, &mut |trial| {
            score.add(trial);
            done += 1;
            on_trial(step, done, trials, score);
        })?;
        Ok((!summary.interrupted).then(|| summary.score()))
    }

    /// Puts the checkpoint `part` in the place of the best one, with how it did.
    ///
    /// By two renames, so that at each moment the old or the new weights are whole on disk, if
    /// under another name.
    fn keep(&mut self, part: &Path, row: Evaluation) -> Result<(), SessionError> {
        let result = serde_json::json!({
            "task": self.task,
            "seed": self.plan.seed,
            "evaluation": row,
        });
        write_json(&part.join(RESULT_FILE), &result)?;
        let (best, old) = (self.out.join(BEST), self.out.join(OLD));
        remove(&old)?;
        if best.is_dir() {
            rename(&best, &old)?;
        }
        rename(part, &best)?;
        remove(&old)?;
        self.best = Some(row);
        Ok(())
    }

    /// The whole table anew each time: it is a few lines.
    fn write_table(&self) -> Result<(), SessionError> {
        let mut text = "step,trials,successes,rate,wilson95_low,wilson95_high\n".to_owned();
        for row in &self.rows {
            let Evaluation {
                step,
                trials,
                successes,
                rate,
                wilson95: [low, high],
            } = row;
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{step},{trials},{successes},{rate},{low},{high}");
        }
        let path = self.out.join(TABLE_FILE);
        fs::write(&path, text).map_err(|error| SessionError::output(&path, error))
    }

    /// All that are done.
    pub(super) fn rows(&self) -> &[Evaluation] {
        &self.rows
    }

    /// The one whose weights are kept.
    pub(super) const fn best(&self) -> Option<Evaluation> {
        self.best
    }
}

/// The task must have the arms and the cameras of the dataset.
fn check_task(task: &str, dataset: &Dataset) -> Result<(), SessionError> {
    let refuse = |reason: String| SessionError::BadArgument(format!("--eval-task: {reason}"));
    let setup = Setup::load(task, None, &PolicyChoice::Expert).map_err(|error| {
        if let SessionError::BadArgument(reason) = error {
            refuse(reason.trim_start_matches("--task: ").to_owned())
        } else {
            error
        }
    })?;
    let arms = (dataset.arms(), setup.task.arms.len());
    if arms.0 != arms.1 {
        return Err(refuse(format!(
            "task {task} has {} arms, the dataset {}",
            arms.1, arms.0
        )));
    }
    for camera in &dataset.spec().cameras {
        check_camera(task, &setup, camera).map_err(refuse)?;
    }
    Ok(())
}

/// The task must have the `camera` of the dataset, of the same size.
fn check_camera(task: &str, setup: &Setup, camera: &CameraSpec) -> Result<(), String> {
    let sizes = |(width, height)| format!("{width} by {height} pixels");
    let seen = setup.task.cameras.iter().find(|it| it.name == camera.name);
    let Some(seen) = seen.map(|camera| (camera.width, camera.height)) else {
        return Err(format!(
            "the dataset has camera {}, task {task} has {}",
            camera.name,
            setup.camera_names().join(", ")
        ));
    };
    let recorded = (camera.width, camera.height);
    if seen != recorded {
        return Err(format!(
            "camera {} of task {task} has {}, in the dataset it has {}",
            camera.name,
            sizes(seen),
            sizes(recorded)
        ));
    }
    Ok(())
}

/// How the best weights did that an interrupted training left in `out`.
fn best_in(out: &Path) -> Result<Option<Evaluation>, SessionError> {
    let (best, old) = (out.join(BEST), out.join(OLD));
    if !best.is_dir() && old.is_dir() {
        // It was cut off while they were replaced.
        rename(&old, &best)?;
    }
    best.is_dir().then(|| kept_evaluation(&best)).transpose()
}

/// How the weights in `best` did.
fn kept_evaluation(best: &Path) -> Result<Evaluation, SessionError> {
    let file = best.join(RESULT_FILE);
    let refuse = |reason: &dyn std::fmt::Display| {
        SessionError::BadArgument(format!("{}: {reason}", file.display()))
    };
    let text = fs::read_to_string(&file).map_err(|error| refuse(&error))?;
    let mut result: serde_json::Value =
        serde_json::from_str(&text).map_err(|error| refuse(&error))?;
    let evaluation: Evaluation =
        serde_json::from_value(result["evaluation"].take()).map_err(|error| refuse(&error))?;
    if (0.0..=1.0).contains(&evaluation.rate) {
        return Ok(evaluation);
    }
    Err(refuse(&format!(
        "evaluation.rate = {} is outside [0, 1]",
        evaluation.rate
    )))
}

fn rename(from: &Path, to: &Path) -> Result<(), SessionError> {
    fs::rename(from, to).map_err(|error| SessionError::output(to, error))
}

/// Removes a folder, if it is there.
fn remove(folder: &Path) -> Result<(), SessionError> {
    if !folder.is_dir() {
        return Ok(());
    }
    fs::remove_dir_all(folder).map_err(|error| SessionError::output(folder, error))
}
