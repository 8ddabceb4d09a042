//! A scene at one instant: what experts may know of it, and what cameras need of it.
//!
//! Both are values of a fixed size, read after a step of physics. [`SceneState`] goes to an expert
//! once a policy step, each arm's part in that arm's RCM frame; [`SceneSnapshot`] goes to whatever
//! thread has the cameras, all in the scene frame.

use hal::{ARMS_MAX, Pose};
use trocar_world::tissue::FlapSnapshot;
use trocar_world::{ArmBodies, Grasp};

/// Most things that a task has.
pub const THINGS_MAX: usize = 2;

/// The true state of the scene as one arm's base sees it.
#[derive(Clone, Copy, Debug)]
pub struct ArmScene {
    /// Tip (control point) in the RCM frame.
    pub tip_in_rcm: Pose,
    /// The thing that the task is about, or the mark on the flap, in the RCM frame.
    pub thing_in_rcm: Pose,
    /// Angle between the jaw fingers, rad.
    pub jaw: f64,
    /// How the fingers hold the thing or the flap.
    pub grasp: Grasp,
}

/// The true state of the scene, which experts may see and policies may not.
#[derive(Clone, Copy, Debug)]
pub struct SceneState {
    /// The arm that a one-armed task has.
    pub first: ArmScene,
    /// The other one.
    pub second: Option<ArmScene>,
    /// Where something is to be brought, scene frame, if the task has such a place.
    pub goal_in_scene: Option<Pose>,
}

/// Where everything that moves is at one instant, in the scene frame.
#[derive(Clone, Copy, Debug)]
pub struct SceneSnapshot {
    /// How many control ticks of 1 ms the scene is old; counts round. Smoke drifts and sensors'
    /// noise changes with it.
    pub moment_ms: u32,
    /// The things that move, as many as the task has. The rest are identities.
    pub things: [Pose; THINGS_MAX],
    /// The place where something is to be brought, if the task has one. Otherwise the identity.
    pub goal: Pose,
    /// The instruments' parts.
    pub arms: [Option<ArmBodies>; ARMS_MAX],
    /// The soft flap, if there is one.
    pub flap: Option<FlapSnapshot>,
}
