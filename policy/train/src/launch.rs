//! How a step's kernels are launched on an accelerator: one by one or, captured after the first few
//! steps, as one CUDA graph.
//!
//! A step is some two thousand kernels, and launching them takes the host longer than running them
//! takes the device.

use tch::{Device, TchError, Tensor};

use super::options::TrainOptions;
use super::{Progress, TrainError, TrainingObserver};
use trocar_nets::cuda_graph::{Capture, CapturedGraph};

/// Steps before the captured one: in the first the libraries look for their best kernels.
const WARM_UP_STEPS: u32 = 3;

/// How the steps are launched.
#[derive(Debug)]
pub(super) enum Launch {
    /// Kernel by kernel.
    Eager,
    /// Kernel by kernel for so many more steps, and then captured.
    WarmingUp(Capture, u32),
    /// As one graph.
    Captured(CapturedGraph),
}

impl Launch {
    /// For the steps of a run on `device`.
    pub(super) fn new(
        options: &TrainOptions,
        device: Device,
        watch: &mut dyn TrainingObserver,
    ) -> Result<Self, TrainError> {
        if options.eager || !device.is_cuda() {
            return Ok(Self::Eager);
        }
        if let Some(capture) = Capture::begin(device)? {
            return Ok(Self::WarmingUp(capture, WARM_UP_STEPS));
        }
        let reason = "the libraries here can't capture CUDA graphs".to_owned();
        watch.progress(&Progress::Slower { reason });
        Ok(Self::Eager)
    }

    /// Launches a step, which is `work` with `inputs`; the result is on the device. `work` must
    /// launch the same at every step, and the caller seeds the generator of random numbers. A
    /// capture that fails is reported once, and the run goes on eagerly.
    pub(super) fn step(
        &mut self,
        inputs: &[Tensor],
        work: &mut dyn FnMut(&[Tensor]) -> Result<Tensor, TchError>,
        watch: &mut dyn TrainingObserver,
    ) -> Result<Tensor, TrainError> {
        let before = std::mem::replace(self, Self::Eager);
        *self = match before {
            Self::WarmingUp(capture, 0) => match capture.capture(inputs, &mut *work) {
                Ok(graph) => Self::Captured(graph),
                Err(error) => {
                    let reason = format!("steps can't be captured as a CUDA graph: {error}");
                    watch.progress(&Progress::Slower { reason });
                    Self::Eager
                }
            },
            Self::WarmingUp(capture, left) => Self::WarmingUp(capture, left - 1),
            other @ (Self::Eager | Self::Captured(_)) => other,
        };
        Ok(match self {
            Self::Captured(graph) => graph.replay(inputs)?,
            Self::Eager | Self::WarmingUp(..) => work(inputs)?,
        })
    }
}
