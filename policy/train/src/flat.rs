//! All trained parameters in one long tensor, with AdamW, clipping and the moving average over it.
//!
//! The network holds views of the long tensor, so one step is a dozen operations whatever the
//! number of layers, and fewer on an accelerator.
//!
//! The way of a step: gradients of the leaves are gathered into one tensor, its norm is clipped,
//! AdamW moves the master copy (the backbone's part at a rate of its own), the working copy is
//! rounded from it, and the moving average follows. Two implementations give the same up to
//! rounding: one in single operations, for the CPU, and one by the library's fused kernels, which a
//! CUDA graph can capture.

use std::collections::BTreeMap;

use tch::{Device, Kind, TchError, Tensor};

use super::TrainError;
use super::options::{TrainOptions, TrainPrecision};
use super::run_state::RunState;
use super::transfer::send;
use trocar_nets::act::BACKBONE_PREFIX;
use trocar_nets::by_name::{AdamW, Moved, copy_all};
use trocar_nets::dp3::MovingAverage;
use trocar_nets::parameters::Parameters;

/// Decay of the second moment, as in the paper.
const BETA_2: f64 = 0.999;
/// Added to the root of the second moment.
const EPS: f64 = 1e-8;

/// On an accelerator every parameter begins at a multiple of so many elements: kernels read 16
/// bytes at once, or are slow.
const ALIGNED: i64 = 64;

/// A part of the network outside autograd, with its own backward pass.
pub(super) struct ManualBackward<'a> {
    /// What it gave to the rest.
    pub(super) gave: Tensor,
    /// Its parameters with their gradients, given that of what it gave.
    pub(super) back: BackwardFn<'a>,
}

/// Runs once, after the gradient of what the part gave is known.
pub(super) type BackwardFn<'a> =
    Box<dyn FnOnce(&Tensor) -> Result<Vec<(Tensor, Tensor)>, TchError> + 'a>;

/// What of an update is another one at every step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rates {
    /// Steps with this one.
    steps: u32,
    /// Learning rates of the backbone and of the rest.
    lr: [f64; 2],
    /// How much of the moving average stays.
    average: f64,
}

impl Rates {
    /// Numbers of [`Self::sent`].
    const NUMBERS: usize = 4;

    /// Those of step `steps`, from 1, with the learning rates `lr` of the backbone and of the rest.
    pub(super) fn of(steps: u64, lr: [f64; 2], options: &TrainOptions) -> Self {
        let steps = u32::try_from(steps).unwrap_or(u32::MAX);
        let exponent = f64::from(steps);
        // Young averages must not remember the initial weights.
        let young = if options.ema_power > 0.0 {
            MovingAverage::decay_with(u64::from(steps) - 1, options.ema_power)
        } else {
            (1.0 + exponent) / (10.0 + exponent)
        };
        Self {
            steps,
            lr,
            average: options.ema_decay.min(young),
        }
    }

    /// The same on `device`, for [`FlatParameters::fused_step`].
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the optimiser computes in single precision"
    )]
    pub(super) fn sent(self, device: Device) -> Result<Tensor, TchError> {
        let numbers: [f64; Self::NUMBERS] = [
            self.lr[0],
            self.lr[1],
            f64::from(self.steps),
            1.0 - self.average,
        ];
        send(
            &Tensor::f_from_slice(&numbers.map(|number| number as f32))?,
            device,
        )
    }
}

