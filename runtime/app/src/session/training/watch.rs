//! What goes on beside a training: what is said of it, how long it takes, and the state from which
//! it can go on.

use std::path::Path;
use std::{fs, io};

use serde::{Deserialize, Serialize};
use trocar_train::{
    AnyTrained, CurveRow, LossCurve, Progress, RunState, TrainError, TrainingObserver,
};

use super::evaluations::{BEST, Evaluation, Evaluations};
use super::options::TrainingOptions;
use super::pace::Pace;
use super::progress::{OnProgress, TrainingProgress};
use super::save::Saver;
use crate::rt;
use crate::session::SessionError;
use crate::session::score::Score;
use crate::session::tensorboard::EventFile;

/// The state of a training that is not at its end, in the checkpoint's folder.
pub(super) const STATE_FILE: &str = "training_state.safetensors";

/// What a state remembers for the one who resumes it.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct About {
    /// As they were given; `out` is replaced by the folder in which the state is found, which may
    /// have been moved.
    pub(super) options: TrainingOptions,
    /// Time that the training has taken, s.
    pub(super) seconds: f64,
    /// Evaluations that are done.
    #[serde(default)]
    pub(super) evaluations: Vec<Evaluation>,
}

/// Reads the state in `folder` and what it remembers.
///
/// # Errors
/// [`SessionError::BadArgument`] if there is no such state, and if it is damaged.
pub(super) fn read_state(folder: &Path) -> Result<(RunState, About), SessionError> {
    let file = folder.join(STATE_FILE);
    let refuse = |reason: &str| {
        let reason = format!("--resume {}: {reason}", folder.display());
        SessionError::BadArgument(reason)
    };
    if !file.is_file() {
        return Err(refuse(&format!("has no {STATE_FILE} to go on from")));
    }
    let state = RunState::read(&file)?;
    let about: About = serde_json::from_str(&state.about).map_err(|error| {
        refuse(&format!(
            "{STATE_FILE} was not written by this program: {error}"
        ))
    })?;
    let options = TrainingOptions {
        out: folder.to_owned(),
        ..about.options.clone()
    };
    Ok((state, About { options, ..about }))
}

/// Takes the state away once there is nothing to go on with.
pub(super) fn remove_state(folder: &Path) -> Result<(), SessionError> {
    let file = folder.join(STATE_FILE);
    if !file.is_file() {
        return Ok(());
    }
    fs::remove_file(&file).map_err(|error| SessionError::output(&file, error))
}

/// Time between two steps that are reported, s. A report waits for the device.
const REPORT_EVERY_S: f64 = 0.5;

/// Tells of a training, here and to TensorBoard, evaluates it, keeps its state in its folder, and
/// stops it when the user asks for that.
pub(super) struct Watcher<'a> {
    /// Writes the weights that are evaluated.
    saver: &'a Saver<'a>,
    pub(super) evaluations: Option<Evaluations>,
    on_progress: &'a mut OnProgress<'a>,
    pub(super) pace: Pace,
    /// None before the first step, and after a write that failed.
    events: Option<EventFile>,
    /// When a step was reported the last time, s.
    reported_s: Option<f64>,
}

impl<'a> Watcher<'a> {
    pub(super) fn new(
        saver: &'a Saver<'a>,
        evaluations: Option<Evaluations>,
        on_progress: &'a mut OnProgress<'a>,
    ) -> Self {
        Self {
            saver,
            evaluations,
            on_progress,
            pace: Pace::new(saver.train_options.batch),
            events: None,
            reported_s: None,
        }
    }

