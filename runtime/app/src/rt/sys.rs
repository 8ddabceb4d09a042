//! The system calls, one thin function each. All unsafe code of the runtime is here and in the
//! counting allocator.
#![expect(
    unsafe_code,
    reason = "libc calls; each takes only memory that this module owns or borrows"
)]

use std::io;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

const NS_PER_S: u64 = 1_000_000_000;

/// Longest look at two clocks that counts as one instant, ns.
const LOOK_NS_MAX: u64 = 1_000_000;

/// The variable of the environment that [`slow_motion`] reads.
pub(super) const SLOW_MOTION: &str = "TROCAR_SLOW_MOTION";

/// Most that clocks may be slowed down.
pub(super) const SLOW_MOTION_MAX: u64 = 100;

/// What the environment says of it.
pub(super) fn wanted_slow_motion() -> Result<u64, String> {
    std::env::var_os(SLOW_MOTION).map_or(Ok(1), |text| {
        let text = text.to_string_lossy();
        parse_slow_motion(&text).ok_or_else(|| text.into_owned())
    })
}

/// A whole number from 1 to `SLOW_MOTION_MAX`; none of anything else.
fn parse_slow_motion(text: &str) -> Option<u64> {
    let factor = text.parse().ok()?;
    (1..=SLOW_MOTION_MAX).contains(&factor).then_some(factor)
}

/// How many times slower than the system's all clocks of this process run: 1 if the environment
/// says nothing that has a meaning.
pub(super) fn slow_motion() -> u64 {
    static FACTOR: OnceLock<u64> = OnceLock::new();
    *FACTOR.get_or_init(|| wanted_slow_motion().unwrap_or(1))
}

/// Gives a variable of the environment that is not set a value.
///
/// Nobody else may read or write the environment meanwhile: the caller is the process' only thread.
pub(super) fn set_unset_environment(name: &str, value: &str) {
    // Set but empty means not set.
    if std::env::var_os(name).is_none_or(|set| set.is_empty()) {
        // SAFETY: the caller is the only thread, as it says.
        unsafe { std::env::set_var(name, value) };
    }
}

/// Ends the process with `code`, and without what libraries would do at its end.
pub(super) fn end_process(code: u8) -> ! {
    // SAFETY: it takes a number and never returns.
    unsafe { libc::_exit(i32::from(code)) }
}

/// The monotonic clock, ns since an arbitrary point.
pub(super) fn monotonic_ns() -> u64 {
    system_ns() / slow_motion()
}

/// Time since 1970, s; for people and for files that other programs read.
pub(super) fn unix_seconds() -> f64 {
    let now_ns = wall_ns();
    #[expect(clippy::cast_precision_loss, reason = "both stay far below 2^52")]
    let (seconds, nanoseconds) = ((now_ns / NS_PER_S) as f64, (now_ns % NS_PER_S) as f64);
    seconds + nanoseconds * 1e-9
}

/// Time since 1970, ns.
pub(super) fn wall_ns() -> u64 {
    clock_ns(libc::CLOCK_REALTIME)
}

/// How far that is ahead of the system's monotonic clock, ns; none if this thread was kept from its
/// core between the looks at both.
pub(super) fn wall_ahead_ns() -> Option<i64> {
    let (before, wall, after) = (system_ns(), wall_ns(), system_ns());
    let between = before.midpoint(after);
    (after - before < LOOK_NS_MAX).then(|| wall.wrapping_sub(between).cast_signed())
}

/// CLOCK_MONOTONIC as it is, not slowed down; ns since the machine started, without the time in
/// which it was suspended.
fn system_ns() -> u64 {
    clock_ns(libc::CLOCK_MONOTONIC)
}

/// The vDSO answers it on most machines, without a system call.
fn clock_ns(clock: libc::clockid_t) -> u64 {
    let mut now = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: `now` is a live timespec. The call cannot fail for the clocks of this module on
    // Linux.
    unsafe { libc::clock_gettime(clock, &raw mut now) };
    now.tv_sec.cast_unsigned() * NS_PER_S + now.tv_nsec.cast_unsigned()
}

