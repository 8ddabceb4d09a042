//! CUDA graphs.

#![expect(unsafe_code, reason = "a drop takes what it drops")]

use std::mem::ManuallyDrop;

use tch::{Device, Kind, TchError, Tensor};

use super::aside::SideStream;
use super::functions::{Object, one_at_a_time, synchronise};
use crate::dimension::length;

/// Captured work of a device, launched again with one call. Its memory is its own.
#[derive(Debug)]
pub(super) struct Graph {
    object: ManuallyDrop<Object>,
    device: i32,
}

impl Graph {
    /// What `work` has `device` do, and what it answered, which each [`Self::replay`] overwrites.
    /// None if the libraries here have no CUDA, `device` is not the thread's current one, or this
    /// work can't be captured. `work` runs twice before, so that what the libraries set up at first
    /// is done.
    pub(super) fn capture<T>(
        device: i32,
        mut work: impl FnMut() -> Result<T, TchError>,
    ) -> Result<Option<(Self, T)>, TchError> {
        let Some(aside) = SideStream::of(device)? else {
            return Ok(None);
        };
        for _ in 0..2 {
            let _answer = work()?;
        }
        Ok(Self::captured_on(&aside, work).ok())
    }

    /// What `work` would have the device do, and what it answered; it does nothing of it yet. The
    /// error says why it can't be captured; everything then is as before.
    ///
    /// Whatever the libraries set up at first must be done, on `aside`.
    pub(super) fn captured_on<T>(
        aside: &SideStream,
        work: impl FnOnce() -> Result<T, TchError>,
    ) -> Result<(Self, T), TchError> {
        let alone = one_at_a_time();
        synchronise()?;
        let mut object = Object::new()?;
        let answer = object.begin().and_then(|()| work());
        let ended = if aside.is_capturing() {
            object.end()
        } else {
            let reason = "something of it waits for the device";
            Err(TchError::Torch(reason.to_owned()))
        };
        if let Err(reason) = ended {
            // The object stays: libtorch still knows it, and would end a capture that there is not.
            aside.abandon();
            // If this fails, so does what draws next.
            let _drawing = Self::let_draw(aside);
            return Err(answer.err().unwrap_or(reason));
        }
        let graph = Self {
            object: ManuallyDrop::new(object),
            device: aside.device,
        };
        drop(alone);
        Ok((graph, answer?))
    }

    /// Has the generator of random numbers, which takes its draws for captured, see the end of a
    /// capture.
    fn let_draw(aside: &SideStream) -> Result<(), TchError> {
        let mut object = Object::new()?;
        object.begin()?;
        // An empty one is warned of.
        let device = Device::Cuda(length(aside.device.into()));
        let _something = Tensor::f_zeros([1], (Kind::Float, device));
        object.end()?;
        object.delete();
        Ok(())
    }

    /// Has the device do it again, after all that this thread has asked of it before.
    pub(super) fn replay(&mut self) -> Result<(), TchError> {
        self.object.launch(self.device)
    }

    /// The same for work that draws random numbers: it draws on from where the generator of its
    /// device stands.
    pub(super) fn replay_drawing(&mut self) -> Result<(), TchError> {
        self.object.replay()
    }
}

impl Drop for Graph {
    fn drop(&mut self) {
        let _alone = one_at_a_time();
        // What was launched may still run; if the device fails there is nothing to wait for.
        let _done = synchronise();
        // SAFETY: it is not used any more.
        let object = unsafe { ManuallyDrop::take(&mut self.object) };
        object.delete();
    }
}
