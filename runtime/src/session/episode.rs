//! One episode in lockstep: virtual time, everything in one thread, bit for bit the same each time.

use hal::{Arm, ArmError, ArmState, CameraFrame, Chunk, FrameRef, SeenArm, TimeNs};
use sim_backend::cameras::SceneSnapshot;
use sim_backend::disturbance::Disturber;
use sim_backend::simulation::Simulation;
use sim_backend::task::Outcome;

use super::SessionError;
use super::latency::{Deliveries, Latency};
use super::source::{ChunkSource, Query, STEP_TICKS, precedes_query, seen_arm};
use super::summary::TissueSummary;
use super::tally::Tally;
use crate::control::{AnyController, OperatorEvent, TickInput};
use crate::log::{TickRecord, TickTiming};
use crate::per_arm::PerArm;
use crate::rt::MonotonicClock;

/// What is fixed about an episode before it begins.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Time from an observation to the delivery of its chunk.
    pub latency: Latency,
    /// The episode is given up after so many ticks.
    pub tick_limit: u64,
}

/// What was seen and answered at one policy step.
#[derive(Clone, Copy, Debug)]
pub struct StepView<'a> {
    /// The measured arms.
    pub arms: &'a PerArm<SeenArm>,
    /// Frames, if any were taken: of the policy's cameras, then of the watcher's others.
    pub frames: &'a [CameraFrame],
    /// The answer, a chunk for each arm, if the policy was asked.
    pub answer: Option<&'a PerArm<Chunk>>,
    /// Where everything is, for pictures that are made later.
    pub snapshot: &'a SceneSnapshot,
}

/// Looks on while an episode runs: a log, a dataset, pictures.
pub trait Watcher {
    /// Cameras whose frames it wants at every policy step.
    fn cameras(&self) -> Vec<String> {
        Vec::new()
    }

    /// A policy step.
    ///
    /// # Errors
    /// Ends the episode.
    fn step(&mut self, view: &StepView<'_>) -> Result<(), SessionError> {
        let _unwatched = view;
        Ok(())
    }

    /// A chunk that the controller has consumed for the arm `arm`, counted from 0; the first arm's comes first, and their tick
    /// after them.
    fn chunk(&mut self, arm: usize, chunk: &Chunk) {
        let _unwatched = (arm, chunk);
    }

    /// A control period.
    fn tick(&mut self, record: &TickRecord) {
        let _unwatched = record;
    }

    /// Whether the episode is to be abandoned; asked before every policy step.
    fn wants_stop(&self) -> bool {
        false
    }

    /// Whether the episode is to end here, unfinished, with all that there is of it; asked before every policy step.
    fn wants_end(&self) -> bool {
        false
    }
}

/// A watcher that wants nothing.
#[derive(Debug)]
pub struct Nobody;

impl Watcher for Nobody {}

/// How an episode ended.
#[derive(Debug)]
pub struct EpisodeEnd {
    /// The task's verdict.
    pub outcome: Outcome,
    /// Counts and percentiles.
    pub tally: Tally,
    /// What a soft tissue went through, if the task has one.
    pub tissue: Option<TissueSummary>,
}

/// The parts of an episode.
pub struct Episode<'a> {
    /// The arms and their scene.
    pub simulation: &'a mut Simulation,
    /// A fresh controller.
    pub controller: &'a mut AnyController,
    /// The policy.
    pub source: &'a mut ChunkSource,
}