/// The trained parameters and the state of their optimiser.
#[derive(Debug)]
pub(super) struct FlatParameters {
    /// Master parameters, single precision.
    master: Tensor,
    /// What the network computes with: the master itself, or its copy in half precision.
    working: Tensor,
    /// Views of `working` with a gradient, one for each of `keys`.
    leaves: Vec<Tensor>,
    /// Where each leaf begins; what is between them is zero. In elements, in the order of `keys`.
    starts: Vec<i64>,
    /// Keys of the trained parameters: the backbone's, then the others', each part in alphabetical
    /// order.
    keys: Vec<String>,
    /// Elements of the backbone; they come first.
    backbone_length: i64,
    /// In single precision, for an accelerator.
    gradient: Option<Tensor>,
    /// Moving mean of the gradient, as long as `master`.
    first_moment: Tensor,
    /// Moving mean of its square.
    second_moment: Tensor,
    /// Moving average of `master`; none if its decay is 0.
    average: Option<Tensor>,
    /// What the optimiser leaves alone, in single precision: tables, and statistics that move with
    /// what is seen.
    fixed: BTreeMap<String, Tensor>,
}

impl FlatParameters {
    /// Copies the trained ones of `parameters` to `device`.
    pub(super) fn new(
        parameters: &Parameters,
        device: Device,
        options: &TrainOptions,
    ) -> Result<Self, TchError> {
        let aligned = if device.is_cuda() { ALIGNED } else { 1 };
        Self::laid(parameters, (device, aligned), options)
    }

    /// The same, each beginning at a multiple of `aligned` elements.
    fn laid(
        parameters: &Parameters,
        (device, aligned): (Device, i64),
        options: &TrainOptions,
    ) -> Result<Self, TchError> {
        let (backbone, rest): (Vec<_>, Vec<_>) = parameters
            .iter()
            .filter(|(key, _)| parameters.is_trainable(key))
            .partition(|(key, _)| key.starts_with(BACKBONE_PREFIX));
        let (mut flats, mut starts, mut length) = (Vec::new(), Vec::new(), 0);
        let mut backbone_length = 0;
        for (index, (_, tensor)) in backbone.iter().chain(&rest).enumerate() {
            let flat = flatten(tensor)?.f_to_device(device)?;
            let between = (-flat.size()[0]).rem_euclid(aligned);
            starts.push(length);
            length += flat.size()[0] + between;
            flats.push(flat);
            if between > 0 {
                flats.push(Tensor::f_zeros([between], (Kind::Float, device))?);
            }
            if index < backbone.len() {
                backbone_length = length;
            }
        }
        let master = Tensor::f_cat(&flats, 0)?;
        let working = match options.precision {
            TrainPrecision::F32 => master.shallow_clone(),
            TrainPrecision::Bf16 => master.f_to_kind(Kind::BFloat16)?,
        };
        let mut flat = Self {
            first_moment: master.f_zeros_like()?,
            second_moment: master.f_zeros_like()?,
            average: if options.ema_decay > 0.0 {
                Some(master.f_add_scalar(0.0)?)
            } else {
                None
            },
            gradient: None,
            backbone_length,
            keys: backbone
                .iter()
                .chain(&rest)
                .map(|(key, _)| (*key).to_owned())
                .collect(),
            leaves: Vec::new(),
            starts,
            master,
            working,
            fixed: BTreeMap::new(),
        };
        for (key, tensor) in parameters.iter() {
            if !parameters.is_trainable(key) {
                let own = tensor.f_to_device(device)?.f_detach_copy()?;
                flat.fixed.insert(key.to_owned(), own);
            }
        }
        for ((_, tensor), &start) in backbone.iter().chain(&rest).zip(&flat.starts) {
            let view = unflatten(&flat.working, start, &tensor.size())?;
            flat.leaves
                .push(view.f_detach()?.f_set_requires_grad(true)?);
        }
        Ok(flat)
    }

    /// The tensors that the network should be built from; they share their memory with these. Those
    /// that the optimiser leaves alone are in single precision whatever the others are.
    pub(super) fn working_tensors(&self) -> BTreeMap<String, Tensor> {
        let trained = self.keys.iter().zip(&self.leaves);
        let all = self.fixed.iter().chain(trained);
        all.map(|(key, tensor)| (key.clone(), tensor.shallow_clone()))
            .collect()
    }

    /// Where it all is.
    pub(super) fn device(&self) -> Device {
        self.master.device()
    }

