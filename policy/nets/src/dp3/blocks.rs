//! The blocks of DP3's U-Net, over `(batch, channels, steps)`.
//!
//! Chi et al. 2023's conditional U-Net over time, as DP3 takes it over. Steps are few (16, 8, 4)
//! and channels many, so that time goes into reading weights.

use tch::{TchError, Tensor};

use crate::layers::Linear;
use crate::parameters::{Init, ParameterError, ParameterSource};

/// A convolution over the steps with bias.
#[derive(Debug)]
pub(super) struct Convolution {
    /// `(outputs, inputs, kernel)`.
    pub(super) weight: Tensor,
    pub(super) bias: Tensor,
    pub(super) stride: i64,
    padding: i64,
}

impl Convolution {
    /// As many steps out as in, divided by `stride`; `kernel` is odd.
    pub(super) fn new(
        source: &mut ParameterSource,
        key: &str,
        [inputs, outputs]: [i64; 2],
        kernel: i64,
        stride: i64,
    ) -> Result<Self, ParameterError> {
        let init = Init::fan_in(inputs * kernel);
        let shape = [outputs, inputs, kernel];
        Ok(Self {
            weight: source.trainable(&format!("{key}.weight"), &shape, &init)?,
            bias: source.trainable(&format!("{key}.bias"), &[outputs], &init)?,
            stride,
            padding: kernel / 2,
        })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        // A few steps by thousands of channels: an accelerator is quicker with one product of
        // matrices.
        if x.device().is_cuda() {
            return self.product(x);
        }
        x.f_conv1d(
            &self.weight,
            Some(&self.bias),
            self.stride,
            self.padding,
            1,
            1,
        )
    }

    /// The convolution as the product of every step's neighbourhood with the weights.
    pub(super) fn product(&self, x: &Tensor) -> Result<Tensor, TchError> {
        let &[outputs, _, kernel] = self.weight.size().as_slice() else {
            return Err(TchError::Shape("weights of three dimensions".to_owned()));
        };
        let padded = x.f_constant_pad_nd([self.padding, self.padding])?;
        // (batch, channels, steps, kernel).
        let around = padded.f_unfold(2, kernel, self.stride)?;
        let rows = around.f_transpose(1, 2)?.f_flatten(2, 3)?;
        let weight = self.weight.f_view([outputs, -1])?;
        rows.f_linear(&weight, Some(&self.bias))?.f_transpose(1, 2)
    }
}

/// The transposed convolution that doubles the steps.
#[derive(Debug)]
pub(super) struct Doubling {
    /// `(inputs, outputs, 4)`: transposed convolutions have their inputs first.
    pub(super) weight: Tensor,
    pub(super) bias: Tensor,
}

impl Doubling {
    /// With stride 2 and padding 1, twice the steps exactly.
    const KERNEL: i64 = 4;

    pub(super) fn new(
        source: &mut ParameterSource,
        key: &str,
        channels: i64,
    ) -> Result<Self, ParameterError> {
        let init = Init::fan_in(channels * Self::KERNEL);
        let shape = [channels, channels, Self::KERNEL];
        Ok(Self {
            weight: source.trainable(&format!("{key}.weight"), &shape, &init)?,
            bias: source.trainable(&format!("{key}.bias"), &[channels], &init)?,
        })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        if x.device().is_cuda() {
            return self.product(x);
        }
        x.f_conv_transpose1d(&self.weight, Some(&self.bias), 2, 1, 0, 1, 1)
    }

    /// The same as one product of matrices: of step `t`, the kernel's places 1 and 2 go to the
    /// steps `2 t` and `2 t + 1`, 3 and 0 to the even one after and the odd one before.
    pub(super) fn product(&self, x: &Tensor) -> Result<Tensor, TchError> {
        let &[batch, channels, steps] = x.size().as_slice() else {
            return Err(TchError::Shape("steps of three dimensions".to_owned()));
        };
        let places = x
            .f_transpose(1, 2)?
            .f_matmul(&self.weight.f_view([channels, -1])?)?
            .f_view([batch, steps, -1, Self::KERNEL])?
            .f_unbind(-1)?;
        let [before, even, odd, after] = places.as_slice() else {
            return Err(TchError::Shape("a kernel of four places".to_owned()));
        };
        let (before, after) = (
            before.f_narrow(1, 1, steps - 1)?,
            after.f_narrow(1, 0, steps - 1)?,
        );
        let even = even.f_add(&after.f_constant_pad_nd([0, 0, 1, 0])?)?;
        let odd = odd.f_add(&before.f_constant_pad_nd([0, 0, 0, 1])?)?;
        Tensor::f_stack(&[even, odd], 2)?
            .f_flatten(1, 2)?
            .f_add(&self.bias)?
            .f_transpose(1, 2)
    }
}

