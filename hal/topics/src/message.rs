//! What the control process and the policy process tell each other besides frames and chunks.
//!
//! Flags are plain numbers with a decoder, since shared memory may hold any bits.

use iceoryx2::prelude::ZeroCopySend;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};

use super::Message;
use hal::{ArmState, JOINT_COUNT, JointVector, Pose, TimeNs};

/// The measured arm at a policy step, with its tip pose.
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/arm_report/2")]
pub struct ArmReport {
    /// When it was measured.
    pub stamp: TimeNs,
    /// Counts the reports of a run.
    pub sequence: u64,
    /// Joint positions, rad (insertion m).
    pub position: [f64; JOINT_COUNT],
    /// Joint velocities, rad/s (m/s).
    pub velocity: [f64; JOINT_COUNT],
    /// Joint efforts, N m (N).
    pub effort: [f64; JOINT_COUNT],
    /// Angle between the jaw fingers, rad.
    pub jaw_position: f64,
    /// Rate of the jaw angle, rad/s.
    pub jaw_velocity: f64,
    /// Jaw effort, N m; negative closes.
    pub jaw_effort: f64,
    /// Tip position in the RCM frame, metres.
    pub tip_position_m: [f64; 3],
    /// Tip rotation in the RCM frame, unit quaternion x, y, z, w.
    pub tip_rotation_xyzw: [f64; 4],
}

impl Message for ArmReport {
    const TOPIC: &'static str = "state";

    // A frame takes time to be drawn or sent: a reader finds the arms of its instant although they
    // have been measured again since.
    const UNREAD: usize = 16;
}

impl ArmReport {
    /// The report of `state` with the tip at `tip_in_rcm`.
    #[must_use]
    pub fn new(sequence: u64, state: &ArmState, tip_in_rcm: &Pose) -> Self {
        Self {
            stamp: state.stamp,
            sequence,
            position: state.position.into(),
            velocity: state.velocity.into(),
            effort: state.effort.into(),
            jaw_position: state.jaw_position,
            jaw_velocity: state.jaw_velocity,
            jaw_effort: state.jaw_effort,
            tip_position_m: tip_in_rcm.translation.vector.into(),
            tip_rotation_xyzw: xyzw(tip_in_rcm),
        }
    }

    /// The arm's state, bit for bit.
    #[must_use]
    pub fn state(&self) -> ArmState {
        ArmState {
            stamp: self.stamp,
            position: JointVector::from(self.position),
            velocity: JointVector::from(self.velocity),
            effort: JointVector::from(self.effort),
            jaw_position: self.jaw_position,
            jaw_velocity: self.jaw_velocity,
            jaw_effort: self.jaw_effort,
        }
    }

    /// The tip pose in the RCM frame, bit for bit.
    #[must_use]
    pub fn tip_in_rcm(&self) -> Pose {
        pose(self.tip_position_m, self.tip_rotation_xyzw)
    }
}

/// Rotation of `pose` as x, y, z, w.
pub(super) fn xyzw(pose: &Pose) -> [f64; 4] {
    let q = pose.rotation.coords;
    [q.x, q.y, q.z, q.w]
}

/// The pose with exactly these numbers; the sender vouches for the unit quaternion.
pub(super) fn pose(position_m: [f64; 3], [x, y, z, w]: [f64; 4]) -> Pose {
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
    Pose::from_parts(Translation3::from(position_m), rotation)
}

/// What a policy process should be doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunCommand {
    /// Nothing yet: load, report ready, wait.
    Wait,
    /// Answer observations; reset with this seed on entering a new episode.
    Run {
        /// Seed for everything random.
        seed: u64,
    },
    /// Exit.
    Stop,
}

/// The whole wish of the control process, so that only the newest message matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/run_control/1")]
pub struct RunControl {
    /// When it was said.
    pub stamp: TimeNs,
    /// Counts episodes; a change means that the policy forgets the past.
    pub episode: u64,
    /// Seed of the episode.
    pub seed: u64,
    code: u64,
}

impl Message for RunControl {
    const TOPIC: &'static str = "control";
}

impl RunControl {
    /// The message that says `command` for `episode`.
    #[must_use]
    pub const fn new(stamp: TimeNs, episode: u64, command: RunCommand) -> Self {
        let (code, seed) = match command {
            RunCommand::Wait => (0, 0),
            RunCommand::Run { seed } => (1, seed),
            RunCommand::Stop => (2, 0),
        };
        Self {
            stamp,
            episode,
            seed,
            code,
        }
    }

    /// What is wanted; `None` for a code from another world, which is best treated as
    /// [`RunCommand::Stop`].
    #[must_use]
    pub const fn command(&self) -> Option<RunCommand> {
        match self.code {
            0 => Some(RunCommand::Wait),
            1 => Some(RunCommand::Run { seed: self.seed }),
            2 => Some(RunCommand::Stop),
            _ => None,
        }
    }
}

/// How far a policy process has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PolicyStage {
    /// Weights are being loaded.
    Loading,
    /// It has reset for the episode and answers observations.
    Ready,
    /// It has failed and will exit.
    Failed,
}

/// A sign of life of the policy process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/policy_status/1")]
pub struct PolicyStatus {
    /// Counts the messages; a count that stands still is a process that hangs.
    pub sequence: u64,
    /// Episode that it has reset for.
    pub episode: u64,
    /// Chunks computed in this episode.
    pub queries: u64,
    /// Time that the newest chunk took to compute, ns.
    pub infer_ns: u64,
    code: u64,
}

impl Message for PolicyStatus {
    const TOPIC: &'static str = "policy_status";
}

impl PolicyStatus {
    /// A message of this stage.
    #[must_use]
    pub const fn new(
        sequence: u64,
        episode: u64,
        stage: PolicyStage,
        queries: u64,
        infer_ns: u64,
    ) -> Self {
        let code = match stage {
            PolicyStage::Loading => 0,
            PolicyStage::Ready => 1,
            PolicyStage::Failed => 2,
        };
        Self {
            sequence,
            episode,
            queries,
            infer_ns,
            code,
        }
    }

    /// The stage; nonsense counts as failed.
    #[must_use]
    pub const fn stage(&self) -> PolicyStage {
        match self.code {
            0 => PolicyStage::Loading,
            1 => PolicyStage::Ready,
            _ => PolicyStage::Failed,
        }
    }
}
