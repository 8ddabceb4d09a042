//! The steps of a run, whatever the network: batches, optimiser, loss curve, end when the loss is
//! NaN.
//!
//! Nothing of a step is waited for: losses stay on the device until a row of the curve is due, so
//! that the host prepares the next step meanwhile. That is why a loss that is not finite is noticed
//! late, and then traced back to its step.

use std::path::PathBuf;

use tch::{Kind, TchError, Tensor};

use super::curve::{CurveRow, LossCurve};
use super::flat::{FlatParameters, ManualBackward, Rates};
use super::frame_order::FrameOrder;
use super::launch::Launch;
use super::options::TrainOptions;
use super::run_state::RunState;
use super::{AnyTrained, Progress, TrainError, TrainingObserver};
use hal::random::SplitMix64;
use trocar_nets::generator;

/// A network in training, with the data that it learns from.
pub(super) trait Learner {
    /// The frames of the step after the next one, to be prefetched.
    fn announce(&self, _frames: &[usize]) {}

    /// All that a step depends on but the weights and the network library's random numbers, where
    /// the network is; of one form at every step.
    fn inputs(&self, frames: &[usize], random: &mut SplitMix64) -> Result<Vec<Tensor>, TchError>;

    /// The loss over the frames of `inputs`, and its two parts for the curve: error of the actions,
    /// divergence.
    ///
    /// It launches the same kernels at every step and reads nothing back: a CUDA graph may capture
    /// it.
    fn losses(&self, inputs: &[Tensor]) -> Result<Losses<'_>, TchError>;

    /// Mean absolute error of the normalised actions over `frames`, as inference sees them.
    fn error(&self, frames: &[usize]) -> Result<f64, TchError>;
}

/// What a step minimises, and its parts.
pub(super) struct Losses<'a> {
    /// The loss, a scalar.
    pub(super) total: Tensor,
    /// Error of the actions.
    pub(super) l1: Tensor,
    /// Divergence of the latent from the prior.
    pub(super) kl: Tensor,
    /// The backward pass below what the library differentiates; none if that is all.
    pub(super) below: Option<ManualBackward<'a>>,
}

impl Losses<'_> {
    /// The loss, its parts and the `norm` of its gradient, as [`TERMS`] has them.
    fn with(&self, norm: &Tensor) -> Result<Tensor, TchError> {
        let [total, l1, kl] = [&self.total, &self.l1, &self.kl].map(Tensor::f_detach);
        Tensor::f_stack(&[total?, l1?, kl?, norm.shallow_clone()], 0)
    }
}

/// The frames trained on, and those held out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Split<'a> {
    /// Frames that are drawn from.
    pub(super) trained: &'a [usize],
    /// Frames of the held-out episodes, for the validation error.
    pub(super) held_out: &'a [usize],
}

/// What the columns of the losses since the last row are, in the order in which the first is looked
/// for that went wrong.
const TERMS: [(usize, &str); 4] = [(1, "l1"), (2, "kl"), (0, "loss"), (3, "gradient")];

/// A run on its way through the steps.
pub(super) struct Steps<'a> {
    /// What computes the loss.
    pub(super) learner: &'a dyn Learner,
    /// Rates, lengths and the seed.
    pub(super) options: &'a TrainOptions,
    /// The frames.
    pub(super) split: Split<'a>,
    /// What must be the same when the run goes on another time, as JSON.
    pub(super) run: String,
    /// What the run would come to if it ended now.
    pub(super) so_far: &'a SoFar<'a>,
}

/// The outcome of a run with these parameters and this curve.
type SoFar<'a> = dyn Fn(&FlatParameters, LossCurve) -> Result<AnyTrained, TrainError> + 'a;

