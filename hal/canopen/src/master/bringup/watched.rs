//! The buses during bring-up, monitored: no second master may command the drives then either, and
//! what was set up has to stay so.

use std::sync::mpsc::Sender;

use super::super::cycle::LINES_MAX;
use super::super::foreign::leads;
use super::super::link::{Bus, ControllerEvent, Received};
use super::super::plan::ArmPlan;
use super::timed::{expect, send};
use super::{BringUpError, Step};
use crate::Frame;
use crate::cia301::{NmtCommand, NmtTarget};
use hal::TimeNs;
use hal::tail::TAIL_AXES;

/// How often a bus is looked at for what came before bring-up: one that is never silent ends that,
/// too.
const LOOKS_MAX: u32 = 16;

/// Buses, and the events received on them that end the bring-up.
#[derive(Debug)]
pub(super) struct MonitoredBuses<B> {
    pub(super) bus: B,
    plan: ArmPlan,
    step: Step,
    /// The first frame that only the master of the plan may send.
    foreign: Option<(u8, Frame)>,
    /// The first thing that happened to a node and may not have, or that may have been missed.
    upset: Option<BringUpError>,
    /// Axes whose nodes have all their settings.
    set_up: [bool; TAIL_AXES],
    /// Whether we have said anything: who was there before us is not disturbed.
    spoke: bool,
    /// Whether our controller on each bus is error passive.
    passive: [bool; LINES_MAX],
    /// Who wants to know what it is at.
    pub(super) steps: Option<Sender<Step>>,
    /// Whether axes that home are to stop.
    pub(super) cancelled: Option<fn() -> bool>,
}

impl<B: Bus> MonitoredBuses<B> {
    pub(super) fn new(bus: B, plan: &ArmPlan) -> Self {
        Self {
            bus,
            plan: *plan,
            step: Step::Finding,
            foreign: None,
            upset: None,
            set_up: [false; TAIL_AXES],
            spoke: false,
            passive: [false; LINES_MAX],
            steps: None,
            cancelled: None,
        }
    }

    /// Whether our controller on `line` is error passive, as it said last.
    pub(super) fn is_passive(&self, line: u8) -> bool {
        self.passive.get(usize::from(line)) == Some(&true)
    }

    /// Notes what bring-up is at from now on. What came before, on whatever bus, is judged by what
    /// it was at then.
    pub(super) fn enter(&mut self, step: Step) -> Result<(), BringUpError> {
        self.drain()?;
        self.step = step;
        if let Some(steps) = &self.steps {
            // Whoever does not listen any more does not want to know.
            let _ = steps.send(step);
        }
        if step == Step::Waiting {
            self.steps = None;
        }
        Ok(())
    }

    /// What a step came to, unless a second master commands our drives or one is no more as it was
    /// set up: whatever it came to, that is the cause, and all nodes that we have begun to set up
    /// are stopped.
    pub(super) fn judge<T>(&mut self, step: Result<T, BringUpError>) -> Result<T, BringUpError> {
        let foreign = self.foreign.map(|(line, frame)| {
            // Who leads our drives is the cause of what happens to them.
            BringUpError::ForeignMaster { line, frame }
        });
        match foreign.or_else(|| self.upset.clone()) {
            Some(cause) => {
                if self.spoke {
                    self.stop();
                }
                Err(cause)
            }
            None => step,
        }
    }

    /// Whether something has come that ends the bring-up: [`Self::judge`] names it.
    pub(super) const fn is_upset(&self) -> bool {
        self.foreign.is_some() || self.upset.is_some()
    }

    /// Notes that the node of `axis` has all its settings: what it reports from now on counts.
    pub(super) const fn note_set_up(&mut self, axis: usize) {
        self.set_up[axis] = true;
    }

    /// Tells every node to stop: it hears no set-points then, and its drive does what 6007h says. A
    /// node whose bus has no room in time does not hear it; the others do.
    pub(super) fn stop(&mut self) {
        for (line, stop) in stops(&self.plan) {
            let _ = send(&mut self.bus, line, stop);
        }
    }