    /// Copies of everything that a run needs to go on, by name.
    ///
    /// Paddings between leaves are left out, so a state written on one device can be read on
    /// another.
    pub(super) fn state(&self) -> Result<BTreeMap<String, Tensor>, TchError> {
        let mut state = BTreeMap::new();
        for (name, tensor, is_flat) in self.named() {
            let own = if is_flat {
                Tensor::f_cat(&self.parts(tensor)?, 0)?
            } else {
                tensor.f_detach_copy()?
            };
            state.insert(name, own.f_to_device(Device::Cpu)?);
        }
        Ok(state)
    }

    /// Goes on from the state that [`Self::state`] of a like run was.
    pub(super) fn resume(&mut self, state: &RunState) -> Result<(), TrainError> {
        tch::no_grad(|| {
            for (name, tensor, is_flat) in self.named() {
                // The copies share their memory with the network's tensors.
                if is_flat {
                    let parts = self.parts(tensor)?;
                    let kept = state.tensor(&name, &Tensor::f_cat(&parts, 0)?)?;
                    let lengths: Vec<i64> = parts.iter().map(|part| part.size()[0]).collect();
                    for (mut part, kept) in parts.into_iter().zip(kept.f_split_sizes(lengths, 0)?) {
                        part.f_copy_(&kept)?;
                    }
                } else {
                    let kept = state.tensor(&name, tensor)?;
                    tensor.shallow_clone().f_copy_(&kept)?;
                }
            }
            self.round()?;
            Ok::<(), TrainError>(())
        })
    }

    /// The leaves' parts of `flat`, each as long as its leaf.
    fn parts(&self, flat: &Tensor) -> Result<Vec<Tensor>, TchError> {
        let leaves = self.leaves.iter().zip(&self.starts);
        leaves
            .map(|(leaf, &start)| {
                let length = leaf.size().iter().product::<i64>();
                flat.f_narrow(0, start, length)
            })
            .collect()
    }

    /// The name in a run's state of the parameter `key` that the optimiser leaves alone.
    pub(super) fn name_of_fixed(key: &str) -> String {
        format!("fixed.{key}")
    }

    /// What a run's state is made of, and whether it is of the leaves, one after another.
    fn named(&self) -> Vec<(String, &Tensor, bool)> {
        let mut named = vec![
            ("master".to_owned(), &self.master, true),
            ("first_moment".to_owned(), &self.first_moment, true),
            ("second_moment".to_owned(), &self.second_moment, true),
        ];
        if let Some(average) = &self.average {
            named.push(("average".to_owned(), average, true));
        }
        for (key, tensor) in &self.fixed {
            named.push((Self::name_of_fixed(key), tensor, false));
        }
        named
    }

    /// Copies of the averaged (or last) parameters in single precision, with what the optimiser
    /// left alone.
    pub(super) fn averaged_tensors(&self) -> Result<BTreeMap<String, Tensor>, TchError> {
        let source = self.average.as_ref().unwrap_or(&self.master);
        let mut tensors = BTreeMap::new();
        for (key, tensor) in &self.fixed {
            tensors.insert(key.clone(), tensor.f_detach_copy()?);
        }
        let parts = self.parts(source)?;
        for ((key, leaf), part) in self.keys.iter().zip(&self.leaves).zip(parts) {
            // A copy of its own lies in memory as a loaded one does, so that kernels round the same
            // way.
            let own = part.f_add_scalar(0.0)?;
            tensors.insert(key.clone(), unflatten(&own, 0, &leaf.size())?);
        }
        Ok(tensors)
    }

    /// One step of AdamW down the gradient of `loss`. Returns the norm of the gradient before
    /// clipping, still on the device.
    pub(super) fn step(
        &mut self,
        loss: &Tensor,
        rates: Rates,
        options: &TrainOptions,
    ) -> Result<Tensor, TchError> {
        let gradients = Tensor::f_run_backward(&[loss], &self.leaves, false, false)?;
        tch::no_grad(|| {
            let gradient = self.joined(&gradients)?;
            let norm = clip(&gradient, options)?;
            self.adam_w(&gradient, rates, options)?;
            Ok(norm)
        })
    }

