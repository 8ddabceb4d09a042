//! Demonstrations: episodes of the expert, or of a policy of the caller's, written as a LeRobot v3
//! dataset.

mod by_hand;
mod failures;
pub mod notes;
mod page;
mod resume;

use std::path::PathBuf;

use hal::{ArmObservation, CameraFrame, TipTarget};
use serde::Serialize;
use trocar_control::AnyController;
use trocar_data::dataset::{ArmFrame, CameraSpec, DatasetError, DatasetSpec, Totals, VideoCodec};
use trocar_data::perception::depth_units;
use trocar_log::TickRecord;
use trocar_nets::act_policy::state_numbers;
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::disturbance::Disturber;
use trocar_tasks::task::{Outcome, PatientPlacement, Variation};

pub use self::by_hand::record_by_hand;
use self::failures::Datasets;
use self::notes::{DISTURBED_TIME_FACTOR, DisturbedCounts, EpisodeNote, by_hand_note};
use self::page::{EpisodePage, RecordPage};
use self::resume::{Found, look};
use super::episode::{Episode, EpisodeObserver, StepView};
use super::run::next_simulation;
use super::source::{ChunkSource, MakeSource, STEP_NS};
use super::{Plan, PolicyChoice, SessionError, Setup, parallel};

/// What to record.
#[derive(Clone, Debug)]
pub struct RecordOptions {
    /// How many successful episodes, with those that are there before; attempt i has the plan's
    /// seed + i, which wraps.
    pub episodes: usize,
    /// The dataset's directory; a new or an empty one, unless the recording goes on.
    pub out: PathBuf,
    /// Go on with the recording that is there, which must have been made with these options.
    pub resume: bool,
    /// Episodes at a time.
    pub jobs: usize,
    /// Keep depth and instance ids of every camera too.
    pub depth: bool,
    /// Keep colour as video, which loses some of it, instead of as PNG.
    pub video: Option<VideoCodec>,
    /// The share of demonstrations that is disturbed, if any is.
    pub disturb: Option<f64>,
    /// What the demonstrations do in words, as the dataset's `task`; the task's name if not given.
    pub instruction: Option<String>,
    /// Keep attempts that failed too, as a dataset of their own in this directory, a new or an
    /// empty one; of a recording from its start.
    pub failures: Option<PathBuf>,
}

/// What became of one attempt.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Attempt {
    /// Its seed.
    pub seed: u64,
    /// Whether it was kept.
    pub kept: bool,
    /// How it ended.
    pub reason: String,
    /// Policy steps.
    pub steps: usize,
    /// How often it was disturbed.
    pub disturbances: usize,
    /// Grasps that the expert tried.
    pub grasps: u32,
}

/// What was recorded.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordSummary {
    /// Task name.
    pub task: String,
    /// From where the cameras looked: `train`, `view1` or `view2`.
    pub view: String,
    /// The needle, in a task that has a choice, unless each episode has its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub needle: Option<String>,
    /// What was drawn anew for each episode.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub varied: Vec<Variation>,
    /// What became of the disturbed demonstrations among the attempts, if some were to be.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub disturbed: Option<DisturbedCounts>,
    /// The scene file, if it was not the built-in one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// How the patient lies whose organ is the ground, if it is one's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patient: Option<PatientPlacement>,
    /// The cameras whose frames are in the dataset.
    pub cameras: Vec<String>,
    /// Episodes in the dataset.
    pub episodes: usize,
    /// How many of them were there before.
    pub episodes_before: usize,
    /// Policy steps in all of them.
    pub steps: usize,
    /// How many attempts that failed are in the dataset of their own, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failures: Option<usize>,
    /// Whether a signal ended the recording before there were as many as asked for.
    pub interrupted: bool,
    /// Every attempt that was made now, in the order of its seed's index.
    pub attempts: Vec<Attempt>,
}

