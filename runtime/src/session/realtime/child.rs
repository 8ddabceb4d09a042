//! The policy process as its parent sees it: started, waited for, listened to, and told to go.

use std::env;
use std::path::Path;
use std::process::{self, Child, Command, Stdio};

use hal::topic::{
    ChunkTopic, PolicyStage, PolicyStatus, PolicyStatusTopic, Publisher, RunCommand, RunControl,
    RunControlTopic, Subscriber, TopicNode,
};
use hal::{Chunk, TimeNs};
use policy::act_policy::ActPolicy;
use rtrb::Producer;
use tch::Device;

use super::Signals;
use super::policy_process::ARM;
use crate::rt::{self, MonotonicClock};
use crate::session::SessionError;
use crate::session::run::RunOptions;

/// The process has this long to load its weights, ns.
const LOAD_NS_MAX: u64 = 120_000_000_000;

/// The process has this long to go by itself, ns.
const EXIT_NS_MAX: u64 = 3_000_000_000;

/// Time between two looks, ns.
const POLL_NS: u64 = 500_000;

/// The running policy process.
pub(super) struct PolicyChild {
    process: Child,
    node: TopicNode,
    control: Publisher<RunControl>,
    status: Subscriber<PolicyStatus>,
    chunks: Subscriber<Chunk>,
}

impl PolicyChild {
    /// Starts the process and waits until it has loaded the checkpoint.
    pub(super) fn start(policy: &Path, options: &RunOptions) -> Result<Self, SessionError> {
        // Loading it here first gives a bad checkpoint's reason as a proper error, before any process is started.
        drop(ActPolicy::load(policy, Device::Cpu)?);
        let run_id = format!("run-{}", process::id());
        let node = TopicNode::join(&run_id)?;
        let control = RunControlTopic::publisher(&node, ARM)?;
        let status = PolicyStatusTopic::subscriber(&node, ARM)?;
        let chunks = ChunkTopic::subscriber(&node, ARM)?;
        let program = env::current_exe().map_err(|error| failed("finding this program", &error))?;
        let process = Command::new(program)
            .args(["policy-process", "--run-id", &run_id, "--policy"])
            .arg(policy)
            .args([
                "--device",
                if options.device == Device::Cpu {
                    "cpu"
                } else {
                    "cuda"
                },
            ])
            .stdin(Stdio::null())
            .spawn()
            .map_err(|error| failed("starting the policy process", &error))?;
        let mut child = Self {
            process,
            node,
            control,
            status,
            chunks,
        };
        child.wait_until_ready(options.seed)?;
        Ok(child)
    }

    fn wait_until_ready(&mut self, seed: u64) -> Result<(), SessionError> {
        let clock = MonotonicClock::new();
        self.control
            .publish(&RunControl::new(TimeNs(0), 1, RunCommand::Run { seed }))?;
        while clock.now().0 < LOAD_NS_MAX {
            if let Some(status) = self.status.newest()?
                && status.stage() == PolicyStage::Ready
                && status.episode == 1
            {
                return Ok(());
            }
            if let Ok(Some(exit)) = self.process.try_wait() {
                return Err(SessionError::RealTime(format!(
                    "the policy process ended while loading: {exit}"
                )));
            }
            self.control.keep_alive()?;
            rt::sleep_ns(POLL_NS);
        }
        Err(SessionError::RealTime(
            "the policy process did not become ready in time".to_owned(),
        ))
    }

    /// The node that this run's topics live on.
    pub(super) const fn node(&self) -> &TopicNode {
        &self.node
    }

    /// Hands chunks to the control thread until it has stopped.
    pub(super) fn forward_chunks(
        &self,
        mut to: Producer<Chunk>,
        signals: &Signals,
    ) -> Result<(), SessionError> {
        while !signals.stopped() {
            if let Some(chunk) = self.chunks.newest()? {
                // Full means that the control thread takes none: it will hold the arm and say so.
                let _full = to.push(chunk);
            }
            rt::sleep_ns(POLL_NS);
        }
        Ok(())
    }

    /// Tells the process to go, and makes it if it does not.
    pub(super) fn finish(mut self) -> Result<(), SessionError> {
        self.control
            .publish(&RunControl::new(TimeNs(0), 1, RunCommand::Stop))?;
        let clock = MonotonicClock::new();
        while clock.now().0 < EXIT_NS_MAX {
            if let Ok(Some(_)) = self.process.try_wait() {
                return Ok(());
            }
            rt::sleep_ns(POLL_NS);
        }
        self.process
            .kill()
            .map_err(|error| failed("ending the policy process", &error))
    }
}

impl Drop for PolicyChild {
    fn drop(&mut self) {
        // Whatever went wrong, no process is left behind; it may be gone already.
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
    }
}

fn failed(doing: &str, error: &std::io::Error) -> SessionError {
    SessionError::RealTime(format!("{doing} failed: {error}"))
}
