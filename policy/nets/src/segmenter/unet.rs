//! A small 3-D U-Net: half resolution inside, so that its widest volumes are an eighth of what it
//! sees, with eight voxels a place at both ends.
//!
//! Ronneberger et al. 2015 in three dimensions, with residual blocks and group normalisation.
//! Folding eight voxels into channels (and back at the end) only moves numbers, so the full
//! resolution is never convolved.

use serde::{Deserialize, Serialize};
use tch::{TchError, Tensor};

use crate::parameters::{Init, ParameterError, ParameterSource, Parameters};

/// Groups of a normalisation.
const GROUPS: i64 = 8;
/// Voxels that become one place, along an axis.
const FOLD: i64 = 2;
/// Channels of what the network sees: the whole range, and a part of it stretched.
const SEEN: i64 = 2;

/// The size of the network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UNetConfig {
    /// Channels of each level; each has half the resolution of the one before.
    pub widths: Vec<i64>,
    /// Classes.
    pub classes: i64,
    /// The part of its input, which is in [0, 1], that it sees stretched to [0, 1] as well: soft
    /// tissue.
    pub narrow: [f64; 2],
}

impl UNetConfig {
    /// What makes it impossible to build, if anything does.
    #[must_use]
    pub fn defect(&self) -> Option<String> {
        let width = |width: &i64| (8..=512).contains(width) && width % GROUPS == 0;
        if !(1..=6).contains(&self.widths.len()) || !self.widths.iter().all(width) {
            return Some(format!(
                "widths = {:?}: one to six multiples of 8 up to 512",
                self.widths
            ));
        }
        let [low, high] = self.narrow;
        if !(0.0 <= low && low < high && high <= 1.0) {
            return Some(format!("narrow = {:?}: a part of [0, 1]", self.narrow));
        }
        (!(1..=254).contains(&self.classes))
            .then(|| format!("classes = {} is outside [1, 254]", self.classes))
    }

    /// What the sides of a window must be a multiple of.
    #[must_use]
    pub fn multiple(&self) -> usize {
        1 << self.widths.len()
    }
}

/// Over three dimensions, with bias; padded so that stride 1 keeps the size.
#[derive(Debug)]
struct Convolution {
    weight: Tensor,
    bias: Tensor,
    stride: i64,
    padding: i64,
}

