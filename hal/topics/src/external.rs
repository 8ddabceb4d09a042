//! What a session and an external policy tell each other, besides the reports, frames, chunks and
//! status that a policy process has too.
//!
//! The policy says hello, the session says who it is, and begins an episode with
//! [`RunControl`](super::RunControl); the policy resets and says so with
//! [`PolicyStatus`](super::PolicyStatus). Reports and frames of one instant are an observation,
//! which it answers with a chunk for each arm, and then with a [`PolicyReply`].

use iceoryx2::prelude::ZeroCopySend;

use super::{Line, Message};

/// Cameras that an external policy can look through.
pub const POLICY_CAMERAS_MAX: usize = 8;

/// Who an external policy is and what it wants to be shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/policy_hello/1")]
pub struct PolicyHello {
    /// Its process, as the process knows itself.
    pub pid: u64,
    /// Arms that it commands; 0 if it takes as many as there are.
    pub arm_count: u64,
    /// Policy steps from one query to the next, at least 1.
    pub query_every_steps: u64,
    /// Policy steps before a query that it wants to have observed too.
    pub history_steps: u64,
    /// How many of `cameras` there are.
    pub camera_count: u64,
    /// What it is called.
    pub name: Line,
    /// The cameras whose frames it wants, by name.
    pub cameras: [Line; POLICY_CAMERAS_MAX],
}

impl Message for PolicyHello {
    const TOPIC: &'static str = "policy_hello";
}

impl PolicyHello {
    /// The names of its cameras; none if there are more than there can be.
    #[must_use]
    pub fn camera_names(&self) -> Option<Vec<String>> {
        let count = usize::try_from(self.camera_count).ok()?;
        let cameras = self.cameras.get(..count)?;
        Some(cameras.iter().map(Line::text).collect())
    }
}

/// The description that a session publishes before its first episode.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/session_hello/2")]
pub struct SessionHello {
    /// Tells sessions apart: the upper 32 bits are those of the numbers of all its episodes.
    pub session: u64,
    /// Its process, as the process knows itself.
    pub pid: u64,
    /// Arms, each with a topic of reports and one of chunks.
    pub arm_count: u64,
    /// 1 in lockstep, where time stands still until the policy has answered.
    pub lockstep: u64,
    /// One policy step, ns.
    pub step_ns: u64,
    /// How far a frame of any camera but the first may be from the instant of an observation, ns.
    pub frames_within_ns: u64,
    /// The task, empty if there is none.
    pub task: Line,
    /// What is to be done, in words, for policies that read it: the task's name if nothing else was
    /// said.
    pub instruction: Line,
}

impl Message for SessionHello {
    const TOPIC: &'static str = "session_hello";
}

/// What an external policy made of an observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply {
    /// It has published its chunks.
    Answered,
    /// It remembers the observation, as part of its history.
    Observed,
    /// It can't go on; the text says why.
    Failed,
    /// It wants no more of this episode.
    Abandoned,
}

/// The end of an external policy's work on an observation.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/policy_reply/1")]
pub struct PolicyReply {
    /// The episode that it has reset for.
    pub episode: u64,
    /// The number of the observation's reports.
    pub sequence: u64,
    /// How many chunks it has published for it, one an arm.
    pub chunk_count: u64,
    code: u64,
    /// Why it can't go on.
    pub text: Line,
}

impl Message for PolicyReply {
    const TOPIC: &'static str = "policy_reply";
}

impl PolicyReply {
    /// The reply `what` to the observation `sequence` of `episode`.
    #[must_use]
    pub fn new(episode: u64, sequence: u64, what: Reply, chunk_count: u64, text: &str) -> Self {
        let code = match what {
            Reply::Answered => 0,
            Reply::Observed => 1,
            Reply::Failed => 2,
            Reply::Abandoned => 3,
        };
        Self {
            episode,
            sequence,
            chunk_count,
            code,
            text: Line::new(text),
        }
    }

    /// What it says; nonsense counts as failed.
    #[must_use]
    pub const fn what(&self) -> Reply {
        match self.code {
            0 => Reply::Answered,
            1 => Reply::Observed,
            3 => Reply::Abandoned,
            _ => Reply::Failed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replies_come_back_and_nonsense_is_a_failure() {
        for what in [
            Reply::Answered,
            Reply::Observed,
            Reply::Failed,
            Reply::Abandoned,
        ] {
            let reply = PolicyReply::new(7, 3, what, 1, "why");
            assert_eq!((reply.what(), reply.text.text().as_str()), (what, "why"));
        }
        let wild = PolicyReply {
            code: 77,
            ..PolicyReply::default()
        };
        assert_eq!(wild.what(), Reply::Failed);
    }

    #[test]
    fn a_hello_with_too_many_cameras_has_none() {
        let mut hello = PolicyHello {
            camera_count: 2,
            ..PolicyHello::default()
        };
        hello.cameras[0] = Line::new("endoscope");
        hello.cameras[1] = Line::new("wrist_psm1");
        let names = hello.camera_names().unwrap();
        assert_eq!(names, ["endoscope", "wrist_psm1"]);
        for count in [POLICY_CAMERAS_MAX as u64 + 1, u64::MAX] {
            hello.camera_count = count;
            assert!(hello.camera_names().is_none(), "{count}");
        }
    }
}
