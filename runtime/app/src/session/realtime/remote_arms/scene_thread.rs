//! The world of arms in another process: its scene for the local policies, the arms' states for a
//! policy process, its frames for the log, all of it for the console's pages, and its verdict.

use std::sync::Arc;

use hal::{ArmObservation, ArmState, CameraFrame, Intrinsics, PerArm, TimeNs, arm_names};
use trocar_topics::{
    ArmReport, ArmStateTopic, CameraTopic, Events, FrameView, Publisher, SceneReport, Subscriber,
    TopicNode, Verdict,
};

use super::super::by_hand::ByHand;
use super::super::channels::{Local, ObserverChannels};
use super::super::scene_topics::{WorldForPages, show_pages};
use super::super::shown::CameraPages;
use super::super::signals::EndRunOnDrop;
use super::awaited::{Camera, PATIENCE_NS, PrintLine};
use crate::histogram::Histogram;
use crate::rt::{self, MonotonicClock};
use crate::session::SessionError;
use crate::session::source::{Query, seen_arm};
use crate::session::summary::TissueSummary;
use crate::session::world_report::{scene_state, tissue};

/// Polling period for the control thread's news, which wakes nobody, ns; what the world shows every
/// 40 ms does.
const POLL_NS: u64 = 3_000_000;

/// A world that says nothing for this long is gone, ns.
const SILENCE_NS_MAX: u64 = 2_000_000_000;

/// Our drives are a world's own if these are operational this long after the thread has begun,
/// which is when ours are checked and started, and its episode begins this long after they are
/// enabled, at the latest, ns.
const BEGIN_NS_MAX: u64 = 3_000_000_000;

/// The thread before it runs.
pub(super) struct SceneThread<'a> {
    /// Says what is waited for.
    pub(super) say: PrintLine<'a>,
    /// A report every 40 ms.
    pub(super) scene: Subscriber<SceneReport>,
    /// Wakes the thread when anything is published on the world's topics.
    pub(super) events: Events,
    pub(super) seen: ObserverChannels,
    pub(super) local: Local,
    /// An operator's hands that move the arms, or may.
    pub(super) by_hand: Option<ByHand>,
    /// For a policy process, one an arm.
    pub(super) reports: Vec<Publisher<ArmReport>>,
    /// For the log and the pages.
    pub(super) frames: Vec<Camera>,
    /// Those of them that the log keeps.
    ///
    /// By name; an error of one of these ends the thread, of another only its page.
    pub(super) logged: Vec<String>,
    pub(super) camera_pages: Option<CameraPages>,
    pub(super) world_pages: Option<WorldForPages>,
}

/// What it leaves behind.
pub(super) struct SceneEnd {
    /// The world's verdict.
    pub(super) verdict: Verdict,
    /// Why the episode was lost, or why there was no verdict.
    pub(super) reason: String,
    /// How long the local policy took for its chunks.
    pub(super) inference: Histogram,
    /// What a soft tissue went through, if the task has one.
    pub(super) tissue: Option<TissueSummary>,
}

impl SceneEnd {
    /// Of an episode that has not begun.
    fn new() -> Self {
        Self {
            verdict: Verdict::Waiting,
            reason: "tick limit".to_owned(),
            inference: Histogram::new(),
            tissue: None,
        }
    }
}

/// The topics on which a policy process hears of `count` arms, if there is one.
pub(in super::super) fn arm_reports(
    node: &TopicNode,
    count: usize,
    has_process: bool,
) -> Result<Vec<Publisher<ArmReport>>, SessionError> {
    let names = arm_names(if has_process { count } else { 0 });
    let reports = names.map(|arm| ArmStateTopic::publisher(node, arm));
    Ok(reports.collect::<Result<_, _>>()?)
}

/// The frames of the cameras `names`, should the world show them.
pub(super) fn frames(node: &TopicNode, names: &[String]) -> Result<Vec<Camera>, SessionError> {
    let open = |name: &String| {
        let topic = CameraTopic::subscriber(node, name)?;
        Ok((name.clone(), topic))
    };
    names.iter().map(open).collect()
}

/// What of a world is waited for after bring-up, before its episode begins.
struct Awaited {
    /// When this wait began, by the run's clock.
    since: TimeNs,
    /// Ours have been enabled: what is waited for is then the episode.
    enabled: bool,
    /// Whether the line about it was said.
    named: bool,
}

