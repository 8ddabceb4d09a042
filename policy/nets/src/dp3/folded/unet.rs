//! The U-Net with everything that does not depend on the noisy actions computed beforehand.

use tch::{TchError, Tensor};

use super::convolved::{Backend, Convolved};
use super::streamed::Workspace;
use crate::dp3::blocks::{ConvolutionBlock, ResidualBlock};
use crate::dp3::unet::UNet;

/// The U-Net for the timesteps of inference.
#[derive(Debug)]
pub(super) struct FoldedUNet {
    down: Vec<(Vec<FoldedBlock>, Option<Convolved>)>,
    middle: Vec<FoldedBlock>,
    up: Vec<(Vec<FoldedBlock>, Convolved)>,
    last: (FoldedConvolution, Convolved),
    modulation: Modulation,
    workspace: Workspace,
}

/// The scales and shifts of all blocks, concatenated.
#[derive(Debug)]
struct Modulation {
    /// The timesteps' part with the bias, `(timesteps, scales and shifts)`.
    of_steps: Tensor,
    /// `(features of the observations, scales and shifts)`.
    observed: Tensor,
    /// How many scales, then shifts, each block has.
    sizes: Vec<i64>,
}

/// Builds the blocks one after the other and gathers what they make of the condition.
struct Builder<'a> {
    /// Features of the timesteps after Mish, `(timesteps, features)`.
    embedded: &'a Tensor,
    backend: Backend,
    of_steps: Vec<Tensor>,
    observed: Vec<Tensor>,
    sizes: Vec<i64>,
}

/// A residual block.
#[derive(Debug)]
struct FoldedBlock {
    first: FoldedConvolution,
    second: FoldedConvolution,
    /// Which of the modulations are its scales; its shifts follow.
    place: usize,
}

/// Convolution, group normalisation, Mish.
#[derive(Debug)]
struct FoldedConvolution {
    taps: Convolved,
    norm_weight: Tensor,
    norm_bias: Tensor,
    groups: i64,
}

impl FoldedUNet {
    /// For actions of `horizon` steps.
    pub(super) fn new(
        unet: &UNet,
        timesteps: &[i64],
        horizon: i64,
        backend: Backend,
    ) -> Result<Self, TchError> {
        let timesteps = Tensor::f_from_slice(timesteps)?.f_to_device(unet.device())?;
        let mut builder = Builder {
            embedded: &unet.embed(&timesteps)?.f_mish()?,
            backend,
            of_steps: Vec::new(),
            observed: Vec::new(),
            sizes: Vec::new(),
        };
        let mut steps = horizon;
        let mut down = Vec::new();
        for level in &unet.down {
            let blocks = builder.blocks(&level.blocks, steps)?;
            let halve = match &level.halve {
                Some(halve) => {
                    let taps = Convolved::new(halve, None, steps, backend)?;
                    steps = (steps - 1) / 2 + 1;
                    Some(taps)
                }
                None => None,
            };
            down.push((blocks, halve));
        }
        let middle = builder.blocks(&unet.middle, steps)?;
        let mut up = Vec::new();
        for level in &unet.up {
            let blocks = builder.blocks(&level.blocks, steps)?;
            up.push((blocks, Convolved::doubling(&level.double, steps, backend)?));
            steps *= 2;
        }
        let (block, out) = &unet.last;
        Ok(Self {
            down,
            middle,
            up,
            last: (
                FoldedConvolution::new(block, None, steps, backend)?,
                Convolved::new(out, None, steps, backend)?,
            ),
            modulation: builder.modulation()?,
            workspace: Workspace::default(),
        })
    }

    /// Scales and shifts `(channels, 1)` of every block at every timestep for the observations'
    /// features `(1, features)`.
    pub(super) fn modulations(&self, observed: &Tensor) -> Result<Vec<Vec<Tensor>>, TchError> {
        let Modulation {
            of_steps,
            observed: weight,
            sizes,
        } = &self.modulation;
        let all = of_steps.f_add(&observed.f_mish()?.f_mm(weight)?)?;
        let steps = all.f_unsqueeze(2)?.f_unbind(0)?;
        steps
            .iter()
            .map(|step| step.f_split_with_sizes(sizes, 0))
            .collect()
    }

