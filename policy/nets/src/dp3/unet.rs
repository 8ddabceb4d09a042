//! The U-Net that tells the clean actions from noisy ones, the diffusion's step and what was
//! observed.
//!
//! Actions of a horizon are a signal over time with a channel for each number. Down: blocks, then
//! half the steps. Up: the skip connection of the same length is concatenated, blocks, then twice
//! the steps. The condition enters every residual block.

use tch::{Device, Kind, TchError, Tensor};

use super::blocks::{BlockShape, Convolution, ConvolutionBlock, Doubling, ResidualBlock};
use super::config::Dp3Config;
use crate::layers::Linear;
use crate::parameters::{ParameterError, ParameterSource};

/// One length of the way down; the last one does not halve.
#[derive(Debug)]
pub(super) struct Down {
    pub(super) blocks: Vec<ResidualBlock>,
    pub(super) halve: Option<Convolution>,
}

/// One length of the way up.
#[derive(Debug)]
pub(super) struct Up {
    pub(super) blocks: Vec<ResidualBlock>,
    pub(super) double: Doubling,
}

/// `(batch, steps, action)` at both ends.
#[derive(Debug)]
pub(super) struct UNet {
    /// A row for each training step, `(steps, width)`, fixed.
    step_embedding: Tensor,
    /// Mish between them.
    step_encoder: [Linear; 2],
    pub(super) down: Vec<Down>,
    pub(super) middle: Vec<ResidualBlock>,
    pub(super) up: Vec<Up>,
    pub(super) last: (ConvolutionBlock, Convolution),
}

impl UNet {
    pub(super) fn new(
        source: &mut ParameterSource,
        key: &str,
        config: &Dp3Config,
    ) -> Result<Self, ParameterError> {
        let width = config.diffusion_step_embed_dim;
        let shape = BlockShape {
            kernel: config.kernel_size,
            groups: config.n_groups,
            condition: width + config.condition_features(),
        };
        let place = |index: usize| format!("{key}.diffusion_step_encoder.{index}");
        let step_encoder = [
            Linear::new(source, &place(1), width, 4 * width)?,
            Linear::new(source, &place(3), 4 * width, width)?,
        ];
        let widths: Vec<i64> = [config.action_dim]
            .iter()
            .chain(&config.down_dims)
            .copied()
            .collect();
        let mut down = Vec::new();
        for (index, pair) in widths.windows(2).enumerate() {
            let key = format!("{key}.down_modules.{index}");
            let blocks = residual_blocks(source, &key, [pair[0], pair[1]], config.blocks, shape)?;
            let halve = if index + 1 < config.down_dims.len() {
                let key = format!("{key}.{}.conv", config.blocks);
                Some(Convolution::new(source, &key, [pair[1]; 2], 3, 2)?)
            } else {
                None
            };
            down.push(Down { blocks, halve });
        }
        let (first, deepest) = (widths[1], widths[widths.len() - 1]);
        let key_of_middle = format!("{key}.mid_modules");
        let middle = residual_blocks(source, &key_of_middle, [deepest; 2], config.blocks, shape)?;
        let mut up = Vec::new();
        for (index, pair) in widths[1..].windows(2).rev().enumerate() {
            let key = format!("{key}.up_modules.{index}");
            // Twice the channels: those of the way down come along.
            let channels = [2 * pair[1], pair[0]];
            let blocks = residual_blocks(source, &key, channels, config.blocks, shape)?;
            let key = format!("{key}.{}.conv", config.blocks);
            let double = Doubling::new(source, &key, pair[0])?;
            up.push(Up { blocks, double });
        }
        let place = |index: usize| format!("{key}.final_conv.{index}");
        let (kernel, groups) = (config.kernel_size, config.n_groups);
        let block = ConvolutionBlock::new(source, &place(0), [first; 2], kernel, groups)?;
        let channels = [first, config.action_dim];
        let out = Convolution::new(source, &place(1), channels, 1, 1)?;
        // Where the parameters are, so that no call has to move it there.
        let step_embedding =
            step_table(config.num_train_timesteps, width)?.f_to_device(step_encoder[0].device())?;
        Ok(Self {
            step_embedding,
            step_encoder,
            down,
            middle,
            up,
            last: (block, out),
        })
    }

