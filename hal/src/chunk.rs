//! A chunk: a policy's tip targets for the next steps.

use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};

use crate::{Pose, TimeNs};

/// The most steps that one chunk can carry.
pub const CHUNK_STEPS_MAX: usize = 128;

/// Where the tip should be at one step.
///
/// Plain numbers, so that it can travel through shared memory and hold nonsense until the input
/// gate has looked at it.
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/tip_target/1")]
pub struct TipTarget {
    /// Tip position in the RCM frame, metres.
    pub position_m: [f64; 3],
    /// Tip rotation in the RCM frame, unit quaternion x, y, z, w.
    pub rotation_xyzw: [f64; 4],
    /// Angle between the jaw fingers, rad.
    pub jaw: f64,
}

impl TipTarget {
    /// A target from a pose and a jaw angle.
    #[must_use]
    pub fn new(tip_in_rcm: &Pose, jaw: f64) -> Self {
        let q = tip_in_rcm.rotation.coords;
        Self {
            position_m: tip_in_rcm.translation.vector.into(),
            rotation_xyzw: [q.x, q.y, q.z, q.w],
            jaw,
        }
    }

    /// The pose as datasets store it: x y z qx qy qz qw.
    #[must_use]
    pub fn pose_numbers(&self) -> [f64; 7] {
        let [x, y, z] = self.position_m;
        let [i, j, k, w] = self.rotation_xyzw;
        [x, y, z, i, j, k, w]
    }

    /// The target as a pose, its rotation normalised.
    ///
    /// Meaningful only after the input gate has accepted the chunk.
    #[must_use]
    pub fn tip_in_rcm(&self) -> Pose {
        let [x, y, z, w] = self.rotation_xyzw;
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        Pose::from_parts(Translation3::from(self.position_m), rotation)
    }
}

/// A policy's answer to one observation.
///
/// `targets[k]` is due at `observed_at + k * step_ns`; between two of them the tip moves evenly.
/// Targets are absolute, so chunks of different observations can be blended.
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/chunk/1")]
pub struct Chunk {
    /// When the observation was taken that this answers.
    pub observed_at: TimeNs,
    /// Counts the chunks of one policy, from 1.
    pub sequence: u64,
    /// Time between two targets, ns.
    pub step_ns: u64,
    /// How many of `targets` are valid, 1 to [`CHUNK_STEPS_MAX`].
    pub len: u32,
    /// Keeps the layout explicit.
    pub reserved: u32,
    /// The targets; those past `len` mean nothing.
    pub targets: [TipTarget; CHUNK_STEPS_MAX],
}

impl Chunk {
    /// A chunk of `targets`, of which at most [`CHUNK_STEPS_MAX`] are kept.
    #[must_use]
    pub fn new(observed_at: TimeNs, sequence: u64, step_ns: u64, targets: &[TipTarget]) -> Self {
        let blank = TipTarget {
            position_m: [0.0; 3],
            rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
            jaw: 0.0,
        };
        let kept = targets.len().min(CHUNK_STEPS_MAX);
        let mut all = [blank; CHUNK_STEPS_MAX];
        all[..kept].copy_from_slice(&targets[..kept]);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "kept is at most CHUNK_STEPS_MAX"
        )]
        let len = kept as u32;
        Self {
            observed_at,
            sequence,
            step_ns,
            len,
            reserved: 0,
            targets: all,
        }
    }

    /// The valid targets; empty if `len` is out of range.
    #[must_use]
    pub fn valid_targets(&self) -> &[TipTarget] {
        self.targets.get(..self.len as usize).unwrap_or(&[])
    }

    /// When `targets[index]` is due.
    #[must_use]
    pub const fn due(&self, index: usize) -> TimeNs {
        self.observed_at.plus_ns(self.step_ns * index as u64)
    }
}
