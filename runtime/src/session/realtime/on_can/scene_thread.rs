//! The world of arms on CAN, which is in another process: its scene for the local policies, the arms' states for a policy
//! process, its frames for the log, and its verdict.

use std::sync::Arc;

use hal::{ArmState, CameraFrame, Chunk, Intrinsics, SeenArm, TimeNs};
use rtrb::Producer;
use trocar_topics::{
    ArmReport, ArmStateTopic, CameraTopic, FrameSubscriber, Publisher, SceneReport, Subscriber,
    TopicNode, Verdict,
};

use super::super::policy_process::arm_names;
use super::super::signals::{EndsRun, Signals};
use super::happened::{Happened, Noticed};
use crate::histogram::Histogram;
use crate::log::SideLog;
use crate::mailbox::MailboxReader;
use crate::per_arm::PerArm;
use crate::rt::{self, MonotonicClock};
use crate::session::source::{ChunkSource, Query, seen_arm};
use crate::session::summary::TissueSummary;
use crate::session::world_report::{scene_state, tissue};
use crate::session::{SessionError, Setup};

/// Time between two looks, ns; the world speaks every 40 ms.
const POLL_NS: u64 = 3_000_000;

/// A world that says nothing for this long is gone, ns.
const SILENCE_NS_MAX: u64 = 2_000_000_000;

/// The thread before it runs.
pub(super) struct SceneThread {
    pub(super) scene: Subscriber<SceneReport>,
    pub(super) clock: MonotonicClock,
    pub(super) measured: MailboxReader<PerArm<ArmState>>,
    pub(super) noticed: MailboxReader<Noticed>,
    /// What of it is in the log.
    pub(super) told: Option<PerArm<Happened>>,
    pub(super) local: Option<(ChunkSource, Producer<PerArm<Chunk>>)>,
    /// For a policy process, one an arm.
    pub(super) reports: Vec<Publisher<ArmReport>>,
    /// For the log.
    pub(super) frames: Vec<(String, FrameSubscriber)>,
    pub(super) log: Option<SideLog>,
    pub(super) signals: Arc<Signals>,
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

/// The topics for a policy process with the arms of `setup`.
pub(super) fn arm_reports(
    node: &TopicNode,
    setup: &Setup,
) -> Result<Vec<Publisher<ArmReport>>, SessionError> {
    let names = arm_names(setup.task.arms.len());
    let reports = names.map(|arm| ArmStateTopic::publisher(node, arm));
    Ok(reports.collect::<Result<_, _>>()?)
}

/// The frames of the cameras `names`, should the world show them.
pub(super) fn frames(
    node: &TopicNode,
    names: Vec<String>,
) -> Result<Vec<(String, FrameSubscriber)>, SessionError> {
    let open = |name: String| {
        let topic = CameraTopic::subscriber(node, &name)?;
        Ok((name, topic))
    };
    names.into_iter().map(open).collect()
}

impl SceneThread {
    /// Runs until the control thread has stopped; says so when the task has its verdict or the world is gone.
    pub(super) fn run(mut self) -> Result<SceneEnd, SessionError> {
        let signals = Arc::clone(&self.signals);
        let _ends = EndsRun(&signals);
        let mut end = SceneEnd {
            verdict: Verdict::Waiting,
            reason: "tick limit".to_owned(),
            inference: Histogram::new(),
            tissue: None,
        };
        let (mut newest, mut heard, mut begun) = (None, self.clock.now(), None);
        while !signals.stopped() {
            newest = self.measured.take().or(newest);
            self.tell_news();
            self.keep_frames()?;
            if let Some(report) = self.scene.newest()? {
                heard = self.clock.now();
                end.tissue = tissue(&report);
                let decided = matches!(
                    end.verdict,
                    Verdict::Success | Verdict::Failure | Verdict::Invalid
                );
                if !decided {
                    end.verdict = report.verdict();
                    end.reason = report.reason.text();
                }
                match end.verdict {
                    Verdict::Waiting => {}
                    Verdict::Running => {
                        let first = *begun.get_or_insert(report.sequence);
                        let step = report.sequence.saturating_sub(first);
                        if let Some(states) = newest.filter(|_| !signals.done()) {
                            self.observe(step, &report, &states, &mut end.inference)?;
                        }
                    }
                    Verdict::Success | Verdict::Failure | Verdict::Invalid => signals.end_run(),
                }
            } else if self.clock.now().since(heard) > SILENCE_NS_MAX && !signals.done() {
                end.reason = format!(
                    "the world has shown nothing for {} s",
                    SILENCE_NS_MAX / 1_000_000_000
                );
                signals.end_run();
            }
            self.keep_alive()?;
            rt::sleep_ns(POLL_NS);
        }
        self.tell_news();
        Ok(end)
    }

    /// A policy step: the arms as they are now belong to the scene that was just shown.
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
        let observed_at = self.clock.from_system(report.stamp);
        if let Some((source, chunks)) = &mut self.local
            && step.is_multiple_of(source.query_every_steps())
        {
            let scene = scene_state(report);
            let query = Query {
                arms: states.map(|state| seen_at(&state, observed_at)),
                frames: &[],
                scene: &scene,
            };
            let clock = MonotonicClock::new();
            let answer = source.answer(&query)?;
            inference.record(clock.now().0);
            // The control thread takes one a tick; a full queue means that it is gone.
            let _gone = chunks.push(answer);
        }
        Ok(())
    }

    /// Writes into the log what has happened to an arm and its buses.
    fn tell_news(&mut self) {
        let Some((at, happened)) = self.noticed.take() else {
            return;
        };
        let told = self.told.replace(happened);
        let told = told.unwrap_or(happened.map(|_| Happened::default()));
        let Some(log) = &mut self.log else {
            return;
        };
        let arms = happened.iter().zip(told.iter());
        for ((now, before), name) in arms.zip(arm_names(happened.count())) {
            for (level, text) in now.news(before) {
                log.event(at, level, &format!("{name}: {text}"));
            }
        }
    }

    /// Hands frames that have come to the log.
    fn keep_frames(&mut self) -> Result<(), SessionError> {
        let Some(log) = &mut self.log else {
            return Ok(());
        };
        for (name, topic) in &mut self.frames {
            if let Some(view) = topic.newest()? {
                let mut frame = CameraFrame::blank(Intrinsics::default());
                view.to_frame(&mut frame);
                frame.stamp = self.clock.from_system(frame.stamp);
                log.frame(name, &frame);
            }
        }
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

/// An arm in `state` as a policy sees it at `stamp`.
fn seen_at(state: &ArmState, stamp: TimeNs) -> SeenArm {
    seen_arm(&ArmState { stamp, ..*state })
}
