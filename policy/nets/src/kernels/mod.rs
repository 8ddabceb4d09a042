//! Kernels of our own for the training of a ResNet on CUDA in 16 bits: what lies between its
//! convolutions, in as few passes over the images as there can be. The library takes thrice as
//! many, and half of its time goes into turning layouts.

#![expect(
    unsafe_code,
    reason = "kernels are given the addresses of tensors' memory"
)]

mod library;
#[cfg(test)]
mod tests;

use std::ffi::{c_int, c_uint};

use hal::count::count_u32;
use tch::{Device, Kind, TchError, Tensor};

use crate::cuda_graph::stream_of;
use crate::dimension::length;
use library::{Argument, Kernel, Library};

/// Threads of a block, in the kernels too.
const THREADS: i64 = 256;
/// Most shares of an image's pixels.
const SHARES_MAX: i64 = 64;
/// Blocks that keep a device busy.
const BLOCKS: i64 = 1024;

/// What is done with a convolution's answer before the next one sees it.
#[derive(Debug)]
pub(crate) enum Affine<'a> {
    /// Group normalisation, 16 channels a group, by its scale and bias.
    Group(&'a Tensor, &'a Tensor),
    /// A scale and a shift for each channel.
    Fixed(&'a Tensor, &'a Tensor),
}

/// What the backward pass needs of the forward pass.
#[derive(Debug)]
pub(crate) struct SavedForBackward {
    /// What the convolution gave.
    convolved: Tensor,
    /// Scale and shift in single precision: `(images, 2, channels)` of group normalisation,
    /// `(2, channels)` of a fixed one.
    maps: Tensor,
    /// Mean and inverse deviation, of group normalisation.
    statistics: Option<Tensor>,
}

/// The gradients of a scale and of a bias.
pub(crate) type OfAffine = Option<(Tensor, Tensor)>;

/// The kernels, for the device that was current when they were made.
#[derive(Debug)]
pub struct Kernels {
    library: Library,
    device: Device,
    sums: Kernel,
    group_maps: Kernel,
    forward: Kernel,
    backward_sums: Kernel,
    backward_maps: Kernel,
    parameters: Kernel,
    backward: Kernel,
    pooled: Kernel,
    pooled_backward_sums: Kernel,
    pooled_backward: Kernel,
}

/// Sizes of images with their channels last. bfloat16; 64, 128, 256 or 512 channels, which a
/// block's threads divide among them.
#[derive(Clone, Copy, Debug)]
struct Shape {
    images: i64,
    channels: i64,
    high: i64,
    wide: i64,
}

impl Shape {
    /// Those of `x`, which must be what the kernels take.
    fn of(x: &Tensor) -> Result<Self, TchError> {
        let (size, stride) = (x.size(), x.stride());
        let &[images, channels, high, wide] = size.as_slice() else {
            return Err(TchError::Shape(format!("images of shape {size:?}")));
        };
        let last = [high * wide * channels, 1, wide * channels, channels];
        let mut strides = size.iter().zip(stride.iter().zip(last));
        let lies = strides.all(|(&size, (&is, last))| size == 1 || is == last);
        let threads = [64, 128, 256, 512].contains(&channels);
        if !lies || !threads || x.kind() != Kind::BFloat16 {
            let kind = x.kind();
            let defect = format!("images of shape {size:?}, strides {stride:?}, kind {kind:?}");
            return Err(TchError::Shape(defect));
        }
        Ok(Self {
            images,
            channels,
            high,
            wide,
        })
    }

    const fn pixels(self) -> i64 {
        self.high * self.wide
    }

    /// The same after the pooling.
    const fn pooled(self) -> Self {
        Self {
            high: (self.high + 1) / 2,
            wide: (self.wide + 1) / 2,
            ..self
        }
    }

    /// Into how many shares each image's pixels are divided.
    fn shares(self) -> i64 {
        let rows = THREADS / (self.channels / 8);
        let wanted = BLOCKS.div_euclid(self.images) + 1;
        let most = SHARES_MAX.min((self.pixels() + rows - 1) / rows);
        wanted.clamp(1, most.max(1))
    }

