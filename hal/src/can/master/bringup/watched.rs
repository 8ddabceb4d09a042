//! The buses while an arm is brought up, under watch: nobody else may lead its drives then either.

use super::super::client::expect;
use super::super::foreign::leads;
use super::super::link::{Bus, Received};
use super::super::plan::ArmPlan;
use super::BringUpError;
use crate::TimeNs;
use crate::can::Frame;

/// Buses, and the first frame on them that only the master of the plan may send.
#[derive(Debug)]
pub(super) struct Watched<B> {
    pub(super) bus: B,
    plan: ArmPlan,
    foreign: Option<(u8, Frame)>,
}

impl<B: Bus> Watched<B> {
    pub(super) const fn new(bus: B, plan: &ArmPlan) -> Self {
        Self {
            bus,
            plan: *plan,
            foreign: None,
        }
    }

    /// What a step came to, unless somebody else leads our drives: whatever it came to, that is the cause.
    pub(super) fn judge<T>(&self, step: Result<T, BringUpError>) -> Result<T, BringUpError> {
        match self.foreign {
            Some((line, frame)) => Err(BringUpError::ForeignMaster { line, frame }),
            None => step,
        }
    }

    /// Takes what has come on any bus and nobody waits for any more.
    pub(super) fn drain(&mut self) -> Result<(), BringUpError> {
        for line in 0..self.plan.lines {
            expect(self, line, 0, |_| None::<()>)?;
        }
        self.judge(Ok(()))
    }
}

impl<B: Bus> Bus for Watched<B> {
    fn now(&self) -> TimeNs {
        self.bus.now()
    }

    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        self.bus.send(line, frames)
    }

    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        let Self { bus, plan, foreign } = self;
        bus.receive(line, &mut |received| {
            if let Received::Frame(frame) = received
                && foreign.is_none()
                && leads(plan, line, &frame)
            {
                *foreign = Some((line, frame));
            }
            sink(received);
        });
    }

    fn flush(&mut self, line: u8) {
        self.bus.flush(line);
    }

    fn wait(&mut self, until: TimeNs) {
        self.bus.wait(until);
    }
}