impl Convolution {
    fn new(
        source: &mut ParameterSource,
        key: &str,
        [inputs, outputs]: [i64; 2],
        kernel: i64,
        stride: i64,
    ) -> Result<Self, ParameterError> {
        let fan_in = inputs * kernel.pow(3);
        let shape = [outputs, inputs, kernel, kernel, kernel];
        Ok(Self {
            weight: source.trainable(&format!("{key}.weight"), &shape, &Init::he(fan_in))?,
            bias: source.trainable(&format!("{key}.bias"), &[outputs], &Init::Constant(0.0))?,
            stride,
            padding: kernel / 2,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        x.f_conv3d(
            &self.weight,
            Some(&self.bias),
            [self.stride; 3],
            [self.padding; 3],
            [1; 3],
            1,
        )
    }
}

/// A convolution, a normalisation and a leaky ReLU.
#[derive(Debug)]
struct Block {
    convolution: Convolution,
    scale: Tensor,
    shift: Tensor,
}

impl Block {
    fn new(
        source: &mut ParameterSource,
        key: &str,
        channels: [i64; 2],
        stride: i64,
    ) -> Result<Self, ParameterError> {
        let one = |value| Init::Constant(value);
        Ok(Self {
            convolution: Convolution::new(source, &format!("{key}.conv"), channels, 3, stride)?,
            scale: source.trainable(&format!("{key}.norm.weight"), &channels[1..], &one(1.0))?,
            shift: source.trainable(&format!("{key}.norm.bias"), &channels[1..], &one(0.0))?,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        self.convolution
            .forward(x)?
            .f_group_norm(GROUPS, Some(&self.scale), Some(&self.shift), 1e-5, true)?
            .f_leaky_relu()
    }
}

/// Two blocks, of which the second adds to what it sees.
#[derive(Debug)]
struct Level {
    first: Block,
    second: Block,
}

impl Level {
    fn new(
        source: &mut ParameterSource,
        key: &str,
        channels: [i64; 2],
        stride: i64,
    ) -> Result<Self, ParameterError> {
        let own = [channels[1]; 2];
        Ok(Self {
            first: Block::new(source, &format!("{key}.0"), channels, stride)?,
            second: Block::new(source, &format!("{key}.1"), own, 1)?,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        let x = self.first.forward(x)?;
        self.second.forward(&x)?.f_add(&x)
    }
}

/// To twice the resolution, joined with what was there on the way down.
#[derive(Debug)]
struct Up {
    weight: Tensor,
    bias: Tensor,
    level: Level,
}

impl Up {
    fn new(
        source: &mut ParameterSource,
        key: &str,
        [inputs, outputs]: [i64; 2],
    ) -> Result<Self, ParameterError> {
        let shape = [inputs, outputs, FOLD, FOLD, FOLD];
        let both = [2 * outputs, outputs];
        let weight = source.trainable(&format!("{key}.up.weight"), &shape, &Init::he(inputs))?;
        let zero = Init::Constant(0.0);
        Ok(Self {
            weight,
            bias: source.trainable(&format!("{key}.up.bias"), &[outputs], &zero)?,
            level: Level::new(source, &format!("{key}.level"), both, 1)?,
        })
    }

    fn forward(&self, x: &Tensor, beside: &Tensor) -> Result<Tensor, TchError> {
        let bias = Some(&self.bias);
        let x = x.f_conv_transpose3d(&self.weight, bias, [FOLD; 3], [0; 3], [0; 3], 1, [1; 3])?;
        self.level.forward(&Tensor::f_cat(&[&x, beside], 1)?)
    }
}

/// The network.
#[derive(Debug)]
pub struct UNet {
    config: UNetConfig,
    /// The first keeps the resolution, each further one halves it.
    down: Vec<Level>,
    /// The deepest first.
    up: Vec<Up>,
    /// 1x1x1, to eight voxels' classes.
    out: Convolution,
    parameters: Parameters,
}

impl UNet {
    /// The network with the parameters of `source`.
    ///
    /// # Errors
    /// [`ParameterError`] if a tensor is missing, left over or of another shape.
    ///
    /// # Panics
    /// If `config` has a defect.
    pub fn new(config: UNetConfig, mut source: ParameterSource) -> Result<Self, ParameterError> {
        assert_eq!(config.defect(), None, "a network that can be built");
        let places = FOLD.pow(3);
        let widths: Vec<i64> = [SEEN * places]
            .iter()
            .chain(&config.widths)
            .copied()
            .collect();
        let mut down = Vec::new();
        for (level, pair) in widths.windows(2).enumerate() {
            let (key, stride) = (format!("down.{level}"), if level == 0 { 1 } else { 2 });
            down.push(Level::new(&mut source, &key, [pair[0], pair[1]], stride)?);
        }
        let mut up = Vec::new();
        for (level, pair) in config.widths.windows(2).enumerate().rev() {
            up.push(Up::new(
                &mut source,
                &format!("up.{level}"),
                [pair[1], pair[0]],
            )?);
        }
        let channels = [config.widths[0], config.classes * places];
        Ok(Self {
            down,
            up,
            out: Convolution::new(&mut source, "out", channels, 1, 1)?,
            parameters: source.finish()?,
            config,
        })
    }

    /// Its size.
    #[must_use]
    pub const fn config(&self) -> &UNetConfig {
        &self.config
    }

    /// Its tensors.
    #[must_use]
    pub const fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Scores `(batch, classes, x, y, z)` of `(batch, 1, x, y, z)`, values in [0, 1], sides
    /// multiples of [`UNetConfig::multiple`].
    ///
    /// # Errors
    /// The network library's.
    pub fn forward(&self, seen: &Tensor) -> Result<Tensor, TchError> {
        let [low, high] = self.config.narrow;
        let narrow = seen.f_sub_scalar(low)?.f_mul_scalar(1.0 / (high - low))?;
        let mut x = folded(&Tensor::f_cat(&[seen, &narrow.f_clamp(0.0, 1.0)?], 1)?)?;
        let mut beside = Vec::new();
        for level in &self.down {
            x = level.forward(&x)?;
            beside.push(x.shallow_clone());
        }
        for (up, beside) in self.up.iter().zip(beside.iter().rev().skip(1)) {
            x = up.forward(&x, beside)?;
        }
        unfolded(&self.out.forward(&x)?)
    }
}

/// The five dimensions of a volume with batch and channels.
fn sides(x: &Tensor) -> Result<[i64; 5], TchError> {
    let wrong = || TchError::Shape("expected batch, channels, x, y, z".to_owned());
    x.size().try_into().map_err(|_| wrong())
}

/// Eight voxels a place: `(batch, channels, x, y, z)` to `(batch, 8 channels, x / 2, y / 2, z /
/// 2)`.
fn folded(x: &Tensor) -> Result<Tensor, TchError> {
    let [batch, channels, a, b, c] = sides(x)?;
    x.f_view(
        &[
            batch,
            channels,
            a / FOLD,
            FOLD,
            b / FOLD,
            FOLD,
            c / FOLD,
            FOLD,
        ][..],
    )?
    .f_permute([0, 1, 3, 5, 7, 2, 4, 6])?
    .f_reshape([batch, channels * FOLD.pow(3), a / FOLD, b / FOLD, c / FOLD])
}

/// The opposite of [`folded`].
fn unfolded(x: &Tensor) -> Result<Tensor, TchError> {
    let [batch, channels, a, b, c] = sides(x)?;
    let channels = channels / FOLD.pow(3);
    x.f_view(&[batch, channels, FOLD, FOLD, FOLD, a, b, c][..])?
        .f_permute([0, 1, 5, 2, 6, 3, 7, 4])?
        .f_reshape([batch, channels, a * FOLD, b * FOLD, c * FOLD])
}
