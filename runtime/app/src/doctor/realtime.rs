//! Scheduling, memory locking, cores and the timer. What can be tried is tried, since limits,
//! capabilities and control groups may each refuse it; kernel and cores are read from `/proc` and
//! `/sys`. Where these files are not there, as in a container, the answer is the cautious one.

use std::fs;
use std::path::{Path, PathBuf};
use std::thread;

use super::{Finding, Status};
use crate::histogram::Histogram;
use crate::rt::{
    CPU_DMA_LATENCY, Grant, MemoryLockLimit, MonotonicClock, Periodic, RtOptions, can_lock_bytes,
    configure_thread, hold_cpu_latency, memory_lock_limit,
};

/// `SCHED_FIFO` priority of the try, the control thread's in `config/realtime.toml`.
const PRIORITY: u8 = 80;
/// Periods of the timer measurement, 1 ms each.
const TIMER_PERIODS: u32 = 300;
/// Worst lateness that a 1 kHz loop can take without a thought, ns.
const TIMER_GOOD_NS: u64 = 200_000;
/// Where control groups are.
const GROUPS: &str = "/sys/fs/cgroup";
/// Memory that a control process locks, more than most limits allow.
const LOCK_BYTES: usize = 64 << 20;

/// Whether it is built for real time (PREEMPT_RT): by the flag of newer kernels or by its version's
/// text. Without that, wake-ups are late by what the kernel can't interrupt.
pub(super) fn kernel() -> Finding {
    let version = fs::read_to_string("/proc/version").unwrap_or_default();
    let release = version
        .split_whitespace()
        .nth(2)
        .unwrap_or("unknown")
        .to_owned();
    let flagged = fs::read_to_string("/sys/kernel/realtime").is_ok_and(|flag| flag.trim() == "1");
    let (status, kind) = if flagged || version.contains("PREEMPT_RT") {
        (Status::Ok, "PREEMPT_RT")
    } else {
        (Status::Limited, "not a real-time kernel")
    };
    Finding::new(
        "kernel",
        status,
        format!("{release}, {kind}"),
        "`sudo apt install linux-image-rt-amd64 && sudo reboot`",
    )
}

/// How many there are, whether any is isolated, and whether a control group cuts their time: a
/// quota stops threads of the ordinary class for the rest of the group's period once it is used up.
pub(super) fn cores() -> Finding {
    let count = thread::available_parallelism().map_or(1, usize::from);
    let isolated = fs::read_to_string("/sys/devices/system/cpu/isolated").unwrap_or_default();
    let isolated = isolated.trim();
    let status = if isolated.is_empty() || count < 2 {
        Status::Limited
    } else {
        Status::Ok
    };
    let kept = if isolated.is_empty() {
        "none isolated".to_owned()
    } else {
        format!("isolated: {isolated}")
    };
    let found = format!("{count} usable, {kept}");
    let Some((quota, file)) = own_group().and_then(|own| quota(Path::new(GROUPS), &own)) else {
        return Finding::new("cores", status, found, &isolation(count));
    };
    let found = format!("{found}; the control group may use {quota:.1} cores' time");
    let lifts = format!(
        "`echo max | sudo tee {}`; {}",
        file.display(),
        isolation(count)
    );
    Finding::new("cores", Status::Limited, found, &lifts)
}

/// The control group of this process in cgroup v2.
fn own_group() -> Option<String> {
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    let own = groups.lines().find_map(|line| line.strip_prefix("0::"));
    own.map(str::to_owned)
}

/// How many cores' time a control group below `root` may use in cgroup v2, and the file that says
/// so: the least `cpu.max` of its own and those above it. None where no `cpu.max` has a number,
/// that is where all is `max`.
fn quota(root: &Path, group: &str) -> Option<(f64, PathBuf)> {
    let group = root.join(group.trim_start_matches('/'));
    let limits = group.ancestors().take_while(|at| at.starts_with(root));
    let limits = limits.filter_map(|at| {
        let file = at.join("cpu.max");
        let text = fs::read_to_string(&file).ok()?;
        let (quota, period) = text.trim().split_once(' ')?;
        let [quota, period] = [quota, period].map(|us| us.parse::<f64>().ok());
        Some((quota? / period?, file))
    });
    limits.min_by(|one, other| one.0.total_cmp(&other.0))
}

