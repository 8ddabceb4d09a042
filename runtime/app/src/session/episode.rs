//! One episode in lockstep: virtual time, everything in one thread, bit for bit the same each time.

use hal::{ArmObservation, CameraFrame, Chunk, FrameRef, Measured, PerArm, Rig as _, TimeNs};
use trocar_tasks::disturbance::Disturber;
use trocar_tasks::scene::SceneSnapshot;
use trocar_tasks::simulation::Simulation;
use trocar_tasks::task::Outcome;

use super::SessionError;
use super::latency::{Deliveries, Latency};
use super::source::{ChunkSource, Query, precedes_query, seen_arm};
use super::summary::TissueSummary;
use super::tally::Tally;
use super::world_report::TaskState;
use crate::rig::{self, lockstep::LockstepRig};
use crate::rt::MonotonicClock;
use trocar_control::{AnyController, OperatorEvent};
use trocar_log::TickRecord;

/// When chunks arrive and when an episode is given up.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// Time from an observation to the delivery of its chunk.
    pub latency: Latency,
    /// The episode is given up after so many ticks.
    ///
    /// Ticks are 1 ms.
    pub tick_limit: u64,
}

/// What was seen and answered at one policy step.
#[derive(Clone, Copy, Debug)]
pub struct StepView<'a> {
    /// The measured arms.
    ///
    /// At the step's tick, before its command.
    pub arms: &'a PerArm<ArmObservation>,
    /// Frames, if any were taken: of the policy's cameras, then of the watcher's others.
    ///
    /// Empty if none were taken in this step; their `sequence` is the step.
    pub frames: &'a [CameraFrame],
    /// The answer, a chunk for each arm, if the policy was asked.
    pub answer: Option<&'a PerArm<Chunk>>,
    /// Where everything is, for pictures that are made later.
    pub snapshot: &'a SceneSnapshot,
    /// How the task stands.
    pub task: TaskState,
}

/// Observes an episode: a log, a dataset, images.
///
/// Methods are called on the episode's thread in a fixed order: at a policy step `wants_stop`,
/// `wants_end` and `step`, in a tick that consumes chunks `chunk` for each arm, in every tick
/// `tick_of`. What they cost, the episode takes longer in wall time, and nothing else changes.
pub trait EpisodeObserver {
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

    /// A chunk that the controller has consumed for the arm `arm`, counted from 0; the first arm's
    /// comes first, and their tick after them.
    fn chunk(&mut self, arm: usize, chunk: &Chunk) {
        let _unwatched = (arm, chunk);
    }

    /// A control period.
    fn tick(&mut self, record: &TickRecord) {
        let _unwatched = record;
    }

    /// The same for whoever looks into the `controller` after it. This is what an episode calls;
    /// unless overridden it calls [`Self::tick`].
    fn tick_of(&mut self, record: &TickRecord, controller: &AnyController) {
        let _unwatched = controller;
        self.tick(record);
    }

    /// Whether the episode is to be abandoned; asked before every policy step.
    fn wants_stop(&self) -> bool {
        false
    }

    /// Whether the episode is to end here, unfinished, with all that there is of it; asked before
    /// every policy step.
    fn wants_end(&self) -> bool {
        false
    }
}

/// An observer that wants nothing.
#[derive(Debug)]
pub struct NoObserver;

impl EpisodeObserver for NoObserver {}

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
    /// From the simulation, the policy or the watcher; [`SessionError::Interrupted`] if the watcher
    /// wants to stop; [`SessionError::BadArgument`] if the simulation has other arms than the
    /// controller.
    pub fn run(
        self,
        timing: &Timing,
        watcher: &mut dyn EpisodeObserver,
    ) -> Result<EpisodeEnd, SessionError> {
        self.run_disturbed(timing, watcher, None)
    }

    /// The same, in which `disturber`, if there is one, decides what is executed of what the expert
    /// answers. The watcher sees the answers themselves at policy steps, and as chunks what the
    /// controller consumed.
    ///
    /// # Errors
    /// Those of [`Self::run`].
    pub fn run_disturbed(
        self,
        timing: &Timing,
        watcher: &mut dyn EpisodeObserver,
        mut disturber: Option<&mut Disturber>,
    ) -> Result<EpisodeEnd, SessionError> {
        let clock = MonotonicClock::new();
        let mut cameras = Cameras::choose(self.source, watcher, self.simulation)?;
        let mut deliveries: Deliveries<PerArm<Chunk>> = Deliveries::new(timing.latency);
        let mut tally = Tally::default();
        let mut running = Running {
            rig: LockstepRig::new(self.simulation),
            controller: self.controller,
            source: self.source,
        };
        let mut period = running.rig.exchange(None);
        let steps = running.source.steps();
        for tick in 0..timing.tick_limit {
            let measured = period.measured.ok_or_else(|| running.other_arms())?;
            let step = steps.beginning_at(tick);
            if step.is_some() && watcher.wants_stop() {
                return Err(SessionError::Interrupted);
            }
            if step.is_some() && tick > 0 && watcher.wants_end() {
                break;
            }
            if let Some(arms) = seen(&measured) {
                let answer = match step {
                    Some(step) => running.policy_step(step, &arms, &mut cameras, watcher, clock)?,
                    None => running.between(tick, &arms, clock)?,
                };
                if let Some((chunks, inference_ns)) = answer {
                    let executed = match &mut disturber {
                        Some(disturber) => running.disturbed(period.now, &chunks, disturber)?,
                        None => chunks,
                    };
                    let latency_ticks = deliveries.send(tick, executed);
                    tally.query(inference_ns, latency_ticks * hal::TICK_NS);
                }
            }
            let chunks = deliveries.receive(tick);
            let operator = (tick == 0).then_some(OperatorEvent::Enable);
            let (record, setpoints) = rig::control(
                running.controller,
                &period,
                measured,
                chunks.as_ref(),
                operator,
                clock,
            );
            running.source.ticked(&record);
            period = running.rig.exchange(Some(&setpoints));
            for (arm, chunk) in chunks.iter().flat_map(PerArm::iter).enumerate() {
                watcher.chunk(arm, chunk);
            }
            tally.tick(&record);
            watcher.tick_of(&record, running.controller);
            let outcome = running.rig.simulation.outcome();
            if !matches!(outcome, Outcome::Running) {
                return Ok(running.end(outcome, tally));
            }
        }
        Ok(running.end(Outcome::Running, tally))
    }
}

