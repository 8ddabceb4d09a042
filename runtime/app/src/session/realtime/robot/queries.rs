//! When a policy of this process is asked, and what it is shown then: the newest instant, with a
//! frame of each of its cameras.

use hal::{FrameRef, TimeNs};
use trocar_topics::FrameView;

use super::super::observed::{QuerySchedule, StepKind};
use super::super::remote_arms::FRAMES_WITHIN_MS;
use crate::rt::MonotonicClock;
use crate::session::source::ChunkSource;

/// How far a frame of any camera but the first may be from the first one's, ns.
const FRAMES_WITHIN_NS: u64 = FRAMES_WITHIN_MS * 1_000_000;

/// The queries of a policy that looks through the first cameras of a run.
pub(super) struct Queries {
    turns: QuerySchedule,
    /// Policy step and time of the newest instant, until the policy was shown it.
    instant: Option<(u64, TimeNs)>,
    /// The newest frame of each of its cameras.
    views: Vec<Option<FrameView>>,
}

impl Queries {
    /// Those of `source`; none without one.
    pub(super) fn of(source: Option<&ChunkSource>) -> Self {
        let (every, history, cameras) = source.map_or((1, 0, 0), |source| {
            let cameras = source.sized_cameras().len();
            (source.query_every_steps(), source.history_steps(), cameras)
        });
        Self {
            turns: QuerySchedule::new(every, history),
            instant: None,
            views: (0..cameras).map(|_| None).collect(),
        }
    }

    /// Takes in the newest frame of the run's camera at `index`.
    pub(super) fn saw(&mut self, index: usize, view: FrameView) {
        if let Some(newest) = self.views.get_mut(index) {
            *newest = Some(view);
        }
    }

    /// The newest instant is `at`, in the policy step `step`: that of the first camera's newest
    /// frame, or of now if the policy looks through none.
    pub(super) const fn begin(&mut self, step: u64, at: TimeNs) {
        self.instant = Some((step, at));
    }

    /// The newest instant, unless the policy was shown it.
    pub(super) fn at(&self) -> Option<TimeNs> {
        self.instant.map(|(_, at)| at)
    }

    /// What the newest instant is to the policy, which counts as shown from now on, and the frames
    /// of then, by the run's `clock`; nothing before there is one of each camera.
    pub(super) fn take(&mut self, clock: MonotonicClock) -> Option<(StepKind, Vec<FrameRef<'_>>)> {
        let (step, at) = self.instant?;
        let views = self.views.iter().enumerate();
        let frames = views.map(|(index, view)| {
            let frame = view.as_ref()?.as_frame();
            let stamp = clock.from_system(frame.stamp);
            let within_ns = if index == 0 { 0 } else { FRAMES_WITHIN_NS };
            (stamp.0.abs_diff(at.0) <= within_ns).then_some(FrameRef { stamp, ..frame })
        });
        let frames = frames.collect::<Option<Vec<_>>>()?;
        self.instant = None;
        Some((self.turns.of_step(step), frames))
    }
}

#[cfg(test)]
mod tests {
    use hal::{Chunk, Intrinsics, Observation, Policy, PolicyError, Pose};
    use trocar_topics::{CameraTopic, FrameHeader, FramePublisher, FrameSubscriber, TopicNode};

    use super::*;

    /// Wants to have observed the step before a query too.
    struct Remembers;

    impl Policy for Remembers {
        fn reset(&mut self, _seed: u64) {}

        fn history_steps(&self) -> u64 {
            1
        }

        fn infer(&mut self, _: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError> {
            Ok(Vec::new())
        }
    }

    /// A camera that shows frames of any time, ms of the run.
    struct Camera {
        to: FramePublisher,
        from: FrameSubscriber,
        clock: MonotonicClock,
    }

    impl Camera {
        fn new(node: &TopicNode, name: &str, clock: MonotonicClock) -> Self {
            Self {
                to: CameraTopic::publisher(node, name, 16).unwrap(),
                from: CameraTopic::subscriber(node, name).unwrap(),
                clock,
            }
        }

        fn shows(&mut self, ms: u64) -> FrameView {
            let lens = Intrinsics::from_vertical_fov(4, 4, 0.9);
            let stamp = self.clock.to_system(TimeNs(ms * 1_000_000));
            let header = FrameHeader::new(stamp, ms, lens, &Pose::identity());
            let blank = |colour: &mut [u8], depth_m: &mut [f32], instance: &mut [u8]| {
                colour.fill(96);
                depth_m.fill(0.1);
                instance.fill(0);
            };
            self.to.publish_with(&header, blank).unwrap();
            self.from.newest().unwrap().unwrap()
        }
    }

    /// What the policy is to do at the newest instant, and the times of its frames, ms of the run.
    fn taken(queries: &mut Queries, clock: MonotonicClock) -> Option<(StepKind, Vec<u64>)> {
        let (kind, frames) = queries.take(clock)?;
        let times = frames.iter().map(|frame| frame.stamp.0 / 1_000_000);
        Some((kind, times.collect()))
    }

    /// The first camera tells the instant, the others may be 40 ms from it; each instant is shown
    /// once.
    #[test]
    fn frames_of_an_instant_are_shown_together() {
        let clock = MonotonicClock::new();
        let node = TopicNode::join(&format!("test-{}-queries", std::process::id())).unwrap();
        let mut left = Camera::new(&node, "left", clock);
        let mut right = Camera::new(&node, "right", clock);
        let mut other = Camera::new(&node, "other", clock);
        let names = ["left", "right"].map(str::to_owned).to_vec();
        let source = ChunkSource::policy(Box::new(Remembers), names, 5);
        let mut queries = Queries::of(Some(&source));
        let begin = |queries: &mut Queries, step: u64, ms: u64| {
            queries.begin(step, TimeNs(ms * 1_000_000));
        };
        begin(&mut queries, 0, 100);
        assert_eq!(taken(&mut queries, clock), None);
        queries.saw(0, left.shows(100));
        queries.saw(2, other.shows(100));
        assert_eq!(taken(&mut queries, clock), None);
        queries.saw(1, right.shows(59));
        assert_eq!(taken(&mut queries, clock), None, "too far apart");
        queries.saw(1, right.shows(60));
        let shown = taken(&mut queries, clock);
        assert_eq!(shown, Some((StepKind::Query, vec![100, 60])));
        assert_eq!(taken(&mut queries, clock), None, "once");
        begin(&mut queries, 1, 140);
        assert_eq!(taken(&mut queries, clock), None, "an older frame");
        queries.saw(0, left.shows(140));
        queries.saw(1, right.shows(150));
        let shown = taken(&mut queries, clock);
        assert_eq!(shown, Some((StepKind::Skip, vec![140, 150])));
        begin(&mut queries, 4, 260);
        queries.saw(0, left.shows(260));
        queries.saw(1, right.shows(260));
        let shown = taken(&mut queries, clock);
        assert_eq!(shown, Some((StepKind::Observe, vec![260, 260])));
    }

    #[test]
    fn a_policy_without_cameras_is_shown_the_arms_alone() {
        let clock = MonotonicClock::new();
        let mut queries = Queries::of(Some(&ChunkSource::noop()));
        assert_eq!(queries.at(), None);
        queries.begin(3, TimeNs(120));
        assert_eq!(queries.at(), Some(TimeNs(120)));
        let shown = taken(&mut queries, clock);
        assert_eq!(shown, Some((StepKind::Query, Vec::new())));
        assert_eq!(queries.at(), None);
    }
}
