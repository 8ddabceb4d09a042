//! A process of our own, the policy's or the cameras': a verb of this program that is started,
//! started again, told to go, and ended with the run.

use std::env;
use std::ffi::OsString;
use std::fs;
use std::os::unix::process::CommandExt as _;
use std::process::{self, Child, Command, Stdio};

use hal::TimeNs;
use trocar_topics::{Message, Publisher, RunCommand, RunControl, Subscriber, TopicNode};

use crate::rt::{self, MonotonicClock};
use crate::session::SessionError;

/// The process has this long to go by itself, ns.
const EXIT_NS_MAX: u64 = 3_000_000_000;

/// Polling period, ns.
const POLL_NS: u64 = 1_000_000;

/// How a process is started.
pub(super) struct Spawned {
    /// What it is called in messages.
    pub(super) who: &'static str,
    /// The verb of this program, and its options.
    pub(super) arguments: Vec<OsString>,
}

/// A process that was started here, which reports by messages of the type `S`. Dropping it ends it,
/// in peace if it listens.
pub(super) struct ChildProcess<S: Message> {
    process: Child,
    spawned: Spawned,
    pub(super) node: TopicNode,
    pub(super) control: Publisher<RunControl>,
    pub(super) status: Subscriber<S>,
    /// While it loads it does not.
    pub(super) listens: bool,
}

impl Spawned {
    fn start(&self) -> Result<Child, SessionError> {
        let program = env::current_exe().map_err(|error| failed("finding this program", &error))?;
        Command::new(program)
            .args(&self.arguments)
            .args(["--parent-pid", &process::id().to_string()])
            // Threads that wait for each other sleep: spinning, they would take cores from the
            // simulation and the control.
            .env("OMP_WAIT_POLICY", "PASSIVE")
            .stdin(Stdio::null())
            // A Ctrl-C in the terminal is for this process alone, which then stops the arm before
            // the others.
            .process_group(0)
            .spawn()
            .map_err(|error| failed(&format!("starting {}", self.who), &error))
    }
}

impl<S: Message> ChildProcess<S> {
    /// Starts it, as a process of the run of `node`.
    pub(super) fn start(
        spawned: Spawned,
        node: TopicNode,
        (control, status): (Publisher<RunControl>, Subscriber<S>),
    ) -> Result<Self, SessionError> {
        Ok(Self {
            process: spawned.start()?,
            spawned,
            node,
            control,
            status,
            listens: false,
        })
    }

    /// What it is called in messages.
    pub(super) const fn who(&self) -> &'static str {
        self.spawned.who
    }

    /// How it ended, if it has.
    pub(super) fn exit(&mut self) -> Option<String> {
        let exit = self.process.try_wait().ok().flatten();
        exit.map(|exit| format!("{} ended: {exit}", self.spawned.who))
    }

    /// The code with which it has ended, if it has.
    pub(super) fn exit_code(&mut self) -> Option<i32> {
        self.process.try_wait().ok().flatten()?.code()
    }

    /// Ends the process, if it still is, with all that it had in shared memory.
    pub(super) fn kill(&mut self) {
        self.listens = false;
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
        self.node.remove_dead();
    }

    /// Ends the process as [`Self::kill`] does, and starts another one.
    pub(super) fn start_again(&mut self) -> Result<(), SessionError> {
        self.kill();
        // Nothing of the dead one is taken for the next one's.
        let _stale = self.status.newest()?;
        self.process = self.spawned.start()?;
        Ok(())
    }

    /// Tells the process to go, without waiting for it; `false` if it can't be told.
    pub(super) fn tell_to_go(&self) -> bool {
        let stop = RunControl::new(TimeNs(0), 1, RunCommand::Stop);
        self.control.publish(&stop).is_ok()
    }

    /// Tells the process to go and waits for it a while; `true` if it went and cleaned up.
    fn goes_by_itself(&mut self) -> bool {
        if !self.tell_to_go() {
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

impl<S: Message> Drop for ChildProcess<S> {
    fn drop(&mut self) {
        if !(self.listens && self.goes_by_itself()) {
            // Whatever went wrong, nothing is left behind: no process, and nothing of it in shared
            // memory.
            let _gone = self.process.kill();
            let _reaped = self.process.wait();
            self.node.remove_dead();
        }
    }
}

/// A name for the run's topics that no other run on this machine has: containers may share memory
/// and count their processes alike, so the process id alone would not do.
pub(super) fn fresh_run_id() -> Result<String, SessionError> {
    let uuid = fs::read_to_string("/proc/sys/kernel/random/uuid")
        .map_err(|error| failed("naming the run", &error))?;
    let tag: String = uuid.chars().take(8).collect();
    Ok(format!("run-{}-{tag}", process::id()))
}

fn failed(doing: &str, error: &std::io::Error) -> SessionError {
    SessionError::RealTime(format!("{doing} failed: {error}"))
}