/// An episode under way.
struct Running<'a> {
    rig: LockstepRig<'a>,
    controller: &'a mut AnyController,
    source: &'a mut ChunkSource,
}

impl Running<'_> {
    fn end(&self, outcome: Outcome, mut tally: Tally) -> EpisodeEnd {
        tally.measured(self.controller);
        let tissue = self.rig.simulation.tissue_extremes();
        EpisodeEnd {
            outcome,
            tally,
            tissue: tissue.map(TissueSummary::from),
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
        let executed = disturber.step(now, activities, &wanted, self.rig.simulation);
        PerArm::collect(executed).ok_or_else(|| self.other_arms())
    }

    /// The one error of a simulation that has other arms than the controller was made for.
    fn other_arms(&self) -> SessionError {
        SessionError::BadArgument(format!(
            "the controller has {} arms, the simulation another number",
            self.controller.arm_count()
        ))
    }

    /// The answer at a tick between two policy steps, of a source that gives one then, and how long
    /// it took, ns.
    fn between(
        &mut self,
        tick: u64,
        arms: &PerArm<ArmObservation>,
        clock: MonotonicClock,
    ) -> Result<Option<(PerArm<Chunk>, u64)>, SessionError> {
        let asked = self.source.answers_between(tick);
        asked.then(|| self.ask(arms, &[], clock)).transpose()
    }

    /// Wall time of the answer is measured, and only reported: delivery in ticks follows the
    /// `Latency` alone.
    fn ask(
        &mut self,
        arms: &PerArm<ArmObservation>,
        frames: &[FrameRef<'_>],
        clock: MonotonicClock,
    ) -> Result<(PerArm<Chunk>, u64), SessionError> {
        let scene = self.rig.simulation.scene_state();
        let query = Query {
            arms: *arms,
            frames,
            scene: Some(&scene),
        };
        let before = clock.now();
        let chunks = self.source.answer(&query)?;
        Ok((chunks, clock.now().since(before)))
    }

    /// Takes frames if anyone wants them, asks the policy if it is its turn, and shows the watcher
    /// both. Gives the answer and how long it took, ns.
    fn policy_step(
        &mut self,
        step: u64,
        arms: &PerArm<ArmObservation>,
        cameras: &mut Cameras,
        watcher: &mut dyn EpisodeObserver,
        clock: MonotonicClock,
    ) -> Result<Option<(PerArm<Chunk>, u64)>, SessionError> {
        let every = self.source.query_every_steps().max(1);
        let asked = step.is_multiple_of(every);
        let shown = precedes_query(step, every, self.source.history_steps());
        cameras.take(self.rig.simulation, step, asked || shown)?;
        let seen = cameras.frames.iter().take(cameras.seen);
        let frames: Vec<FrameRef<'_>> = seen.map(CameraFrame::as_frame).collect();
        if shown {
            self.source.observe(arms, &frames)?;
        }
        let answer = if asked {
            Some(self.ask(arms, &frames, clock)?)
        } else {
            None
        };
        let frames: &[CameraFrame] = if cameras.fresh { &cameras.frames } else { &[] };
        watcher.step(&StepView {
            arms,
            frames,
            answer: answer.as_ref().map(|(chunks, _)| chunks),
            snapshot: &self.rig.simulation.snapshot(),
            task: TaskState::of(self.rig.simulation),
        })?;
        Ok(answer)
    }
}

/// The arms as a policy sees them, unless one was not measured.
fn seen(measured: &PerArm<Measured>) -> Option<PerArm<ArmObservation>> {
    let arms: Option<Vec<ArmObservation>> = measured
        .iter()
        .map(|arm| arm.as_ref().ok().map(seen_arm))
        .collect();
    PerArm::collect(arms?)
}

/// The cameras of an episode and their newest frames.
///
/// Frames are allocated once and drawn over in each step.
struct Cameras {
    /// Cameras of the simulation, one for each of `frames`.
    indices: Vec<usize>,
    frames: Vec<CameraFrame>,
    /// So many of them, the first, are the policy's.
    seen: usize,
    /// An observer wants frames whether the policy is asked or not.
    every_step: bool,
    /// Whether `frames` are of this step.
    fresh: bool,
}

impl Cameras {
    /// The policy's cameras and the watcher's others.
    fn choose(
        source: &ChunkSource,
        watcher: &dyn EpisodeObserver,
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

    /// Draws all of them at once, or none.
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