    fn out(&self) -> &'a Path {
        &self.saver.options.out
    }

    fn note(&mut self, line: &str) {
        (self.on_progress)(&TrainingProgress::Note(line));
    }

    /// A resumed training begins a file of its own for TensorBoard, from its step on.
    fn begin(&mut self, step: u64, seconds: f64) {
        self.pace.begin(step, seconds);
        match EventFile::create(self.out(), step, rt::unix_seconds()) {
            Ok(events) => self.events = Some(events),
            Err(error) => self.no_events(&error),
        }
    }

    /// A training is worth more than its curves.
    fn no_events(&mut self, error: &io::Error) {
        self.events = None;
        let folder = self.out().display();
        let line = format!("{folder}: nothing more is written for TensorBoard: {error}");
        (self.on_progress)(&TrainingProgress::Warning(&line));
    }

    fn scalars(&mut self, step: u64, scalars: &[(&str, f64)]) {
        let Some(events) = &mut self.events else {
            return;
        };
        if let Err(error) = events.scalars(step, rt::unix_seconds(), scalars) {
            self.no_events(&error);
        }
    }

    /// Called for a row of the loss curve and for a step that was asked for; TensorBoard gets rows
    /// alone.
    fn standing(&mut self, step: (u64, u64), loss: (f64, Option<CurveRow>), seconds: f64) {
        let evaluations = self.evaluations.as_ref();
        let left = evaluations.map_or(0, |all| all.left(step.0, step.1));
        let standing = self.pace.standing(step, loss, seconds, left);
        if let Some(row) = &standing.row {
            let mut scalars = vec![
                ("train/loss", row.loss),
                ("train/l1", row.l1),
                ("train/kl", row.kl),
                ("train/gradient_norm", row.gradient_norm),
                ("train/learning_rate", row.lr),
            ];
            let rate = standing.samples_per_second;
            scalars.extend(rate.map(|rate| ("train/samples_per_second", rate)));
            scalars.extend(row.validation_l1.map(|l1| ("validation/l1", l1)));
            self.scalars(row.step, &scalars);
        }
        (self.on_progress)(&TrainingProgress::Status(&standing));
        if let Some(line) = self.pace.warning(&standing) {
            (self.on_progress)(&TrainingProgress::Warning(&line));
        }
    }

    /// Evaluates what was trained, and says how it did.
    ///
    /// Blocks the training for as long as the trials take. That time is left out of the pace.
    fn evaluate(&mut self, step: u64, trained: &AnyTrained) -> Result<(), SessionError> {
        let (saver, before) = (self.saver, self.saver.stopwatch.seconds());
        let Some(evaluations) = &mut self.evaluations else {
            return Ok(());
        };
        let save = |folder: &Path| saver.save(folder, trained);
        let row = evaluations.run(step, &save, &mut trial_progress(&mut *self.on_progress))?;
        let best = evaluations.best();
        let seconds = saver.stopwatch.seconds() - before;
        self.pace.aside(seconds);
        let Some(row) = row else {
            self.note(&format!(
                "step {step}: the evaluation was interrupted and does not count"
            ));
            return Ok(());
        };
        self.scalars(step, &[("evaluation/success_rate", row.rate)]);
        self.note_evaluation(step, row, best == Some(row), seconds);
        Ok(())
    }

    fn note_evaluation(&mut self, step: u64, row: Evaluation, is_best: bool, seconds: f64) {
        let kept = if is_best {
            format!(
                "; the best so far, kept in {}",
                self.out().join(BEST).display()
            )
        } else {
            String::new()
        };
        let [low, high] = row.wilson95;
        self.note(&format!(
            "step {step}: {} of {} trials succeeded, rate {:.2} [{low:.2}, {high:.2}], in {seconds:.0} s{kept}",
            row.successes, row.trials, row.rate
        ));
    }
}

impl TrainingObserver for Watcher<'_> {
    fn progress(&mut self, progress: &Progress) {
        let seconds = self.saver.stopwatch.seconds();
        match *progress {
            Progress::Read { frames, of } => (self.on_progress)(&TrainingProgress::Reading {
                frames,
                of,
                seconds,
            }),
            Progress::Unseen { frames, of } => self.note(&format!(
                "in {frames} of {of} frames nothing wanted is in view: their clouds lie at the origin"
            )),
            Progress::Slower { ref reason } => {
                self.note(&format!("steps take longer than they could: {reason}"));
            }
            Progress::Begin { step, .. } => self.begin(step, seconds),
            Progress::Step { step, steps, loss } => {
                self.reported_s = Some(seconds);
                self.standing((step, steps), (loss, None), seconds);
            }
            Progress::Row { steps, row } => {
                self.standing((row.step, steps), (row.loss, Some(row)), seconds);
            }
        }
    }

    fn wants_step(&mut self, _step: u64) -> bool {
        let now = self.saver.stopwatch.seconds();
        self.reported_s
            .is_none_or(|last| now - last >= REPORT_EVERY_S)
    }

    fn wants_network(&mut self, step: u64) -> bool {
        let steps = self.saver.train_options.steps;
        let evaluations = self.evaluations.as_ref();
        evaluations.is_some_and(|all| all.wants(step, steps)) && !rt::interrupted()
    }

    fn network(&mut self, step: u64, trained: AnyTrained) -> Result<(), TrainError> {
        self.evaluate(step, &trained)
            .map_err(|error| TrainError::Watch(format!("evaluation after step {step}: {error}")))
    }

    fn wants_stop(&mut self) -> bool {
        rt::interrupted()
    }

    /// Called before a stop and every so many steps: state and loss curve are written, and the
    /// state names the options, so that resuming needs the folder alone.
    fn keep(&mut self, mut state: RunState) -> Result<(), TrainError> {
        let failed = |error: &dyn std::fmt::Display| TrainError::State(error.to_string());
        let evaluations = self.evaluations.as_ref().map(Evaluations::rows);
        let about = About {
            options: self.saver.options.clone(),
            seconds: self.saver.stopwatch.seconds(),
            evaluations: evaluations.unwrap_or_default().to_vec(),
        };
        state.about = serde_json::to_string(&about).map_err(|error| failed(&error))?;
        let out = self.out();
        state.write(&out.join(STATE_FILE))?;
        write_curve(out, state.curve()).map_err(|error| failed(&error))?;
        self.note(&format!(
            "step {}: state kept; `trocar train --resume {}` goes on from there",
            state.step,
            out.display()
        ));
        Ok(())
    }
}

/// Writes the losses as a table (`loss.csv`) and as a picture (`loss.svg`).
pub(super) fn write_curve(folder: &Path, curve: &LossCurve) -> Result<(), SessionError> {
    for (name, text) in [("loss.csv", curve.to_csv()), ("loss.svg", curve.to_svg())] {
        let path = folder.join(name);
        fs::write(&path, text).map_err(|error| SessionError::output(&path, error))?;
    }
    Ok(())
}

/// Makes progress events of the trials of an evaluation.
fn trial_progress<'a>(
    on_progress: &'a mut OnProgress<'_>,
) -> impl FnMut(u64, usize, usize, Score) + 'a {
    |step, trials, of, score| {
        on_progress(&TrainingProgress::Evaluating {
            step,
            trials,
            of,
            score,
        });
    }
}