    /// The clean actions `(1, steps, action)` behind `noisy` ones by one timestep's
    /// [`Self::modulations`].
    pub(super) fn forward(
        &mut self,
        noisy: &Tensor,
        modulations: &[Tensor],
    ) -> Result<Tensor, TchError> {
        let workspace = &mut self.workspace;
        let mut x = noisy.f_transpose(1, 2)?.f_contiguous()?;
        let mut on_the_way = Vec::new();
        for (blocks, halve) in &mut self.down {
            x = through(blocks, x, modulations, workspace)?;
            on_the_way.push(x.shallow_clone());
            if let Some(halve) = halve {
                x = halve.apply(&x, workspace)?;
            }
        }
        x = through(&mut self.middle, x, modulations, workspace)?;
        for ((blocks, double), beside) in self.up.iter_mut().zip(on_the_way.iter().rev()) {
            let joined = Tensor::f_cat(&[&x, beside], 1)?;
            x = through(blocks, joined, modulations, workspace)?;
            x = double.apply(&x, workspace)?;
        }
        let (block, out) = &mut self.last;
        out.apply(&block.apply(&x, workspace)?, workspace)?
            .f_transpose(1, 2)
    }
}

impl Builder<'_> {
    fn blocks(
        &mut self,
        blocks: &[ResidualBlock],
        steps: i64,
    ) -> Result<Vec<FoldedBlock>, TchError> {
        blocks
            .iter()
            .map(|block| self.block(block, steps))
            .collect()
    }

    fn block(&mut self, block: &ResidualBlock, steps: i64) -> Result<FoldedBlock, TchError> {
        let [first, second] = &block.blocks;
        let weight = block.condition.weight.f_detach()?;
        let (own, all) = (self.embedded.size()[1], weight.size()[1]);
        let of_steps = weight.f_narrow(1, 0, own)?;
        let bias = block.condition.bias.f_detach()?;
        let of_steps = self.embedded.f_linear(&of_steps, Some(&bias))?;
        let channels = of_steps.size()[1] / 2;
        self.of_steps.push(of_steps);
        let observed = weight.f_narrow(1, own, all - own)?;
        self.observed.push(observed.f_transpose(0, 1)?);
        let place = self.sizes.len();
        self.sizes.extend([channels; 2]);
        Ok(FoldedBlock {
            first: FoldedConvolution::new(first, block.residual.as_ref(), steps, self.backend)?,
            second: FoldedConvolution::new(second, None, steps, self.backend)?,
            place,
        })
    }

    fn modulation(self) -> Result<Modulation, TchError> {
        Ok(Modulation {
            of_steps: Tensor::f_cat(&self.of_steps, 1)?,
            observed: Tensor::f_cat(&self.observed, 1)?.f_contiguous()?,
            sizes: self.sizes,
        })
    }
}

impl FoldedBlock {
    fn apply(
        &mut self,
        x: &Tensor,
        modulations: &[Tensor],
        workspace: &mut Workspace,
    ) -> Result<Tensor, TchError> {
        let Some([scale, shift]) = modulations.get(self.place..self.place + 2) else {
            return Err(TchError::Shape("a scale and a shift".to_owned()));
        };
        let inner = shift.f_addcmul(scale, &self.first.apply(x, workspace)?)?;
        let out = self.second.apply(&inner, workspace)?;
        self.first.taps.add_beside(out, x)
    }
}

impl FoldedConvolution {
    fn new(
        block: &ConvolutionBlock,
        beside: Option<&crate::dp3::blocks::Convolution>,
        steps: i64,
        backend: Backend,
    ) -> Result<Self, TchError> {
        Ok(Self {
            taps: Convolved::new(&block.convolution, beside, steps, backend)?,
            norm_weight: block.norm_weight.f_detach()?,
            norm_bias: block.norm_bias.f_detach()?,
            groups: block.groups,
        })
    }

    fn apply(&mut self, x: &Tensor, workspace: &mut Workspace) -> Result<Tensor, TchError> {
        let x = self.taps.apply(x, workspace)?;
        let (weight, bias) = (Some(&self.norm_weight), Some(&self.norm_bias));
        let x = x.f_group_norm(self.groups, weight, bias, 1e-5, true)?;
        self.taps.activated(x)
    }
}

/// A level's residual blocks, one after the other.
fn through(
    blocks: &mut [FoldedBlock],
    mut x: Tensor,
    modulations: &[Tensor],
    workspace: &mut Workspace,
) -> Result<Tensor, TchError> {
    for block in blocks {
        x = block.apply(&x, modulations, workspace)?;
    }
    Ok(x)
}