/// The commands that keep the last of `count` cores for the control thread.
fn isolation(count: usize) -> String {
    let last = count.saturating_sub(1);
    if last == 0 {
        return "a machine with two cores or more".to_owned();
    }
    format!(
        "isolcpus={last} nohz_full={last} rcu_nocbs={last} in GRUB_CMDLINE_LINUX of /etc/default/grub, then `sudo update-grub && sudo reboot`; \
         `trocar run --set realtime.control.cpu={last}`"
    )
}

/// The command that allows every user's processes `item` (of limits.conf(5)) up to `value`, from
/// the next login on.
fn allowing(item: &str, value: &str) -> String {
    format!(
        "`echo '* - {item} {value}' | sudo tee /etc/security/limits.d/trocar-{item}.conf`, then log in again"
    )
}

/// Whether a thread gets `SCHED_FIFO`, tried on one of its own.
pub(super) fn fifo() -> Finding {
    let name = "scheduling";
    match on_a_thread_under_fifo(|| ()) {
        (Grant::Granted, _) => Finding::new(
            name,
            Status::Ok,
            format!("SCHED_FIFO {PRIORITY} granted"),
            "",
        ),
        (refused @ (Grant::Refused(_) | Grant::NotAsked), _) => Finding::new(
            name,
            Status::Limited,
            format!("SCHED_FIFO {PRIORITY} {refused}"),
            &format!("{}{}", allowing("rtprio", "90"), throttled_group()),
        ),
    }
}

/// What else holds it back where the kernel shares real-time out among control groups and gives
/// this one none. In cgroup v2 no group but the root can be given any.
fn throttled_group() -> &'static str {
    let none = |path: &str| fs::read_to_string(path).is_ok_and(|us| us.trim() == "0");
    let release = fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
    let config = fs::read_to_string(format!("/boot/config-{}", release.trim()));
    let shares = || config.is_ok_and(|config| config.contains("CONFIG_RT_GROUP_SCHED=y"));
    if none("/sys/fs/cgroup/cpu/user.slice/cpu.rt_runtime_us") {
        "; the control group has no real-time: `echo 950000 | sudo tee /sys/fs/cgroup/cpu/user.slice/cpu.rt_runtime_us`"
    } else if Path::new(GROUPS).join("cgroup.controllers").exists() && shares() {
        "; this kernel (CONFIG_RT_GROUP_SCHED) may refuse it to all but the root control group: `echo $$ | sudo tee /sys/fs/cgroup/cgroup.procs` \
         in the shell that starts the run"
    } else {
        ""
    }
}

/// Runs `work` on a thread of its own that asks for SCHED_FIFO. If that is refused the work runs in
/// the ordinary class; the grant says which it was.
fn on_a_thread_under_fifo<R: Send + Default>(work: impl FnOnce() -> R + Send) -> (Grant, R) {
    let asking = RtOptions {
        priority: Some(PRIORITY),
        cpu: None,
        lock_stack: false,
        strict: false,
    };
    thread::scope(|scope| {
        let handle = scope.spawn(|| {
            let grant = configure_thread(&asking)
                .map_or_else(|refused| refused.0.fifo, |report| report.fifo);
            (grant, work())
        });
        handle
            .join()
            .unwrap_or_else(|_| (Grant::Refused("the thread died".to_owned()), R::default()))
    })
}

/// Whether `LOCK_BYTES` can be locked, tried and given back; the limit stands beside it.
pub(super) fn memory_locking() -> Finding {
    let limit = match memory_lock_limit() {
        Ok(MemoryLockLimit::Unlimited) => "limit: none".to_owned(),
        Ok(MemoryLockLimit::Bytes(bytes)) => format!("limit: {} KiB", bytes >> 10),
        Err(error) => format!("limit unknown ({error})"),
    };
    let amount = LOCK_BYTES >> 20;
    let (status, detail) = match can_lock_bytes(LOCK_BYTES) {
        Ok(()) => (Status::Ok, format!("{amount} MiB locked; {limit}")),
        Err(error) => (
            Status::Limited,
            format!("{amount} MiB refused ({error}); {limit}"),
        ),
    };
    Finding::new(
        "memory locking",
        status,
        detail,
        &allowing("memlock", "unlimited"),
    )
}