impl Steps<'_> {
    /// Takes the steps that are left, all of them or those after `from`'s; `watch` gets every row
    /// of the loss curve and keeps the state.
    pub(super) fn take(
        &self,
        flat: &mut FlatParameters,
        from: Option<&RunState>,
        watch: &mut dyn TrainingObserver,
    ) -> Result<LossCurve, TrainError> {
        let options = self.options;
        let mut order = FrameOrder::new(self.split.trained, options.seed);
        let mut curve = LossCurve::default();
        let mut since_row = Vec::new();
        let mut first = 0;
        if let Some(state) = from {
            state.check(&self.run, options.steps)?;
            flat.resume(state)?;
            curve.rows.clone_from(&state.curve.rows);
            since_row = rows_of(state.since_row.as_ref(), flat)?;
            first = state.step;
        }
        let steps = options.steps;
        watch.progress(&Progress::Begin { step: first, steps });
        if first > 0 {
            self.offer(first, flat, (&curve, &since_row), watch)?;
        }
        let mut next = order.of_step(first, options.batch);
        let mut launch = Launch::new(options, flat.device(), watch)?;
        for step in first..options.steps {
            let frames = next;
            next = order.of_step(step + 1, options.batch);
            self.learner.announce(&next);
            // Not waited for.
            since_row.push(self.step(step, &frames, flat, (&mut launch, &mut *watch))?);
            let done = step + 1;
            if let Some(last) = since_row.last()
                && watch.wants_step(done)
            {
                let (step, loss) = (done, last.f_double_value(&[0])?);
                watch.progress(&Progress::Step { step, steps, loss });
            }
            if done.is_multiple_of(options.log_every) || done == options.steps {
                let row = self.row(done, &since_row)?;
                since_row.clear();
                curve.rows.push(row);
                watch.progress(&Progress::Row { steps, row });
            }
            self.offer(done, flat, (&curve, &since_row), watch)?;
            if done == options.steps {
                break;
            }
            let stop = watch.wants_stop();
            if stop || (options.save_every > 0 && done.is_multiple_of(options.save_every)) {
                check_finite(done, &since_row)?;
                let state = self.state(done, flat, &curve, &since_row)?;
                watch.keep(state)?;
            }
            if stop {
                return Err(TrainError::Stopped { step: done });
            }
        }
        Ok(curve)
    }

    /// Passes the outcome after `done` steps to `watch`, if it wants that.
    fn offer(
        &self,
        done: u64,
        flat: &FlatParameters,
        (curve, since_row): (&LossCurve, &[Tensor]),
        watch: &mut dyn TrainingObserver,
    ) -> Result<(), TrainError> {
        if !watch.wants_network(done) {
            return Ok(());
        }
        check_finite(done, since_row)?;
        watch.network(done, (self.so_far)(flat, curve.clone())?)
    }

    /// One step: the loss, its parts and the norm of the gradient, on the device.
    ///
    /// Its random numbers depend on the seed and the step alone. On the CPU operations run one by
    /// one; on CUDA the whole step, optimiser included, is one unit of work that [`Launch`] may
    /// capture.
    fn step(
        &self,
        step: u64,
        frames: &[usize],
        flat: &mut FlatParameters,
        (launch, watch): (&mut Launch, &mut dyn TrainingObserver),
    ) -> Result<Tensor, TrainError> {
        let options = self.options;
        let mut random = SplitMix64::named(&format!("train/step/{step}"), options.seed);
        let seed = random.next_u64();
        let mut inputs = self.learner.inputs(frames, &mut random)?;
        let factor = options.lr_factor(step);
        let lr = [options.lr_backbone * factor, options.lr * factor];
        let rates = Rates::of(step + 1, lr, options);
        if !flat.device().is_cuda() {
            let losses = {
                let _drawing = generator::seeded(seed);
                self.learner.losses(&inputs)?
            };
            let norm = flat.step(&losses.total, rates, options)?;
            return Ok(losses.with(&norm)?);
        }
        inputs.push(rates.sent(flat.device())?);
        let _drawing = generator::seeded(seed);
        let mut work = |inputs: &[Tensor]| {
            let Some((rates, inputs)) = inputs.split_last() else {
                return Err(TchError::Shape("no inputs".to_owned()));
            };
            let mut losses = self.learner.losses(inputs)?;
            let below = losses.below.take();
            let norm = flat.fused_step(&losses.total, below, rates, options)?;
            losses.with(&norm)
        };
        launch.step(&inputs, &mut work, watch)
    }

    /// The row of the curve after `done` steps: the means of what was lost `since_row`.
    fn row(&self, done: u64, since_row: &[Tensor]) -> Result<CurveRow, TrainError> {
        let all = Tensor::f_stack(since_row, 0)?;
        let means = all.f_mean_dim([0].as_slice(), false, Kind::Double)?;
        let means = Vec::<f64>::try_from(&means)?;
        let [loss, l1, kl, gradient_norm] = [means[0], means[1], means[2], means[3]];
        if !means.iter().all(|mean| mean.is_finite()) {
            return Err(diverged(done, &all)?);
        }
        let factor = self.options.lr_factor(done.saturating_sub(1));
        Ok(CurveRow {
            step: done,
            loss,
            l1,
            kl,
            gradient_norm,
            lr: self.options.lr * factor,
            validation_l1: validate(self.learner, self.split.held_out, self.options.batch)?,
        })
    }

    /// What the run is at after `step` steps, to be written and gone on from.
    fn state(
        &self,
        step: u64,
        flat: &FlatParameters,
        curve: &LossCurve,
        since_row: &[Tensor],
    ) -> Result<RunState, TrainError> {
        Ok(RunState {
            step,
            about: String::new(),
            run: self.run.clone(),
            curve: curve.clone(),
            since_row: if since_row.is_empty() {
                None
            } else {
                Some(Tensor::f_stack(since_row, 0)?)
            },
            tensors: flat.state()?,
            file: PathBuf::new(),
        })
    }
}

