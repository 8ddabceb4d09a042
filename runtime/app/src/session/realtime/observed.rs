//! What a policy process sees: reports and frames of one instant as an observation, and which of them it is asked about.

use hal::{FrameRef, Observation, Policy as _, SeenArm, TimeNs};
use trocar_nets::loaded_policy::LoadedPolicy;
use trocar_topics::{
    ArmReport, ArmStateTopic, CameraTopic, FrameSubscriber, FrameView, Subscriber, TopicNode,
};

use super::policy_process::arm_names;
use crate::session::SessionError;
use crate::session::source::{camera_names, precedes_query};

/// The newest report of each arm and the newest frame of each camera.
pub(in crate::session) struct Observed {
    arms: Vec<Subscriber<ArmReport>>,
    cameras: Vec<FrameSubscriber>,
    reports: Vec<Option<ArmReport>>,
    views: Vec<Option<FrameView>>,
}

/// Reports and frames that belong together.
pub(in crate::session) struct Whole<'a> {
    /// The policy step.
    pub(in crate::session) sequence: u64,
    arms: Vec<SeenArm>,
    frames: Vec<FrameRef<'a>>,
}

impl Whole<'_> {
    /// As a policy sees it.
    pub(in crate::session) fn observation(&self) -> Observation<'_> {
        Observation {
            arms: &self.arms,
            frames: &self.frames,
        }
    }
}

impl Observed {
    /// Reads the topics of the arms and cameras that `network` was trained with.
    pub(in crate::session) fn open(
        node: &TopicNode,
        network: &LoadedPolicy,
    ) -> Result<Self, SessionError> {
        let cameras = camera_names(network)
            .iter()
            .map(|camera| CameraTopic::subscriber(node, camera))
            .collect::<Result<Vec<_>, _>>()?;
        let arms = arm_names(network.recipe().arms)
            .map(|arm| ArmStateTopic::subscriber(node, arm))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            reports: arms.iter().map(|_| None).collect(),
            views: cameras.iter().map(|_| None).collect(),
            arms,
            cameras,
        })
    }

    /// Takes what has come since.
    pub(in crate::session) fn look(&mut self) -> Result<(), SessionError> {
        for (arm, report) in self.arms.iter().zip(&mut self.reports) {
            if let Some(newest) = arm.newest()? {
                *report = Some(newest);
            }
        }
        for (camera, view) in self.cameras.iter_mut().zip(&mut self.views) {
            if let Some(newest) = camera.newest()? {
                *view = Some(newest);
            }
        }
        Ok(())
    }

    /// What has come so far is of no interest any more.
    pub(in crate::session) fn forget(&mut self) -> Result<(), SessionError> {
        self.look()?;
        self.reports.fill(None);
        self.views.iter_mut().for_each(|view| *view = None);
        Ok(())
    }

    /// The newest observation, once its parts belong together: frames of any camera but the first may be `frames_within_ns` from it.
    pub(in crate::session) fn whole(&self, frames_within_ns: u64) -> Option<Whole<'_>> {
        let (stamp, sequence, arms) = of_one_instant(&self.reports)?;
        let mut frames = Vec::with_capacity(self.views.len());
        for (index, view) in self.views.iter().enumerate() {
            let view = view.as_ref()?;
            // The arms were measured when the first camera took its frame.
            let within_ns = if index == 0 { 0 } else { frames_within_ns };
            if view.header().stamp.0.abs_diff(stamp.0) > within_ns {
                return None;
            }
            frames.push(view.as_frame());
        }
        Some(Whole {
            sequence,
            arms,
            frames,
        })
    }
}

/// What an observation is to a policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::session) enum Turn {
    /// It wants an answer.
    Asked,
    /// It is to be remembered.
    Shown,
    /// It was dealt with, or is none that the policy wants.
    Nothing,
}