    /// The gradients of the leaves, with those of the backbone from what knows them.
    fn gradients_with(
        &self,
        loss: &Tensor,
        below: ManualBackward<'_>,
    ) -> Result<Vec<Tensor>, TchError> {
        let known = self
            .keys
            .iter()
            .position(|key| !key.starts_with(BACKBONE_PREFIX));
        let (backbone, rest) = self.leaves.split_at(known.unwrap_or(self.leaves.len()));
        let above: Vec<&Tensor> = rest.iter().chain([&below.gave]).collect();
        let mut gradients = Tensor::f_run_backward(&[loss], &above, false, false)?;
        let Some(of_given) = gradients.pop() else {
            return Err(TchError::Torch("no gradients".to_owned()));
        };
        let found = (below.back)(&of_given)?;
        let of = |leaf: &Tensor| {
            let same = |(parameter, _): &&(Tensor, Tensor)| parameter.data_ptr() == leaf.data_ptr();
            let found = found.iter().find(same);
            found.map_or_else(Tensor::new, |(_, gradient)| gradient.shallow_clone())
        };
        Ok(backbone.iter().map(of).chain(gradients).collect())
    }

    /// The same in fewer operations, all of them the same at every step: the `rates` are those that
    /// were [`Rates::sent`].
    pub(super) fn fused_step(
        &mut self,
        loss: &Tensor,
        below: Option<ManualBackward<'_>>,
        rates: &Tensor,
        options: &TrainOptions,
    ) -> Result<Tensor, TchError> {
        let gradients = match below {
            None => Tensor::f_run_backward(&[loss], &self.leaves, false, false)?,
            Some(below) => self.gradients_with(loss, below)?,
        };
        tch::no_grad(|| {
            let gradient = self.gathered(&gradients)?;
            let norm = clip(&gradient, options)?;
            self.fused_adam_w(&gradient, rates, options)?;
            Ok(norm)
        })
    }

    /// The gradients as one in single precision, where nothing is between them.
    fn joined(&self, gradients: &[Tensor]) -> Result<Tensor, TchError> {
        let mut flats = Vec::with_capacity(gradients.len());
        for (gradient, leaf) in gradients.iter().zip(&self.leaves) {
            flats.push(if gradient.defined() {
                flatten(gradient)?
            } else {
                flatten(&leaf.f_zeros_like()?)?
            });
        }
        Tensor::f_cat(&flats, 0)?.f_to_kind(Kind::Float)
    }

    /// The same in one piece of work, in memory of its own.
    fn gathered(&mut self, gradients: &[Tensor]) -> Result<Tensor, TchError> {
        let all = match &self.gradient {
            Some(all) => all.shallow_clone(),
            None => self.master.f_zeros_like()?,
        };
        let (mut from, mut to) = (Vec::new(), Vec::new());
        for (gradient, part) in gradients.iter().zip(self.parts(&all)?) {
            // Parameters that the loss does not depend on keep a zero gradient.
            if gradient.defined() {
                from.push(flatten(gradient)?);
                to.push(part);
            }
        }
        copy_all(&to, &from)?;
        self.gradient = Some(all.shallow_clone());
        Ok(all)
    }

