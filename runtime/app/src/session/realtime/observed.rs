//! What a policy process sees: reports and frames of one instant as an observation, and which of
//! them it is asked about.

use std::collections::VecDeque;

use hal::{ArmObservation, FrameRef, Observation, Policy as _, TimeNs, arm_names};
use trocar_nets::loaded_policy::LoadedPolicy;
use trocar_topics::{
    ArmReport, ArmStateTopic, CameraTopic, FrameSubscriber, FrameView, Message as _, Subscriber,
    TopicNode,
};

use crate::session::SessionError;
use crate::session::source::{camera_names, precedes_query};

/// The newest reports of each arm and the newest frame of each camera.
pub(in crate::session) struct ObservationBuffer {
    arms: Vec<Subscriber<ArmReport>>,
    cameras: Vec<FrameSubscriber>,
    reports: Vec<Past>,
    views: Vec<Option<FrameView>>,
}

/// The newest reports of an arm, the newest last: a frame comes after that of its instant, and
/// others may have come meanwhile.
#[derive(Debug, Default)]
struct Past(VecDeque<ArmReport>);

impl Past {
    fn add(&mut self, report: ArmReport) {
        if self.0.len() == ArmReport::UNREAD {
            self.0.pop_front();
        }
        self.0.push_back(report);
    }

    fn newest_first(&self) -> impl Iterator<Item = &ArmReport> {
        self.0.iter().rev()
    }
}

/// Reports and frames that belong together.
pub(in crate::session) struct AlignedObservation<'a> {
    /// The policy step.
    pub(in crate::session) sequence: u64,
    arms: Vec<ArmObservation>,
    frames: Vec<FrameRef<'a>>,
}

impl AlignedObservation<'_> {
    /// As a policy sees it.
    pub(in crate::session) fn observation(&self) -> Observation<'_> {
        Observation {
            arms: &self.arms,
            frames: &self.frames,
        }
    }
}

impl ObservationBuffer {
    /// Reads the topics of the arms and cameras that `network` was trained with.
    pub(in crate::session) fn open(
        node: &TopicNode,
        network: &LoadedPolicy,
    ) -> Result<Self, SessionError> {
        let cameras = camera_names(network.recipe())
            .iter()
            .map(|camera| CameraTopic::subscriber(node, camera))
            .collect::<Result<Vec<_>, _>>()?;
        let arms = arm_names(network.recipe().arms)
            .map(|arm| ArmStateTopic::subscriber(node, arm))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            reports: arms.iter().map(|_| Past::default()).collect(),
            views: cameras.iter().map(|_| None).collect(),
            arms,
            cameras,
        })
    }

    /// Takes what has come since.
    pub(in crate::session) fn look(&mut self) -> Result<(), SessionError> {
        for (arm, past) in self.arms.iter().zip(&mut self.reports) {
            while let Some(report) = arm.next_unread()? {
                past.add(report);
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
        self.reports.iter_mut().for_each(|past| past.0.clear());
        self.views.iter_mut().for_each(|view| *view = None);
        Ok(())
    }

    /// The newest observation, once its parts belong together: the arms were measured when the
    /// first camera took its frame, and frames of others may be `frames_within_ns` from it.
    pub(in crate::session) fn whole(
        &self,
        frames_within_ns: u64,
    ) -> Option<AlignedObservation<'_>> {
        let seen_at = match self.views.first() {
            Some(view) => Some(view.as_ref()?.header().stamp),
            None => None,
        };
        let (stamp, sequence, arms) = of_one_instant(&self.reports, seen_at)?;
        let mut frames = Vec::with_capacity(self.views.len());
        for view in &self.views {
            let view = view.as_ref()?;
            if view.header().stamp.0.abs_diff(stamp.0) > frames_within_ns && !frames.is_empty() {
                return None;
            }
            frames.push(view.as_frame());
        }
        Some(AlignedObservation {
            sequence,
            arms,
            frames,
        })
    }
}

/// What an observation is to a policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::session) enum StepKind {
    /// It wants an answer.
    Query,
    /// It is to be remembered.
    Observe,
    /// It was dealt with, or is none that the policy wants.
    Skip,
}

/// Turns begin at multiples of the query interval. When the camera or the network was too slow for
/// the first observation of a turn, the newest one takes its place.
#[derive(Debug)]
pub(in crate::session) struct QuerySchedule {
    every_steps: u64,
    history_steps: u64,
    /// The turn that the last answer was for.
    answered: Option<u64>,
    /// The last step that was shown without being asked.
    shown: Option<u64>,
}

impl QuerySchedule {
    pub(in crate::session) fn of(network: &LoadedPolicy) -> Self {
        let every_steps = u64::from(network.recipe().query_every_steps);
        Self::new(every_steps, network.history_steps())
    }