/// Convolution, group normalisation, Mish.
#[derive(Debug)]
pub(super) struct ConvolutionBlock {
    pub(super) convolution: Convolution,
    pub(super) norm_weight: Tensor,
    pub(super) norm_bias: Tensor,
    pub(super) groups: i64,
}

impl ConvolutionBlock {
    pub(super) fn new(
        source: &mut ParameterSource,
        key: &str,
        channels: [i64; 2],
        kernel: i64,
        groups: i64,
    ) -> Result<Self, ParameterError> {
        let outputs = [channels[1]];
        let norm = format!("{key}.block.1");
        Ok(Self {
            convolution: Convolution::new(source, &format!("{key}.block.0"), channels, kernel, 1)?,
            norm_weight: source.trainable(
                &format!("{norm}.weight"),
                &outputs,
                &Init::Constant(1.0),
            )?,
            norm_bias: source.trainable(&format!("{norm}.bias"), &outputs, &Init::Constant(0.0))?,
            groups,
        })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        let x = self.convolution.forward(x)?;
        let weight = Some(&self.norm_weight);
        x.f_group_norm(self.groups, weight, Some(&self.norm_bias), 1e-5, true)?
            .f_mish()
    }
}

/// Two convolution blocks around a scale and a shift that the condition gives each channel, and
/// what went in added. Feature-wise modulation (FiLM, Perez et al. 2018): `scale * x + shift`.
#[derive(Debug)]
pub(super) struct ResidualBlock {
    pub(super) blocks: [ConvolutionBlock; 2],
    /// To the scales, then the shifts, of the channels.
    pub(super) condition: Linear,
    /// Of one tap, where the number of channels changes.
    pub(super) residual: Option<Convolution>,
}

/// What all residual blocks of a network have in common.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockShape {
    pub(super) kernel: i64,
    pub(super) groups: i64,
    pub(super) condition: i64,
}

impl ResidualBlock {
    pub(super) fn new(
        source: &mut ParameterSource,
        key: &str,
        channels: [i64; 2],
        shape: BlockShape,
    ) -> Result<Self, ParameterError> {
        let (kernel, groups) = (shape.kernel, shape.groups);
        let [inputs, outputs] = channels;
        let place = |index: usize| format!("{key}.blocks.{index}");
        let first = ConvolutionBlock::new(source, &place(0), channels, kernel, groups)?;
        let second = ConvolutionBlock::new(source, &place(1), [outputs; 2], kernel, groups)?;
        let residual = if inputs == outputs {
            None
        } else {
            let key = format!("{key}.residual_conv");
            Some(Convolution::new(source, &key, channels, 1, 1)?)
        };
        let key = format!("{key}.cond_encoder.1");
        Ok(Self {
            blocks: [first, second],
            condition: Linear::new(source, &key, shape.condition, 2 * outputs)?,
            residual,
        })
    }

    /// `condition` is `(batch, condition)` and has been through Mish.
    pub(super) fn forward(&self, x: &Tensor, condition: &Tensor) -> Result<Tensor, TchError> {
        let scale_and_shift = self.condition.forward(condition)?.f_unsqueeze(-1)?;
        let parts = scale_and_shift.f_chunk(2, 1)?;
        let [scale, shift] = parts.as_slice() else {
            return Err(TchError::Shape("a scale and a shift".to_owned()));
        };
        let modulated = scale.f_mul(&self.blocks[0].forward(x)?)?.f_add(shift)?;
        let out = self.blocks[1].forward(&modulated)?;
        match &self.residual {
            Some(residual) => out.f_add(&residual.forward(x)?),
            None => out.f_add(x),
        }
    }
}