impl Awaited {
    const fn new(since: TimeNs) -> Self {
        Self {
            since,
            enabled: false,
            named: false,
        }
    }

    /// Names what is waited for, once it takes long; gives why it is given up, if it is. The drives
    /// of the world may be `operational`, and ours `enabled`.
    fn look(
        &mut self,
        now: TimeNs,
        (operational, enabled): (bool, bool),
        say: PrintLine<'_>,
    ) -> Option<String> {
        if enabled && !self.enabled {
            *self = Self::new(now);
            self.enabled = true;
        }
        let (what, lacking) = match (operational, enabled) {
            (_, true) => (
                "the drives are enabled; waiting for the world to begin its episode",
                "the world has not begun its episode",
            ),
            (true, false) => return None,
            (false, false) => (
                "waiting for the drives of the world to be operational; no drive has torque",
                "the drives of the world are not operational: are ours its own?",
            ),
        };
        let waited_ns = now.since(self.since);
        let limit_s = BEGIN_NS_MAX / 1_000_000_000;
        if waited_ns > PATIENCE_NS && !self.named {
            self.named = true;
            say(&format!("{what}, for {limit_s} s at most"));
        }
        (waited_ns > BEGIN_NS_MAX).then(|| format!("{lacking} ({limit_s} s)"))
    }
}

/// Why a world with this verdict is not that of our drives, which are not enabled yet and may be
/// `operational`.
///
/// None if it may be.
fn too_early(verdict: Verdict, operational: bool) -> Option<&'static str> {
    match verdict {
        Verdict::Waiting | Verdict::Operational => None,
        Verdict::Running => (!operational)
            .then_some("the world has begun its episode without our drives: are they its own?"),
        Verdict::Success | Verdict::Failure | Verdict::Invalid => {
            Some("the world's episode was over before our drives were enabled")
        }
    }
}

