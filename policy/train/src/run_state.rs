//! The state from which a training resumes, in one file.
//!
//! Every random number of a step depends on the run's seed and the step alone, so that there is no
//! generator state to keep: what is kept is the parameters with their optimiser, the moving
//! average, and the curve so far.
//!
//! A safetensors file: `step` (int64), `curve` (float64, a row of seven numbers each), `about` and
//! `run` (UTF-8 bytes), `since_row`, and the parameters' tensors under the names that `flat` gives
//! them. What it holds is checked when it is read, and its fit to the run when that resumes.

use hal::count::index;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use tch::{Device, Kind, TchError, Tensor};

use super::TrainError;
use super::curve::{CurveRow, LossCurve};
use trocar_nets::dimension::dimension;

/// Steps taken. This and the next four are the keys of what is stored beside parameters and
/// moments.
const STEP: &str = "step";
/// The rows of the loss curve.
const CURVE: &str = "curve";
/// The caller's text.
const ABOUT: &str = "about";
/// What must be the same in a run that resumes.
const RUN: &str = "run";
/// Losses of the steps since the curve's last row.
const SINCE_ROW: &str = "since_row";

/// Numbers in a row of the stored curve.
const COLUMNS: usize = 7;

/// A training that is not at its end.
#[derive(Debug)]
pub struct RunState {
    /// Steps taken.
    pub step: u64,
    /// What the caller wants to know again: how the run was begun.
    ///
    /// Empty in a state that a run gives to
    /// [`TrainingObserver::keep`](crate::TrainingObserver::keep): the caller fills it in.
    pub about: String,
    /// What must be the same in the run that goes on, as JSON.
    pub(super) run: String,
    /// The loss curve so far.
    pub(super) curve: LossCurve,
    /// Losses since the last row of the curve, `(steps, 4)`.
    pub(super) since_row: Option<Tensor>,
    /// Parameters, moments and averages by name.
    pub(super) tensors: BTreeMap<String, Tensor>,
    /// Where it was read; empty of a state that was not.
    pub(super) file: PathBuf,
}

impl RunState {
    /// Writes the state to `file`, by way of a file beside it, so that a cut-off leaves the state
    /// before it.
    ///
    /// # Errors
    /// [`TrainError::State`] naming the file.
    pub fn write(&self, file: &Path) -> Result<(), TrainError> {
        let refuse = |reason: String| TrainError::State(format!("{}: {reason}", file.display()));
        let tensors = self.all().map_err(|error| refuse(error.to_string()))?;
        let tensors: Vec<(&str, &Tensor)> = tensors
            .iter()
            .map(|(key, tensor)| (key.as_str(), tensor))
            .collect();
        let part = file.with_extension("part");
        Tensor::write_safetensors(&tensors, &part).map_err(|error| refuse(error.to_string()))?;
        fs::rename(&part, file).map_err(|error| refuse(error.to_string()))
    }

    /// Reads the state in `file`.
    ///
    /// # Errors
    /// [`TrainError::State`] naming the file and what is wrong with it.
    pub fn read(file: &Path) -> Result<Self, TrainError> {
        let refuse = |reason: String| TrainError::State(format!("{}: {reason}", file.display()));
        let tensors = Tensor::read_safetensors(file).map_err(|error| refuse(error.to_string()))?;
        let mut tensors: BTreeMap<String, Tensor> = tensors.into_iter().collect();
        let mut take = |key: &str, kind: Kind, dims: usize| {
            let tensor = tensors
                .remove(key)
                .ok_or_else(|| refuse(format!("has no {key}")))?;
            if tensor.kind() == kind && tensor.dim() == dims {
                return Ok(tensor);
            }
            Err(refuse(format!("{key} is not what it should be")))
        };
        let step = take(STEP, Kind::Int64, 1)?;
        let curve = take(CURVE, Kind::Double, 2)?;
        let (about, run) = (take(ABOUT, Kind::Uint8, 1)?, take(RUN, Kind::Uint8, 1)?);
        let text = |tensor: &Tensor| {
            let bytes = Vec::<u8>::try_from(tensor).map_err(|error| refuse(error.to_string()))?;
            String::from_utf8(bytes).map_err(|error| refuse(error.to_string()))
        };
        for (key, tensor) in &tensors {
            let finite = tensor.f_isfinite().and_then(|all| all.f_all());
            if !matches!(finite.and_then(bool::try_from), Ok(true)) {
                return Err(refuse(format!("{key} has a number that is not finite")));
            }
        }
        let step = Vec::<i64>::try_from(&step).map_err(|error| refuse(error.to_string()))?;
        let step = step.first().and_then(|&step| u64::try_from(step).ok());
        let state = Self {
            step: step.ok_or_else(|| refuse(format!("{STEP} is not what it should be")))?,
            about: text(&about)?,
            run: text(&run)?,
            curve: curve_of(&curve).map_err(|error| refuse(error.to_string()))?,
            since_row: tensors.remove(SINCE_ROW),
            tensors,
            file: file.to_owned(),
        };
        state
            .defect()
            .map_or(Ok(state), |defect| Err(refuse(defect)))
    }