/// Whether cores can be kept out of idle states, and how long they take to leave the deepest one.
pub(super) fn idle_states() -> Finding {
    let slowest = match slowest_exit_us() {
        Some(us) => format!("a core takes up to {us} us to leave one"),
        None => "the system knows none here".to_owned(),
    };
    let (status, can) = match hold_cpu_latency(Path::new(CPU_DMA_LATENCY)) {
        Ok(_) => (Status::Ok, "`hold_cpu_dma_latency` works".to_owned()),
        Err(error) => (
            Status::Limited,
            format!("`hold_cpu_dma_latency` refused ({error})"),
        ),
    };
    Finding::new(
        "idle states",
        status,
        format!("{slowest}; {can}"),
        "`echo 'KERNEL==\"cpu_dma_latency\", MODE=\"0666\"' | sudo tee /etc/udev/rules.d/90-trocar.rules && sudo udevadm control --reload \
         && sudo udevadm trigger --name-match=cpu_dma_latency`",
    )
}

/// The longest time that the first core takes to leave an idle state, us; none where it has no such
/// states.
fn slowest_exit_us() -> Option<u64> {
    let states = fs::read_dir("/sys/devices/system/cpu/cpu0/cpuidle").ok()?;
    let latency = |state: fs::DirEntry| {
        let text = fs::read_to_string(state.path().join("latency")).ok()?;
        text.trim().parse().ok()
    };
    states.flatten().filter_map(latency).max()
}

/// How late a 1 kHz thread wakes on this machine as it is now, over `TIMER_PERIODS`. A short
/// sample: it finds a machine that is unfit, and proves none fit.
pub(super) fn timer() -> Finding {
    let (grant, late) = on_a_thread_under_fifo(lateness);
    let microseconds = |fraction: f64| late.percentile(fraction) / 1_000;
    let detail = format!(
        "1 kHz wake-up late by p50 {} us, p99 {} us, max {} us ({})",
        microseconds(0.5),
        microseconds(0.99),
        late.max() / 1_000,
        if grant == Grant::Granted {
            "SCHED_FIFO"
        } else {
            "ordinary scheduling"
        }
    );
    let status = if late.max() <= TIMER_GOOD_NS {
        Status::Ok
    } else {
        Status::Limited
    };
    Finding::new(
        "timer",
        status,
        detail,
        "compare with `cyclictest`; real-time kernel, isolated core, no virtual machine",
    )
}

/// Lateness of each wake-up, ns; a skipped period counts with its whole length.
fn lateness() -> Histogram {
    let mut late = Histogram::new();
    let clock = MonotonicClock::new();
    let mut periodic = Periodic::new(clock, clock.now().plus_ns(hal::TICK_NS), hal::TICK_NS);
    for _ in 0..TIMER_PERIODS {
        let wake = periodic.wait();
        late.record(wake.late_ns() + wake.skipped * hal::TICK_NS);
    }
    late
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn least_quota_above_a_group_counts() {
        let root = std::env::temp_dir().join(format!("trocar-groups-{}", std::process::id()));
        let inner = root.join("user.slice/session");
        fs::create_dir_all(&inner).unwrap();
        let found = || quota(&root, "/user.slice/session");
        assert_eq!(found(), None);
        fs::write(inner.join("cpu.max"), "max 100000\n").unwrap();
        assert_eq!(found(), None);
        let above = root.join("user.slice/cpu.max");
        fs::write(&above, "150000 100000\n").unwrap();
        assert_eq!(found(), Some((1.5, above.clone())));
        fs::write(inner.join("cpu.max"), "400000 100000\n").unwrap();
        assert_eq!(found(), Some((1.5, above)));
        fs::remove_dir_all(&root).unwrap();
    }
}