/// Turns begin at multiples of the query interval. When the camera or the network was too slow for the first observation of a turn, the
/// newest one takes its place.
#[derive(Debug)]
pub(in crate::session) struct Turns {
    every_steps: u64,
    history_steps: u64,
    /// The turn that the last answer was for.
    answered: Option<u64>,
    /// The last step that was shown without being asked.
    shown: Option<u64>,
}

impl Turns {
    pub(in crate::session) fn of(network: &LoadedPolicy) -> Self {
        Self {
            every_steps: u64::from(network.recipe().query_every_steps).max(1),
            history_steps: network.history_steps(),
            answered: None,
            shown: None,
        }
    }

    /// Policy steps from one query to the next, and before one those that are shown.
    pub(in crate::session) const fn steps(&self) -> (u64, u64) {
        (self.every_steps, self.history_steps)
    }

    /// An episode begins.
    pub(in crate::session) const fn begin(&mut self) {
        self.answered = None;
        self.shown = None;
    }

    /// What the observation of `step` is, which counts as dealt with from now on.
    pub(in crate::session) fn of_step(&mut self, step: u64) -> Turn {
        let turn = step / self.every_steps;
        if self.answered != Some(turn) {
            self.answered = Some(turn);
            return Turn::Asked;
        }
        let wanted = precedes_query(step, self.every_steps, self.history_steps);
        if !wanted || self.shown == Some(step) {
            return Turn::Nothing;
        }
        self.shown = Some(step);
        Turn::Shown
    }
}

/// Time and sequence of the reports and the arms in them, once there is one of each arm and all are of the same instant.
fn of_one_instant(reports: &[Option<ArmReport>]) -> Option<(TimeNs, u64, Vec<SeenArm>)> {
    let first = (*reports.first()?)?;
    let mut arms = Vec::with_capacity(reports.len());
    for report in reports {
        let report = report.as_ref()?;
        if (report.stamp, report.sequence) != (first.stamp, first.sequence) {
            return None;
        }
        arms.push(SeenArm {
            state: report.state(),
            tip_in_rcm: report.tip_in_rcm(),
        });
    }
    Some((first.stamp, first.sequence, arms))
}

#[cfg(test)]
mod tests {
    use hal::{ArmState, JointVector, Pose};

    use super::*;

    #[test]
    fn arms_are_seen_together_or_not_at_all() {
        let report = |step: u64, jaw| {
            let state = ArmState::at_rest(TimeNs(step * 40), JointVector::zeros(), jaw);
            Some(ArmReport::new(step, &state, &Pose::identity()))
        };
        let seen = of_one_instant(&[report(3, 0.1), report(3, 0.2)]);
        let (stamp, sequence, arms) = seen.unwrap();
        assert_eq!((stamp, sequence), (TimeNs(120), 3));
        let jaws: Vec<f64> = arms.iter().map(|arm| arm.state.jaw_position).collect();
        assert_eq!(jaws, [0.1, 0.2]);
        // The second arm's report is still that of the step before, or not there at all.
        assert!(of_one_instant(&[report(3, 0.1), report(2, 0.2)]).is_none());
        assert!(of_one_instant(&[report(3, 0.1), None]).is_none());
        assert!(of_one_instant(&[None, report(3, 0.1)]).is_none());
        assert!(of_one_instant(&[]).is_none());
    }

    #[test]
    fn a_turn_is_answered_once_and_its_end_is_shown() {
        let mut turns = Turns {
            every_steps: 10,
            history_steps: 2,
            answered: None,
            shown: None,
        };
        let mut seen = |step| turns.of_step(step);
        // The first of a turn that can be answered is, be it late.
        assert_eq!(seen(3), Turn::Asked);
        assert_eq!(seen(3), Turn::Nothing);
        assert_eq!(seen(7), Turn::Nothing);
        assert_eq!(seen(8), Turn::Shown);
        assert_eq!(seen(8), Turn::Nothing);
        assert_eq!(seen(9), Turn::Shown);
        assert_eq!(seen(10), Turn::Asked);
        assert_eq!(seen(11), Turn::Nothing);
        turns.begin();
        assert_eq!(turns.of_step(10), Turn::Asked);
    }
}