    fn empty(self, kind: Kind, device: Device) -> Result<Tensor, TchError> {
        let size = [self.images, self.high, self.wide, self.channels];
        Tensor::f_empty(size, (kind, device))?.f_permute([0, 3, 1, 2])
    }
}

fn memory(tensor: &Tensor) -> Argument {
    Argument::Memory(tensor.data_ptr())
}

fn maybe(tensor: Option<&Tensor>) -> Argument {
    Argument::Memory(tensor.map_or(std::ptr::null_mut(), Tensor::data_ptr))
}

/// A count as the kernels take it, in 31 bits.
fn number(number: i64) -> Argument {
    let count = count_u32(length(number)).cast_signed();
    assert!(count >= 0, "images of more pixels than a kernel counts");
    Argument::Number(count)
}

fn flag(set: bool) -> Argument {
    Argument::Number(c_int::from(set))
}

impl Kernels {
    /// Compiles them for `device`, the thread's current one.
    ///
    /// # Errors
    /// What is missing of CUDA here, or what its compiler says.
    pub fn new(device: Device) -> Result<Self, TchError> {
        // The device's context is there once something is.
        let _there = Tensor::f_zeros([1], (Kind::Float, device))?;
        let library = Library::compiled(include_str!("backbone.cu"))?;
        Ok(Self {
            sums: library.kernel(c"sums")?,
            group_maps: library.kernel(c"group_maps")?,
            forward: library.kernel(c"forward")?,
            backward_sums: library.kernel(c"backward_sums")?,
            backward_maps: library.kernel(c"backward_maps")?,
            parameters: library.kernel(c"parameters")?,
            backward: library.kernel(c"backward")?,
            pooled: library.kernel(c"pooled")?,
            pooled_backward_sums: library.kernel(c"pooled_backward_sums")?,
            pooled_backward: library.kernel(c"pooled_backward")?,
            library,
            device,
        })
    }

    /// `affine` of a convolution's output, plus the residual `identity`, then ReLU if `rectified`.
    pub(crate) fn forward(
        &self,
        convolved: Tensor,
        affine: &Affine<'_>,
        identity: Option<&Tensor>,
        rectified: bool,
    ) -> Result<(Tensor, SavedForBackward), TchError> {
        let shape = Shape::of(&convolved)?;
        if let Some(identity) = identity {
            alike(identity, &convolved)?;
        }
        let kept = self.kept(convolved, shape, affine)?;
        let answer = shape.empty(Kind::BFloat16, self.device)?;
        let arguments = [
            memory(&kept.convolved),
            memory(&kept.maps),
            maybe(identity),
            memory(&answer),
            number(shape.pixels()),
            number(shape.channels),
            flag(kept.statistics.is_some()),
            flag(rectified),
        ];
        self.over(self.forward, shape, arguments)?;
        Ok((answer, kept))
    }

    /// `affine` of a convolution's output, 3x3 max pooling with stride 2, then ReLU; and the index
    /// of each maximum.
    pub(crate) fn pooled(
        &self,
        convolved: Tensor,
        affine: &Affine<'_>,
    ) -> Result<(Tensor, Tensor, SavedForBackward), TchError> {
        let shape = Shape::of(&convolved)?;
        let kept = self.kept(convolved, shape, affine)?;
        let answer = shape.pooled().empty(Kind::BFloat16, self.device)?;
        let which = shape.pooled().empty(Kind::Uint8, self.device)?;
        let arguments = [
            memory(&kept.convolved),
            memory(&kept.maps),
            memory(&answer),
            memory(&which),
            number(shape.high),
            number(shape.wide),
            number(shape.channels),
            flag(kept.statistics.is_some()),
        ];
        self.over(self.pooled, shape.pooled(), arguments)?;
        Ok((answer, which, kept))
    }