impl RecordSummary {
    /// Of a recording that has done nothing yet beyond what it `found`.
    fn new(plan: &Plan, options: &RecordOptions, found: &Found) -> Self {
        let setup = &plan.setup;
        Self {
            task: setup.task_name.clone(),
            view: setup.task.view.name().to_owned(),
            needle: setup.needle().map(str::to_owned),
            varied: setup.task.varied.clone(),
            disturbed: options.disturb.map(|_| DisturbedCounts::default()),
            scene: setup.scene_file.clone(),
            patient: setup.task.patient().cloned(),
            cameras: setup.cameras_with(Vec::new()),
            episodes: found.totals.episodes,
            episodes_before: found.totals.episodes,
            steps: found.totals.frames,
            failures: None,
            interrupted: false,
            attempts: Vec::new(),
        }
    }

    fn add(&mut self, attempt: Attempt) {
        if attempt.kept {
            self.episodes += 1;
            self.steps += attempt.steps;
        }
        if let Some(disturbed) = &mut self.disturbed {
            disturbed.add(&attempt);
        }
        self.attempts.push(attempt);
    }
}

/// A recording before its next episode.
struct Begun {
    summary: RecordSummary,
    /// How many attempts there were before.
    attempts: u64,
    /// None if all episodes were there before: nothing is touched then.
    datasets: Option<Datasets>,
}

impl Begun {
    /// Creates the dataset, or opens the one that the recording is appended to.
    ///
    /// # Errors
    /// Those of [`record`] that concern the dataset's folder.
    fn new(plan: &Plan, options: &RecordOptions) -> Result<Self, SessionError> {
        failures::check(options)?;
        check_lens(plan, options)?;
        let found = look(plan, options)?;
        let summary = RecordSummary::new(plan, options, &found);
        let whole = options.resume && summary.episodes >= options.episodes;
        let datasets = if whole {
            None
        } else {
            let spec = DatasetSpec {
                intervention: plan.demonstrates && plan.policy != PolicyChoice::Teleop,
                ..dataset_spec(&plan.setup, options)
            };
            Some(Datasets::begin(plan, options, &found, &spec)?)
        };
        Ok(Self {
            summary,
            attempts: found.attempts,
            datasets,
        })
    }
}

/// Records the episodes of `plan`, whose policy is the expert, until enough attempts have
/// succeeded; failed ones are reported, and kept apart if that is wanted. Once `stop` says so,
/// those in progress are abandoned, and the dataset has what was done.
///
/// A recording that goes on comes to the same episodes as one without a break: it begins behind the
/// seed of the last one that is there. If there are enough already, nothing is touched.
///
/// # Errors
/// From the simulation or the dataset; [`SessionError::BadArgument`] if the folder is not empty,
/// or, to go on, if it holds no dataset, one that does not say how it was recorded, or one that was
/// recorded with other options; [`SessionError::Unproductive`] if the expert fails far too often.
pub fn record(
    plan: &Plan,
    options: &RecordOptions,
    stop: &(dyn Fn() -> bool + Sync),
    on_attempt: &mut dyn FnMut(&Attempt),
) -> Result<RecordSummary, SessionError> {
    record_by(plan, options, None, stop, on_attempt)
}

/// The same with a policy of the caller's in the place of the expert, asked at every policy step:
/// the action is the first target of its chunk, which is executed after the latency of `plan`, at
/// once if that has none. The plan names it by [`PolicyChoice::Own`], and so does the dataset.
/// `make` makes the policy of each job in its thread, anew where failed attempts are made up for,
/// and one more at first; it is reset with the seed of each attempt.
///
/// # Errors
/// Those of [`record`] and of `make`; [`SessionError::BadArgument`] for a policy that is not asked
/// at every step, and for disturbances, which are the expert's.
pub fn record_with(
    plan: &Plan,
    options: &RecordOptions,
    make: MakeSource<'_>,
    stop: &(dyn Fn() -> bool + Sync),
    on_attempt: &mut dyn FnMut(&Attempt),
) -> Result<RecordSummary, SessionError> {
    check_own(plan, options, &make()?)?;
    // That of a network would leave nothing of a short chunk.
    let plan = &Plan {
        latency_ms: plan.latency_ms.or(Some(0)),
        ..plan.clone()
    };
    record_by(plan, options, Some(make), stop, on_attempt)
}

