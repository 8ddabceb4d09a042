//! The cameras' process as the run sees it: started early, waited for, listened to, and told to go.
//!
//! Drawing is in a process of its own since a graphics driver may crash, hang or take any lock.
//! What that process does is `cameras_process`; restarts and holds are decided by `supervisor`.

use std::ffi::OsString;

use hal::TimeNs;
use trocar_topics::{CamerasStatus, CamerasStatusTopic, Events, RunControlTopic, TopicNode};

use super::cameras_process::CAMERAS;
use super::child_process::{ChildProcess, Spawned};
use super::policy_process::FIRST_ARM;
use super::remote_arms::PrintLine;
use super::supervisor::{Remote, await_ready};
use crate::rt::{self, MonotonicClock};
use crate::session::changes::ConfigFile;
use crate::session::{Plan, SessionError};

/// How long the process may take until it is ready, ns: a driver that compiles for the first time
/// takes seconds.
const LOAD_NS_MAX: u64 = 60_000_000_000;

/// A process that says nothing for this long hangs, ns. As long as a camera of another's may show
/// nothing, and far beyond any frame.
const SILENCE_NS_MAX: u64 = 2_000_000_000;

/// The running cameras' process.
pub(super) struct CamerasChild {
    /// Dropping it ends the process.
    own: ChildProcess<CamerasStatus>,
    /// For whoever waits for frames; another handle is made for the start.
    events: Events,
    /// Of its own: when it was heard. It begins when the process is started.
    clock: MonotonicClock,
    heard: TimeNs,
}

impl CamerasChild {
    /// Starts the process on `topics`, where it shows frames of the cameras `wanted`, and to
    /// `pages` what they ask for.
    ///
    /// Returns at once: the process loads while the policy does.
    ///
    /// # Errors
    /// From the topics, or if this program cannot be started.
    pub(super) fn start(
        plan: &Plan,
        topics: &str,
        wanted: &[String],
        pages: bool,
    ) -> Result<Self, SessionError> {
        let node = TopicNode::join(topics)?;
        let events = node.events()?;
        let control = RunControlTopic::publisher(&node, CAMERAS)?;
        let status = CamerasStatusTopic::subscriber(&node, FIRST_ARM)?;
        let spawned = verb(plan, topics, wanted, pages);
        Ok(Self {
            clock: MonotonicClock::new(),
            own: ChildProcess::start(spawned, node, (control, status))?,
            events,
            heard: TimeNs(0),
        })
    }

    /// Waits until it has drawn for the first time.
    ///
    /// Blocks for 60 s at most; its first status counts as ready, which it gives once every camera
    /// has drawn.
    pub(super) fn wait_until_ready(&mut self, say: PrintLine<'_>) -> Result<(), SessionError> {
        let events = self.own.node.events()?;
        await_ready(self, (self.clock, LOAD_NS_MAX), &events, say)
    }

    /// Waits until something may have been published, for `at_most_ns`.
    pub(super) fn wait(&self, at_most_ns: u64) {
        rt::wait(&self.events, at_most_ns);
    }

    /// Any new status is a sign of life; whether there was one.
    fn hear(&mut self) -> Result<bool, SessionError> {
        let heard = self.own.status.newest()?.is_some();
        if heard {
            self.heard = self.clock.now();
            self.own.listens = true;
        }
        Ok(heard)
    }
}

impl Remote for CamerasChild {
    fn who(&self) -> String {
        self.own.who().to_owned()
    }

    fn is_own(&self) -> bool {
        true
    }

    fn call_again(&mut self) -> Result<(), SessionError> {
        self.own.start_again()
    }

    fn is_ready(&mut self) -> Result<bool, SessionError> {
        self.own.control.keep_alive()?;
        self.hear()
    }

    /// A new process is ready as the first was.
    fn is_back(&mut self, _now: TimeNs) -> Result<bool, SessionError> {
        self.is_ready()
    }

    fn ended(&mut self) -> Result<Option<String>, SessionError> {
        Ok(self.own.exit())
    }

    /// While it loads it may be silent for [`LOAD_NS_MAX`], then for [`SILENCE_NS_MAX`].
    fn lost(&mut self) -> Option<String> {
        if let Some(reason) = self.own.exit() {
            return Some(reason);
        }
        if let Err(error) = self.hear() {
            return Some(error.to_string());
        }
        let silence_ns = self.clock.now().since(self.heard);
        let limit_ns = if self.own.listens {
            SILENCE_NS_MAX
        } else {
            LOAD_NS_MAX
        };
        (silence_ns > limit_ns).then(|| {
            let (who, seconds) = (self.own.who(), silence_ns / 1_000_000_000);
            format!("{who} has sent no heartbeat for {seconds} s")
        })
    }
}

/// `trocar cameras`, with all that decides the scene of `plan`.
///
/// The process reads the same files and must come to the same scene hash.
fn verb(plan: &Plan, topics: &str, wanted: &[String], pages: bool) -> Spawned {
    let setup = &plan.setup;
    let mut arguments: Vec<OsString> = vec!["cameras".into()];
    let mut option = |name: &str, value: OsString| arguments.extend([name.into(), value]);
    option("--task", setup.task_asked.clone().into());
    option("--topics", topics.into());
    option("--seed", plan.seed.to_string().into());
    option("--view", setup.task.view.name().into());
    if let Some(file) = &setup.scene_file {
        option("--scene", file.into());
    }
    if let Some(needle) = setup.needle() {
        option("--needle", needle.into());
    }
    for variation in &setup.task.varied {
        option("--vary", variation.name().into());
    }
    for change in setup.changes.of(&[ConfigFile::Scene, ConfigFile::Safety]) {
        option("--set", change.into());
    }
    if !wanted.is_empty() {
        option("--cameras", wanted.join(",").into());
    }
    let flags = [(pages, "--pages"), (setup.stereo, "--stereo")];
    let flags = flags.into_iter().filter(|(given, _)| *given);
    arguments.extend(flags.map(|(_, flag)| flag.into()));
    Spawned {
        who: "the cameras' process",
        arguments,
    }
}