/// Sleeps until [`monotonic_ns`] reaches `deadline_ns`; signals do not cut it short.
pub(super) fn sleep_until_ns(deadline_ns: u64) {
    let deadline_ns = deadline_ns.saturating_mul(slow_motion());
    let deadline = libc::timespec {
        tv_sec: (deadline_ns / NS_PER_S).cast_signed(),
        tv_nsec: (deadline_ns % NS_PER_S).cast_signed(),
    };
    loop {
        let remaining = core::ptr::null_mut();
        // SAFETY: `deadline` is a live, normalised timespec; with an absolute deadline the last
        // pointer may be null.
        let code = unsafe {
            libc::clock_nanosleep(
                libc::CLOCK_MONOTONIC,
                libc::TIMER_ABSTIME,
                &raw const deadline,
                remaining,
            )
        };
        if code != libc::EINTR {
            return;
        }
    }
}

/// Puts the calling thread under `SCHED_FIFO`. The priority is 1 to 99; needs `CAP_SYS_NICE` or a
/// limit `rtprio`.
pub(super) fn set_fifo(priority: u8) -> io::Result<()> {
    let parameters = libc::sched_param {
        sched_priority: i32::from(priority),
    };
    // SAFETY: pid 0 is the calling thread and `parameters` is live.
    checked(unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) })
}

/// Keeps the calling thread on one core. A core that is not there, or not this process', is the
/// system's error.
pub(super) fn pin_to(cpu: usize) -> io::Result<()> {
    let capacity = usize::try_from(libc::CPU_SETSIZE).unwrap_or(0);
    if cpu >= capacity {
        return Err(io::Error::from_raw_os_error(libc::EINVAL));
    }
    // SAFETY: a cpu set is an array of integers, for which zero is a value.
    let mut set: libc::cpu_set_t = unsafe { core::mem::zeroed() };
    // SAFETY: `cpu` is below the set's capacity.
    unsafe { libc::CPU_SET(cpu, &mut set) };
    // SAFETY: pid 0 is the calling thread and `set` is live and of the size given.
    checked(unsafe { libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const set) })
}

/// Keeps the pages of everything that the process has mapped in memory, once they are touched.
///
/// Pages are locked as they are touched: locking all of the network library's code would take
/// hundreds of megabytes. What is mapped later is not locked, so that it does not count against the
/// limit: topics that open later must not fail for it.
pub(super) fn lock_memory() -> io::Result<()> {
    // SAFETY: the call takes no pointers.
    checked(unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_ONFAULT) })
}

/// Keeps `memory` in memory until it is unmapped.
pub(super) fn lock(memory: &[u8]) -> io::Result<()> {
    // SAFETY: the range is borrowed, and locking changes nothing in it.
    checked(unsafe { libc::mlock(memory.as_ptr().cast(), memory.len()) })
}

/// Page faults (minor, major) and context switches (voluntary, involuntary) of the calling thread.
pub(super) fn thread_usage() -> io::Result<[u64; 4]> {
    // SAFETY: rusage is plain integers, for which zero is a value.
    let mut usage: libc::rusage = unsafe { core::mem::zeroed() };
    // SAFETY: `usage` is a live rusage.
    checked(unsafe { libc::getrusage(libc::RUSAGE_THREAD, &raw mut usage) })?;
    let counts = [
        usage.ru_minflt,
        usage.ru_majflt,
        usage.ru_nvcsw,
        usage.ru_nivcsw,
    ];
    Ok(counts.map(|count| u64::try_from(count).unwrap_or(0)))
}

/// How much memory the process may lock without a privilege.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MemoryLockLimit {
    /// Any amount.
    Unlimited,
    /// So many bytes.
    Bytes(u64),
}

/// The soft limit on locked memory.
///
/// # Errors
/// The system's.
pub fn memory_lock_limit() -> io::Result<MemoryLockLimit> {
    let mut limit = libc::rlimit {
        rlim_cur: 0,
        rlim_max: 0,
    };
    // SAFETY: `limit` is a live rlimit.
    checked(unsafe { libc::getrlimit(libc::RLIMIT_MEMLOCK, &raw mut limit) })?;
    if limit.rlim_cur == libc::RLIM_INFINITY {
        return Ok(MemoryLockLimit::Unlimited);
    }
    Ok(MemoryLockLimit::Bytes(limit.rlim_cur))
}

/// Tries to lock `bytes` of fresh memory, and gives them back.
///
/// # Errors
/// The system's refusal.
pub fn can_lock_bytes(bytes: usize) -> io::Result<()> {
    let memory = vec![0_u8; bytes];
    // SAFETY: the range is a live allocation.
    checked(unsafe { libc::mlock(memory.as_ptr().cast(), memory.len()) })?;
    // SAFETY: as above.
    checked(unsafe { libc::munlock(memory.as_ptr().cast(), memory.len()) })
}

