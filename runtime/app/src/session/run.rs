//! One run in lockstep, with its log, its pictures and its summary.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use hal::{Arm as _, ArmState, Chunk, TimeNs};
use trocar_nets::checkpoint::load_recipe;
use trocar_nets::compute::Compute;
use trocar_tasks::simulation::{Rendering, Simulation};
use trocar_tasks::task::Outcome;

use super::episode::{Episode, EpisodeEnd, Plan, StepView, Watcher};
use super::latency::Latency;
use super::pictures::Pictures;
use super::source::{ChunkSource, PolicyChoice};
use super::summary::RunSummary;
use super::tally::RunLabels;
use super::{SessionError, Setup, outputs, pictures};
use crate::console::Console;
use crate::rt;
use trocar_control::{ControlConfig, MeasuredClearance, beyond};
use trocar_log::{Level, LogError, Pressure, Recorder, RunHeader, RunOutcome, TickRecord, Writing};

/// The libtorch that the program was built with.
pub const LIBTORCH_VERSION: &str = env!("LIBTORCH_VERSION");

/// The reason of a run that a signal ended.
pub(super) const INTERRUPTED: &str = "interrupted";

/// The reason of a run that the operator ended.
pub(super) const STOPPED: &str = "stopped by the operator";

/// How to run.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// The policy.
    pub policy: PolicyChoice,
    /// Everything random depends on this.
    pub seed: u64,
    /// Where the log goes, if anywhere. A log holds frames even if the policy needs none: see [`Setup::cameras_with`].
    pub log: Option<PathBuf>,
    /// Bytes that the log takes at most on its disk, if it has a bound; it keeps the last part.
    pub log_bytes_max: Option<u64>,
    /// Whether to keep pictures of the run for [`RunResult::pictures`].
    pub pictures: bool,
    /// Delay from observation to chunk, ms; the policy's own if not given.
    pub latency_ms: Option<u64>,
    /// What may come on top of it, evenly from nothing to this, drawn for each chunk by the seed, ms.
    pub latency_jitter_ms: u64,
    /// Where and how the network computes.
    pub compute: Compute,
    /// The page that shows a run in real time, if there is one.
    pub console: Option<Console>,
    /// Says at once what a person should know, from any thread.
    pub warn: fn(&str),
}

impl RunOptions {
    /// Whether anybody but the policy wants frames.
    pub(super) const fn wants_frames(&self) -> bool {
        self.pictures || self.log.is_some()
    }
}

/// What a run leaves behind.
#[derive(Debug)]
pub struct RunResult {
    /// Whether the task was done; of a robot without a task, whether the run ended as it was asked to.
    pub ok: bool,
    /// The summary.
    pub summary: RunSummary,
    /// Frames of the first camera, empty unless asked for.
    pub pictures: Pictures,
    /// Why the log is not whole, if it is not.
    pub log_failure: Option<LogError>,
}

/// Runs one episode in lockstep.
///
/// # Errors
/// From the configuration, the policy, the simulation or the log.
pub fn run_lockstep(setup: &Setup, options: &RunOptions) -> Result<RunResult, SessionError> {
    let source = setup.source(&options.policy, options.seed, options.compute)?;
    run_lockstep_with(setup, options, source)
}

/// The same with a policy of the caller's, [`ChunkSource::policy`]; that of `options` only names it.
///
/// # Errors
/// From the configuration, the policy, the simulation or the log.
pub fn run_lockstep_with(
    setup: &Setup,
    options: &RunOptions,
    mut source: ChunkSource,
) -> Result<RunResult, SessionError> {
    source.reset(options.seed);
    let needs_frames = options.wants_frames() || !source.cameras().is_empty();
    let rendering = if needs_frames {
        Rendering::On
    } else {
        Rendering::Off
    };
    let mut simulation = simulation(setup, options, rendering)?;
    let mut controller = setup.controller()?;
    let cameras = if options.wants_frames() {
        setup.cameras_with(source.cameras())
    } else {
        Vec::new()
    };
    let recorder = open_log(setup, options, true)?;
    let mut watcher = RunWatcher {
        recorder,
        cameras,
        pictures: options.pictures.then(Pictures::default),
    };
    let plan = Plan {
        latency: Latency {
            ticks: options.latency_ms.unwrap_or_else(|| source.latency_ticks()),
            jitter_ticks: options.latency_jitter_ms,
            seed: options.seed,
        },
        tick_limit: setup.tick_limit(),
    };
    let episode = Episode {
        simulation: &mut simulation,
        controller: &mut controller,
        source: &mut source,
    };
    let end = episode.run(&plan, &mut watcher)?;
    let reason = reason_of(&end);
    let success = matches!(end.outcome, Outcome::Success);
    let mut log_failure = None;
    if let Some(mut recorder) = watcher.recorder {
        if let Some(tissue) = &end.tissue {
            let last = TimeNs::from_tick(end.tally.ticks());
            recorder.event(last, Level::Info, &tissue.to_string());
        }
        let outcome = RunOutcome {
            success: Some(success),
            reason: reason.clone(),
            command_hash: end.tally.command_hash(),
        };
        log_failure = recorder.finish(Some(&outcome)).err();
    }
    let labels = RunLabels {
        task: &setup.task_name,
        view: setup.task.view.name(),
        needle: setup.task.needle(),
        scene: setup.scene_file.as_deref(),
        policy: &options.policy.name(),
        trained_on: setup.trained_on.as_deref(),
        weights_sha256: setup.weights_sha256.as_deref(),
        seed: options.seed,
        success: Some(success),
        reason: &reason,
        tissue: end.tissue,
    };
    Ok(RunResult {
        ok: success,
        summary: end.tally.summary(&labels, None),
        pictures: watcher.pictures.unwrap_or_default(),
        log_failure,
    })
}