    /// Loshchilov and Hutter 2019, algorithm 2.
    fn adam_w(
        &mut self,
        gradient: &Tensor,
        rates: Rates,
        options: &TrainOptions,
    ) -> Result<(), TchError> {
        let exponent = f64::from(rates.steps);
        let (bias_1, bias_2) = (
            1.0 - options.beta_1.powf(exponent),
            1.0 - BETA_2.powf(exponent),
        );
        let _ = self.first_moment.f_lerp_(gradient, 1.0 - options.beta_1)?;
        let _ = self
            .second_moment
            .f_lerp_(&gradient.f_square()?, 1.0 - BETA_2)?;
        let root = self
            .second_moment
            .f_div_scalar(bias_2)?
            .f_sqrt()?
            .f_add_scalar(EPS)?;
        let update = self.first_moment.f_div(&root)?.f_div_scalar(bias_1)?;
        for ((start, length), lr) in self.groups().into_iter().zip(rates.lr) {
            let mut part = self.master.f_narrow(0, start, length)?;
            let _ = part.f_mul_scalar_(1.0 - lr * options.weight_decay)?;
            let _ = part.f_sub_(&update.f_narrow(0, start, length)?.f_mul_scalar(lr)?)?;
        }
        self.round()?;
        if let Some(average) = &mut self.average {
            let _ = average.f_lerp_(&self.master, 1.0 - rates.average)?;
        }
        Ok(())
    }

    /// The same by the library's own.
    fn fused_adam_w(
        &mut self,
        gradient: &Tensor,
        rates: &Tensor,
        options: &TrainOptions,
    ) -> Result<(), TchError> {
        let adam_w = AdamW {
            beta_1: options.beta_1,
            beta_2: BETA_2,
            weight_decay: options.weight_decay,
            eps: EPS,
        };
        let step = rates.f_select(0, 2)?;
        for (group, (start, length)) in (0..).zip(self.groups()) {
            let moved = Moved {
                parameters: &self.master.f_narrow(0, start, length)?,
                gradient: &gradient.f_narrow(0, start, length)?,
                first_moment: &self.first_moment.f_narrow(0, start, length)?,
                second_moment: &self.second_moment.f_narrow(0, start, length)?,
            };
            if length > 0 {
                adam_w.step(&moved, &step, &rates.f_select(0, group)?)?;
            }
        }
        self.round()?;
        if let Some(average) = &mut self.average {
            let _ = average.f_lerp_tensor_(&self.master, &rates.f_select(0, 3)?)?;
        }
        Ok(())
    }

    /// Start and length of what has a learning rate of its own: the backbone, and the rest.
    fn groups(&self) -> [(i64, i64); 2] {
        let total = self.master.size()[0];
        [
            (0, self.backbone_length),
            (self.backbone_length, total - self.backbone_length),
        ]
    }

    /// Copies the master parameters into the working ones, in their precision.
    fn round(&mut self) -> Result<(), TchError> {
        if self.working.kind() == self.master.kind() {
            return Ok(());
        }
        self.working.f_copy_(&self.master)
    }
}

/// Clips `gradient` to the options' norm; returns its norm before.
///
/// `g * min(1, clip / (norm + 1e-6))`, as PyTorch has it; nothing is read back from the device.
fn clip(gradient: &Tensor, options: &TrainOptions) -> Result<Tensor, TchError> {
    let norm = gradient.f_norm()?;
    if options.clip_norm.is_finite() {
        let shrink = norm
            .f_add_scalar(1e-6)?
            .f_reciprocal()?
            .f_mul_scalar(options.clip_norm)?;
        let _ = gradient.shallow_clone().f_mul_(&shrink.f_clamp_max(1.0)?)?;
    }
    Ok(norm)
}

/// Filters are stored with their channels last, which is what convolutions like best.
fn flatten(tensor: &Tensor) -> Result<Tensor, TchError> {
    if tensor.dim() == 4 {
        tensor.f_permute([0, 2, 3, 1])?.f_reshape([-1])
    } else {
        tensor.f_reshape([-1])
    }
}

/// The parameter of this shape from the place `start` of all.
fn unflatten(flat: &Tensor, start: i64, shape: &[i64]) -> Result<Tensor, TchError> {
    let part = flat.f_narrow(0, start, shape.iter().product())?;
    if let &[outputs, inputs, high, wide] = shape {
        part.f_view([outputs, high, wide, inputs])?
            .f_permute([0, 3, 1, 2])
    } else {
        part.f_view(shape)
    }
}

#[cfg(test)]
mod tests;
