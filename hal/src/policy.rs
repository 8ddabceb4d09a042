//! The interface to a policy: observation in, a chunk for each arm out.

use crate::{ArmState, Chunk, FrameRef, Pose, TICK_NS, TipTarget};

/// One policy step: the time between two observations that a run may show a policy, ns. The steps
/// of its chunks may be others.
pub const POLICY_STEP_NS: u64 = 40 * TICK_NS;

/// What a policy sees of one arm at one instant.
#[derive(Clone, Copy, Debug)]
pub struct ArmObservation {
    /// What was measured.
    pub state: ArmState,
    /// Measured tip pose in the arm's own RCM frame, from forward kinematics.
    pub tip_in_rcm: Pose,
}

impl ArmObservation {
    /// Where the arm is, as a target.
    #[must_use]
    pub fn here(&self) -> TipTarget {
        TipTarget::new(&self.tip_in_rcm, self.state.jaw_position)
    }
}

/// What a policy sees at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// The measured arms, of one instant and in their order; the stamp of the first is the
    /// observation's.
    pub arms: &'a [ArmObservation],
    /// Frames taken at the observation, in the order of the policy's camera list.
    pub frames: &'a [FrameRef<'a>],
}

/// A policy. Answers are a function of the seed and of the observations since the last reset.
pub trait Policy {
    /// Forgets the past; everything random afterwards depends on `seed`.
    fn reset(&mut self, seed: u64);

    /// How many policy steps ([`POLICY_STEP_NS`]) before a query it wants to have observed too; see
    /// [`observe`](Self::observe).
    fn history_steps(&self) -> u64 {
        0
    }

    /// Remembers `observation` for the query that follows in at most
    /// [`history_steps`](Self::history_steps) steps.
    ///
    /// # Errors
    /// [`PolicyError`] when the observation does not fit the policy.
    fn observe(&mut self, observation: &Observation<'_>) -> Result<(), PolicyError> {
        let _unused = observation;
        Ok(())
    }

    /// The chunks that answer `observation`, one for each of its arms, all with the same time and
    /// sequence.
    ///
    /// # Errors
    /// [`PolicyError`] when the observation does not fit the policy or the computation failed.
    fn infer(&mut self, observation: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError>;
}

/// Why a policy gave no chunk.
#[derive(Debug, thiserror::Error)]
pub enum PolicyError {
    /// The observation has another number of arms than the policy was trained with.
    #[error("policy commands {expected} arms, observation has {actual}")]
    ArmCount {
        /// Arms the policy was trained with.
        expected: usize,
        /// Arms in the observation.
        actual: usize,
    },
    /// The observation has another number of cameras than the policy was trained with.
    #[error("policy expects {expected} camera frames, observation has {actual}")]
    CameraCount {
        /// Cameras the policy was trained with.
        expected: usize,
        /// Frames in the observation.
        actual: usize,
    },
    /// A frame has another size than the policy was trained with.
    #[error(
        "policy expects {expected_width}x{expected_height} images, camera {camera} has {width}x{height}"
    )]
    ImageSize {
        /// Index of the camera.
        camera: usize,
        /// Width the policy was trained with, pixels.
        expected_width: u32,
        /// Height the policy was trained with, pixels.
        expected_height: u32,
        /// Width of the frame, pixels.
        width: u32,
        /// Height of the frame, pixels.
        height: u32,
    },
    /// The network library failed.
    #[error("inference failed: {0}")]
    Inference(String),
    /// A policy in another process did not answer, or said something that can't be used.
    #[error("external policy {name:?}: {reason}")]
    External {
        /// The name of its topics.
        name: String,
        /// Why.
        reason: String,
    },
    /// A policy in another process wants no more of the episode.
    #[error("external policy {name:?} abandoned the episode")]
    Abandoned {
        /// The name of its topics.
        name: String,
    },
    /// A signal came while the policy was waited for.
    #[error("interrupted")]
    Interrupted,
}