/// How many signals have asked the process to end, and how many of those are wishes: one more ends
/// it at once.
static INTERRUPTS: AtomicU32 = AtomicU32::new(0);
/// How many signals only ask for the end: 1, or 2 while arms move.
static WISHES: AtomicU32 = AtomicU32::new(1);

/// Runs inside the signal: nothing but atomics and what POSIX calls async-signal-safe is allowed
/// there.
extern "C" fn note_interrupt(signal: libc::c_int) {
    let before = INTERRUPTS.fetch_add(1, Ordering::AcqRel);
    if before >= WISHES.load(Ordering::Acquire) {
        // SAFETY: the call is async-signal-safe and takes no pointers.
        unsafe { libc::signal(signal, libc::SIG_DFL) };
        // SAFETY: the same; the signal strikes when this handler returns.
        unsafe { libc::raise(signal) };
    }
}

/// Makes the next SIGINT, SIGTERM or SIGHUP a wish that [`interrupted`] tells of; a second one ends
/// the process at once.
///
/// # Errors
/// The system's.
pub fn catch_interrupts() -> io::Result<()> {
    WISHES.store(1, Ordering::Release);
    catch()
}

/// As [`catch_interrupts`] while arms move: wrappers such as `timeout` and terminals may send a
/// signal twice, so that a second one is a wish too and only a third ends the process at once,
/// until [`arms_rest`].
///
/// # Errors
/// The system's.
pub fn catch_interrupts_in_motion() -> io::Result<()> {
    WISHES.store(2, Ordering::Release);
    catch()
}

/// From now on the next signal ends the process at once, if one has come before.
pub fn arms_rest() {
    WISHES.store(1, Ordering::Release);
}

/// Installs the handler for the three signals and forgets those that came before. `SA_RESTART`
/// keeps blocking calls from failing with `EINTR`.
fn catch() -> io::Result<()> {
    INTERRUPTS.store(0, Ordering::Release);
    for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP] {
        // SAFETY: sigaction is integers, a mask and an optional function, for which zero is a
        // value.
        let mut action: libc::sigaction = unsafe { core::mem::zeroed() };
        let handler: extern "C" fn(libc::c_int) = note_interrupt;
        action.sa_sigaction = handler as libc::sighandler_t;
        action.sa_flags = libc::SA_RESTART;
        // SAFETY: `action` is live, and its handler does only what a handler may.
        checked(unsafe { libc::sigaction(signal, &raw const action, core::ptr::null_mut()) })?;
    }
    Ok(())
}

/// Whether one of those signals has come since [`catch_interrupts`].
#[must_use]
pub fn interrupted() -> bool {
    INTERRUPTS.load(Ordering::Acquire) > 0
}

/// Sends SIGINT to the process `id`.
///
/// # Errors
/// The system's, such as that there is no such process.
pub fn interrupt_process(id: u32) -> io::Result<()> {
    let id = libc::pid_t::try_from(id).map_err(io::Error::other)?;
    // SAFETY: the call takes no pointers.
    checked(unsafe { libc::kill(id, libc::SIGINT) })
}

/// Greatest memory of the process `id` so far, bytes. `VmHWM` of `/proc`; none of a process that
/// has ended.
pub(crate) fn peak_memory(id: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{id}/status")).ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

/// Makes this process get SIGINT when the thread that started it ends, however that happens.
///
/// # Errors
/// The system's; or if `parent` is not the parent any more, which ended before this call.
pub fn end_with_parent(parent: u32) -> io::Result<()> {
    // SAFETY: the call takes a number besides the option.
    checked(unsafe { libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGINT) })?;
    if std::os::unix::process::parent_id() == parent {
        return Ok(());
    }
    Err(io::Error::other(
        "the process that started this one is gone",
    ))
}

/// The error of a call that answers with a code other than 0 and sets `errno`.
fn checked(code: libc::c_int) -> io::Result<()> {
    if code == 0 {
        Ok(())
    } else {
        Err(io::Error::last_os_error())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Slow motion is a whole number from 1 to 100 and nothing else.
    #[test]
    fn slow_motion_is_a_whole_number_from_1_to_100() {
        for (text, factor) in [("1", 1), ("6", 6), ("100", 100)] {
            assert_eq!(parse_slow_motion(text), Some(factor));
        }
        for text in ["", "0", "101", "-2", "1.5", "six", " 6", "6x"] {
            assert_eq!(parse_slow_motion(text), None, "{text:?}");
        }
    }
}
