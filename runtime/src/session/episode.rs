//! One episode in lockstep: virtual time, everything in one thread, bit for bit the same each time.

use std::collections::VecDeque;

use hal::{Arm, ArmState, CameraFrame, Chunk, FrameRef, Pose, TimeNs};
use sim_backend::simulation::Simulation;
use sim_backend::task::Outcome;

use super::SessionError;
use super::source::{ChunkSource, Query, STEP_TICKS};
use super::tally::Tally;
use crate::control::{Controller, Fault, OperatorEvent, TickInput};
use crate::kinematics;
use crate::log::{TickRecord, TickTiming};
use crate::rt::MonotonicClock;

/// What is fixed about an episode before it begins.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Ticks from an observation to the delivery of its chunk.
    pub latency_ticks: u64,
    /// The episode is given up after so many ticks.
    pub tick_limit: u64,
}

/// What was seen and answered at one policy step.
#[derive(Clone, Copy, Debug)]
pub struct StepView<'a> {
    /// The time of the step.
    pub now: TimeNs,
    /// The measured arm.
    pub arm: &'a ArmState,
    /// Measured tip pose in the RCM frame.
    pub tip_in_rcm: Pose,
    /// Frames, if any were taken.
    pub frames: &'a [CameraFrame],
    /// The answer, if the policy was asked.
    pub answer: Option<&'a Chunk>,
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

    /// A chunk that the controller is about to consume.
    fn chunk(&mut self, chunk: &Chunk) {
        let _unwatched = chunk;
    }

    /// A control period.
    fn tick(&mut self, record: &TickRecord) {
        let _unwatched = record;
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
}

/// The parts of an episode.
pub struct Episode<'a> {
    /// The arm and its scene.
    pub simulation: &'a mut Simulation,
    /// A fresh controller.
    pub controller: &'a mut Controller,
    /// The policy.
    pub source: &'a mut ChunkSource,
}

impl Episode<'_> {
    /// Runs to the task's verdict or the tick limit.
    ///
    /// # Errors
    /// From the simulation, the policy or the watcher.
    pub fn run(
        mut self,
        plan: &Plan,
        watcher: &mut dyn Watcher,
    ) -> Result<EpisodeEnd, SessionError> {
        let clock = MonotonicClock::new();
        let mut cameras = Cameras::choose(self.source, watcher, self.simulation)?;
        let mut pending: VecDeque<(u64, Chunk)> = VecDeque::new();
        let mut tally = Tally::default();
        for tick in 0..plan.tick_limit {
            let now = TimeNs::from_tick(tick);
            let measured = self.simulation.read(now);
            if let (Ok(arm), 0) = (&measured, tick % STEP_TICKS) {
                let step = tick / STEP_TICKS;
                let answer = self.policy_step(step, arm, &mut cameras, watcher, clock)?;
                if let Some((chunk, inference_ns)) = answer {
                    tally.query(inference_ns, plan.latency_ticks * hal::TICK_NS);
                    pending.push_back((tick + plan.latency_ticks, chunk));
                }
            }
            let due = pending.front().is_some_and(|(at, _)| *at <= tick);
            let chunk = if due {
                pending.pop_front().map(|(_, chunk)| chunk)
            } else {
                None
            };
            let operator = (tick == 0).then_some(OperatorEvent::Enable);
            let before = clock.now();
            let output = self.controller.tick(&TickInput {
                now,
                measured,
                chunk: chunk.as_ref(),
                operator,
            });
            let compute_ns = clock.now().since(before);
            self.simulation.write(&output.command, &output.tail)?;
            self.simulation.step();
            if let Some(chunk) = &chunk {
                watcher.chunk(chunk);
            }
            let record = TickRecord {
                tick,
                now,
                measured,
                operator,
                chunk_sequence: chunk.map(|chunk| chunk.sequence),
                command: output.command,
                report: output.report,
                timing: TickTiming {
                    wake_ns: 0,
                    compute_ns,
                },
            };
            tally.tick(&record);
            watcher.tick(&record);
            let outcome = self.simulation.outcome();
            if !matches!(outcome, Outcome::Running) {
                return Ok(EpisodeEnd { outcome, tally });
            }
        }
        Ok(EpisodeEnd {
            outcome: Outcome::Running,
            tally,
        })
    }

    /// Takes frames if anyone wants them, asks the policy if it is its turn, and shows the watcher both. Gives the answer
    /// and how long it took, ns.
    fn policy_step(
        &mut self,
        step: u64,
        arm: &ArmState,
        cameras: &mut Cameras,
        watcher: &mut dyn Watcher,
        clock: MonotonicClock,
    ) -> Result<Option<(Chunk, u64)>, SessionError> {
        let asked = step.is_multiple_of(self.source.query_every_steps());
        cameras.take(self.simulation, step, asked)?;
        let tip_in_rcm = kinematics::forward(&arm.position);
        let answer = if asked {
            let scene = self.simulation.scene_state();
            let frames: Vec<FrameRef<'_>> =
                cameras.frames.iter().map(CameraFrame::as_frame).collect();
            let query = Query {
                arm,
                tip_in_rcm,
                frames: &frames,
                scene: &scene,
            };
            let before = clock.now();
            let chunk = self.source.answer(&query)?;
            Some((chunk, clock.now().since(before)))
        } else {
            None
        };
        let frames: &[CameraFrame] = if cameras.fresh { &cameras.frames } else { &[] };
        watcher.step(&StepView {
            now: arm.stamp,
            arm,
            tip_in_rcm,
            frames,
            answer: answer.as_ref().map(|(chunk, _)| chunk),
        })?;
        Ok(answer)
    }
}

/// The cameras of an episode and their newest frames.
struct Cameras {
    indices: Vec<usize>,
    frames: Vec<CameraFrame>,
    every_step: bool,
    fresh: bool,
}

impl Cameras {
    /// The policy's cameras if it has any, otherwise the watcher's.
    fn choose(
        source: &ChunkSource,
        watcher: &dyn Watcher,
        simulation: &Simulation,
    ) -> Result<Self, SessionError> {
        let watched = watcher.cameras();
        let seen = source.cameras();
        let every_step = !watched.is_empty();
        let names = if seen.is_empty() { watched } else { seen };
        if names.is_empty() {
            return Ok(Self {
                indices: Vec::new(),
                frames: Vec::new(),
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
        if !self.fresh {
            return Ok(());
        }
        for (&index, frame) in self.indices.iter().zip(&mut self.frames) {
            simulation.render(index, frame)?;
            frame.sequence = step;
        }
        Ok(())
    }
}

impl EpisodeEnd {
    /// Why the episode ended, in words.
    #[must_use]
    pub fn reason(&self) -> String {
        reason(&self.outcome, self.tally.fault())
    }
}

/// Why an episode ended, in words: a fault of the controller explains a failure.
#[must_use]
pub fn reason(outcome: &Outcome, fault: Option<Fault>) -> String {
    match (outcome, fault) {
        (Outcome::Success, _) => "success".to_owned(),
        (_, Some(fault)) => format!("fault: {fault}"),
        (Outcome::Failure(reason), None) => reason.to_string(),
        (Outcome::Running, None) => "tick limit".to_owned(),
    }
}