    /// Where its parameters are.
    pub(super) fn device(&self) -> Device {
        self.step_encoder[0].device()
    }

    /// Features of the diffusion's `step` (whole numbers, `(batch)`): `(batch, features)`.
    pub(super) fn embed(&self, step: &Tensor) -> Result<Tensor, TchError> {
        let [widen, narrow] = &self.step_encoder;
        let embedding = self.step_embedding.f_index_select(0, step)?;
        let embedding = embedding.f_to_kind(widen.weight.kind())?;
        narrow.forward(&widen.forward(&embedding)?.f_mish()?)
    }

    /// The clean actions `(batch, steps, action)` behind `noisy` ones, by the diffusion's `step`
    /// (whole numbers, `(batch)`) and the observations' features `(batch, features)`; in single
    /// precision, whatever the weights have.
    pub(super) fn forward(
        &self,
        noisy: &Tensor,
        step: &Tensor,
        observed: &Tensor,
    ) -> Result<Tensor, TchError> {
        let embedding = self.embed(step)?;
        let noisy = noisy.f_to_kind(embedding.kind())?;
        let condition = Tensor::f_cat(&[&embedding, observed], -1)?.f_mish()?;
        let mut x = noisy.f_transpose(1, 2)?;
        let mut on_the_way = Vec::new();
        for Down { blocks, halve } in &self.down {
            x = through(blocks, x, &condition)?;
            on_the_way.push(x.shallow_clone());
            if let Some(halve) = halve {
                x = halve.forward(&x)?;
            }
        }
        x = through(&self.middle, x, &condition)?;
        // The first length's skip connection is never used, as published.
        for (Up { blocks, double }, beside) in self.up.iter().zip(on_the_way.iter().rev()) {
            x = through(blocks, Tensor::f_cat(&[&x, beside], 1)?, &condition)?;
            x = double.forward(&x)?;
        }
        let (block, out) = &self.last;
        let clean = out.forward(&block.forward(&x)?)?;
        clean.f_transpose(1, 2)?.f_to_kind(Kind::Float)
    }
}

/// `count` blocks at `key.0`, `key.1` and so on, of which the first changes the number of channels.
fn residual_blocks(
    source: &mut ParameterSource,
    key: &str,
    channels: [i64; 2],
    count: usize,
    shape: BlockShape,
) -> Result<Vec<ResidualBlock>, ParameterError> {
    (0..count)
        .map(|index| {
            let inputs = if index == 0 { channels[0] } else { channels[1] };
            let key = format!("{key}.{index}");
            ResidualBlock::new(source, &key, [inputs, channels[1]], shape)
        })
        .collect()
}

fn through(
    blocks: &[ResidualBlock],
    mut x: Tensor,
    condition: &Tensor,
) -> Result<Tensor, TchError> {
    for block in blocks {
        x = block.forward(&x, condition)?;
    }
    Ok(x)
}

/// Sines, then cosines, of every step at frequencies from 1 to 1/10000: `(steps, width)`.
fn step_table(steps: i64, width: i64) -> Result<Tensor, TchError> {
    let (kind, device) = (Kind::Float, Device::Cpu);
    #[expect(clippy::cast_precision_loss, reason = "a width is small")]
    let last = (width / 2 - 1) as f64;
    let octave = -(10_000.0_f64.ln()) / last;
    let frequencies = Tensor::f_arange(width / 2, (kind, device))?
        .f_mul_scalar(octave)?
        .f_exp()?;
    let angles = Tensor::f_arange(steps, (kind, device))?
        .f_unsqueeze(1)?
        .f_mul(&frequencies)?;
    Tensor::f_cat(&[angles.f_sin()?, angles.f_cos()?], 1)
}
