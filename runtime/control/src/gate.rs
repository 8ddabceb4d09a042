//! The input gate: no chunk gets further unless every number in it makes sense. Hot path: bounded,
//! no allocation, no I/O, no lock.

use hal::{Chunk, Pose, TICK_NS, TimeNs, TipTarget, count};
use nalgebra::Vector3;

use super::snapshot::state;

/// The longest step that a chunk may have, ns.
const STEP_NS_MAX: u64 = 1_000_000_000;

/// How far a rotation's norm may be from 1.
const UNIT_TOLERANCE: f64 = 1e-3;

/// What the gate lets through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GateLimits {
    /// Oldest observation that a chunk may answer, ns.
    pub age_ns_max: u64,
    /// Longest way between two targets of a chunk, m.
    pub step_m_max: f64,
    /// Largest turn between two targets of a chunk, rad.
    pub step_rad_max: f64,
    /// Longest way from the commanded tip to the target that is due, m.
    pub jump_m_max: f64,
    /// Largest turn from the commanded tip to the target that is due, rad.
    pub jump_rad_max: f64,
    /// The same after a hold of the run's own, m.
    pub resume_m_max: f64,
    /// And its turn, rad.
    pub resume_rad_max: f64,
}

/// What the gate thinks of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GateDecision {
    /// It is used.
    Accepted,
    /// It carries no target, or more than fit.
    WrongLength {
        /// The length it claims.
        len: u32,
    },
    /// Its step is shorter than a tick or longer than a second.
    WrongStep {
        /// The step it claims.
        step_ns: u64,
    },
    /// It answers an observation that lies ahead.
    FromTheFuture,
    /// It answers an observation that is too old or from before [`Gate::begin_anew`], or its last
    /// target was due already.
    Stale {
        /// Age of the observation, ns.
        age_ns: u64,
    },
    /// A chunk with a higher sequence or a newer observation was accepted before.
    OutOfOrder,
    /// A target holds NaN or infinity.
    NotFinite {
        /// Index of the target.
        index: u32,
    },
    /// A target's rotation is no unit quaternion.
    NotUnit {
        /// Index of the target.
        index: u32,
    },
    /// Two neighbouring targets are too far apart.
    StepTooLong {
        /// Index of the second one.
        index: u32,
    },
    /// The target that is due is too far from the commanded tip.
    Jump,
    /// After a hold of the run's own it does not start where the arm is.
    Elsewhere,
}

impl GateDecision {
    /// Whether the chunk is used.
    #[must_use]
    pub fn is_accepted(self) -> bool {
        self == Self::Accepted
    }
}

/// The gate, with its memory of what it has judged.
#[derive(Clone, Debug)]
pub struct Gate {
    limits: GateLimits,
    accepted: Option<(u64, TimeNs)>,
    /// Observations from before are too old, whatever their age.
    not_before: TimeNs,
    /// A hold of the run's own has ended, and no chunk was let through since.
    held: bool,
    judged: Option<(u64, TimeNs)>,
    accepted_count: u64,
    refused_count: u64,
}

state!(Gate {
    accepted: Option<(u64, TimeNs)>,
    not_before: TimeNs,
    held: bool,
    judged: Option<(u64, TimeNs)>,
    accepted_count: u64,
    refused_count: u64,
} beside { limits });

impl Gate {
    /// A gate that has seen nothing.
    #[must_use]
    pub fn new(limits: GateLimits) -> Self {
        Self {
            limits,
            accepted: None,
            not_before: TimeNs(0),
            held: false,
            judged: None,
            accepted_count: 0,
            refused_count: 0,
        }
    }

    /// Forgets the order of the chunks so far, but not how many there were.
    pub fn forget(&mut self) {
        self.accepted = None;
        self.judged = None;
        self.held = false;
    }

    /// Forgets the order of the chunks so far; what answers an observation from before `now` is
    /// stale from now on.
    pub fn begin_anew(&mut self, now: TimeNs) {
        self.forget();
        self.not_before = now;
    }

    /// The next chunk that is let through starts where the arm is: the arm was held since nobody
    /// answered.
    pub fn go_on(&mut self) {
        self.held = true;
    }

    /// Chunks let through since the start.
    #[must_use]
    pub fn accepted_count(&self) -> u64 {
        self.accepted_count
    }

    /// Chunks refused since the start.
    #[must_use]
    pub fn refused_count(&self) -> u64 {
        self.refused_count
    }

