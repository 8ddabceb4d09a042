//! A stream that can be captured.

#![expect(
    unsafe_code,
    reason = "streams are had from libtorch's functions for C"
)]

use std::ffi::c_int;
use std::ptr;

use tch::TchError;

use super::functions::{Functions, Stream, checked, one_at_a_time};

/// `cudaStreamCaptureStatusActive`.
const CAPTURING: c_int = 1;

/// A stream of libtorch's pool as this thread's current one, until it is dropped: the default stream can't be captured.
#[derive(Debug)]
pub(super) struct SideStream {
    pub(super) functions: Functions,
    pub(super) device: i32,
    before: Stream,
    stream: Stream,
}

impl SideStream {
    /// None if the libraries here have no CUDA, or `device` is not the thread's current one.
    pub(super) fn of(device: i32) -> Result<Option<Self>, TchError> {
        let found = Functions::found().filter(|found| found.is_current(device));
        found
            .map(|functions| Self::new(functions, device))
            .transpose()
    }

    fn new(functions: Functions, device: i32) -> Result<Self, TchError> {
        let before = functions.stream(device)?;
        let mut stream = ptr::null_mut();
        // SAFETY: it writes to a variable of ours.
        let code = unsafe { (functions.stream_from_pool)(false, device, &raw mut stream) };
        checked("a stream of libtorch's pool", code)?;
        {
            let _alone = one_at_a_time();
            functions.synchronise()?;
        }
        // SAFETY: the stream is libtorch's own, of this device.
        let code = unsafe { (functions.set_stream)(stream, device) };
        checked("a stream of its own", code)?;
        Ok(Self {
            functions,
            device,
            before,
            stream,
        })
    }

    pub(super) fn is_capturing(&self) -> bool {
        let mut status = 0;
        // SAFETY: the stream lives as long as the process; the status is a variable of ours.
        let code = unsafe { (self.functions.status)(self.stream, &raw mut status) };
        code == 0 && status == CAPTURING
    }

    /// Abandons a capture that failed, and its error, which the next call of libtorch would take for its own.
    pub(super) fn abandon(&self) {
        let mut nothing = ptr::null_mut();
        // SAFETY: the stream lives as long as the process; the graph is a variable of ours. What it answers is of no use: the
        // capture is lost anyway.
        let _code = unsafe { (self.functions.abandon)(self.stream, &raw mut nothing) };
        // SAFETY: it takes nothing.
        let _forgotten = unsafe { (self.functions.last_error)() };
    }
}

impl Drop for SideStream {
    fn drop(&mut self) {
        // Streams do not wait for each other; if the device fails there is nothing to wait for.
        {
            let _alone = one_at_a_time();
            let _done = self.functions.synchronise();
        }
        // SAFETY: the stream that was current before. It fails only if there is no such device.
        let _code = unsafe { (self.functions.set_stream)(self.before, self.device) };
    }
}