/// A policy of the caller's has to demonstrate every step, undisturbed and by its name.
fn check_own(
    plan: &Plan,
    options: &RecordOptions,
    source: &ChunkSource,
) -> Result<(), SessionError> {
    let (name, every) = (plan.policy.name(), source.query_every_steps());
    let wrong = if !matches!(plan.policy, PolicyChoice::Own(_)) {
        "the plan has to name the policy of record_with by PolicyChoice::Own".to_owned()
    } else if options.disturb.is_some() {
        "only demonstrations of the expert can be disturbed".to_owned()
    } else if every != 1 {
        format!("it is asked every {every} policy steps, and a demonstration has an action of each")
    } else {
        return Ok(());
    };
    Err(SessionError::BadArgument(format!("policy {name}: {wrong}")))
}

fn record_by(
    plan: &Plan,
    options: &RecordOptions,
    make: Option<MakeSource<'_>>,
    stop: &(dyn Fn() -> bool + Sync),
    on_attempt: &mut dyn FnMut(&Attempt),
) -> Result<RecordSummary, SessionError> {
    let Begun {
        mut summary,
        mut attempts,
        datasets,
    } = Begun::new(plan, options)?;
    let Some(mut datasets) = datasets else {
        return Ok(summary);
    };
    let page = plan.console.as_ref();
    let page = page.map(|to| RecordPage::new(to, summary.episodes, options.episodes));
    let attempts_max = (options.episodes as u64)
        .saturating_mul(4)
        .saturating_add(20);
    while summary.episodes < options.episodes && !summary.interrupted {
        if attempts >= attempts_max {
            return Err(SessionError::Unproductive {
                kept: summary.episodes,
                attempts,
            });
        }
        let wanted = options.episodes - summary.episodes;
        let first = plan.seed.wrapping_add(attempts);
        let mut done = 0;
        parallel::in_order_until(
            wanted,
            options.jobs,
            // What is cut off loses no more than these.
            options.jobs,
            stop,
            || {
                let page = page.as_ref();
                Ok(demonstrator(plan, first, options, make, (stop, page)))
            },
            &mut |index, demo: Option<Demonstration>| {
                // Behind an abandoned attempt nothing counts: seeds have no gaps.
                if let Some(demo) = demo.filter(|_| index == done) {
                    datasets.keep(options, &demo)?;
                    let attempt = demo.attempt();
                    on_attempt(&attempt);
                    if let Some(page) = &page {
                        page.tell(&attempt);
                    }
                    summary.add(attempt);
                    done += 1;
                }
                Ok(())
            },
        )?;
        summary.interrupted = done < wanted;
        attempts = attempts.saturating_add(done as u64);
    }
    summary.failures = datasets.finish()?;
    Ok(summary)
}

/// The error that a file could not be written, such as on a full disk; others as they are.
fn unwritten(options: &RecordOptions, error: DatasetError) -> SessionError {
    let there = Totals::read(&options.out).map_or(0, |there| there.episodes);
    let reason = if let DatasetError::Io { path, source } = &error {
        format!("{}: {source}", path.display())
    } else if let DatasetError::Parquet { path, source } = &error {
        format!("{}: {source}", path.display())
    } else if let (DatasetError::Video { .. }, true) = (&error, there > 0) {
        // Of the first episode it is the encoder that fails, later the disk.
        error.to_string()
    } else {
        return error.into();
    };
    let reason = format!("{reason}; {there} episodes are there, which --resume appends to");
    SessionError::output(&options.out, reason)
}

/// A dataset has one lens for the depth of a camera, by which clouds are made of it.
fn check_lens(plan: &Plan, options: &RecordOptions) -> Result<(), SessionError> {
    let bend = [Variation::Lens, Variation::Distortion];
    let mut varied = plan.setup.task.varied.iter();
    match varied.find(|variation| bend.contains(variation)) {
        Some(variation) if options.depth => Err(SessionError::BadArgument(format!(
            "--vary {}: --depth keeps one lens a camera for all episodes; give either",
            variation.name()
        ))),
        Some(_) | None => Ok(()),
    }
}