/// The losses since the last row, as they were kept, where the run computes.
fn rows_of(kept: Option<&Tensor>, flat: &FlatParameters) -> Result<Vec<Tensor>, TchError> {
    kept.map_or(Ok(Vec::new()), |kept| {
        kept.f_to_device(flat.device())?.f_unbind(0)
    })
}

/// A state that can't be resumed must not replace a good one.
fn check_finite(done: u64, since_row: &[Tensor]) -> Result<(), TrainError> {
    if since_row.is_empty() {
        return Ok(());
    }
    let all = Tensor::f_stack(since_row, 0)?;
    match bool::try_from(all.f_isfinite()?.f_all()?)? {
        true => Ok(()),
        false => Err(diverged(done, &all)?),
    }
}

/// Which step and which term was the first that is not finite, among `all` `(steps, 4)` up to step
/// `done`.
fn diverged(done: u64, all: &Tensor) -> Result<TrainError, TchError> {
    let rows = Vec::<f64>::try_from(&all.f_to_kind(Kind::Double)?.f_reshape([-1])?)?;
    let (rows, _) = rows.as_chunks::<4>();
    let before = done - rows.len() as u64;
    for (step, row) in (before + 1..).zip(rows) {
        for (column, term) in TERMS {
            let value = row[column];
            if !value.is_finite() {
                return Ok(TrainError::Diverged { step, term, value });
            }
        }
    }
    // Finite numbers whose sum is not.
    let (term, value) = ("loss", f64::INFINITY);
    Ok(TrainError::Diverged {
        step: done,
        term,
        value,
    })
}

/// Mean absolute error of held-out frames, normalised; none without such frames. At most 256
/// frames, evenly spread, by the weights as they are.
fn validate(
    learner: &dyn Learner,
    held_out: &[usize],
    batch: usize,
) -> Result<Option<f64>, TchError> {
    if held_out.is_empty() {
        return Ok(None);
    }
    let stride = held_out.len().div_ceil(256);
    let frames: Vec<usize> = held_out.iter().copied().step_by(stride).collect();
    tch::no_grad(|| {
        let (mut sum, mut parts) = (0.0, 0.0);
        for frames in frames.chunks(batch) {
            sum += learner.error(frames)?;
            parts += 1.0;
        }
        Ok(Some(sum / parts))
    })
}

#[cfg(test)]
mod tests {
    use super::{FlatParameters, Learner, Losses, Split, Steps};
    use crate::{Progress, RunState, TrainError, TrainOptions, TrainingObserver};
    use hal::random::SplitMix64;
    use std::cell::Cell;
    use tch::{Device, Kind, TchError, Tensor};
    use trocar_nets::act::ActPreset;
    use trocar_nets::parameters::{Init, ParameterSource};

