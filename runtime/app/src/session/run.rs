//! One run in lockstep, with its log, its pictures and its summary.

use std::io::Write as _;
use std::path::Path;

use hal::Chunk;
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::simulation::{Rendering, Simulation};
use trocar_tasks::task::{Outcome, TaskConfig};

use super::ended::Ended;
use super::episode::{Episode, EpisodeObserver, StepView};
use super::pictures::Thumbnails;
use super::source::ChunkSource;
use super::summary::RunSummary;
use super::teleop::Demonstration;
use super::{Plan, SessionError, outputs, pictures, scene_record};
use crate::rt;
use trocar_control::AnyController;
use trocar_log::{LogError, Recorder, TickRecord};

/// The libtorch that the program was built with.
pub const LIBTORCH_VERSION: &str = env!("LIBTORCH_VERSION");

/// The reason of a run that a signal ended.
pub(super) const INTERRUPTED: &str = "interrupted";

/// The reason of a run that the operator ended.
pub(super) const STOPPED: &str = "stopped by the operator";

/// What a run leaves behind.
#[derive(Debug)]
pub struct RunResult {
    /// Whether the task was done; of a robot without a task, whether the run ended as it was asked
    /// to.
    pub ok: bool,
    /// The summary.
    pub summary: RunSummary,
    /// Frames of the first camera, empty unless asked for.
    pub pictures: Thumbnails,
    /// Why the log is not whole, if it is not.
    pub log_failure: Option<LogError>,
    /// What a person has demonstrated, if one was to.
    pub demonstration: Option<Demonstration>,
}

/// Runs one episode in lockstep.
///
/// # Errors
/// From the configuration, the policy, the simulation or the log.
pub fn run_lockstep(plan: &Plan) -> Result<RunResult, SessionError> {
    run_lockstep_with(plan, plan.source()?)
}

/// The same with a policy of the caller's, [`ChunkSource::policy`]; that of `plan` only names it.
///
/// # Errors
/// From the configuration, the policy, the simulation or the log.
pub fn run_lockstep_with(plan: &Plan, mut source: ChunkSource) -> Result<RunResult, SessionError> {
    source.reset(plan.seed);
    let needs_frames = plan.wants_frames() || !source.cameras().is_empty();
    let mut simulation = plan.simulation(rendering(needs_frames))?;
    let mut controller = plan.setup.controller()?;
    let cameras = if plan.wants_frames() {
        plan.setup.cameras_with(source.cameras())
    } else {
        Vec::new()
    };
    let mut watcher = RunWatcher {
        recorder: plan.open_log(true)?,
        cameras,
        pictures: plan.pictures.then(Thumbnails::default),
    };
    let timing = plan.timing(plan.seed, &source);
    let episode = Episode {
        simulation: &mut simulation,
        controller: &mut controller,
        source: &mut source,
    };
    let end = episode.run(&timing, &mut watcher)?;
    let mut ended = Ended::episode(&end);
    // A signal comes before the limit of ticks.
    if matches!(end.outcome, Outcome::Running) && rt::interrupted() {
        INTERRUPTED.clone_into(&mut ended.reason);
    }
    let log_failure = watcher
        .recorder
        .and_then(|recorder| ended.close(recorder, &end.tally).err());
    Ok(RunResult {
        ok: ended.ok,
        summary: end.tally.summary(plan, &ended, None),
        pictures: watcher.pictures.unwrap_or_default(),
        log_failure,
        demonstration: None,
    })
}

/// Whether a simulation draws.
pub(super) const fn rendering(draws: bool) -> Rendering {
    if draws { Rendering::On } else { Rendering::Off }
}

/// The simulation of the episode `seed`, with the `cameras` of the one before if there are some:
/// they are slow to make.
pub(super) fn next_simulation(
    task: &TaskConfig,
    seed: u64,
    cameras: Option<SceneCameras>,
    draws: bool,
) -> Result<Simulation, SessionError> {
    Ok(match cameras {
        Some(cameras) => Simulation::with_cameras(task, seed, cameras),
        None => Simulation::new(task, seed, rendering(draws))?,
    })
}

/// Writes the log and keeps pictures, each if asked to.
struct RunWatcher {
    recorder: Option<Recorder>,
    cameras: Vec<String>,
    pictures: Option<Thumbnails>,
}

impl EpisodeObserver for RunWatcher {
    fn cameras(&self) -> Vec<String> {
        self.cameras.clone()
    }

    fn step(&mut self, view: &StepView<'_>) -> Result<(), SessionError> {
        if let Some(recorder) = &mut self.recorder {
            scene_record::keep(recorder, view);
        }
        for (index, frame) in view.frames.iter().enumerate() {
            if let (Some(recorder), Some(name)) = (&mut self.recorder, self.cameras.get(index)) {
                recorder.frame(name, frame);
            }
            if let (Some(pictures), 0) = (&mut self.pictures, index) {
                pictures.push(frame);
            }
        }
        Ok(())
    }

    fn chunk(&mut self, arm: usize, chunk: &Chunk) {
        if let Some(recorder) = &mut self.recorder {
            recorder.chunk(arm, chunk);
        }
    }

    fn wants_end(&self) -> bool {
        rt::interrupted()
    }

    fn tick_of(&mut self, record: &TickRecord, controller: &AnyController) {
        if let Some(recorder) = &mut self.recorder {
            recorder.tick(record);
            recorder.snapshot(controller);
        }
    }
}

/// Writes `value` as pretty JSON, to standard output if `path` is `-`.
///
/// # Errors
/// [`SessionError::Output`].
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<(), SessionError> {
    let text =
        serde_json::to_string_pretty(value).map_err(|error| SessionError::output(path, error))?;
    if outputs::is_standard_output(path) {
        let written = writeln!(std::io::stdout(), "{text}");
        return written.map_err(|error| SessionError::output(path, error));
    }
    pictures::create_parent(path)?;
    std::fs::write(path, text + "\n").map_err(|error| SessionError::output(path, error))
}
