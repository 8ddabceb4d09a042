//! Demonstrations by hand: a person starts each episode on the console, does the task in real time,
//! and keeps it or not. With a policy that drives, the person takes over where it fails; each frame
//! says who drove.
//!
//! An episode waits for its start with its time standing still. It ends with the judge's verdict or
//! with the person's word; what is kept is drawn afterwards from where everything was at each
//! policy step, so pictures cost the run nothing and none is missing.

use hal::{ArmObservation, CameraFrame, PerArm, TipTarget};
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::task::Outcome;

use super::notes::{ByHandNote, EpisodeNote, source};
use super::{Attempt, Begun, Demonstration, RecordOptions, RecordSummary, StoredFrame, arm_frame};
use crate::console::Console;
use crate::rt;
use crate::session::realtime::run_realtime;
use crate::session::run::{INTERRUPTED, RunResult, STOPPED};
use crate::session::teleop::{self, DemonstrationStep, EpisodeCommand, Phase, Recording};
use crate::session::{Plan, SessionError, Setup};

/// Records the episodes that a person does by hand on `console` until enough are kept; whatever
/// else was done is reported. A signal, or the operator's stop, ends it with what there is.
///
/// # Errors
/// Those of [`record`](super::record), but that a person may fail as often as it takes; and those
/// of a run in real time.
pub fn record_by_hand(
    plan: &Plan,
    options: &RecordOptions,
    console: &Console,
    on_attempt: &mut dyn FnMut(&Attempt),
) -> Result<RecordSummary, SessionError> {
    let plan = &Plan {
        console: Some(console.clone()),
        demonstrates: true,
        ..plan.clone()
    };
    let Begun {
        mut summary,
        mut attempts,
        datasets,
    } = Begun::new(plan, options)?;
    let Some(mut datasets) = datasets else {
        return Ok(summary);
    };
    let mut studio = Studio::new(&plan.setup)?;
    while summary.episodes < options.episodes && !summary.interrupted {
        let seed = plan.seed.wrapping_add(attempts);
        let tell = |phase, kept| {
            console.hands().tell_recording(Recording {
                phase,
                kept,
                wanted: options.episodes,
                seed,
            });
        };
        tell(Phase::Waiting, summary.episodes);
        let one = Plan {
            seed,
            ..plan.clone()
        };
        let mut result = run_realtime(&one, &|line| (one.warn)(line))?;
        tell(Phase::Writing, summary.episodes);
        if [INTERRUPTED, STOPPED].contains(&result.summary.reason.as_str()) {
            summary.interrupted = true;
            break;
        }
        let demonstrated = result.demonstration.take().unwrap_or_default();
        let again = demonstrated.ended == Some(EpisodeCommand::Redo);
        let mut demo = studio.draw(&one, options, &result, demonstrated)?;
        // The label of what is done again is kept for the next try.
        if let Some(note) = demo.note.by_hand.as_mut().filter(|_| !again) {
            note.label = console.hands().take_label();
        }
        // What is done again was no attempt that counts.
        if !again {
            datasets.keep(options, &demo)?;
        }
        let attempt = demo.attempt();
        on_attempt(&attempt);
        summary.add(attempt);
        attempts = attempts.saturating_add(u64::from(!again));
        // A signal while the pictures were drawn; the next run would not know of it.
        summary.interrupted = rt::interrupted();
    }
    tell_end(console, &summary, options);
    summary.failures = datasets.finish()?;
    Ok(summary)
}

fn tell_end(console: &Console, summary: &RecordSummary, options: &RecordOptions) {
    console.hands().tell_recording(Recording {
        phase: Phase::Writing,
        kept: summary.episodes,
        wanted: options.episodes,
        seed: 0,
    });
}

/// The cameras that draw what was demonstrated.
struct Studio {
    cameras: SceneCameras,
    wanted: Vec<usize>,
    frames: Vec<CameraFrame>,
}

impl Studio {
    fn new(setup: &Setup) -> Result<Self, SessionError> {
        let cameras = SceneCameras::new(&setup.task)?;
        let names = setup.cameras_with(Vec::new());
        let wanted: Vec<usize> = names.iter().filter_map(|name| cameras.find(name)).collect();
        let frames = wanted.iter().map(|&camera| cameras.blank_frame(camera));
        let frames = frames.collect::<Result<_, _>>()?;
        Ok(Self {
            cameras,
            wanted,
            frames,
        })
    }

    /// The demonstration of the run of `plan` that ended with `result`, with its pictures if it may
    /// be kept.
    fn draw(
        &mut self,
        plan: &Plan,
        options: &RecordOptions,
        result: &RunResult,
        demonstrated: teleop::Demonstration,
    ) -> Result<Demonstration, SessionError> {
        let summary = &result.summary;
        let task = &plan.setup.task;
        self.cameras.begin_episode(task, plan.seed);
        let steps = demonstrated.moments.len();
        // Whatever else ends an attempt, such as a policy that dies, is no failure of the person's.
        let failed = demonstrated.ended == Some(EpisodeCommand::Discard);
        let frames = if result.ok || (failed && options.failures.is_some()) {
            let moments = demonstrated.moments.iter();
            let frames = moments.map(|moment| self.frame(moment, options.depth));
            frames.collect::<Result<Vec<_>, SessionError>>()?
        } else {
            Vec::new()
        };
        Ok(Demonstration {
            outcome: if result.ok {
                Outcome::Success
            } else {
                Outcome::Running
            },
            reason: summary.reason.clone(),
            steps,
            frames,
            note: EpisodeNote {
                seed: plan.seed,
                grasps: 0,
                drawn: task.drawn(plan.seed),
                disturbances: None,
                by_hand: summary
                    .teleop
                    .zip(source(plan))
                    .map(|(teleop, source)| ByHandNote {
                        source,
                        ended_by: demonstrated.ended.map_or("judge", |_| "operator"),
                        label: None,
                        teleop,
                    }),
            },
        })
    }

    fn frame(
        &mut self,
        moment: &DemonstrationStep,
        depth: bool,
    ) -> Result<StoredFrame, SessionError> {
        for (&camera, frame) in self.wanted.iter().zip(&mut self.frames) {
            self.cameras.render(camera, &moment.scene, frame)?;
        }
        Ok(
            StoredFrame::new(rows(&moment.arms, &moment.targets), &self.frames, depth)
                .driven(moment.by_hand),
        )
    }
}

/// What each arm measured, with the target that whoever drives gave it.
fn rows(
    arms: &PerArm<ArmObservation>,
    targets: &PerArm<TipTarget>,
) -> Vec<trocar_data::dataset::ArmFrame> {
    let both = arms.iter().zip(targets.iter());
    both.map(|(arm, target)| arm_frame(arm, target)).collect()
}
