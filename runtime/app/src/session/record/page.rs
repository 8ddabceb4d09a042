//! What a page of the console sees of a recording by the expert: how far it is, and one of the
//! episodes that go on.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use serde::Serialize;
use trocar_control::AnyController;
use trocar_log::TickRecord;
use trocar_tasks::cameras::SceneModel;
use trocar_tasks::scene::SceneSnapshot;
use trocar_tasks::task::TaskConfig;
use trocar_topics::TaskReport;

use super::Attempt;
use crate::console::{Console, ControlTap, Facts, FrameTap, SceneTap};
use crate::mailbox::MailboxWriter;
use crate::session::episode::StepView;
use crate::session::source::STEP_NS;
use crate::session::views::show_frame;
use crate::session::{Plan, SessionError};

/// Attempts that a page has.
const ATTEMPTS_MAX: usize = 20;

/// A recording on its way to the pages that look at it.
pub(super) struct RecordPage<'a> {
    console: &'a Console,
    /// Whether an episode is shown.
    taken: AtomicBool,
    status: Mutex<RecordingStatus>,
}

/// How far it is.
#[derive(Debug, Serialize)]
struct RecordingStatus {
    kind: &'static str,
    kept: usize,
    wanted: usize,
    attempts: usize,
    /// The newest, oldest first.
    newest: VecDeque<Attempt>,
}

impl<'a> RecordPage<'a> {
    /// Of a recording that has `kept` episodes of those that are `wanted`.
    pub(super) fn new(console: &'a Console, kept: usize, wanted: usize) -> Self {
        let status = RecordingStatus {
            kind: "recording",
            kept,
            wanted,
            attempts: 0,
            newest: VecDeque::new(),
        };
        console.tell(&status);
        Self {
            console,
            taken: AtomicBool::new(false),
            status: Mutex::new(status),
        }
    }

    /// Tells what became of an attempt.
    pub(super) fn tell(&self, attempt: &Attempt) {
        let mut status = self.status.lock().unwrap_or_else(PoisonError::into_inner);
        status.attempts += 1;
        status.kept += usize::from(attempt.kept);
        if status.newest.len() == ATTEMPTS_MAX {
            status.newest.pop_front();
        }
        status.newest.push_back(attempt.clone());
        self.console.tell(&*status);
    }

    /// Shows the episode of `seed`, which begins with `start`, if no other is shown.
    ///
    /// # Errors
    /// If an arm that carries a camera is not in `start`.
    pub(super) fn begin(
        &'a self,
        plan: &Plan,
        (task, seed): (&TaskConfig, u64),
        start: &SceneSnapshot,
    ) -> Result<Option<EpisodePage<'a>>, SessionError> {
        if self.taken.swap(true, Ordering::Relaxed) {
            return Ok(None);
        }
        let (console, setup) = (self.console, &plan.setup);
        let control = &setup.robot.control;
        let model = SceneModel::new(task, seed);
        let scene = console.show_scene(model, start, &control.arms)?;
        let cameras = setup.cameras_with(Vec::new());
        let facts = Facts::new(
            &setup.task_name,
            &plan.policy.name(),
            seed,
            control,
            cameras,
        );
        let facts = facts.within_s(task.time_limit_s).with_scene();
        let taps = console.show_run(facts.of_recording(), None);
        Ok(Some(EpisodePage {
            of: &self.taken,
            control: taps.control,
            task: taps.task,
            frames: console.frames(),
            scene,
        }))
    }
}

/// The episode that is shown; dropping it leaves the page to another.
pub(super) struct EpisodePage<'a> {
    of: &'a AtomicBool,
    control: ControlTap,
    task: MailboxWriter<TaskReport>,
    frames: FrameTap,
    scene: SceneTap,
}

impl EpisodePage<'_> {
    /// A policy step.
    ///
    /// # Errors
    /// If an arm that carries a camera is not in the scene.
    pub(super) fn step(&mut self, view: &StepView<'_>) -> Result<(), SessionError> {
        let stamp = view.arms.first.state.stamp;
        for (camera, frame) in view.frames.iter().enumerate() {
            show_frame(&self.frames, camera, stamp, frame);
        }
        self.scene.show(view.snapshot, stamp)?;
        self.task.put(view.task.report(stamp, stamp.0 / STEP_NS));
        if let Some(chunks) = view.answer {
            self.control.chunk(chunks, 0);
        }
        Ok(())
    }

    /// A control period.
    pub(super) fn tick(&mut self, record: &TickRecord, controller: &AnyController) {
        self.control.tick(record, controller, 0);
    }
}

impl Drop for EpisodePage<'_> {
    fn drop(&mut self) {
        self.of.store(false, Ordering::Relaxed);
    }
}