/// The simulation of a run; says where its arms are beyond a boundary before they are enabled there.
pub(super) fn simulation(
    setup: &Setup,
    options: &RunOptions,
    rendering: Rendering,
) -> Result<Simulation, SessionError> {
    let mut simulation = Simulation::new(&setup.task, options.seed, rendering)?;
    let mut states = vec![simulation.read(TimeNs(0))?];
    if let Some(mut second) = simulation.arm(1) {
        states.push(second.read(TimeNs(0))?);
    }
    warn_of_start(&setup.control, &states, options.warn);
    Ok(simulation)
}

/// Why a run in lockstep ended: a signal comes before the limit of ticks.
fn reason_of(end: &EpisodeEnd) -> String {
    if matches!(end.outcome, Outcome::Running) && rt::interrupted() {
        INTERRUPTED.to_owned()
    } else {
        end.reason()
    }
}

/// Opens the log that `options` ask for; a lockstep log loses nothing, a real-time log never waits.
///
/// # Errors
/// [`SessionError::Log`] or [`SessionError::Output`].
pub fn open_log(
    setup: &Setup,
    options: &RunOptions,
    lockstep: bool,
) -> Result<Option<Recorder>, SessionError> {
    let header = header(setup, options, lockstep);
    open_log_with(&header, options)
}

/// Opens the log that `options` ask for; it begins with `header`.
///
/// # Errors
/// [`SessionError::Log`] or [`SessionError::Output`].
pub(super) fn open_log_with(
    header: &RunHeader,
    options: &RunOptions,
) -> Result<Option<Recorder>, SessionError> {
    let Some(path) = &options.log else {
        return Ok(None);
    };
    pictures::create_parent(path)?;
    let pressure = if header.lockstep {
        Pressure::Block
    } else {
        Pressure::Drop
    };
    let warn = options.warn;
    let on_failure = Box::new(move |error: &LogError| {
        warn(&format!("{}; the run goes on without it", chain(error)));
    });
    let writing = Writing {
        on_failure,
        bytes_max: options.log_bytes_max,
        ..Writing::new(pressure)
    };
    let recorder = Recorder::create_with(path, header, writing)?;
    Ok(Some(recorder))
}

/// An error and what is behind it.
fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join(": ")
}

/// Says where arms are beyond a boundary before they are enabled there.
fn warn_of_start(control: &ControlConfig, arms: &[ArmState], warn: fn(&str)) {
    for start in beyond(control, arms) {
        let MeasuredClearance {
            arm,
            boundary,
            part,
            clearance_m,
            ..
        } = start;
        warn(&format!(
            "{arm} is enabled {:.2} mm beyond {boundary} ({part}): the boundary closes in behind it as it comes out",
            -1e3 * clearance_m
        ));
    }
}

fn header(setup: &Setup, options: &RunOptions, lockstep: bool) -> RunHeader {
    RunHeader {
        task: setup.task_name.clone(),
        policy: options.policy.name(),
        seed: options.seed,
        lockstep,
        view: setup.task.view.name().to_owned(),
        needle: setup.task.needle().map(str::to_owned),
        versions: versions(&options.policy, setup.weights_sha256.as_deref()),
        texts: setup.texts.by_name(),
        left_out: 0,
    }
}

/// What is running and where: program with its commit, library, a checkpoint's weights by their SHA-256 and the dataset that it was
/// trained on, and the machine.
pub(super) fn versions(
    policy: &PolicyChoice,
    weights_sha256: Option<&str>,
) -> BTreeMap<String, String> {
    let dataset = match policy {
        PolicyChoice::Checkpoint(folder) => load_recipe(folder).ok().flatten(),
        PolicyChoice::Expert
        | PolicyChoice::Noop
        | PolicyChoice::Random
        | PolicyChoice::External(_)
        | PolicyChoice::Own(_) => None,
    };
    let dataset = dataset.map(|recipe| {
        let dataset = recipe.dataset;
        format!(
            "{}, {} episodes, {} frames at {} Hz",
            dataset.task, dataset.episodes, dataset.frames, dataset.fps
        )
    });
    let machine = rt::machine();
    let versions = [
        ("trocar", Some(env!("CARGO_PKG_VERSION"))),
        ("commit", Some(env!("TROCAR_COMMIT"))),
        ("libtorch", Some(LIBTORCH_VERSION)),
        ("weights_sha256", weights_sha256),
        ("dataset", dataset.as_deref()),
        ("machine", Some(machine.as_str())),
    ];
    versions
        .into_iter()
        .filter_map(|(name, version)| Some((name.to_owned(), version?.to_owned())))
        .collect()
}

/// Writes the log and keeps pictures, each if asked to.
struct RunWatcher {
    recorder: Option<Recorder>,
    cameras: Vec<String>,
    pictures: Option<Pictures>,
}

impl Watcher for RunWatcher {
    fn cameras(&self) -> Vec<String> {
        self.cameras.clone()
    }

    fn step(&mut self, view: &StepView<'_>) -> Result<(), SessionError> {
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

    fn tick(&mut self, record: &TickRecord) {
        if let Some(recorder) = &mut self.recorder {
            recorder.tick(record);
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