    /// Why curve, steps and the losses since the curve's last row are not of one run.
    fn defect(&self) -> Option<String> {
        let mut last = 0;
        for row in &self.curve.rows {
            if row.step <= last || row.step > self.step {
                let (row, step) = (row.step, self.step);
                return Some(format!(
                    "{CURVE} has a row at step {row} after {last}, of {step}"
                ));
            }
            last = row.step;
            let numbers = [row.loss, row.l1, row.kl, row.gradient_norm, row.lr];
            if !numbers.iter().all(|number| number.is_finite()) {
                return Some(format!("{CURVE} has a number that is not finite"));
            }
        }
        let expected = [dimension(index(self.step - last)), 4];
        let found = self.since_row.as_ref().map_or(vec![0, 4], Tensor::size);
        let float = self
            .since_row
            .as_ref()
            .is_none_or(|it| it.kind() == Kind::Float);
        (found != expected || !float).then(|| {
            format!("{SINCE_ROW} has the shape {found:?}, expected {expected:?} of floats")
        })
    }

    /// The error that this state can't be resumed.
    fn refused(&self, reason: &str) -> TrainError {
        TrainError::State(format!("{}: {reason}", self.file.display()))
    }

    /// Everything as tensors by key; texts as their bytes.
    fn all(&self) -> Result<BTreeMap<String, Tensor>, TchError> {
        let mut all = BTreeMap::new();
        for (key, tensor) in &self.tensors {
            all.insert(
                key.clone(),
                tensor.f_to_device(Device::Cpu)?.f_contiguous()?,
            );
        }
        if let Some(since_row) = &self.since_row {
            all.insert(SINCE_ROW.to_owned(), since_row.f_to_device(Device::Cpu)?);
        }
        let step = dimension(index(self.step));
        all.insert(STEP.to_owned(), Tensor::f_from_slice(&[step])?);
        all.insert(CURVE.to_owned(), tensor_of(&self.curve)?);
        all.insert(
            ABOUT.to_owned(),
            Tensor::f_from_slice(self.about.as_bytes())?,
        );
        all.insert(RUN.to_owned(), Tensor::f_from_slice(self.run.as_bytes())?);
        Ok(all)
    }

    /// One that has `tensors` alone.
    #[cfg(test)]
    pub(super) fn of(tensors: BTreeMap<String, Tensor>) -> Self {
        Self {
            step: 1,
            about: String::new(),
            run: String::new(),
            curve: LossCurve::default(),
            since_row: None,
            tensors,
            file: PathBuf::new(),
        }
    }

    /// The losses so far.
    #[must_use]
    pub const fn curve(&self) -> &LossCurve {
        &self.curve
    }

    /// The tensor `key`, which must be like `like`, where that is.
    pub(super) fn tensor(&self, key: &str, like: &Tensor) -> Result<Tensor, TrainError> {
        match self.tensors.get(key) {
            Some(tensor) if tensor.size() == like.size() && tensor.kind() == like.kind() => {
                Ok(tensor.f_to_device(like.device())?)
            }
            Some(_) => Err(self.refused(&format!("{key} is of another network"))),
            None => Err(self.refused(&format!("there is no {key}"))),
        }
    }

    /// Refuses to go on as the run `run` of `steps` what was begun as another, or is at its end.
    pub(super) fn check(&self, run: &str, steps: u64) -> Result<(), TrainError> {
        if self.run == run {
            if (1..steps).contains(&self.step) {
                return Ok(());
            }
            let reason = format!("is at step {}, expected 1 to {}", self.step, steps - 1);
            return Err(self.refused(&reason));
        }
        let fields = |text: &str| {
            serde_json::from_str::<serde_json::Map<String, serde_json::Value>>(text)
                .unwrap_or_default()
        };
        let (begun, now) = (fields(&self.run), fields(run));
        let differs = now
            .iter()
            .find(|(key, value)| begun.get(*key) != Some(value));
        let what = differs.map_or("format", |(key, _)| key.as_str());
        Err(self.refused(&format!(
            "the run was begun with another {what}, and would not be the same run"
        )))
    }
}

/// The curve to the bit; what is not there is NaN.
#[expect(clippy::cast_precision_loss, reason = "steps stay far below 2^52")]
fn tensor_of(curve: &LossCurve) -> Result<Tensor, TchError> {
    let numbers: Vec<f64> = curve
        .rows
        .iter()
        .flat_map(|row| {
            let CurveRow {
                step,
                loss,
                l1,
                kl,
                gradient_norm,
                lr,
                validation_l1,
            } = *row;
            let validation_l1 = validation_l1.unwrap_or(f64::NAN);
            [step as f64, loss, l1, kl, gradient_norm, lr, validation_l1]
        })
        .collect();
    let shape = [curve.rows.len(), COLUMNS].map(dimension);
    Tensor::f_from_slice(&numbers)?.f_view(shape)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a step was stored"
)]
/// The loss curve out of its tensor `(rows, 7)`.
fn curve_of(tensor: &Tensor) -> Result<LossCurve, TchError> {
    let numbers = Vec::<f64>::try_from(&tensor.f_reshape([-1])?)?;
    let (rows, _) = numbers.as_chunks::<COLUMNS>();
    let rows = rows.iter().map(|row| {
        let [step, loss, l1, kl, gradient_norm, lr, validation_l1] = *row;
        CurveRow {
            step: step as u64,
            loss,
            l1,
            kl,
            gradient_norm,
            lr,
            validation_l1: (!validation_l1.is_nan()).then_some(validation_l1),
        }
    });
    Ok(LossCurve {
        rows: rows.collect(),
    })
}
