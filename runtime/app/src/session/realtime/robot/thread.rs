//! What a policy sees of a robot: the arms as they were when its first camera took a frame, and
//! frames of all its cameras; or the arms alone, every policy step, if it looks at none.

use std::collections::VecDeque;
use std::sync::Arc;

use hal::{ArmState, TimeNs};
use trocar_log::Level;
use trocar_topics::{ArmReport, Events, Publisher};

use super::super::by_hand::ByHand;
use super::super::channels::{Local, ObserverChannels};
use super::super::child::{ANSWER_NS_MAX, answers_nothing};
use super::super::observed::StepKind;
use super::super::remote_arms::{AHEAD_NS_MAX, Camera, FRAME_NS_MAX, logged, seen_at};
use super::super::shown::CameraPages;
use super::super::signals::{EndRunOnDrop, HoldCause, Signals};
use super::queries::Queries;
use super::sight::{CameraMonitor, Rules};
use super::{ArmsScene, RobotOptions};
use crate::histogram::Histogram;
use crate::rt;
use crate::session::SessionError;
use crate::session::source::{ChunkSource, Query, STEP_NS};
use crate::session::teleop::Hands;
use hal::PerArm;

/// Polling period for the measured arms, which wake nobody, ns; a frame does.
const POLL_NS: u64 = 2_000_000;

/// How far a measurement may be from the instant that it stands for, ns.
const NEAR_NS: u64 = 20_000_000;

/// Looks whose measurements are kept: more than a camera's frame takes to come.
const KEPT: usize = 512;

/// The thread before it runs.
pub(in super::super) struct RobotThread {
    seen: ObserverChannels,
    local: Local,
    /// An operator's hands that move the arms, or may.
    by_hand: Option<ByHand>,
    /// For a policy process, one an arm.
    reports: Vec<Publisher<ArmReport>>,
    /// Those that the policy looks through first.
    cameras: Vec<Camera>,
    sight: CameraMonitor,
    /// After how long it ends, ns.
    limit_ns: Option<u64>,
    past: Past,
    /// When a policy of this process was last shown an instant, or first could have been.
    policy_shown: Option<TimeNs>,
    events: Option<Events>,
    /// Pages that are shown frames.
    pages: Option<CameraPages>,
    /// Where a person says how the run goes, if that is asked.
    marked_by: Option<Arc<Hands>>,
    /// Pages that are shown the instruments.
    scene: Option<ArmsScene>,
}

/// What it leaves behind.
pub(in super::super) struct RobotEnd {
    /// Why the run was ended from here, if it was: the time was up, a camera was gone, or the
    /// policy was shown nothing.
    pub(in super::super) ended_by: Option<String>,
    /// Whether that was what was asked.
    pub(in super::super) as_asked: bool,
    /// How long the local policy took for its chunks.
    pub(in super::super) inference: Histogram,
}

/// Where the arms were, newest last.
#[derive(Debug, Default)]
struct Past(VecDeque<(TimeNs, PerArm<ArmState>)>);

impl Past {
    fn add(&mut self, at: TimeNs, states: PerArm<ArmState>) {
        if self.0.len() == KEPT {
            self.0.pop_front();
        }
        self.0.push_back((at, states));
    }

    /// What was measured at `at`, if it is known.
    fn at(&self, at: TimeNs) -> Option<&PerArm<ArmState>> {
        let nearest = self.0.iter().min_by_key(|(then, _)| then.0.abs_diff(at.0));
        let near = nearest.filter(|(then, _)| then.0.abs_diff(at.0) <= NEAR_NS);
        near.map(|(_, states)| states)
    }

    /// When the first was measured that is still known.
    fn begins(&self) -> Option<TimeNs> {
        self.0.front().map(|(at, _)| *at)
    }
}

