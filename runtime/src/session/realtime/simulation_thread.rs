//! The simulated arm in a real-time run: one step a millisecond, and the local policies that look at its scene.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use hal::{Arm, ArmCommand, ArmState, Chunk, TICK_NS, TimeNs};
use rtrb::Producer;
use sim_backend::simulation::Simulation;
use sim_backend::task::Outcome;

use super::Signals;
use super::camera_thread::Snapshot;
use crate::kinematics;
use crate::mailbox::{MailboxReader, MailboxWriter};
use crate::rt::{MonotonicClock, Periodic};
use crate::session::SessionError;
use crate::session::source::{ChunkSource, Query, STEP_TICKS};

/// The simulation thread before it runs.
pub(super) struct SimulationThread {
    pub(super) simulation: Simulation,
    pub(super) measured: MailboxWriter<ArmState>,
    pub(super) commands: MailboxReader<ArmCommand>,
    pub(super) snapshots: Option<Producer<Snapshot>>,
    pub(super) local: Option<(ChunkSource, Producer<Chunk>)>,
    pub(super) signals: Arc<Signals>,
}

/// What it leaves behind.
pub(super) struct SimulationEnd {
    pub(super) outcome: Outcome,
}

impl SimulationThread {
    /// Runs until the control thread has stopped; says so when the task has its verdict.
    pub(super) fn run(
        mut self,
        clock: MonotonicClock,
        first: TimeNs,
    ) -> Result<SimulationEnd, SessionError> {
        let mut periodic = Periodic::new(clock, first, TICK_NS);
        let mut verdict = Outcome::Running;
        let result = loop {
            if self.signals.stopped() {
                break Ok(SimulationEnd { outcome: verdict });
            }
            let wake = periodic.wait();
            // After a late wake-up the missed milliseconds are made up for, so that simulated time stays real time.
            for late in (0..=wake.skipped).rev() {
                let now = TimeNs(wake.due.0.saturating_sub(late * TICK_NS));
                let tick = wake.index.saturating_sub(late);
                if let Err(error) = self.step(tick, now) {
                    self.signals.done.store(true, Ordering::Release);
                    return Err(error);
                }
            }
            if matches!(verdict, Outcome::Running) {
                verdict = self.simulation.outcome();
                if !matches!(verdict, Outcome::Running) {
                    self.signals.done.store(true, Ordering::Release);
                }
            }
        };
        result
    }

    fn step(&mut self, tick: u64, now: TimeNs) -> Result<(), SessionError> {
        if let Some(command) = self.commands.take() {
            self.simulation.write(&command)?;
        }
        self.simulation.step();
        let state = self.simulation.read(now)?;
        self.measured.put(state);
        if tick.is_multiple_of(STEP_TICKS) && !self.signals.done() {
            self.observe(tick / STEP_TICKS, &state)?;
        }
        Ok(())
    }

    /// A policy step: a snapshot for the cameras, and a chunk if the policy is a local one.
    fn observe(&mut self, step: u64, state: &ArmState) -> Result<(), SessionError> {
        let tip_in_rcm = kinematics::forward(&state.position);
        if let Some(snapshots) = &mut self.snapshots {
            // A camera that is still busy skips this step.
            let _busy = snapshots.push(Snapshot {
                step,
                arm: *state,
                tip_in_rcm,
                scene: self.simulation.snapshot(),
            });
        }
        if let Some((source, chunks)) = &mut self.local
            && step.is_multiple_of(source.query_every_steps())
        {
            let scene = self.simulation.scene_state();
            let query = Query {
                arm: state,
                tip_in_rcm,
                frames: &[],
                scene: &scene,
            };
            let chunk = source.answer(&query)?;
            // The control thread takes one a tick; a full queue means that it is gone.
            let _gone = chunks.push(chunk);
        }
        Ok(())
    }
}
