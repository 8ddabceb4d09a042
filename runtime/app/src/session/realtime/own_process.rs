//! A policy process of our own: started, started again, told to go, and ended with the run.

use std::env;
use std::fs;
use std::os::unix::process::CommandExt as _;
use std::path::PathBuf;
use std::process::{self, Child, Command, Stdio};

use hal::TimeNs;
use tch::Device;
use trocar_nets::compute::{Arithmetic, Compute};
use trocar_topics::{PolicyStatus, Publisher, RunCommand, RunControl, Subscriber, TopicNode};

use crate::rt::{self, MonotonicClock};
use crate::session::SessionError;

/// The process has this long to go by itself, ns.
const EXIT_NS_MAX: u64 = 3_000_000_000;

/// Time between two looks, ns.
const POLL_NS: u64 = 1_000_000;

/// How a process is started.
pub(super) struct Spawned {
    pub(super) run_id: String,
    /// The checkpoint's folder.
    pub(super) policy: PathBuf,
    pub(super) compute: Compute,
    pub(super) frames_within_ms: u64,
}

/// A process that was started here. Dropping it ends it, in peace if it listens.
pub(super) struct OwnProcess {
    pub(super) process: Child,
    pub(super) spawned: Spawned,
    pub(super) node: TopicNode,
    pub(super) control: Publisher<RunControl>,
    pub(super) status: Subscriber<PolicyStatus>,
    /// While it loads it does not.
    pub(super) listens: bool,
}

impl Spawned {
    pub(super) fn start(&self) -> Result<Child, SessionError> {
        let program = env::current_exe().map_err(|error| failed("finding this program", &error))?;
        let device = if self.compute.device == Device::Cpu {
            "cpu"
        } else {
            "cuda"
        };
        let precision = match self.compute.arithmetic {
            Arithmetic::F32 => "f32",
            Arithmetic::Bf16 => "bf16",
        };
        Command::new(program)
            .args(["policy-process", "--run-id", &self.run_id, "--policy"])
            .arg(&self.policy)
            .args(["--device", device, "--precision", precision])
            .args(["--threads", &self.compute.threads.to_string()])
            .args(["--frames-within-ms", &self.frames_within_ms.to_string()])
            // Threads that wait for each other sleep: spinning, they would take cores from the simulation and the control.
            .env("OMP_WAIT_POLICY", "PASSIVE")
            .args(["--parent-pid", &process::id().to_string()])
            .stdin(Stdio::null())
            // A Ctrl-C in the terminal is for this process alone, which then stops the arm before the policy.
            .process_group(0)
            .spawn()
            .map_err(|error| failed("starting the policy process", &error))
    }
}

impl OwnProcess {
    /// Ends the process, if it still is, with all that it had in shared memory, and starts another one.
    pub(super) fn start_again(&mut self) -> Result<(), SessionError> {
        self.listens = false;
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
        self.node.remove_dead();
        // Nothing of the dead one is taken for the next one's.
        let _stale = self.status.newest()?;
        self.process = self.spawned.start()?;
        Ok(())
    }

    /// Tells the process to go and waits for it a while; `true` if it went and cleaned up.
    fn goes_by_itself(&mut self) -> bool {
        let told = self
            .control
            .publish(&RunControl::new(TimeNs(0), 1, RunCommand::Stop));
        if told.is_err() {
            return false;
        }
        let clock = MonotonicClock::new();
        while clock.now().0 < EXIT_NS_MAX {
            if let Ok(Some(exit)) = self.process.try_wait() {
                return exit.success();
            }
            rt::sleep_ns(POLL_NS);
        }
        false
    }
}

impl Drop for OwnProcess {
    fn drop(&mut self) {
        if !(self.listens && self.goes_by_itself()) {
            // Whatever went wrong, nothing is left behind: no process, and nothing of it in shared memory.
            let _gone = self.process.kill();
            let _reaped = self.process.wait();
            self.node.remove_dead();
        }
    }
}

/// A name for the run's topics that no other run on this machine has: containers may share memory and count their processes
/// alike, so the process id alone would not do.
pub(super) fn fresh_run_id() -> Result<String, SessionError> {
    let uuid = fs::read_to_string("/proc/sys/kernel/random/uuid")
        .map_err(|error| failed("naming the run", &error))?;
    let tag: String = uuid.chars().take(8).collect();
    Ok(format!("run-{}-{tag}", process::id()))
}

fn failed(doing: &str, error: &std::io::Error) -> SessionError {
    SessionError::RealTime(format!("{doing} failed: {error}"))
}
