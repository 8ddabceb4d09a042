//! The handshake of a session with an external policy, and the topics that they share from then on.

use std::{fs, process};

use hal::{ARM_NAMES, PolicyError, TimeNs};
use trocar_topics::{
    Events, Line, PolicyHello, PolicyHelloTopic, PolicyReply, PolicyReplyTopic, PolicyStatus,
    PolicyStatusTopic, Publisher, RunCommand, RunControl, RunControlTopic, SessionHello,
    SessionHelloTopic, Subscriber, TopicError, TopicNode,
};

use crate::rt::{self, MonotonicClock};
use crate::session::{SessionError, Setup};

/// The arm that the topics of the whole policy are named after.
pub(super) const FIRST_ARM: &str = ARM_NAMES[0];

/// Whoever waits for topics looks this often even if nobody has woken it, ns: for writers that wake
/// nobody, and readers that came late.
pub(in crate::session) const LOOK_NS: u64 = 10_000_000;

/// Time from one look at whether the policy lives to the next, ns.
pub(super) const ALIVE_EVERY_NS: u64 = 25_000_000;

/// Most policy steps from one query to the next, or of a history.
const STEPS_MAX: u64 = 10_000;

/// What a session says of itself.
#[derive(Clone, Copy, Debug)]
pub(in crate::session) struct About<'a> {
    /// The task, empty if there is none.
    pub(in crate::session) task: &'a str,
    /// What is to be done, in words.
    pub(in crate::session) instruction: &'a str,
    /// How many arms there are.
    pub(in crate::session) arms: usize,
    /// Whether time stands still until the policy has answered.
    pub(in crate::session) lockstep: bool,
    /// How long a policy step is, ns.
    pub(in crate::session) step_ns: u64,
    /// How far a frame of any camera but the first may be from the instant of an observation, ms.
    pub(in crate::session) frames_within_ms: u64,
}

/// The topics that a session and an external policy share, once the policy has said hello.
pub(in crate::session) struct ExternalLink {
    pub(in crate::session) name: String,
    pub(in crate::session) within_ns: u64,
    pub(in crate::session) node: TopicNode,
    pub(in crate::session) control: Publisher<RunControl>,
    pub(in crate::session) status: Subscriber<PolicyStatus>,
    pub(in crate::session) replies: Subscriber<PolicyReply>,
    pub(in crate::session) hello: PolicyHello,
    pub(in crate::session) cameras: Vec<String>,
    /// Its upper 32 bits are those of the numbers of all episodes.
    pub(in crate::session) session: u64,
    said: Publisher<SessionHello>,
    hellos: Subscriber<PolicyHello>,
    events: Events,
}

impl ExternalLink {
    /// Opens the topics `name` and waits for a policy that commands the arms of `about`.
    pub(in crate::session) fn open(
        name: &str,
        within_s: u64,
        about: &About<'_>,
    ) -> Result<Self, SessionError> {
        let node = TopicNode::join(name)?;
        let session = fresh_session()?;
        let control = RunControlTopic::publisher(&node, FIRST_ARM)?;
        let said = SessionHelloTopic::publisher(&node, FIRST_ARM)?;
        said.publish(&SessionHello {
            session,
            pid: u64::from(process::id()),
            arm_count: about.arms as u64,
            lockstep: u64::from(about.lockstep),
            step_ns: about.step_ns,
            frames_within_ns: about.frames_within_ms * 1_000_000,
            task: Line::new(about.task),
            instruction: Line::new(about.instruction),
        })?;
        let mut link = Self {
            hellos: PolicyHelloTopic::subscriber(&node, FIRST_ARM)?,
            name: name.to_owned(),
            within_ns: within_s * 1_000_000_000,
            control,
            status: PolicyStatusTopic::subscriber(&node, FIRST_ARM)?,
            replies: PolicyReplyTopic::subscriber(&node, FIRST_ARM)?,
            hello: PolicyHello::default(),
            cameras: Vec::new(),
            session,
            said,
            events: node.events()?,
            node,
        };
        link.hello = link.wait("appeared", |link| {
            link.hellos.newest().map_err(|error| link.topic(&error))
        })?;
        link.cameras = checked(&link.hello, about).map_err(|reason| link.refused(reason))?;
        Ok(link)
    }

    /// Looks whenever something is published until there is something. `doing` is what the policy
    /// has not done in time.
    pub(in crate::session) fn wait<T>(
        &self,
        doing: &str,
        mut look: impl FnMut(&Self) -> Result<Option<T>, PolicyError>,
    ) -> Result<T, PolicyError> {
        let clock = MonotonicClock::new();
        let mut alive = clock.now();
        while clock.now().0 < self.within_ns {
            if let Some(found) = look(self)? {
                return Ok(found);
            }
            if rt::interrupted() {
                return Err(PolicyError::Interrupted);
            }
            if clock.now().since(alive) >= ALIVE_EVERY_NS {
                alive = clock.now();
                let told = self.keep_alive().and_then(|()| self.check_alive());
                told?;
            }
            rt::wait(&self.events, LOOK_NS);
        }
        let within_s = self.within_ns / 1_000_000_000;
        Err(self.failed(format!("has not {doing} for {within_s} s")))
    }

