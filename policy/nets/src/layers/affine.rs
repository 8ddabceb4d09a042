//! Linear layers as inference runs them.

use tch::{Device, Kind, TchError, Tensor};

use super::Linear;
use super::aligned::Aligned;
use super::matrix::{Epilogue, Matrix};
use super::vectors::Processor;

/// What computes matrix products.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Backend {
    /// Our GEMM kernel, for this processor: on the CPU in single precision, on one thread.
    Native(Processor),
    /// libtorch, in this precision.
    Torch(Kind),
}

impl Backend {
    /// The fastest on `device`, with so many threads as there are now.
    pub(crate) fn fastest(kind: Kind, device: Device) -> Self {
        Self::with_threads(kind, device, tch::get_num_threads())
    }

    fn with_threads(kind: Kind, device: Device, threads: i32) -> Self {
        let ours = kind == Kind::Float && device == Device::Cpu && threads == 1;
        match Processor::found() {
            Some(processor) if ours => Self::Native(processor),
            _ => Self::Torch(kind),
        }
    }

    /// The precision that it computes in.
    pub(crate) const fn kind(self) -> Kind {
        match self {
            Self::Native(_) => Kind::Float,
            Self::Torch(kind) => kind,
        }
    }
}

/// A linear layer whose bias may differ from row to row.
#[derive(Debug)]
pub(crate) enum Affine {
    Native {
        matrix: Matrix,
        /// `(outputs)` or `(rows of one observation, outputs)`.
        bias: Aligned,
    },
    Torch {
        /// `(inputs, outputs)`, so that the product reads it as it is.
        weight: Tensor,
        /// As above.
        bias: Tensor,
    },
}

impl Affine {
    /// `weight` `(outputs, inputs)`; `bias` is `(outputs)` or `(rows of one observation, outputs)`.
    pub(crate) fn new(weight: &Tensor, bias: &Tensor, backend: Backend) -> Result<Self, TchError> {
        let (weight, bias) = (weight.f_detach()?, bias.f_detach()?.f_contiguous()?);
        if bias.size().last() != weight.size().first() {
            let text = format!("bias {:?} of weight {:?}", bias.size(), weight.size());
            return Err(TchError::Shape(text));
        }
        match backend {
            Backend::Native(processor) if Matrix::fits(&weight) => Ok(Self::Native {
                matrix: Matrix::new(processor, &weight)?,
                bias: Aligned::of(&Vec::<f32>::try_from(&bias.f_view([-1])?)?),
            }),
            Backend::Native(_) | Backend::Torch(_) => Ok(Self::Torch {
                weight: weight
                    .f_to_kind(backend.kind())?
                    .f_transpose(0, 1)?
                    .f_contiguous()?,
                bias: bias.f_to_kind(backend.kind())?,
            }),
        }
    }

    /// The trained `linear`, detached.
    pub(crate) fn of(linear: &Linear, backend: Backend) -> Result<Self, TchError> {
        Self::new(&linear.weight, &linear.bias, backend)
    }

    /// `x` `(rows, inputs)` to `(rows, outputs)`.
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        self.apply(x, false)
    }

    /// The same, followed by ReLU.
    pub(crate) fn rectified(&self, x: &Tensor) -> Result<Tensor, TchError> {
        self.apply(x, true)
    }

    /// The product with its epilogue; on libtorch ReLU is a second pass.
    fn apply(&self, x: &Tensor, rectified: bool) -> Result<Tensor, TchError> {
        match self {
            Self::Native { matrix, bias } => {
                matrix.apply(&x.f_contiguous()?, Epilogue { bias, rectified })
            }
            Self::Torch { weight, bias } => {
                let mut sum = bias_of(bias, x)?.f_addmm(x, weight)?;
                // tch 0.24 hands the flag of the fused `_addmm_activation` to the parameter `beta`,
                // so two steps.
                if rectified { sum.f_relu_() } else { Ok(sum) }
            }
        }
    }
}

/// `bias` as often as there are observations in `x`.
fn bias_of(bias: &Tensor, x: &Tensor) -> Result<Tensor, TchError> {
    let rows = x.size()[0];
    match bias.size().as_slice() {
        &[own, _] if own != rows => bias.f_repeat([rows / own.max(1), 1]),
        _ => Ok(bias.shallow_clone()),
    }
}

#[cfg(test)]
#[cfg(target_arch = "x86_64")]
mod tests {
    use tch::{Device, Kind, Tensor};

    use super::{Affine, Backend};
    use crate::layers::vectors::Processor;

    fn zeros(shape: &[i64]) -> Tensor {
        Tensor::zeros(shape, (Kind::Float, Device::Cpu))
    }

    #[test]
    fn one_core_in_single_precision_computes_with_code_of_ours() {
        assert!(Processor::found().is_some(), "the tests need AVX2");
        for (kind, device, threads, own) in [
            (Kind::Float, Device::Cpu, 1, true),
            (Kind::Float, Device::Cpu, 2, false),
            (Kind::Float, Device::Cuda(0), 1, false),
            (Kind::BFloat16, Device::Cpu, 1, false),
        ] {
            let backend = Backend::with_threads(kind, device, threads);
            assert_eq!(
                (matches!(backend, Backend::Native(_)), backend.kind()),
                (own, kind)
            );
        }
    }

    #[test]
    fn whole_panels_of_outputs_are_code_of_ours() {
        let own = Backend::with_threads(Kind::Float, Device::Cpu, 1);
        for (backend, outputs, expected) in [
            (own, 32, true),
            (own, 7, false),
            (Backend::Torch(Kind::Float), 32, false),
        ] {
            let layer = Affine::new(&zeros(&[outputs, 5]), &zeros(&[outputs]), backend).unwrap();
            assert_eq!(
                matches!(layer, Affine::Native { .. }),
                expected,
                "{layer:?}"
            );
        }
    }

    #[test]
    fn a_bias_of_other_outputs_is_refused() {
        for backend in [
            Backend::with_threads(Kind::Float, Device::Cpu, 1),
            Backend::Torch(Kind::Float),
        ] {
            for bias in [&[31_i64] as &[i64], &[4, 64], &[0]] {
                assert!(
                    Affine::new(&zeros(&[32, 5]), &zeros(bias), backend).is_err(),
                    "{bias:?}"
                );
            }
        }
    }
}
