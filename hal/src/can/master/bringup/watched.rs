//! The buses while an arm is brought up, under watch: nobody else may lead its drives then either.

use super::super::client::expect;
use super::super::foreign::leads;
use super::super::link::{Bus, Received};
use super::super::plan::ArmPlan;
use super::BringUpError;
use crate::TimeNs;
use crate::can::Frame;
use crate::can::cia301::{Cob, NmtCommand, NmtTarget};

/// First byte of a request to read an object (CiA 301, initiate SDO upload).
const READ: u8 = 0x40;

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

    /// What a step came to, unless somebody else leads our drives: whatever it came to, that is the cause, and all nodes are
    /// stopped, so that they hear no set-points of his.
    pub(super) fn judge<T>(&mut self, step: Result<T, BringUpError>) -> Result<T, BringUpError> {
        match self.foreign {
            Some((line, frame)) => {
                self.stop();
                Err(BringUpError::ForeignMaster { line, frame })
            }
            None => step,
        }
    }

    /// Tells every node to stop: it hears no set-points then, and its drive does what 6007h says.
    pub(super) fn stop(&mut self) {
        for axis in &self.plan.axes {
            let stop = NmtCommand::Stop.emit(NmtTarget::Node(axis.node));
            self.bus.send(axis.line, &[stop]);
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

    /// Once somebody else leads our drives nothing goes out that would change a drive or give it torque.
    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        let harmful = |frame: &Frame| self.foreign.is_some() && !is_harmless(frame);
        let count = frames.iter().take_while(|frame| !harmful(frame)).count();
        self.bus.send(line, &frames[..count])
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

/// Whether a frame of ours neither changes a node's objects nor lets its drive have voltage.
fn is_harmless(frame: &Frame) -> bool {
    let first = frame.data().first();
    match Cob::of(frame.id) {
        // All else of a client writes or goes on writing.
        Cob::SdoRequest(_) => first == Some(&READ),
        // Bit 1 of the control word is "enable voltage".
        Cob::ReceivePdo(..) => first.is_some_and(|low| low & 0b10 == 0),
        // A master says these to end it as well; SYNC may have the time stamp's identifier.
        Cob::Nmt | Cob::Sync | Cob::Time | Cob::Heartbeat(_) => true,
        Cob::Emergency(_) | Cob::TransmitPdo(..) | Cob::SdoResponse(_) | Cob::Other(_) => false,
    }
}