    /// Takes what came before bring-up began. What had become of our controllers then is over if
    /// they are back; one that has left its bus and was not heard to be back, or whose interface
    /// was down, ends it.
    pub(super) fn catch_up(&mut self) -> Result<(), BringUpError> {
        for line in 0..self.plan.lines {
            let (mut off, mut down) = (false, false);
            for _ in 0..LOOKS_MAX {
                let mut silent = true;
                self.receive(line, &mut |received| {
                    silent = false;
                    match received {
                        Received::ControllerEvent(ControllerEvent::BusOff) => off = true,
                        Received::ControllerEvent(ControllerEvent::Restarted) => off = false,
                        // The system tells it before what came earlier, and never that it is over.
                        Received::ControllerEvent(ControllerEvent::Down) => down = true,
                        Received::ControllerEvent(_) | Received::Frame(_) => {}
                    }
                });
                if silent {
                    break;
                }
            }
            if off || down {
                return Err(BringUpError::Off { line });
            }
        }
        Ok(())
    }

    /// Receives what no transfer waits for any more.
    pub(super) fn drain(&mut self) -> Result<(), BringUpError> {
        for line in 0..self.plan.lines {
            let taken = expect(self, line, 0, |_| None::<()>);
            self.judge(taken)?;
        }
        Ok(())
    }
}

impl<B: Bus> Bus for MonitoredBuses<B> {
    fn now(&self) -> TimeNs {
        self.bus.now()
    }

    /// Once a second master commands our drives nothing goes out any more, and what waits for an
    /// answer gets none.
    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        if self.foreign.is_some() {
            return frames.len();
        }
        self.spoke = true;
        self.bus.send(line, frames)
    }

    /// Whoever leads our drives is kept from it at once and not only when the step is judged: one
    /// may have torque.
    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        let was_alone = self.foreign.is_none();
        let Self {
            bus,
            plan,
            step,
            foreign,
            upset,
            set_up,
            spoke,
            passive,
            steps: _,
            cancelled: _,
        } = self;
        let mut passive = passive.get_mut(usize::from(line));
        bus.receive(line, &mut |received| {
            if let (Received::ControllerEvent(trouble), Some(passive)) =
                (received, passive.as_mut())
            {
                **passive = is_passive_after(trouble, **passive);
            }
            if let Received::Frame(frame) = received {
                if foreign.is_none() && leads(plan, line, &frame) {
                    *foreign = Some((line, frame));
                }
                // What was said before we said anything is over.
                if *spoke && upset.is_none() {
                    *upset = step.upset(plan, set_up, line, &frame);
                }
            }
            if let Received::ControllerEvent(ControllerEvent::Lost(count)) = received
                && *spoke
            {
                let step = *step;
                upset.get_or_insert(BringUpError::FramesLost { line, count, step });
            }
            sink(received);
        });
        if was_alone && self.foreign.is_some() && self.spoke {
            for (line, stop) in stops(&self.plan) {
                self.bus.send(line, &[stop]);
            }
        }
    }

    fn flush(&mut self, line: u8) {
        self.bus.flush(line);
    }

    fn wait(&mut self, until: TimeNs) {
        self.bus.wait(until);
    }
}

/// Whether a controller is error passive once it has reported `trouble`.
const fn is_passive_after(trouble: ControllerEvent, was: bool) -> bool {
    match trouble {
        ControllerEvent::ErrorPassive => true,
        ControllerEvent::ErrorActive | ControllerEvent::Restarted => false,
        ControllerEvent::BusOff
        | ControllerEvent::Lost(_)
        | ControllerEvent::Foreign
        | ControllerEvent::Down => was,
    }
}

/// The commands that stop all nodes of the plan, each with its bus.
fn stops(plan: &ArmPlan) -> impl Iterator<Item = (u8, Frame)> {
    let stop = |node| NmtCommand::Stop.emit(NmtTarget::Node(node));
    plan.axes
        .map(|axis| (axis.line, stop(axis.node)))
        .into_iter()
}
