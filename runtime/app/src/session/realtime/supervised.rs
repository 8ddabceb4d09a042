//! A policy process under supervision: its chunks to the control thread, and what is done when it
//! dies or hangs.
//!
//! Without restarts (`[policy]` in `control.toml`) the run ends with it. With some, the arms come
//! to a smooth stop and hold, while our own process is started again, or an external one is waited
//! for. They go on with the first chunk that answers an observation from after it was ready again,
//! if the gate lets it through.

use hal::{Chunk, PerArm};
use rtrb::Producer;
use trocar_control::Supervision;
use trocar_log::Level;

use super::child::PolicyChild;
use super::signals::{HoldCause, Signals};
use super::supervisor::Supervisor;
use crate::histogram::Histogram;
use crate::rt::MonotonicClock;
use crate::session::SessionError;

/// The process, where its chunks go, and how it is supervised.
pub(super) struct Supervised<'a> {
    child: &'a mut PolicyChild,
    chunks: Producer<PerArm<Chunk>>,
    supervisor: Supervisor,
}

impl<'a> Supervised<'a> {
    /// By the run's `clock`.
    pub(super) const fn new(
        child: &'a mut PolicyChild,
        chunks: Producer<PerArm<Chunk>>,
        clock: MonotonicClock,
        rules: (Supervision, fn(&str)),
    ) -> Self {
        Self {
            child,
            chunks,
            supervisor: Supervisor::new(Some(HoldCause::Answers), clock, rules),
        }
    }

    /// How often it was started again, or had to be waited for.
    pub(super) const fn restarts(&self) -> u32 {
        self.supervisor.restarts()
    }

    /// Waits until it may have said something, or a little.
    pub(super) fn wait(&self) {
        self.child.wait();
    }

    /// Hands its newest answer to the control thread.
    pub(super) fn hand_on(
        &mut self,
        signals: &Signals,
        inference: &mut Histogram,
    ) -> Result<(), SessionError> {
        if !self.supervisor.is_here() {
            return Ok(());
        }
        if let Some(answer) = self.child.newest_chunks()? {
            if signals.lacks(HoldCause::Answers) {
                if answer.first.observed_at < signals.answers_from() {
                    return Ok(());
                }
                // Before the chunk: arms that are paused would ignore it.
                signals.go_on(HoldCause::Answers);
                self.supervisor.tell(
                    signals,
                    Level::Info,
                    "the policy answers again; its hold of the arms ends",
                );
            }
            // Full means that the control thread takes none: it will hold the arms and say so.
            let _full = self.chunks.push(answer);
        }
        if let Some(infer_ns) = self.child.newest_inference_ns()? {
            inference.record(infer_ns);
        }
        Ok(())
    }

    /// Tells a process of ours that the run is over: it goes while the log is closed.
    pub(super) fn tell_to_go(&self) {
        self.child.tell_to_go();
    }

    /// Starts it again when it is time to; why the run ends with it, if so.
    pub(super) fn look_after(&mut self, signals: &Signals) -> Result<Option<String>, SessionError> {
        if signals.lacks(HoldCause::Frames) {
            self.child.excuse();
        }
        self.supervisor.look_after(self.child, signals)
    }
}