    /// Takes note of a process that has come in the place of one that left. It must want to be
    /// shown the same.
    pub(in crate::session) fn welcome(&mut self) -> Result<(), SessionError> {
        let Some(hello) = self.hellos.newest()? else {
            return Ok(());
        };
        let wants = |hello: &PolicyHello| {
            let PolicyHello {
                arm_count,
                query_every_steps,
                history_steps,
                ..
            } = *hello;
            (arm_count, query_every_steps, history_steps)
        };
        let same = wants(&hello) == wants(&self.hello);
        if !same || hello.camera_names().as_ref() != Some(&self.cameras) {
            let who = hello.name.text();
            let reason = format!(
                "{who} (process {}) has come back as another: arms, query interval, history and cameras must be as before",
                hello.pid
            );
            return Err(SessionError::RealTime(self.failed(reason).to_string()));
        }
        self.hello = hello;
        Ok(())
    }

    pub(in crate::session) fn keep_alive(&self) -> Result<(), PolicyError> {
        let told = self.control.keep_alive();
        told.and_then(|()| self.said.keep_alive())
            .map_err(|error| self.topic(&error))
    }

    fn check_alive(&self) -> Result<(), PolicyError> {
        match self.gone() {
            Some(reason) => Err(self.failed(reason)),
            None => Ok(()),
        }
    }

    /// Why it answers no more, if its process is gone.
    pub(in crate::session) fn gone(&self) -> Option<String> {
        let PolicyHello { pid, .. } = self.hello;
        let known = pid > 0;
        (known && !self.node.is_alive(pid)).then(|| format!("{} ended", self.who()))
    }

    /// The policy by the name that it gives itself.
    pub(in crate::session) fn who(&self) -> String {
        format!("{} (process {})", self.hello.name.text(), self.hello.pid)
    }

    pub(in crate::session) fn failed(&self, reason: impl Into<String>) -> PolicyError {
        PolicyError::External {
            name: self.name.clone(),
            reason: reason.into(),
        }
    }

    fn refused(&self, reason: String) -> SessionError {
        SessionError::BadArgument(self.failed(reason).to_string())
    }

    pub(super) fn topic(&self, error: &TopicError) -> PolicyError {
        self.failed(error.to_string())
    }
}

impl Drop for ExternalLink {
    fn drop(&mut self) {
        // Who no longer listens finds out by looking whether this process is there.
        let stop = RunControl::new(TimeNs(0), self.session, RunCommand::Stop);
        let _told = self.control.publish(&stop);
    }
}

/// The cameras of `hello`, which must fit what the session has.
pub(super) fn checked(hello: &PolicyHello, about: &About<'_>) -> Result<Vec<String>, String> {
    let arms = about.arms as u64;
    if hello.arm_count != 0 && hello.arm_count != arms {
        return Err(format!(
            "commands {} arms, there are {arms}",
            hello.arm_count
        ));
    }
    for (what, value, least) in [
        ("query interval", hello.query_every_steps, 1),
        ("history", hello.history_steps, 0),
    ] {
        if !(least..=STEPS_MAX).contains(&value) {
            return Err(format!(
                "says a {what} of {value} steps: allowed are {least} to {STEPS_MAX}"
            ));
        }
    }
    hello
        .camera_names()
        .ok_or_else(|| format!("asks for {} cameras", hello.camera_count))
}

/// The task must have the cameras that an external policy wants.
pub(in crate::session) fn check_wanted(
    setup: &Setup,
    wanted: &[String],
) -> Result<(), SessionError> {
    let available = setup.camera_names();
    match wanted.iter().find(|name| !available.contains(name)) {
        None => Ok(()),
        Some(name) => Err(SessionError::UnknownCamera {
            name: name.clone(),
            available: available.join(", "),
        }),
    }
}

/// A number that tells this session from any other that a policy may know, in its upper 32 bits.
fn fresh_session() -> Result<u64, SessionError> {
    let uuid = fs::read_to_string("/proc/sys/kernel/random/uuid")
        .map_err(|error| SessionError::RealTime(format!("naming the session failed: {error}")))?;
    let tag: String = uuid.chars().take(8).collect();
    let tag = u32::from_str_radix(&tag, 16)
        .map_err(|error| SessionError::RealTime(format!("naming the session failed: {error}")))?;
    Ok(u64::from(tag) << 32)
}