fn dataset_spec(setup: &Setup, options: &RecordOptions) -> DatasetSpec {
    let names = setup.cameras_with(Vec::new());
    let cameras = names
        .iter()
        .filter_map(|name| {
            setup
                .task
                .cameras
                .iter()
                .find(|camera| camera.name == *name)
        })
        .map(|camera| CameraSpec {
            name: camera.name.clone(),
            width: camera.intrinsics().width,
            height: camera.intrinsics().height,
            depth: options.depth.then(|| camera.intrinsics()),
        })
        .collect();
    #[expect(clippy::cast_possible_truncation, reason = "25 steps a second")]
    let fps = (1_000_000_000 / STEP_NS) as u32;
    DatasetSpec {
        fps,
        robot_type: robot_type(setup.task.arms.len()).to_owned(),
        arms: setup.task.arms.len(),
        task: options
            .instruction
            .clone()
            .unwrap_or_else(|| setup.task_name.clone()),
        cameras,
        intervention: false,
    }
}

/// The robot's name: LeRobot puts `bi_` before that of an arm of which there are two.
const fn robot_type(arms: usize) -> &'static str {
    if arms == 1 {
        "dvrk_psm_sim"
    } else {
        "bi_dvrk_psm_sim"
    }
}

/// One episode in memory.
struct Demonstration {
    outcome: Outcome,
    reason: String,
    /// Policy steps; frames are there of what is kept, failures among it if those are.
    steps: usize,
    frames: Vec<StoredFrame>,
    note: EpisodeNote,
}

impl Demonstration {
    const fn succeeded(&self) -> bool {
        matches!(self.outcome, Outcome::Success)
    }

    fn attempt(&self) -> Attempt {
        Attempt {
            seed: self.note.seed,
            kept: self.succeeded(),
            reason: self.reason.clone(),
            steps: self.steps,
            disturbances: self.note.disturbances.as_ref().map_or(0, Vec::len),
            grasps: self.note.grasps,
        }
    }
}

struct StoredFrame {
    arms: Vec<ArmFrame>,
    images: Vec<Vec<u8>>,
    /// Of every camera, or none.
    depth: Vec<StoredDepth>,
    /// Whether an operator drove.
    by_hand: bool,
}

impl StoredFrame {
    /// What the arms measured and were given, and what the cameras saw, with its `depth` or not.
    fn new(arms: Vec<ArmFrame>, frames: &[CameraFrame], depth: bool) -> Self {
        let depths = frames.iter().filter(|_| depth);
        Self {
            arms,
            images: frames.iter().map(|frame| frame.colour.clone()).collect(),
            depth: depths.map(StoredDepth::of).collect(),
            by_hand: false,
        }
    }

    /// The same, driven by an operator or not.
    const fn driven(mut self, by_hand: bool) -> Self {
        self.by_hand = by_hand;
        self
    }
}

struct StoredDepth {
    units: Vec<u16>,
    instance: Vec<u8>,
    camera_in_scene: [f64; 7],
}

impl StoredDepth {
    fn of(frame: &CameraFrame) -> Self {
        let depths = frame.depth_m.iter();
        Self {
            units: depths.map(|&depth_m| depth_units(depth_m)).collect(),
            instance: frame.instance.clone(),
            camera_in_scene: TipTarget::new(&frame.camera_in_scene, 0.0).pose_numbers(),
        }
    }
}