    /// The backward pass of [`Self::forward`]: the gradients of what the convolution gave, of scale
    /// and bias, and, if there was an identity, of that. `answer` is needed if so.
    pub(crate) fn backward(
        &self,
        gradient: &Tensor,
        kept: &SavedForBackward,
        affine: &Affine<'_>,
        answer: Option<&Tensor>,
        rectified: bool,
    ) -> Result<(Tensor, OfAffine, Option<Tensor>), TchError> {
        let shape = Shape::of(&kept.convolved)?;
        alike(gradient, &kept.convolved)?;
        let each = kept.statistics.is_some();
        let (pixels, channels) = (number(shape.pixels()), number(shape.channels));
        let seen = [
            memory(gradient),
            maybe(answer),
            memory(&kept.convolved),
            memory(&kept.maps),
        ];
        let part = self.part(shape)?;
        let [g, a, x, m] = seen;
        if each {
            let arguments = [
                g,
                a,
                x,
                m,
                memory(&part),
                pixels,
                channels,
                flag(each),
                flag(rectified),
            ];
            self.over(self.backward_sums, shape, arguments)?;
        }
        let (back, of_affine) = self.backward_maps(shape, shape, kept, affine, &part)?;
        let of_convolved = shape.empty(Kind::BFloat16, self.device)?;
        let of_identity = match answer {
            Some(_) => Some(shape.empty(Kind::BFloat16, self.device)?),
            None => None,
        };
        let arguments = [
            g,
            a,
            x,
            m,
            maybe(back.as_ref()),
            memory(&of_convolved),
            maybe(of_identity.as_ref()),
            pixels,
            channels,
            flag(each),
            flag(rectified),
        ];
        self.over(self.backward, shape, arguments)?;
        Ok((of_convolved, of_affine, of_identity))
    }

    /// The backward pass of [`Self::pooled`].
    pub(crate) fn pooled_backward(
        &self,
        gradient: &Tensor,
        (answer, which, kept): &(Tensor, Tensor, SavedForBackward),
        affine: &Affine<'_>,
    ) -> Result<(Tensor, OfAffine), TchError> {
        let shape = Shape::of(&kept.convolved)?;
        alike(gradient, answer)?;
        let seen = [
            memory(gradient),
            memory(answer),
            memory(which),
            memory(&kept.convolved),
        ];
        let [g, a, w, x] = seen;
        let sizes = [
            number(shape.high),
            number(shape.wide),
            number(shape.channels),
        ];
        let [high, wide, channels] = sizes;
        let part = self.part(shape.pooled())?;
        if kept.statistics.is_some() {
            let arguments = [g, a, w, x, memory(&part), high, wide, channels];
            self.over(self.pooled_backward_sums, shape.pooled(), arguments)?;
        }
        let (back, of_affine) = self.backward_maps(shape, shape.pooled(), kept, affine, &part)?;
        let of_convolved = shape.empty(Kind::BFloat16, self.device)?;
        let arguments = [
            g,
            a,
            w,
            x,
            memory(&kept.maps),
            maybe(back.as_ref()),
            memory(&of_convolved),
            high,
            wide,
            channels,
            flag(kept.statistics.is_some()),
        ];
        self.over(self.pooled_backward, shape, arguments)?;
        Ok((of_convolved, of_affine))
    }

    /// The affine maps of `convolved`.
    fn kept(
        &self,
        convolved: Tensor,
        shape: Shape,
        affine: &Affine<'_>,
    ) -> Result<SavedForBackward, TchError> {
        let float = (Kind::Float, self.device);
        let (scale, bias) = match affine {
            Affine::Group(scale, bias) => (scale, bias),
            Affine::Fixed(scale, shift) => {
                let rows = [scale.f_reshape([-1])?, shift.f_reshape([-1])?];
                let maps = Tensor::f_stack(&rows, 0)?.f_to_kind(Kind::Float)?;
                if maps.size() != [2, shape.channels] || maps.device() != self.device {
                    return Err(TchError::Shape(format!("a scale and a shift {maps:?}")));
                }
                return Ok(SavedForBackward {
                    convolved,
                    maps,
                    statistics: None,
                });
            }
        };
        self.check(scale, shape)?;
        self.check(bias, shape)?;
        let part = self.part(shape)?;
        let (pixels, channels) = (number(shape.pixels()), number(shape.channels));
        let arguments = [memory(&convolved), memory(&part), pixels, channels];
        self.over(self.sums, shape, arguments)?;
        let maps = Tensor::f_empty([shape.images, 2, shape.channels], float)?;
        let statistics = Tensor::f_empty([shape.images, shape.channels, 2], float)?;
        let arguments = [
            memory(&part),
            memory(scale),
            memory(bias),
            memory(&maps),
            memory(&statistics),
            pixels,
            channels,
            number(shape.shares()),
        ];
        self.launch(self.group_maps, [shape.images, 1], arguments)?;
        Ok(SavedForBackward {
            convolved,
            maps,
            statistics: Some(statistics),
        })
    }

