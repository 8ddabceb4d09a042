//! What goes on beside a training: what is said of it, how long it takes, and the state from which it can go on.

use std::fs;
use std::path::Path;

use hal::TimeNs;
use policy::train::{LossCurve, Progress, RunState, TrainError, Watch};
use serde::{Deserialize, Serialize};

use super::SessionError;
use super::training::TrainingOptions;
use crate::rt::{self, MonotonicClock};

/// The state of a training that is not at its end, in the checkpoint's folder.
pub(super) const STATE_FILE: &str = "training_state.safetensors";

/// What a state remembers for the one who resumes it.
#[derive(Debug, Serialize, Deserialize)]
struct About {
    options: TrainingOptions,
    /// Time that the training has taken, s.
    seconds: f64,
}

/// Reads the state in `folder`, the options that it was begun with, and the time that it took, s.
///
/// # Errors
/// [`SessionError::BadArgument`] if there is no such state, and if it is damaged.
pub(super) fn read_state(folder: &Path) -> Result<(RunState, TrainingOptions, f64), SessionError> {
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
        ..about.options
    };
    Ok((state, options, about.seconds))
}

/// Takes the state away once there is nothing to go on with.
pub(super) fn remove_state(folder: &Path) -> Result<(), SessionError> {
    let file = folder.join(STATE_FILE);
    if !file.is_file() {
        return Ok(());
    }
    fs::remove_file(&file).map_err(|error| SessionError::output(&file, error))
}

/// How long a training has taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stopwatch {
    clock: MonotonicClock,
    begun: TimeNs,
    /// What it took before it was stopped the last time, s.
    before: f64,
}

impl Stopwatch {
    /// One that has run for `before` seconds.
    pub(super) fn start(before: f64) -> Self {
        let clock = MonotonicClock::new();
        let begun = clock.now();
        Self {
            clock,
            begun,
            before,
        }
    }

    /// Time since the start, s.
    pub(super) fn seconds(&self) -> f64 {
        self.before + TimeNs(self.clock.now().since(self.begun)).seconds()
    }
}

/// Tells of a training, keeps its state in its folder, and stops it when the user asks for that.
pub(super) struct Watcher<'a> {
    pub(super) options: &'a TrainingOptions,
    pub(super) stopwatch: &'a Stopwatch,
    pub(super) say: &'a mut dyn FnMut(&str),
    pub(super) pace: Pace,
}

impl<'a> Watcher<'a> {
    pub(super) fn new(
        options: &'a TrainingOptions,
        stopwatch: &'a Stopwatch,
        say: &'a mut dyn FnMut(&str),
    ) -> Self {
        Self {
            options,
            stopwatch,
            say,
            pace: Pace::default(),
        }
    }
}

impl Watch for Watcher<'_> {
    fn progress(&mut self, progress: &Progress) {
        (self.say)(&self.pace.line(progress, self.stopwatch.seconds()));
    }

    fn wants_stop(&mut self) -> bool {
        rt::interrupted()
    }

    fn keep(&mut self, mut state: RunState) -> Result<(), TrainError> {
        let failed = |error: &dyn std::fmt::Display| TrainError::State(error.to_string());
        let about = About {
            options: self.options.clone(),
            seconds: self.stopwatch.seconds(),
        };
        state.about = serde_json::to_string(&about).map_err(|error| failed(&error))?;
        let out = &self.options.out;
        state.write(&out.join(STATE_FILE))?;
        write_curve(out, state.curve()).map_err(|error| failed(&error))?;
        (self.say)(&format!(
            "step {}: state kept; `trocar train --resume {}` goes on from there",
            state.step,
            out.display()
        ));
        Ok(())
    }
}

/// Says where a training stands, with the time that is left.
///
/// The pace is that of the steps since the first row of the curve: what came before it (decoding, the first steps, for
/// which an accelerator looks for its best kernels) says nothing about the rest.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pace {
    /// Step and time of the first row.
    first: Option<(u64, f64)>,
    /// The same of the newest.
    last: Option<(u64, f64)>,
}

impl Pace {
    /// Samples a second between the first row and the newest.
    #[expect(clippy::cast_precision_loss, reason = "steps stay far below 2^52")]
    pub(super) fn samples_per_second(&self, batch: usize) -> Option<f64> {
        let ((first, since), (last, until)) = (self.first?, self.last?);
        (last > first).then(|| ((last - first) * batch as u64) as f64 / (until - since))
    }

    /// The line about `progress` after `seconds`.
    pub(super) fn line(&mut self, progress: &Progress, seconds: f64) -> String {
        match *progress {
            Progress::Read { frames, of } => {
                format!("{frames} of {of} frames decoded; {seconds:.0} s")
            }
            Progress::Unseen { frames, of } => format!(
                "in {frames} of {of} frames nothing wanted is in view: their clouds lie at the origin"
            ),
            Progress::Slower { ref reason } => {
                format!("steps take longer than they could: {reason}")
            }
            Progress::Row { steps, row } => {
                let (step, since) = *self.first.get_or_insert((row.step, seconds));
                self.last = Some((row.step, seconds));
                let left = time_left(row.step - step, seconds - since, steps - row.step);
                let left = left.map_or_else(String::new, |left| format!(", {left:.0} s left"));
                let validation = row
                    .validation_l1
                    .map_or_else(String::new, |l1| format!(", validation l1 {l1:.5}"));
                format!(
                    "step {}/{steps}: loss {:.5}, l1 {:.5}, kl {:.5}, gradient {:.3}{validation}; {seconds:.0} s{left}",
                    row.step, row.loss, row.l1, row.kl, row.gradient_norm,
                )
            }
        }
    }
}

/// Time that `left` more steps take when `done` took `seconds`, s; unknown before there was one.
#[expect(clippy::cast_precision_loss, reason = "steps stay far below 2^52")]
fn time_left(done: u64, seconds: f64, left: u64) -> Option<f64> {
    (done > 0).then(|| seconds * left as f64 / done as f64)
}

/// Writes the losses as a table (`loss.csv`) and as a picture (`loss.svg`).
pub(super) fn write_curve(folder: &Path, curve: &LossCurve) -> Result<(), SessionError> {
    for (name, text) in [("loss.csv", curve.to_csv()), ("loss.svg", curve.to_svg())] {
        let path = folder.join(name);
        fs::write(&path, text).map_err(|error| SessionError::output(&path, error))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::Pace;
    use policy::train::{CurveRow, Progress};

    fn row(step: u64) -> Progress {
        let row = CurveRow {
            step,
            loss: 1.0,
            l1: 0.5,
            kl: 0.1,
            gradient_norm: 2.0,
            lr: 1e-4,
            validation_l1: None,
        };
        Progress::Row { steps: 400, row }
    }

    #[test]
    fn the_time_that_is_left_is_that_of_the_steps_and_not_of_what_came_before() {
        let mut pace = Pace::default();
        let decoded = Progress::Read { frames: 5, of: 9 };
        assert_eq!(pace.line(&decoded, 80.0), "5 of 9 frames decoded; 80 s");
        assert!(!pace.line(&row(100), 100.0).contains("left"), "unknown yet");
        assert_eq!(pace.samples_per_second(8), None);
        let line = pace.line(&row(200), 105.0);
        assert!(
            line.starts_with("step 200/400: loss 1.00000") && line.ends_with("105 s, 10 s left"),
            "{line}"
        );
        let rate = pace.samples_per_second(8).unwrap();
        assert!((rate - 160.0).abs() < 1e-9, "{rate}");
    }
}