    /// Pulls one number to zero; in one step, one of its terms is `planted`.
    struct Planted {
        number: Tensor,
        at: u64,
        term: &'static str,
        planted: f64,
        step: Cell<u64>,
    }

    impl Learner for Planted {
        fn inputs(&self, _: &[usize], _: &mut SplitMix64) -> Result<Vec<Tensor>, TchError> {
            Ok(Vec::new())
        }

        fn losses(&self, _inputs: &[Tensor]) -> Result<Losses<'_>, TchError> {
            self.step.set(self.step.get() + 1);
            let pick = |term, good: &Tensor| {
                if term == self.term && self.step.get() == self.at {
                    good.f_full_like(self.planted)
                } else {
                    Ok(good.shallow_clone())
                }
            };
            let total = self.number.f_square()?.f_sum(Kind::Float)?;
            Ok(Losses {
                l1: pick("l1", &total.f_detach()?)?,
                kl: pick("kl", &total.f_detach()?)?,
                total,
                below: None,
            })
        }

        fn error(&self, _frames: &[usize]) -> Result<f64, TchError> {
            Ok(0.0)
        }
    }

    /// Remembers after which steps the state was kept.
    #[derive(Default)]
    struct Kept(Vec<u64>);

    impl TrainingObserver for Kept {
        fn progress(&mut self, _progress: &Progress) {}

        fn keep(&mut self, state: RunState) -> Result<(), TrainError> {
            self.0.push(state.step);
            Ok(())
        }
    }

    fn run(term: &'static str, planted: f64) -> Result<(), TrainError> {
        kept_by(term, planted, 0).1
    }

    /// The steps after which the state was kept, one in `save_every`, and how the run ended.
    fn kept_by(
        term: &'static str,
        planted: f64,
        save_every: u64,
    ) -> (Vec<u64>, Result<(), TrainError>) {
        let mut source = ParameterSource::seeded(2, Device::Cpu);
        let start = Init::Constant(1.0);
        let _ = source.trainable("number", &[1], &start).unwrap();
        let parameters = source.finish().unwrap();
        let options = TrainOptions {
            steps: 10,
            log_every: 5,
            save_every,
            ..TrainOptions::preset(ActPreset::Small)
        };
        let mut flat = FlatParameters::new(&parameters, Device::Cpu, &options).unwrap();
        let number = flat.working_tensors()["number"].shallow_clone();
        let learner = Planted {
            number,
            at: 8,
            term,
            planted,
            step: Cell::new(0),
        };
        let steps = Steps {
            learner: &learner,
            options: &options,
            split: Split {
                trained: &[0],
                held_out: &[],
            },
            run: String::new(),
            so_far: &|_, _| Err(TrainError::Empty),
        };
        let mut kept = Kept::default();
        let end = steps.take(&mut flat, None, &mut kept).map(drop);
        (kept.0, end)
    }

    #[test]
    fn a_state_from_which_nobody_could_go_on_is_not_kept() {
        let (kept, end) = kept_by("none of them", 0.0, 3);
        assert!(end.is_ok());
        assert_eq!(kept, [3, 6, 9]);
        let (kept, end) = kept_by("l1", f64::NAN, 3);
        let diverged = matches!(end, Err(TrainError::Diverged { step: 8, .. }));
        assert!(diverged && kept == [3, 6], "{end:?}, {kept:?}");
    }

    #[test]
    fn the_first_number_that_is_none_is_named_with_its_step() {
        assert!(run("none of them", f64::NAN).is_ok());
        for (term, planted) in [("l1", f64::NAN), ("kl", f64::NEG_INFINITY)] {
            let error = run(term, planted).unwrap_err();
            assert!(
                matches!(&error, TrainError::Diverged { step: 8, term: found, .. } if *found == term),
                "{error}"
            );
            let said = format!("the {term} is {planted} at step 8");
            assert!(error.to_string().starts_with(&said), "{error}");
        }
    }
}
