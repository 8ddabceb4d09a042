//! Time on the buses in memory: who lives when, and what becomes of each frame on its way.

use super::super::motor::Motor;
use super::super::wire::Delivery;
use super::{NODE_STEP_NS, Network, Tampering};
use hal::TimeNs;
use hal::count::count_u8;
use trocar_canopen::master::Received;

impl<M: Motor> Network<M> {
    /// Lets time pass until `until`, frame by frame and step by step.
    ///
    /// A step at the very time `until` is made. Frames that arrive at a step come before it.
    pub fn advance(&mut self, until: TimeNs) {
        while self.next_step <= until {
            self.exchange(self.next_step);
            self.now = self.next_step;
            for place in 0..self.drives.len() {
                self.with(place, |now, drive, out| {
                    let demand = drive.node.demand(now);
                    drive.node.feedback(drive.motor.step(NODE_STEP_NS, &demand));
                    drive.node.on_time(now, out);
                });
            }
            self.next_step = self.next_step.plus_ns(NODE_STEP_NS);
        }
        self.exchange(until);
        self.now = until;
    }

    /// Delivers everything that arrives by `until`, in order of time.
    ///
    /// Bus by bus: lines are independent but for the drives' steps, between which this runs.
    fn exchange(&mut self, until: TimeNs) {
        for line in 0..self.lines.len() {
            loop {
                let delayed = self.lines[line].delayed.iter().map(|(at, _)| *at);
                let due = delayed.min().filter(|at| *at <= until);
                // What is not delayed and comes earlier comes first.
                if let Some(delivery) = self.lines[line].wire.next(due.unwrap_or(until)) {
                    self.now = delivery.at;
                    self.arrive(line, delivery);
                } else if let Some(due) = due {
                    let delayed = &mut self.lines[line].delayed;
                    let place = delayed.iter().position(|(at, _)| *at == due);
                    let (at, delivery) = delayed.remove(place.unwrap_or(0));
                    self.now = at;
                    self.hand_over(line, &delivery);
                } else {
                    break;
                }
            }
        }
    }

    /// A frame that has passed the wire; the tamper hook may drop, replace, repeat or delay it.
    fn arrive(&mut self, line: usize, delivery: Delivery) {
        let number = count_u8(line);
        let tampering = self.tamper.as_mut().map_or(Tampering::Pass, |tamper| {
            tamper(number, delivery.at, &delivery.frame)
        });
        match tampering {
            Tampering::Pass => self.hand_over(line, &delivery),
            Tampering::Drop => {}
            Tampering::Replace(frame) => self.hand_over(line, &Delivery { frame, ..delivery }),
            Tampering::Repeat => {
                self.hand_over(line, &delivery);
                self.hand_over(line, &delivery);
            }
            Tampering::Delay(ns) => {
                let due = delivery.at.plus_ns(ns);
                self.lines[line].delayed.push((due, delivery));
            }
        }
    }

    /// Gives a frame to every node and master on the bus but its sender.
    fn hand_over(&mut self, line: usize, delivery: &Delivery) {
        for master in &mut self.lines[line].masters {
            if delivery.port != master.port {
                master.inbox.push(Received::Frame(delivery.frame));
            }
        }
        for place in 0..self.drives.len() {
            let drive = &self.drives[place];
            if drive.line == line && drive.port != delivery.port {
                self.with(place, |now, drive, out| {
                    drive.node.on_frame(now, &delivery.frame, out);
                });
            }
        }
    }
}
