//! The Vulkan device that draws: found without a window, silent, and never panicking on its own
//! errors.
//!
//! wgpu reports errors of validation and memory to a callback rather than to the call that made
//! them; here the callback keeps the first, and every wait looks at it. No surface and no display
//! is involved. Limits are those of the downlevel defaults with the adapter's resolution, so that
//! software rasterisers qualify.

use core::future::Future;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use super::RenderError;

/// An opened device and the first error it reported by itself.
pub(super) struct Gpu {
    /// Makes buffers, textures and pipelines.
    pub(super) device: wgpu::Device,
    /// Takes writes and submissions, in order.
    pub(super) queue: wgpu::Queue,
    /// Adapter and driver, for messages.
    pub(super) name: String,
    /// Longest side of an image, pixels.
    pub(super) size_px_max: u32,
    /// The first report since the last [`Self::check`]; later ones are its consequences.
    error: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Opens the best Vulkan adapter: a discrete GPU before an integrated one before a software
    /// rasteriser. Several that are alike take turns, so that a machine's GPUs share what its
    /// renderers draw.
    pub(super) fn open() -> Result<Self, RenderError> {
        let mut description = wgpu::InstanceDescriptor::new_without_display_handle();
        description.backends = wgpu::Backends::VULKAN;
        // No validation layers: they may be absent, and they print.
        description.flags = wgpu::InstanceFlags::empty();
        let instance = wgpu::Instance::new(description);
        let mut adapters = ready(instance.enumerate_adapters(wgpu::Backends::VULKAN))?;
        adapters.sort_by_key(|adapter| preference(adapter.get_info().device_type));
        let best = adapters.first().ok_or(RenderError::NoAdapter)?.get_info();
        adapters.retain(|adapter| {
            let info = adapter.get_info();
            (info.device_type, &info.name) == (best.device_type, &best.name)
        });
        let turn = turn() % adapters.len().max(1);
        let adapter = adapters
            .into_iter()
            .nth(turn)
            .ok_or(RenderError::NoAdapter)?;
        let info = adapter.get_info();
        let limits = wgpu::Limits::downlevel_defaults().using_resolution(adapter.limits());
        let size_px_max = limits.max_texture_dimension_2d;
        let (device, queue) = ready(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("renderer"),
            required_limits: limits,
            ..Default::default()
        }))?
        .map_err(|error| RenderError::Device {
            adapter: info.name.clone(),
            reason: error.to_string(),
        })?;
        let error = Arc::new(Mutex::new(None));
        let first = Arc::clone(&error);
        device.on_uncaptured_error(Arc::new(move |report: wgpu::Error| {
            first
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .get_or_insert_with(|| report.to_string());
        }));
        Ok(Self {
            device,
            queue,
            name: format!("{} ({})", info.name, info.driver),
            size_px_max,
            error,
        })
    }

    /// Fails with what the device has complained about since the last call, if it has.
    pub(super) fn check(&self) -> Result<(), RenderError> {
        match self
            .error
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
        {
            Some(reason) => Err(RenderError::Gpu(reason)),
            None => Ok(()),
        }
    }

    /// Waits until all submitted work is done.
    pub(super) fn finish(&self) -> Result<(), RenderError> {
        self.poll(wgpu::PollType::wait_indefinitely())
    }

    /// Waits until `submission` is done.
    pub(super) fn wait(&self, submission: wgpu::SubmissionIndex) -> Result<(), RenderError> {
        self.poll(wgpu::PollType::Wait {
            submission_index: Some(submission),
            timeout: None,
        })
    }

    /// Drives the device's callbacks on this thread, then looks at its errors.
    fn poll(&self, what: wgpu::PollType) -> Result<(), RenderError> {
        self.device
            .poll(what)
            .map_err(|error| RenderError::Gpu(error.to_string()))?;
        self.check()
    }
}

/// Which of several GPUs that are alike is this renderer's: processes begin apart, and those of one
/// process follow each other.
fn turn() -> usize {
    static RENDERERS: AtomicUsize = AtomicUsize::new(0);
    let process = usize::try_from(std::process::id()).unwrap_or_default();
    process.wrapping_add(RENDERERS.fetch_add(1, Ordering::Relaxed))
}

/// Lower is better. Adapters of one kind stay in the order in which the loader lists them.
const fn preference(kind: wgpu::DeviceType) -> u8 {
    match kind {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Cpu => 3,
        wgpu::DeviceType::Other => 4,
    }
}

/// The value of a future that is ready at once, as all of wgpu's are on Vulkan.
fn ready<T>(future: impl Future<Output = T>) -> Result<T, RenderError> {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => Ok(value),
        Poll::Pending => Err(RenderError::Gpu(
            "the device did not answer at once".to_owned(),
        )),
    }
}