impl SceneThread<'_> {
    /// Runs until the control thread has stopped; says so when the task has its verdict or the
    /// world is gone.
    ///
    /// # Errors
    /// From the topics and the local policy; [`SessionError::RealTime`] if the world is gone or
    /// turns out not to be ours before any drive has torque. After that the same reasons end the
    /// run with its arms at rest, and are its reason.
    pub(super) fn run(mut self) -> Result<SceneEnd, SessionError> {
        let signals = Arc::clone(&self.seen.signals);
        let _ends = EndRunOnDrop(&signals);
        let mut end = SceneEnd::new();
        let (mut newest, mut heard, mut begun) = (None, self.seen.clock.now(), None);
        let (mut awaits, mut ended) = (Awaited::new(heard), false);
        while !signals.stopped() {
            newest = self.seen.measured.take().or(newest);
            self.seen.tell();
            self.keep_frames()?;
            if let Some(report) = self.scene.newest()? {
                heard = self.seen.clock.now();
                end.tissue = tissue(&report);
                let decided = matches!(
                    end.verdict,
                    Verdict::Success | Verdict::Failure | Verdict::Invalid
                );
                // What ended the run from here is its reason, whatever the world says meanwhile.
                if !decided && !ended {
                    end.verdict = report.verdict();
                    end.reason = report.reason.text();
                }
                if newest.is_none()
                    && let Some(reason) = too_early(end.verdict, signals.torque_allowed())
                {
                    return Err(SessionError::RealTime(reason.to_owned()));
                }
                match end.verdict {
                    Verdict::Waiting | Verdict::Operational => {
                        if end.verdict == Verdict::Operational {
                            signals.allow_torque();
                        }
                        // There are measurements once the drives are enabled.
                        let operational = signals.torque_allowed();
                        let gone = awaits.look(heard, (operational, newest.is_some()), self.say);
                        if let Some(reason) = gone.filter(|_| !signals.done()) {
                            if newest.is_none() {
                                return Err(SessionError::RealTime(reason));
                            }
                            ended = true;
                            end.reason = reason;
                            signals.end_run();
                        }
                    }
                    Verdict::Running => {
                        let first = *begun.get_or_insert(report.sequence);
                        let step = report.sequence.saturating_sub(first);
                        if let Some(states) = newest.filter(|_| !signals.done()) {
                            self.observe(step, &report, &states, &mut end.inference)?;
                        }
                    }
                    Verdict::Success | Verdict::Failure | Verdict::Invalid => signals.end_run(),
                }
            } else if self.seen.clock.now().since(heard) > SILENCE_NS_MAX && !signals.done() {
                end.reason = format!(
                    "the world has published no scene for {} s",
                    SILENCE_NS_MAX / 1_000_000_000
                );
                if newest.is_none() {
                    return Err(SessionError::RealTime(end.reason));
                }
                ended = true;
                signals.end_run();
            }
            let running = end.verdict == Verdict::Running && !signals.done();
            self.move_by_hand(newest.as_ref().filter(|_| running))?;
            // Whoever looks on waits for the policy.
            show_pages(&mut self.world_pages, self.seen.clock, &signals);
            self.keep_alive()?;
            rt::wait(&self.events, POLL_NS);
        }
        self.seen.tell();
        Ok(end)
    }

    /// Lets an operator's hands move the arms, which were measured as `states` last if they are to.
    fn move_by_hand(&mut self, states: Option<&PerArm<ArmState>>) -> Result<(), SessionError> {
        match (&mut self.by_hand, states) {
            (Some(by_hand), Some(states)) => {
                by_hand.look(states, self.seen.clock.now(), &self.seen.signals)
            }
            (None, _) | (_, None) => Ok(()),
        }
    }

    /// A policy step: the arms as they are now belong to the scene that was just shown.
    ///
    /// Reports for a policy process go out every step; a local policy is asked at its own interval,
    /// in this thread, and its time is in `inference`.
    fn observe(
        &mut self,
        step: u64,
        report: &SceneReport,
        states: &PerArm<ArmState>,
        inference: &mut Histogram,
    ) -> Result<(), SessionError> {
        for (topic, state) in self.reports.iter().zip(states.iter()) {
            // The policy process looks for the frames of the same instant, which is the system's.
            let seen = seen_at(state, report.stamp);
            topic.publish(&ArmReport::new(step, &seen.state, &seen.tip_in_rcm))?;
        }
        let observed_at = self.seen.clock.from_system(report.stamp);
        if let Some((source, chunks)) = &mut self.local
            && step.is_multiple_of(source.query_every_steps())
        {
            let scene = scene_state(report);
            let query = Query {
                arms: states.map(|state| seen_at(&state, observed_at)),
                frames: &[],
                scene: Some(&scene),
            };
            let clock = MonotonicClock::new();
            let answer = source.answer(&query)?;
            inference.record(clock.now().0);
            // The control thread takes one a tick; a full queue means that it is gone.
            let _gone = chunks.push(answer);
            for text in source.take_notices() {
                self.seen
                    .signals
                    .tell(observed_at, trocar_log::Level::Info, &text);
            }
        }
        Ok(())
    }

    /// Hands frames that have come to the log and the pages.
    fn keep_frames(&mut self) -> Result<(), SessionError> {
        let (logged_names, signals, now) =
            (&self.logged, &self.seen.signals, self.seen.clock.now());
        let mut failed = None;
        for (name, topic) in &mut self.frames {
            let view = match topic.newest() {
                Ok(view) => view,
                Err(error) if logged_names.contains(name) => return Err(error.into()),
                // Only pages look at it.
                Err(error) => {
                    let text = format!("pages are shown no more of camera {name}: {error}");
                    signals.tell(now, trocar_log::Level::Warning, &text);
                    failed = Some(name.clone());
                    continue;
                }
            };
            let Some(view) = view else {
                continue;
            };
            if let Some(pages) = &self.camera_pages {
                pages.show(name, &view, self.seen.clock);
            }
            if let Some(log) = &mut self.seen.log
                && logged_names.contains(name)
            {
                log.frame(name, &logged(&view, &self.seen.clock));
            }
        }
        self.frames
            .retain(|(name, _)| failed.as_ref() != Some(name));
        Ok(())
    }

    /// Lets a policy process that has just come connect.
    fn keep_alive(&self) -> Result<(), SessionError> {
        for report in &self.reports {
            report.keep_alive()?;
        }
        Ok(())
    }
}

/// A frame of another process as this run's log has it.
pub(in super::super) fn logged(view: &FrameView, clock: &MonotonicClock) -> CameraFrame {
    let mut frame = CameraFrame::blank(Intrinsics::default());
    view.to_frame(&mut frame);
    frame.stamp = clock.from_system(frame.stamp);
    frame
}

/// An arm in `state` as a policy sees it at `stamp`.
pub(in super::super) fn seen_at(state: &ArmState, stamp: TimeNs) -> ArmObservation {
    seen_arm(&ArmState { stamp, ..*state })
}