impl Episode<'_> {
    /// Runs to the task's verdict or the tick limit.
    ///
    /// # Errors
    /// From the simulation, the policy or the watcher; [`SessionError::Interrupted`] if the watcher wants to stop;
    /// [`SessionError::BadArgument`] if the simulation has other arms than the
    /// controller.
    pub fn run(self, plan: &Plan, watcher: &mut dyn Watcher) -> Result<EpisodeEnd, SessionError> {
        self.run_disturbed(plan, watcher, None)
    }

    /// The same, in which `disturber`, if there is one, decides what is executed of what the expert answers. The watcher sees
    /// the answers themselves at policy steps, and as chunks what the controller consumed.
    ///
    /// # Errors
    /// Those of [`Self::run`].
    pub fn run_disturbed(
        mut self,
        plan: &Plan,
        watcher: &mut dyn Watcher,
        mut disturber: Option<&mut Disturber>,
    ) -> Result<EpisodeEnd, SessionError> {
        let clock = MonotonicClock::new();
        let mut cameras = Cameras::choose(self.source, watcher, self.simulation)?;
        let mut deliveries: Deliveries<PerArm<Chunk>> = Deliveries::new(plan.latency);
        let mut tally = Tally::default();
        for tick in 0..plan.tick_limit {
            let now = TimeNs::from_tick(tick);
            let measured = self.read(now)?;
            if tick % STEP_TICKS == 0 && watcher.wants_stop() {
                return Err(SessionError::Interrupted);
            }
            if tick % STEP_TICKS == 0 && tick > 0 && watcher.wants_end() {
                break;
            }
            if let (Some(arms), 0) = (seen(&measured), tick % STEP_TICKS) {
                let step = tick / STEP_TICKS;
                let answer = self.policy_step(step, &arms, &mut cameras, watcher, clock)?;
                if let Some((chunks, inference_ns)) = answer {
                    let executed = match &mut disturber {
                        Some(disturber) => self.disturbed(now, &chunks, disturber)?,
                        None => chunks,
                    };
                    let latency_ticks = deliveries.send(tick, executed);
                    tally.query(inference_ns, latency_ticks * hal::TICK_NS);
                }
            }
            let chunks = deliveries.receive(tick);
            let record = self.control(tick, measured, chunks.as_ref(), clock)?;
            for (arm, chunk) in chunks.iter().flat_map(PerArm::iter).enumerate() {
                watcher.chunk(arm, chunk);
            }
            tally.tick(&record);
            watcher.tick(&record);
            let outcome = self.simulation.outcome();
            if !matches!(outcome, Outcome::Running) {
                return Ok(self.end(outcome, tally));
            }
        }
        Ok(self.end(Outcome::Running, tally))
    }

    fn end(&self, outcome: Outcome, tally: Tally) -> EpisodeEnd {
        EpisodeEnd {
            outcome,
            tally,
            tissue: self.simulation.tissue_extremes().map(TissueSummary::from),
        }
    }

    /// What is executed of what the expert wants.
    fn disturbed(
        &mut self,
        now: TimeNs,
        wanted: &PerArm<Chunk>,
        disturber: &mut Disturber,
    ) -> Result<PerArm<Chunk>, SessionError> {
        let wanted: Vec<Chunk> = wanted.iter().copied().collect();
        let activities = self.source.activities();
        let executed = disturber.step(now, activities, &wanted, self.simulation);
        PerArm::collect(executed).ok_or_else(|| other_arms(self.controller))
    }

    /// What each arm measured.
    fn read(&mut self, now: TimeNs) -> Result<PerArm<Measured>, SessionError> {
        let count = self.simulation.arm_count();
        let read = |arm| Some(self.simulation.arm(arm)?.read(now));
        PerArm::collect((0..count).filter_map(read)).ok_or_else(|| other_arms(self.controller))
    }

    /// One control period: the controller's tick, and the arms' millisecond after it.
    fn control(
        &mut self,
        tick: u64,
        measured: PerArm<Measured>,
        chunks: Option<&PerArm<Chunk>>,
        clock: MonotonicClock,
    ) -> Result<TickRecord, SessionError> {
        let now = TimeNs::from_tick(tick);
        let mut newest = chunks.into_iter().flat_map(PerArm::iter);
        let inputs = measured.map(|measured| TickInput {
            now,
            measured,
            chunk: newest.next(),
            operator: (tick == 0).then_some(OperatorEvent::Enable),
        });
        let before = clock.now();
        let outputs = self.controller.tick(&inputs);
        let compute_ns = clock.now().since(before);
        let outputs = outputs.ok_or_else(|| other_arms(self.controller))?;
        for (index, output) in outputs.iter().enumerate() {
            if let Some(mut arm) = self.simulation.arm(index) {
                arm.write(&output.command, &output.tail)?;
            }
        }
        self.simulation.step();
        let timing = TickTiming {
            wake_ns: 0,
            compute_ns,
        };
        Ok(TickRecord::new(tick, inputs, outputs, timing))
    }

    /// Takes frames if anyone wants them, asks the policy if it is its turn, and shows the watcher both. Gives the answer
    /// and how long it took, ns.
    fn policy_step(
        &mut self,
        step: u64,
        arms: &PerArm<SeenArm>,
        cameras: &mut Cameras,
        watcher: &mut dyn Watcher,
        clock: MonotonicClock,
    ) -> Result<Option<(PerArm<Chunk>, u64)>, SessionError> {
        let every = self.source.query_every_steps().max(1);
        let asked = step.is_multiple_of(every);
        let shown = precedes_query(step, every, self.source.history_steps());
        cameras.take(self.simulation, step, asked || shown)?;
        let seen = cameras.frames.iter().take(cameras.seen);
        let frames: Vec<FrameRef<'_>> = seen.map(CameraFrame::as_frame).collect();
        if shown {
            self.source.observe(arms, &frames)?;
        }
        let answer = if asked {
            let scene = self.simulation.scene_state();
            let query = Query {
                arms: *arms,
                frames: &frames,
                scene: Some(&scene),
            };
            let before = clock.now();
            let chunks = self.source.answer(&query)?;
            Some((chunks, clock.now().since(before)))
        } else {
            None
        };
        let frames: &[CameraFrame] = if cameras.fresh { &cameras.frames } else { &[] };
        watcher.step(&StepView {
            arms,
            frames,
            answer: answer.as_ref().map(|(chunks, _)| chunks),
            snapshot: &self.simulation.snapshot(),
        })?;
        Ok(answer)
    }
}