    /// Judges `chunk`; `None` if it is the chunk that was judged last.
    pub fn judge(
        &mut self,
        chunk: &Chunk,
        now: TimeNs,
        commanded_tip_in_rcm: &Pose,
    ) -> Option<GateDecision> {
        let identity = (chunk.sequence, chunk.observed_at);
        if self.judged == Some(identity) {
            return None;
        }
        self.judged = Some(identity);
        let decision = self.decision(chunk, now, commanded_tip_in_rcm);
        if decision.is_accepted() {
            self.accepted = Some(identity);
            self.held = false;
            self.accepted_count += 1;
        } else {
            self.refused_count += 1;
        }
        Some(decision)
    }

    fn decision(&self, chunk: &Chunk, now: TimeNs, commanded: &Pose) -> GateDecision {
        let targets = chunk.valid_targets();
        if targets.is_empty() {
            return GateDecision::WrongLength { len: chunk.len };
        }
        if !(TICK_NS..=STEP_NS_MAX).contains(&chunk.step_ns) {
            return GateDecision::WrongStep {
                step_ns: chunk.step_ns,
            };
        }
        if chunk.observed_at > now {
            return GateDecision::FromTheFuture;
        }
        if let Some((sequence, observed_at)) = self.accepted
            && (chunk.sequence <= sequence || chunk.observed_at < observed_at)
        {
            return GateDecision::OutOfOrder;
        }
        let age_ns = now.since(chunk.observed_at);
        let old = age_ns > self.limits.age_ns_max || chunk.observed_at < self.not_before;
        if old || chunk.due(targets.len() - 1) < now {
            return GateDecision::Stale { age_ns };
        }
        if let Some(decision) = self.first_bad_target(targets) {
            return decision;
        }
        let due = count::index(age_ns / chunk.step_ns).min(targets.len() - 1);
        let target = targets[due].tip_in_rcm();
        let away_m = (target.translation.vector - commanded.translation.vector).norm();
        let away_rad = target.rotation.angle_to(&commanded.rotation);
        let limits = &self.limits;
        if away_m > limits.jump_m_max || away_rad > limits.jump_rad_max {
            return GateDecision::Jump;
        }
        if self.held && (away_m > limits.resume_m_max || away_rad > limits.resume_rad_max) {
            return GateDecision::Elsewhere;
        }
        GateDecision::Accepted
    }

    /// Whether `chunk` is one that the gate may have let through at `newest` or before: as for its
    /// form, at any time.
    pub(super) fn may_have_accepted(&self, chunk: &Chunk, newest: TimeNs) -> bool {
        let targets = chunk.valid_targets();
        !targets.is_empty()
            && (TICK_NS..=STEP_NS_MAX).contains(&chunk.step_ns)
            && chunk.observed_at <= newest
            && self.first_bad_target(targets).is_none()
    }

    fn first_bad_target(&self, targets: &[TipTarget]) -> Option<GateDecision> {
        let mut previous: Option<&TipTarget> = None;
        for (index, target) in (0_u32..).zip(targets) {
            if !is_finite(target) {
                return Some(GateDecision::NotFinite { index });
            }
            let norm = dot(&target.rotation_xyzw, &target.rotation_xyzw).sqrt();
            if (norm - 1.0).abs() > UNIT_TOLERANCE {
                return Some(GateDecision::NotUnit { index });
            }
            if previous.is_some_and(|previous| self.too_far(previous, target)) {
                return Some(GateDecision::StepTooLong { index });
            }
            previous = Some(target);
        }
        None
    }

    fn too_far(&self, from: &TipTarget, to: &TipTarget) -> bool {
        let way_m = (Vector3::from(to.position_m) - Vector3::from(from.position_m)).norm();
        let (a, b) = (&from.rotation_xyzw, &to.rotation_xyzw);
        let half_turn_cosine = (dot(a, b).abs() / (dot(a, a) * dot(b, b)).sqrt()).min(1.0);
        way_m > self.limits.step_m_max || 2.0 * half_turn_cosine.acos() > self.limits.step_rad_max
    }
}

fn is_finite(target: &TipTarget) -> bool {
    target
        .position_m
        .iter()
        .chain(&target.rotation_xyzw)
        .all(|x| x.is_finite())
        && target.jaw.is_finite()
}

fn dot(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

#[cfg(test)]
mod tests;
