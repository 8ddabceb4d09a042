//! Making the calling thread a real-time thread, as far as the system lets us.

use core::fmt;

use serde::Serialize;

use super::sys;

/// Stack that is touched in advance, bytes. An eighth of what a Rust thread has by default.
const STACK_BYTES: usize = 256 * 1024;

/// What the control thread asks of the system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RtOptions {
    /// `SCHED_FIFO` priority, 1 to 99.
    pub priority: Option<u8>,
    /// The core to stay on.
    pub cpu: Option<usize>,
    /// Whether to keep the thread's stack in memory; the rest is [`lock_memory`]'s.
    pub lock_stack: bool,
    /// Whether a refusal is an error.
    pub strict: bool,
}

/// What became of one wish.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Grant {
    /// It was not asked for.
    NotAsked,
    /// It is so.
    Granted,
    /// It is not, and why.
    Refused(String),
}

impl Grant {
    /// None is a request that was not made.
    fn of(result: Option<std::io::Result<()>>) -> Self {
        match result {
            None => Self::NotAsked,
            Some(Ok(())) => Self::Granted,
            Some(Err(error)) => Self::Refused(error.to_string()),
        }
    }

    /// Whether the system said no.
    #[must_use]
    pub const fn is_refused(&self) -> bool {
        matches!(self, Self::Refused(_))
    }
}

impl fmt::Display for Grant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAsked => write!(f, "not asked for"),
            Self::Granted => write!(f, "granted"),
            Self::Refused(reason) => write!(f, "refused ({reason})"),
        }
    }
}

/// What became of each wish.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RtReport {
    /// `SCHED_FIFO`.
    pub fifo: Grant,
    /// The core.
    pub cpu: Grant,
    /// Locked memory: of the thread its stack, of a run's control thread the process's too.
    pub memory: Grant,
    /// Cores out of idle states: the process's wish, of a run's control thread.
    pub cpu_latency: Grant,
}

impl RtReport {
    /// Whether the system refused something.
    #[must_use]
    pub fn any_refused(&self) -> bool {
        let all = [&self.fifo, &self.cpu, &self.memory, &self.cpu_latency];
        all.into_iter().any(Grant::is_refused)
    }
}

impl fmt::Display for RtReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "SCHED_FIFO {}, core {}, locked memory {}, awake cores {}",
            self.fifo, self.cpu, self.memory, self.cpu_latency
        )
    }
}

/// The system refused something that strict options insist on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the control thread did not get what it insists on: {0}; see `trocar doctor`")]
pub struct RtRefused(pub RtReport);

/// Keeps in memory what the process has mapped, page by page as it is touched. It takes tens of
/// milliseconds, so that it comes before the first deadline, and after all is mapped that the loop
/// uses: what is mapped later is not locked, nor does it count against the limit.
#[must_use]
pub fn lock_memory() -> Grant {
    Grant::of(Some(sys::lock_memory()))
}

/// Applies `options` to the calling thread and touches its stack in advance.
///
/// # Errors
/// [`RtRefused`] if the options are strict and the system refused something; everything grantable
/// is applied all the same.
pub fn configure_thread(options: &RtOptions) -> Result<RtReport, RtRefused> {
    let report = RtReport {
        memory: Grant::of(options.lock_stack.then(lock_stack)),
        cpu: Grant::of(options.cpu.map(sys::pin_to)),
        fifo: Grant::of(options.priority.map(sys::set_fifo)),
        cpu_latency: Grant::NotAsked,
    };
    if !options.lock_stack {
        touch_stack(|_| ());
    }
    if options.strict && report.any_refused() {
        return Err(RtRefused(report));
    }
    Ok(report)
}

/// Keeps the stack that ticks will use in memory.
fn lock_stack() -> std::io::Result<()> {
    let mut locked = Ok(());
    touch_stack(|pages| locked = sys::lock(pages));
    locked
}

/// Writes to the stack that ticks will use, so that they fault no page in.
#[inline(never)]
#[expect(
    clippy::large_stack_arrays,
    reason = "taking that much stack is the point"
)]
fn touch_stack(then: impl FnOnce(&[u8])) {
    let mut pages = [0_u8; STACK_BYTES];
    pages.iter_mut().step_by(4096).for_each(|byte| *byte = 1);
    then(core::hint::black_box(&pages));
}

/// What disturbed the calling thread since it began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ThreadFaults {
    /// Page faults served from memory.
    pub minor: u64,
    /// Page faults that waited for a disk.
    pub major: u64,
    /// Times it gave up its core.
    pub voluntary_switches: u64,
    /// Times its core was taken.
    pub involuntary_switches: u64,
}

impl ThreadFaults {
    /// The increase since `earlier`.
    #[must_use]
    pub const fn since(&self, earlier: &Self) -> Self {
        Self {
            minor: self.minor.saturating_sub(earlier.minor),
            major: self.major.saturating_sub(earlier.major),
            voluntary_switches: self
                .voluntary_switches
                .saturating_sub(earlier.voluntary_switches),
            involuntary_switches: self
                .involuntary_switches
                .saturating_sub(earlier.involuntary_switches),
        }
    }
}

/// What disturbed the calling thread since it began; zeros where the system does not say.
#[must_use]
pub fn thread_faults() -> ThreadFaults {
    let [minor, major, voluntary_switches, involuntary_switches] =
        sys::thread_usage().unwrap_or_default();
    ThreadFaults {
        minor,
        major,
        voluntary_switches,
        involuntary_switches,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOTHING: RtOptions = RtOptions {
        priority: None,
        cpu: None,
        lock_stack: false,
        strict: true,
    };

    #[test]
    fn nothing_asked_is_nothing_refused() {
        let report = configure_thread(&NOTHING).unwrap();
        assert_eq!(
            (&report.fifo, &report.cpu, &report.memory),
            (&Grant::NotAsked, &Grant::NotAsked, &Grant::NotAsked)
        );
    }

    #[test]
    fn refusal_is_reported_and_an_error_only_if_strict() {
        std::thread::spawn(|| {
            for cpu in [100_000, 1023] {
                let lenient = RtOptions {
                    cpu: Some(cpu),
                    strict: false,
                    ..NOTHING
                };
                let report = configure_thread(&lenient).unwrap();
                assert!(report.cpu.is_refused() && report.any_refused(), "{report}");
                let refused = configure_thread(&RtOptions {
                    strict: true,
                    ..lenient
                })
                .unwrap_err();
                assert!(refused.to_string().contains("core refused"), "{refused}");
            }
        })
        .join()
        .unwrap();
    }

    #[test]
    fn impossible_priority_is_refused() {
        std::thread::spawn(|| {
            let report = configure_thread(&RtOptions {
                priority: Some(200),
                strict: false,
                ..NOTHING
            })
            .unwrap();
            assert!(report.fifo.is_refused(), "{report}");
        })
        .join()
        .unwrap();
    }

    #[test]
    fn touching_new_memory_counts_as_faults() {
        let before = thread_faults();
        let mut fresh = vec![0_u8; 64 << 20];
        fresh.iter_mut().step_by(4096).for_each(|byte| *byte = 1);
        core::hint::black_box(&fresh);
        let during = thread_faults().since(&before);
        assert!(during.minor > 16, "{during:?}");
    }
}
