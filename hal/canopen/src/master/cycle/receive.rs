//! What comes from the buses in a cycle. Hot path: bounded, no allocation, no I/O, no lock.

use super::super::fault::{Fault, is_harmless};
use super::super::foreign::leads;
use super::super::link::{ControllerEvent, Received};
use super::Cycle;
use crate::cia301::cob::PdoNumber;
use crate::cia301::emcy::ErrorCode;
use crate::cia301::{Cob, Emergency, NmtState};
use crate::{Frame, NodeId};
use hal::TimeNs;

impl Cycle {
    /// Takes what came on `line`.
    pub fn on_received(&mut self, line: u8, now: TimeNs, received: &Received) {
        match received {
            Received::Frame(frame) => self.on_frame(line, now, frame),
            Received::ControllerEvent(trouble) => self.on_controller_event(line, now, *trouble),
        }
    }

    fn on_controller_event(&mut self, line: u8, now: TimeNs, trouble: ControllerEvent) {
        let Some(health) = self.lines.get_mut(usize::from(line)) else {
            return;
        };
        match trouble {
            // Whoever restarted the controller, what it missed is not known.
            ControllerEvent::BusOff | ControllerEvent::Restarted => {
                health.off = true;
                self.latch(now, Fault::BusOff { line });
            }
            ControllerEvent::Down => {
                health.off = true;
                self.latch(now, Fault::Down { line });
            }
            ControllerEvent::ErrorPassive => {
                // Each error in that state is reported anew.
                health.passives += u64::from(!health.passive);
                health.passive = true;
            }
            ControllerEvent::ErrorActive => health.passive = false,
            ControllerEvent::Lost(count) => health.lost += u64::from(count),
            ControllerEvent::Foreign => health.foreign += 1,
        }
    }

    fn on_frame(&mut self, line: u8, now: TimeNs, frame: &Frame) {
        if leads(&self.plan, line, frame) {
            self.second_master = true;
            let id = frame.id;
            self.latch(now, Fault::ForeignMaster { line, id });
            return;
        }
        let axis = |node: NodeId| self.plan.axis_of(line, node);
        match Cob::of(frame.id) {
            Cob::Heartbeat(node) => {
                if let Some(axis) = axis(node) {
                    self.on_heartbeat(axis, now, frame.data());
                }
            }
            Cob::TransmitPdo(number, node) => {
                if let Some(axis) = axis(node).filter(|_| number == PdoNumber::FIRST) {
                    self.on_answer(axis, frame.data());
                }
            }
            Cob::Emergency(node) => {
                if let Some(axis) = axis(node) {
                    self.on_emergency(axis, now, frame.data());
                }
            }
            Cob::Nmt
            | Cob::Sync
            | Cob::Time
            | Cob::ReceivePdo(..)
            | Cob::SdoResponse(_)
            | Cob::SdoRequest(_)
            | Cob::Other(_) => {}
        }
    }

    fn on_answer(&mut self, axis: usize, data: &[u8]) {
        if let Some(sync) = self.sync {
            // What is not taken is counted by the axis, and missing at the end of the cycle.
            let plan = &self.plan.axes[axis];
            let _ = self.axes[axis].on_answer(plan, self.plan.cycle_ns, sync, data);
        }
    }

    fn on_emergency(&mut self, axis: usize, now: TimeNs, data: &[u8]) {
        let Ok(Emergency { code, .. }) = Emergency::parse(data) else {
            return;
        };
        // Before our first SYNC a drive may miss it, as it may during bring-up.
        let missed = self.began.is_none() && is_harmless(code);
        if code != ErrorCode::RESET && !missed {
            let who = self.plan.who(axis);
            self.latch(now, Fault::Emergency(who, code));
        }
    }

    fn on_heartbeat(&mut self, axis: usize, now: TimeNs, data: &[u8]) {
        let who = self.plan.who(axis);
        let Ok(state) = NmtState::parse(data) else {
            return;
        };
        self.axes[axis].nmt_state = Some(state);
        match state {
            NmtState::Operational => self.axes[axis].last_heartbeat = Some(now),
            NmtState::BootUp => self.latch(now, Fault::Rebooted(who)),
            NmtState::Stopped | NmtState::PreOperational => {
                self.latch(now, Fault::LeftOperational(who, state));
            }
        }
    }
}