/// What an arm answers when it is read.
type Measured = Result<ArmState, ArmError>;

/// The arms as a policy sees them, unless one was not measured.
fn seen(measured: &PerArm<Measured>) -> Option<PerArm<SeenArm>> {
    let arms: Option<Vec<SeenArm>> = measured
        .iter()
        .map(|arm| arm.as_ref().ok().map(seen_arm))
        .collect();
    PerArm::collect(arms?)
}

fn other_arms(controller: &AnyController) -> SessionError {
    SessionError::BadArgument(format!(
        "the controller has {} arms, the simulation another number",
        controller.arm_count()
    ))
}

/// The cameras of an episode and their newest frames.
struct Cameras {
    indices: Vec<usize>,
    frames: Vec<CameraFrame>,
    /// So many of them, the first, are the policy's.
    seen: usize,
    every_step: bool,
    fresh: bool,
}

impl Cameras {
    /// The policy's cameras and the watcher's others.
    fn choose(
        source: &ChunkSource,
        watcher: &dyn Watcher,
        simulation: &Simulation,
    ) -> Result<Self, SessionError> {
        let watched = watcher.cameras();
        let seen = source.cameras();
        let every_step = !watched.is_empty();
        let seen_count = seen.len();
        let mut names = seen;
        let others = watched
            .into_iter()
            .filter(|name| !names.contains(name))
            .collect::<Vec<_>>();
        names.extend(others);
        if names.is_empty() {
            return Ok(Self {
                indices: Vec::new(),
                frames: Vec::new(),
                seen: 0,
                every_step: false,
                fresh: false,
            });
        }
        let cameras = simulation.cameras()?;
        let mut indices = Vec::with_capacity(names.len());
        let mut frames = Vec::with_capacity(names.len());
        for name in &names {
            let index = cameras
                .find(name)
                .ok_or_else(|| SessionError::UnknownCamera {
                    name: name.clone(),
                    available: cameras.names().collect::<Vec<_>>().join(", "),
                })?;
            indices.push(index);
            frames.push(cameras.blank_frame(index)?);
        }
        Ok(Self {
            indices,
            frames,
            seen: seen_count,
            every_step,
            fresh: false,
        })
    }

    fn take(
        &mut self,
        simulation: &mut Simulation,
        step: u64,
        asked: bool,
    ) -> Result<(), SessionError> {
        self.fresh = self.every_step || asked;
        if !self.fresh || self.indices.is_empty() {
            return Ok(());
        }
        simulation.render_all(&self.indices, &mut self.frames)?;
        for frame in &mut self.frames {
            frame.sequence = step;
        }
        Ok(())
    }
}

impl EpisodeEnd {
    /// Why the episode ended, in words.
    #[must_use]
    pub fn reason(&self) -> String {
        reason(&self.outcome, &self.tally)
    }
}

/// Why an episode ended, in words: a fault of the controller explains a failure.
#[must_use]
pub fn reason(outcome: &Outcome, tally: &Tally) -> String {
    match (outcome, tally.faults()) {
        (Outcome::Success, _) => "success".to_owned(),
        (_, Some(faults)) => faults,
        (Outcome::Failure(_) | Outcome::Invalid(_), None) => outcome.to_string(),
        (Outcome::Running, None) => "tick limit".to_owned(),
    }
}