    /// Of group normalisation: the maps of the backward pass, and the gradients of scale and bias,
    /// from the sums in `part`, which were taken over images of the shape `summed`.
    fn backward_maps(
        &self,
        shape: Shape,
        summed: Shape,
        kept: &SavedForBackward,
        affine: &Affine<'_>,
        part: &Tensor,
    ) -> Result<(Option<Tensor>, OfAffine), TchError> {
        let (Affine::Group(scale, _), Some(statistics)) = (affine, &kept.statistics) else {
            return Ok((None, None));
        };
        let float = (Kind::Float, self.device);
        let back = Tensor::f_empty([shape.images, 3, shape.channels], float)?;
        let added = Tensor::f_empty([shape.images, shape.channels, 2], float)?;
        let arguments = [
            memory(part),
            memory(statistics),
            memory(scale),
            memory(&back),
            memory(&added),
            number(shape.pixels()),
            number(shape.channels),
            number(summed.shares()),
        ];
        self.launch(self.backward_maps, [shape.images, 1], arguments)?;
        let (of_scale, of_bias) = (scale.f_empty_like()?, scale.f_empty_like()?);
        let arguments = [
            memory(&added),
            memory(&of_scale),
            memory(&of_bias),
            number(shape.images),
            number(shape.channels),
        ];
        let blocks = (shape.channels + THREADS - 1) / THREADS;
        self.launch(self.parameters, [blocks, 1], arguments)?;
        Ok((Some(back), Some((of_scale, of_bias))))
    }

    /// Room for the sums of an image's shares, two for each channel.
    fn part(&self, shape: Shape) -> Result<Tensor, TchError> {
        let size = [shape.images, shape.shares(), shape.channels, 2];
        Tensor::f_empty(size, (Kind::Float, self.device))
    }

    /// Refuses a scale or a bias that isn't as long as there are channels, or of another kind.
    fn check(&self, of_channels: &Tensor, shape: Shape) -> Result<(), TchError> {
        let right = of_channels.size() == [shape.channels]
            && of_channels.kind() == Kind::BFloat16
            && of_channels.device() == self.device
            && of_channels.is_contiguous();
        if right {
            return Ok(());
        }
        Err(TchError::Shape(format!("a scale {of_channels:?}")))
    }

    /// Launches a kernel over the shares of all images.
    fn over<const N: usize>(
        &self,
        kernel: Kernel,
        shape: Shape,
        arguments: [Argument; N],
    ) -> Result<(), TchError> {
        self.launch(kernel, [shape.shares(), shape.images], arguments)
    }

    /// Launches on the thread's current stream, and so into a capture that is under way.
    fn launch<const N: usize>(
        &self,
        kernel: Kernel,
        blocks: [i64; 2],
        mut arguments: [Argument; N],
    ) -> Result<(), TchError> {
        let blocks = blocks.map(|count| count_u32(length(count)));
        let stream = stream_of(self.device)?;
        const THREADS_OF_BLOCK: c_uint = count_u32(length(THREADS));
        // SAFETY: each caller gives its kernel the arguments of `backbone.cu`, of tensors whose
        // sizes it has checked or made.
        unsafe {
            self.library
                .launch(kernel, blocks, THREADS_OF_BLOCK, stream, &mut arguments)
        }
    }
}

/// Refuses `other` if it does not lie as `x` does.
fn alike(other: &Tensor, x: &Tensor) -> Result<(), TchError> {
    Shape::of(other)?;
    if other.size() == x.size() && other.device() == x.device() {
        return Ok(());
    }
    Err(TchError::Shape(format!("images {other:?} beside {x:?}")))
}
