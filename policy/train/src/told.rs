//! How an accelerator is told its steps: piece by piece, or, recorded after the first few, with one call each.
//!
//! A step is some two thousand operations, and telling them takes the host longer than doing them takes the device.

use tch::{Device, TchError, Tensor};

use super::options::TrainOptions;
use super::{Progress, TrainError, Watch};
use trocar_nets::recorded::{Recorder, Recording};

/// Steps before the one that is recorded: in the first the libraries look for their best kernels.
const WARM_UP_STEPS: u32 = 3;

/// How it is told.
#[derive(Debug)]
pub(super) enum Told {
    /// Piece by piece.
    PieceByPiece,
    /// Piece by piece for so many more steps, and then recorded.
    WarmingUp(Recorder, u32),
    /// With one call.
    Recorded(Recording),
}

impl Told {
    /// For the steps of a run on `device`.
    pub(super) fn new(
        options: &TrainOptions,
        device: Device,
        watch: &mut dyn Watch,
    ) -> Result<Self, TrainError> {
        if options.eager || !device.is_cuda() {
            return Ok(Self::PieceByPiece);
        }
        if let Some(recorder) = Recorder::begin(device)? {
            return Ok(Self::WarmingUp(recorder, WARM_UP_STEPS));
        }
        let reason = "the libraries here can't record steps".to_owned();
        watch.progress(&Progress::Slower { reason });
        Ok(Self::PieceByPiece)
    }

    /// Has the device do a step, which is `work` with `inputs`; the answer is on the device. `work` must tell the device the
    /// same at every step, and the generator of random numbers must be the caller's.
    pub(super) fn step(
        &mut self,
        inputs: &[Tensor],
        work: &mut dyn FnMut(&[Tensor]) -> Result<Tensor, TchError>,
        watch: &mut dyn Watch,
    ) -> Result<Tensor, TrainError> {
        let before = std::mem::replace(self, Self::PieceByPiece);
        *self = match before {
            Self::WarmingUp(recorder, 0) => match recorder.record(inputs, &mut *work) {
                Ok(recording) => Self::Recorded(recording),
                Err(error) => {
                    let reason = format!("they can't be recorded: {error}");
                    watch.progress(&Progress::Slower { reason });
                    Self::PieceByPiece
                }
            },
            Self::WarmingUp(recorder, left) => Self::WarmingUp(recorder, left - 1),
            other @ (Self::PieceByPiece | Self::Recorded(_)) => other,
        };
        Ok(match self {
            Self::Recorded(recording) => recording.drawn_answer(inputs)?,
            Self::PieceByPiece | Self::WarmingUp(..) => work(inputs)?,
        })
    }
}
