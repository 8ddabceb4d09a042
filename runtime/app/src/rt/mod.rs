//! The clock, sleeping and what the operating system grants a real-time thread; nothing else in the
//! runtime has these.

mod allocations;
mod held;
mod periodic;
mod profile;
mod sys;
mod thread;
mod wall;

use hal::TimeNs;
use trocar_topics::Events;

pub use allocations::{CountingAllocator, thread_allocations};
pub use held::{CPU_DMA_LATENCY, Held, hold_cpu_latency};
pub use periodic::{Periodic, Wake};
pub use profile::RtProfile;
pub(crate) use sys::peak_memory;
pub use sys::{
    MemoryLockLimit, arms_rest, can_lock_bytes, catch_interrupts, catch_interrupts_in_motion,
    end_with_parent, interrupt_process, interrupted, memory_lock_limit,
};
pub use thread::{
    Grant, RtOptions, RtRefused, RtReport, ThreadFaults, configure_thread, lock_memory,
    thread_faults,
};
pub use wall::{WallClock, wall_time};

/// How many times slower than the system's the clocks of this process run; 1 unless
/// `TROCAR_SLOW_MOTION` in its environment says otherwise, a whole number up to 100
/// ([`check_slow_motion`]).
///
/// For machines that are too slow for a run in real time, such as a kernel inside a kernel:
/// emulated drives and their controller, slowed down alike, do the same as ever. A real drive does
/// not slow down; it hears no SYNC in time and stops.
#[must_use]
pub fn slow_motion() -> u64 {
    sys::slow_motion()
}

/// `TROCAR_SLOW_MOTION` in the environment is nothing that clocks can be slowed down by.
#[derive(Debug, thiserror::Error)]
#[error("TROCAR_SLOW_MOTION = {value:?} in the environment: allowed are whole numbers in [1, {max}]", max = sys::SLOW_MOTION_MAX)]
pub struct BadSlowMotion {
    /// What it is.
    pub value: String,
}

/// Whether [`slow_motion`] is what the environment asks for. Without this a value that means
/// nothing counts as 1.
///
/// # Errors
/// [`BadSlowMotion`] with the value.
pub fn check_slow_motion() -> Result<(), BadSlowMotion> {
    let wanted = sys::wanted_slow_motion();
    wanted.map(|_| ()).map_err(|value| BadSlowMotion { value })
}

/// Gives this process and its children a folder for XDG_RUNTIME_DIR if it has none: each renderer
/// of Mesa's would complain otherwise, though it shows no window. To be called first of all, before
/// there is a second thread.
pub fn quieten_mesa() {
    sys::set_unset_environment("XDG_RUNTIME_DIR", "/tmp");
}

/// Ends the process with the exit code `code`: libtorch would take its operators down one by one,
/// which is a third of what a short command takes. To be called last of all, when nothing is left
/// to be dropped or flushed.
pub fn end_process(code: u8) -> ! {
    sys::end_process(code)
}

/// The system's monotonic clock, slowed down if [`slow_motion`] says so, counted from where it was
/// made.
#[derive(Clone, Copy, Debug)]
pub struct MonotonicClock {
    origin_ns: u64,
}

impl MonotonicClock {
    /// A clock that reads zero now.
    #[must_use]
    pub fn new() -> Self {
        Self {
            origin_ns: sys::monotonic_ns(),
        }
    }

    /// Time since the clock was made.
    #[must_use]
    pub fn now(&self) -> TimeNs {
        TimeNs(sys::monotonic_ns().saturating_sub(self.origin_ns))
    }

    /// What the system's own clock, which all processes share, says at `at`, ns.
    #[must_use]
    pub const fn to_system(&self, at: TimeNs) -> TimeNs {
        at.plus_ns(self.origin_ns)
    }

    /// When the system's own clock said `at`; zero for what was before this one was made.
    #[must_use]
    pub const fn from_system(&self, at: TimeNs) -> TimeNs {
        TimeNs(at.since(TimeNs(self.origin_ns)))
    }

    /// Sleeps until `deadline`; returns at once if it has passed.
    pub fn wait_until(&self, deadline: TimeNs) {
        sys::sleep_until_ns(self.origin_ns.saturating_add(deadline.0));
    }
}

impl Default for MonotonicClock {
    fn default() -> Self {
        Self::new()
    }
}

/// What the calendar says, as seconds since 1970: for people and for files that other programs
/// read, never for a duration.
#[must_use]
pub fn unix_seconds() -> f64 {
    sys::unix_seconds()
}

/// What this machine is: its name, its processor, its kernel.
#[must_use]
pub fn machine() -> String {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let name = read("/proc/sys/kernel/hostname");
    let kernel = read("/proc/sys/kernel/osrelease");
    let processors = read("/proc/cpuinfo");
    let model = processors
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'))
        .map_or("unknown processor", |(_, model)| model.trim());
    format!("{}, {model}, Linux {}", name.trim(), kernel.trim())
}

/// Waits until something is published on the run's topics, for `at_most_ns`; never for the control
/// thread.
pub fn wait(events: &Events, at_most_ns: u64) {
    events.wait(at_most_ns.saturating_mul(slow_motion()));
}

/// Sleeps for `duration_ns` at least; for threads that poll, never for the control thread.
pub fn sleep_ns(duration_ns: u64) {
    sys::sleep_until_ns(sys::monotonic_ns().saturating_add(duration_ns));
}