    /// With so many policy steps from one query to the next, and before one those that are shown.
    pub(in crate::session) fn new(every_steps: u64, history_steps: u64) -> Self {
        Self {
            every_steps: every_steps.max(1),
            history_steps,
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
    pub(in crate::session) fn of_step(&mut self, step: u64) -> StepKind {
        let turn = step / self.every_steps;
        if self.answered != Some(turn) {
            self.answered = Some(turn);
            return StepKind::Query;
        }
        let wanted = precedes_query(step, self.every_steps, self.history_steps);
        if !wanted || self.shown == Some(step) {
            return StepKind::Skip;
        }
        self.shown = Some(step);
        StepKind::Observe
    }
}

/// Time and sequence of the newest reports that are of one instant, that of `seen_at` if there is
/// one, and the arms in them.
fn of_one_instant(
    reports: &[Past],
    seen_at: Option<TimeNs>,
) -> Option<(TimeNs, u64, Vec<ArmObservation>)> {
    let mut first = reports.first()?.newest_first();
    first.find_map(|first| {
        if seen_at.is_some_and(|stamp| stamp != first.stamp) {
            return None;
        }
        let arms = reports.iter().map(|past| {
            let mut past = past.newest_first();
            past.find(|report| (report.stamp, report.sequence) == (first.stamp, first.sequence))
                .map(|report| ArmObservation {
                    state: report.state(),
                    tip_in_rcm: report.tip_in_rcm(),
                })
        });
        Some((first.stamp, first.sequence, arms.collect::<Option<_>>()?))
    })
}

#[cfg(test)]
mod tests {
    use hal::{ArmState, JointVector, Pose};

    use super::*;

    fn past(steps: &[u64], jaw: f64) -> Past {
        let mut past = Past::default();
        for &step in steps {
            let state = ArmState::at_rest(TimeNs(step * 40), JointVector::zeros(), jaw);
            past.add(ArmReport::new(step, &state, &Pose::identity()));
        }
        past
    }

    #[test]
    fn arms_are_seen_together_or_not_at_all() {
        let seen = of_one_instant(&[past(&[3], 0.1), past(&[3], 0.2)], None);
        let (stamp, sequence, arms) = seen.unwrap();
        assert_eq!((stamp, sequence), (TimeNs(120), 3));
        let jaws: Vec<f64> = arms.iter().map(|arm| arm.state.jaw_position).collect();
        assert_eq!(jaws, [0.1, 0.2]);
        // The second arm's report is still that of the step before, or not there at all.
        assert!(of_one_instant(&[past(&[3], 0.1), past(&[2], 0.2)], None).is_none());
        assert!(of_one_instant(&[past(&[3], 0.1), past(&[], 0.2)], None).is_none());
        assert!(of_one_instant(&[past(&[], 0.1), past(&[3], 0.2)], None).is_none());
        assert!(of_one_instant(&[], None).is_none());
    }

    /// The arms are measured on while a camera draws: its frame is seen with the arms of its own
    /// instant, and with no others.
    #[test]
    fn a_frame_goes_with_the_arms_of_its_instant() {
        let arms = [past(&[3, 4, 5], 0.1), past(&[3, 4], 0.2)];
        let step = |seen_at| of_one_instant(&arms, seen_at).map(|(_, sequence, _)| sequence);
        assert_eq!(step(Some(TimeNs(3 * 40))), Some(3));
        assert_eq!(step(Some(TimeNs(4 * 40))), Some(4));
        assert_eq!(step(Some(TimeNs(5 * 40))), None);
        assert_eq!(step(Some(TimeNs(6 * 40))), None);
        // Without cameras the newest instant of all arms counts.
        assert_eq!(step(None), Some(4));
        let many: Vec<u64> = (0..40).collect();
        let kept = past(&many, 0.1).0;
        assert_eq!(kept.len(), ArmReport::UNREAD);
        assert_eq!(kept.back().map(|report| report.sequence), Some(39));
    }

    #[test]
    fn a_turn_is_answered_once_and_its_end_is_shown() {
        let mut turns = QuerySchedule::new(10, 2);
        let mut seen = |step| turns.of_step(step);
        // The first of a turn that can be answered is, be it late.
        assert_eq!(seen(3), StepKind::Query);
        assert_eq!(seen(3), StepKind::Skip);
        assert_eq!(seen(7), StepKind::Skip);
        assert_eq!(seen(8), StepKind::Observe);
        assert_eq!(seen(8), StepKind::Skip);
        assert_eq!(seen(9), StepKind::Observe);
        assert_eq!(seen(10), StepKind::Query);
        assert_eq!(seen(11), StepKind::Skip);
        turns.begin();
        assert_eq!(turns.of_step(10), StepKind::Query);
    }
}