impl RobotThread {
    pub(in super::super) fn new(
        seen: ObserverChannels,
        local: Local,
        reports: Vec<Publisher<ArmReport>>,
        (cameras, looked_at): (Vec<Camera>, usize),
        (asked, supervised): (&RobotOptions, Rules),
    ) -> Self {
        let names = cameras.iter().take(looked_at);
        let names = names.map(|(name, _)| name.clone()).collect();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "checked to be a time of some days at most"
        )]
        let limit_ns = asked.seconds.map(|seconds| (seconds * 1e9) as u64);
        Self {
            seen,
            local,
            by_hand: None,
            reports,
            cameras,
            sight: CameraMonitor::new(names, supervised),
            limit_ns,
            past: Past::default(),
            policy_shown: None,
            events: None,
            pages: None,
            marked_by: None,
            scene: None,
        }
    }

    /// The same thread, which looks at an operator's hands if there are some.
    pub(in super::super) fn moved_by(self, by_hand: Option<ByHand>) -> Self {
        Self { by_hand, ..self }
    }

    /// The same thread, which a new frame wakes.
    pub(in super::super) fn woken_by(self, events: Events) -> Self {
        let events = Some(events);
        Self { events, ..self }
    }

    /// The same thread, which shows frames on `pages` if there are some.
    pub(in super::super) fn shown_on(self, pages: Option<CameraPages>) -> Self {
        Self { pages, ..self }
    }

    /// The same thread, which shows the instruments in `scene` if there is one.
    pub(in super::super) fn shown_in(self, scene: Option<ArmsScene>) -> Self {
        Self { scene, ..self }
    }

    /// The same thread, which tells the log how the run is marked at `marked_by`, if that is asked.
    pub(in super::super) fn marked_by(self, marked_by: Option<Arc<Hands>>) -> Self {
        Self { marked_by, ..self }
    }

    /// Runs until the control thread has stopped; ends the run when the time is up or a camera that
    /// the policy needs is gone.
    pub(in super::super) fn run(mut self) -> Result<RobotEnd, SessionError> {
        let signals = Arc::clone(&self.seen.signals);
        let _ends = EndRunOnDrop(&signals);
        let mut end = RobotEnd {
            ended_by: None,
            as_asked: false,
            inference: Histogram::new(),
        };
        let mut queries = Queries::of(self.local.as_ref().map(|(source, _)| source));
        let (mut first, mut observed): (_, Option<TimeNs>) = (None, None);
        self.sight.begin(self.seen.clock.now());
        while !signals.stopped() {
            self.tell();
            let now = self.seen.clock.now();
            if let Some(states) = self.seen.measured.take() {
                self.past.add(states.first.stamp, states);
                self.show_arms(&states);
                if let Some(by_hand) = self.by_hand.as_mut().filter(|_| !signals.done()) {
                    by_hand.look(&states, now, &signals)?;
                }
            }
            let frame = self.newest_frame(&mut queries)?;
            let begun = first.or_else(|| self.past.begins());
            if let Some(begun) = begun {
                first = Some(begun);
                let at = if self.is_blind() { Some(now) } else { frame };
                let at = at.filter(|at| *at >= begun && observed.is_none_or(|last| last < *at));
                if let Some(at) = at.filter(|_| !signals.done()) {
                    observed = Some(at);
                    let step = at.since(begun) / STEP_NS;
                    queries.begin(step, at);
                    self.report(step, at)?;
                }
                if !signals.done() {
                    self.ask(&mut queries, &mut end.inference)?;
                }
                self.end_in_time((begun, now), &signals, &mut end);
            } else {
                self.sight.begin(now);
            }
            for report in &self.reports {
                report.keep_alive()?;
            }
            match &self.events {
                Some(events) => rt::wait(events, POLL_NS),
                None => rt::sleep_ns(POLL_NS),
            }
        }
        self.tell();
        Ok(end)
    }

    /// Ends the run, which has `begun`, if its time is up, a camera that the policy needs is gone,
    /// or the policy is shown nothing.
    fn end_in_time(
        &mut self,
        (begun, now): (TimeNs, TimeNs),
        signals: &Signals,
        end: &mut RobotEnd,
    ) {
        let up = self
            .limit_ns
            .is_some_and(|limit_ns| now.since(begun) >= limit_ns);
        let blind = self.sight.judge(now, signals);
        let blind = blind.or_else(|| self.shown_nothing(now, signals));
        let due = up || blind.is_some();
        if !due || signals.done() {
            return;
        }
        end.as_asked = up;
        end.ended_by = Some(match blind.filter(|_| !up) {
            Some(reason) => reason,
            None => {
                let limit_s = self.limit_ns.map_or(0.0, |ns| TimeNs(ns).seconds());
                format!("the {limit_s} s are over")
            }
        });
        signals.end_run();
    }

    /// Why the run ends if a policy of this process has for too long been shown nothing at `now`;
    /// while the arms hold for frames it is not to be.
    fn shown_nothing(&mut self, now: TimeNs, signals: &Signals) -> Option<String> {
        let (source, _) = self.local.as_ref()?;
        let interval_ns = source.query_every_steps().saturating_mul(STEP_NS);
        let limit_ns = ANSWER_NS_MAX.saturating_add(interval_ns);
        if signals.lacks(HoldCause::Frames) {
            self.policy_shown = Some(now);
        }
        let shown = *self.policy_shown.get_or_insert(now);
        let unshown_ns = now.since(shown);
        (unshown_ns > limit_ns).then(|| answers_nothing(unshown_ns))
    }

    /// Whether the policy goes by no camera's frames; those of an operator beside it are none of
    /// its.
    fn is_blind(&self) -> bool {
        let sees = |(source, _): &(ChunkSource, _)| !source.cameras().is_empty();
        let beside = self.by_hand.is_some() && !self.local.as_ref().is_none_or(sees);
        beside || self.sight.is_blind()
    }

    /// Keeps what cameras show in the log and for `queries`; when the newest frame of the policy's
    /// first camera was taken, if there is a new one.
    fn newest_frame(&mut self, queries: &mut Queries) -> Result<Option<TimeNs>, SessionError> {
        let mut taken = None;
        for (index, (name, topic)) in self.cameras.iter_mut().enumerate() {
            let Some(view) = topic.newest()? else {
                continue;
            };
            let now = self.seen.clock.now();
            let header = view.header();
            let stamp = self.seen.clock.from_system(header.stamp);
            let size = (header.intrinsics.width, header.intrinsics.height);
            self.sight.sized(index, size);
            // One from ahead would be the newest for ever.
            if stamp > now.plus_ns(AHEAD_NS_MAX) {
                continue;
            }
            // A camera that lags shows nothing of now.
            if now.since(stamp) <= FRAME_NS_MAX {
                self.sight.saw(index, now);
                self.sight.coloured(index, view.colour(), now);
            }
            if index == 0 {
                taken = Some(stamp);
            }
            if let Some(scene) = &mut self.scene {
                scene.saw(index, &header.intrinsics, &header.camera_in_scene());
            }
            if let Some(pages) = &self.pages {
                pages.show(name, &view, self.seen.clock);
            }
            if let Some(log) = &mut self.seen.log {
                log.frame(name, &logged(&view, &self.seen.clock));
            }
            queries.saw(index, view);
        }
        Ok(taken)
    }

    /// Writes into the log what has happened, and how the run is marked.
    fn tell(&mut self) {
        let marked = self.marked_by.as_ref().and_then(|hands| hands.take_mark());
        if let Some(mark) = marked {
            let text = match mark {
                Some(mark) => format!("the operator marks the run: {}", mark.name()),
                None => "the operator takes the mark of the run back".to_owned(),
            };
            let now = self.seen.clock.now();
            self.seen.signals.tell(now, Level::Info, &text);
        }
        self.seen.tell();
    }

    /// Shows pages where the arms are; a scene that can't be shown ends with a word, the run goes
    /// on.
    fn show_arms(&mut self, states: &PerArm<ArmState>) {
        let shown = self.scene.as_mut().map(|scene| scene.show(states));
        if let Some(Err(error)) = shown {
            let text = format!("pages are shown no more of the scene: {error}");
            let signals = &self.seen.signals;
            signals.tell(self.seen.clock.now(), Level::Warning, &text);
            self.scene = None;
        }
    }

    /// Tells a policy process where the arms were `at` the instant of a frame, which it needs to go
    /// with that frame.
    fn report(&self, step: u64, at: TimeNs) -> Result<(), SessionError> {
        let Some(states) = self.past.at(at) else {
            return Ok(());
        };
        let stamp = self.seen.clock.to_system(at);
        for (topic, state) in self.reports.iter().zip(states.iter()) {
            let seen = seen_at(state, stamp);
            topic.publish(&ArmReport::new(step, &seen.state, &seen.tip_in_rcm))?;
        }
        Ok(())
    }

    /// Shows a policy of this process the newest instant once all that it sees of it is there, the
    /// arms as they were then among it.
    fn ask(
        &mut self,
        queries: &mut Queries,
        inference: &mut Histogram,
    ) -> Result<(), SessionError> {
        let clock = self.seen.clock;
        let (Some((source, chunks)), Some(at)) = (&mut self.local, queries.at()) else {
            return Ok(());
        };
        let Some(states) = self.past.at(at) else {
            return Ok(());
        };
        let arms = states.map(|state| seen_at(&state, at));
        let Some((kind, frames)) = queries.take(clock) else {
            return Ok(());
        };
        match kind {
            StepKind::Skip => {}
            StepKind::Observe => source.observe(&arms, &frames)?,
            StepKind::Query => {
                let query = Query {
                    arms,
                    frames: &frames,
                    scene: None,
                };
                let before = clock.now();
                let answer = source.answer(&query)?;
                inference.record(clock.now().since(before));
                // The control thread takes one a tick; a full queue means that it is gone.
                let _gone = chunks.push(answer);
            }
        }
        // Its inference may have taken long.
        self.policy_shown = Some(clock.now());
        Ok(())
    }
}

#[cfg(test)]
mod tests;