/// The job of one thread: the demonstration of `first + index`, shown on `page` if no other is;
/// none if it was abandoned because `stop` said so.
fn demonstrator<'a>(
    plan: &'a Plan,
    first: u64,
    options: &'a RecordOptions,
    make: Option<MakeSource<'a>>,
    (stop, page): (&'a (dyn Fn() -> bool + Sync), Option<&'a RecordPage<'a>>),
) -> impl FnMut(usize) -> Result<Option<Demonstration>, SessionError> {
    let setup = &plan.setup;
    let mut cameras: Option<SceneCameras> = None;
    let mut own: Option<ChunkSource> = None;
    move |index| {
        let seed = first.wrapping_add(index as u64);
        let share = options.disturb.unwrap_or(0.0);
        let mut disturber = Disturber::draw(&setup.task, seed, share);
        let time_factor = if disturber.is_some() {
            DISTURBED_TIME_FACTOR
        } else {
            1
        };
        let mut task = setup.task.clone();
        task.time_limit_s *= f64::from(time_factor);
        let mut simulation = next_simulation(&task, seed, cameras.take(), true)?;
        let mut source = match make {
            Some(make) => own.take().map_or_else(make, Ok)?,
            None => setup.source(&plan.policy, seed, plan.compute)?,
        };
        source.reset(seed);
        let mut controller = setup.controller()?;
        let mut recorder = StepRecorder {
            cameras: setup.cameras_with(Vec::new()),
            depth: options.depth,
            frames: Vec::new(),
            shown: match page {
                Some(page) => page.begin(plan, (&task, seed), &simulation.snapshot())?,
                None => None,
            },
            stop,
        };
        let mut timing = plan.timing(seed, &source);
        timing.tick_limit *= u64::from(time_factor);
        let episode = Episode {
            simulation: &mut simulation,
            controller: &mut controller,
            source: &mut source,
        };
        let end = match episode.run_disturbed(&timing, &mut recorder, disturber.as_mut()) {
            Err(SessionError::Interrupted) => return Ok(None),
            end => end?,
        };
        cameras = simulation.into_cameras();
        let note = EpisodeNote {
            seed,
            grasps: source.attempts(),
            drawn: task.drawn(seed),
            disturbances: disturber.map(|it| it.happened().to_vec()),
            by_hand: by_hand_note(plan, &source),
        };
        // Others are made with the seed.
        own = Some(source).filter(|source| matches!(source, ChunkSource::Policy(_)));
        Ok(Some(Demonstration {
            note,
            reason: end.reason(),
            outcome: end.outcome,
            steps: recorder.frames.len(),
            frames: recorder.frames,
        }))
    }
}

/// Records every policy step of the expert.
struct StepRecorder<'a> {
    cameras: Vec<String>,
    depth: bool,
    frames: Vec<StoredFrame>,
    /// What pages see of it, if they do.
    shown: Option<EpisodePage<'a>>,
    stop: &'a (dyn Fn() -> bool + Sync),
}

impl EpisodeObserver for StepRecorder<'_> {
    fn cameras(&self) -> Vec<String> {
        self.cameras.clone()
    }

    fn tick_of(&mut self, record: &TickRecord, controller: &AnyController) {
        if let Some(shown) = &mut self.shown {
            shown.tick(record, controller);
        }
    }

    fn step(&mut self, view: &StepView<'_>) -> Result<(), SessionError> {
        if let Some(shown) = &mut self.shown {
            shown.step(view)?;
        }
        let Some(chunks) = view.answer else {
            return Ok(());
        };
        let arms = view.arms.iter().zip(chunks.iter());
        let arms: Option<Vec<ArmFrame>> = arms
            .map(|(arm, chunk)| Some(arm_frame(arm, chunk.valid_targets().first()?)))
            .collect();
        let Some(arms) = arms else { return Ok(()) };
        self.frames
            .push(StoredFrame::new(arms, view.frames, self.depth));
        Ok(())
    }

    fn wants_stop(&self) -> bool {
        (self.stop)()
    }
}

/// What an arm measured and the first target that it was given for it.
pub(super) fn arm_frame(arm: &ArmObservation, target: &TipTarget) -> ArmFrame {
    let [x, y, z, i, j, k, w] = target.pose_numbers();
    ArmFrame {
        state: state_numbers(&arm.state),
        tip_pose: arm.here().pose_numbers(),
        action: [x, y, z, i, j, k, w, target.jaw],
    }
}
