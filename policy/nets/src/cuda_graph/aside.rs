//! A stream that can be captured.

use tch::TchError;

use super::functions::{Stream, is_current, one_at_a_time, synchronise};

/// A stream of libtorch's pool as this thread's current one, until it is dropped: the default
/// stream can't be captured.
#[derive(Debug)]
pub(super) struct SideStream {
    pub(super) device: i32,
    /// What was current, and is again when this is dropped.
    before: Stream,
    /// What is current meanwhile.
    stream: Stream,
}

impl SideStream {
    /// None if the libraries here have no CUDA, or `device` is not the thread's current one.
    pub(super) fn of(device: i32) -> Result<Option<Self>, TchError> {
        if !is_current(device) {
            return Ok(None);
        }
        let before = Stream::current(device)?;
        let stream = Stream::of_pool(device)?;
        {
            let _alone = one_at_a_time();
            synchronise()?;
        }
        stream.set_current(device)?;
        Ok(Some(Self {
            device,
            before,
            stream,
        }))
    }

    /// False after an operation that a capture does not allow, which invalidates it.
    pub(super) fn is_capturing(&self) -> bool {
        self.stream.is_capturing()
    }

    /// Abandons a capture that failed.
    pub(super) fn abandon(&self) {
        self.stream.abandon();
    }
}

impl Drop for SideStream {
    fn drop(&mut self) {
        // Streams do not wait for each other; if the device fails there is nothing to wait for.
        {
            let _alone = one_at_a_time();
            let _done = synchronise();
        }
        // It fails only if there is no such device.
        let _set = self.before.set_current(self.device);
    }
}
