#![doc = include_str!("../README.md")]

mod arm;
mod error;
mod events;
mod external;
mod frame;
mod limits;
mod message;
mod node;
mod port;
mod scene;
mod shm;
mod snapshot;
mod task;
#[cfg(test)]
mod tests;
mod unfinished;

pub use arm::{ArmFeedback, ArmSetpoint, AxisStop, SETPOINT_AGE_NS_MAX, arms_of};
pub use error::TopicError;
pub use events::Events;
pub use external::{POLICY_CAMERAS_MAX, PolicyHello, PolicyReply, Reply, SessionHello};
pub use frame::{CameraTopic, FrameHeader, FrameLoan, FramePublisher, FrameSubscriber, FrameView};
pub use message::{ArmReport, PolicyStage, PolicyStatus, RunCommand, RunControl};
pub use node::{TopicNode, check_run_id};
pub use port::{Message, Publisher, Subscriber, Topic};
pub use scene::{LINE_BYTES_MAX, Line, PoseMessage, SceneArm, SceneReport, SceneTissue, Verdict};
pub use shm::{SHARED_MEMORY_DIR, SharedMemorySpace, shared_memory_space};
pub use snapshot::{
    CamerasStatus, FLAP_NODES_MAX, Flap, InstrumentParts, SCENE_THINGS_MAX, SnapshotReport,
};
pub use task::{CRITERIA_MAX, CriterionReport, TaskReport};

/// Chunks, from the policy process to the control process; one topic an arm.
pub type ChunkTopic = Topic<hal::Chunk>;

/// The measured arm, from the control process to the policy process; one topic an arm.
pub type ArmStateTopic = Topic<ArmReport>;

/// What an arm in another process measures; one topic an arm, on the node of [`arms_of`].
pub type ArmFeedbackTopic = Topic<ArmFeedback>;

/// What an arm in another process is to do; one topic an arm, on the node of [`arms_of`].
pub type ArmSetpointTopic = Topic<ArmSetpoint>;

/// What the policy process should be doing; one topic a process, under the first of its arms.
pub type RunControlTopic = Topic<RunControl>;

/// The true state of a world in another process; one topic a world, under the first of its arms.
pub type SceneTopic = Topic<SceneReport>;

/// How the task of a world in another process stands; one topic a world, under the first of its
/// arms.
pub type TaskTopic = Topic<TaskReport>;

/// Where everything in a simulated scene is, from whoever simulates it to whoever draws or shows
/// it; one topic a run, under the first of its arms, and one under `console` for what only pages
/// look at.
pub type SnapshotTopic = Topic<SnapshotReport>;

/// How the process that draws is doing; one topic a run, under the first of its arms.
pub type CamerasStatusTopic = Topic<CamerasStatus>;

/// How the policy process is doing; one topic a process, under the first of its arms.
pub type PolicyStatusTopic = Topic<PolicyStatus>;

/// Who an external policy is; one topic a policy, under the first of its arms.
pub type PolicyHelloTopic = Topic<PolicyHello>;

/// Who asks an external policy; one topic a session, under the first of its arms.
pub type SessionHelloTopic = Topic<SessionHello>;

/// What an external policy made of an observation; one topic a policy, under the first of its arms.
pub type PolicyReplyTopic = Topic<PolicyReply>;
