//! Buses in memory on which a story happens, and a watch over the master and the motors.

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::vec::IntoIter;

use hal::TimeNs;
use hal::can::bus::{IdealMotor, Network, Tampering};
use hal::can::cia301::cob::PdoNumber;
use hal::can::cia301::{Cob, NmtCommand, nmt};
use hal::can::cia402::{Command, ControlView};
use hal::can::master::{ArmPlan, Bus, Received, Trouble};
use hal::can::{Frame, NodeId};

use crate::life::{Act, Burst, Life};

/// How often motors are looked at, and bursts may begin, ns.
const LOOK_NS: u64 = 500_000;
const MS_NS: u64 = 1_000_000;

/// What was thrown, what moved, and what was wrong.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen {
    /// Frames that found room on a bus.
    pub(crate) thrown: u64,
    /// Things that happened beside them.
    pub(crate) troubles: u64,
    /// How far all motors went together, counts.
    pub(crate) travelled: f64,
    /// Times at which all motors were looked at.
    pub(crate) looks: u64,
    /// Greatest share of its drive's greatest speed that an axis had.
    pub(crate) speed_share: f64,
    /// The first thing that must not be.
    pub(crate) wrong: Option<String>,
}

impl Seen {
    pub(crate) fn add(&mut self, other: &Self) {
        self.thrown += other.thrown;
        self.troubles += other.troubles;
        self.travelled += other.travelled;
        self.looks += other.looks;
        self.speed_share = self.speed_share.max(other.speed_share);
    }

    /// Notes what `what` says unless `holds`.
    pub(crate) fn must(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds {
            self.wrong.get_or_insert_with(what);
        }
    }
}

/// An axis, where its motor was, and where its drive last said that it is, counts.
#[derive(Clone, Copy)]
struct Watched {
    node: NodeId,
    range: (f64, f64),
    speed_max: f64,
    before: f64,
    /// Where the master may send it.
    planned: (f64, f64),
    told: Option<i32>,
}

pub(crate) struct Noisy {
    net: Network<IdealMotor>,
    plan: ArmPlan,
    story: IntoIter<Burst>,
    next: Option<Burst>,
    looks_left: u32,
    slowness: u32,
    begun: bool,
    /// How far the master's clock is from the buses', ns.
    skew_ns: i64,
    stall_ms: u16,
    no_room: [u8; 3],
    lose: [u8; 3],
    spoil: Rc<Cell<Option<Tampering>>>,
    watched: [Watched; 7],
    /// The master knows of a fault.
    latched: bool,
    seen: Rc<RefCell<Seen>>,
}

impl Noisy {
    pub(crate) fn new(mut net: Network<IdealMotor>, plan: &ArmPlan, life: &Life) -> Self {
        let spoil: Rc<Cell<Option<Tampering>>> = Rc::default();
        let spoilt = Rc::clone(&spoil);
        net.tamper(Box::new(move |_, _, _| {
            spoilt.take().unwrap_or(Tampering::Pass)
        }));
        let watched = plan.axes.map(|axis| {
            let drive = axis.drive(0);
            let counts = |units: f64| units * axis.counts_per_unit;
            let (a, b) = (counts(axis.range.0), counts(axis.range.1));
            Watched {
                node: axis.node,
                range: (drive.range.0.into(), drive.range.1.into()),
                speed_max: drive.speed_max.into(),
                before: f64::NAN,
                planned: (a.min(b) - 1.0, a.max(b) + 1.0),
                told: None,
            }
        });
        Self {
            net,
            plan: *plan,
            story: life.bursts.clone().into_iter(),
            next: None,
            looks_left: 0,
            slowness: life.buses.slowness(),
            begun: life.from_the_start,
            skew_ns: 0,
            stall_ms: 0,
            no_room: [0; 3],
            lose: [0; 3],
            spoil,
            watched,
            latched: false,
            seen: Rc::default(),
        }
    }

    /// What happens on these buses, also when they are gone.
    pub(crate) fn seen(&self) -> Rc<RefCell<Seen>> {
        Rc::clone(&self.seen)
    }

    /// The story begins, if it has not.
    pub(crate) fn begin(&mut self) {
        self.begun = true;
    }

    /// Whether all of it has happened.
    pub(crate) fn is_over(&self) -> bool {
        self.next.is_none() && self.story.len() == 0
    }

    /// From now on the master may not lead a drive anywhere.
    pub(crate) fn latch(&mut self) {
        self.latched = true;
    }

    /// How long the master's thread is to stand still, ns.
    pub(crate) fn take_stall_ns(&mut self) -> u64 {
        u64::from(core::mem::take(&mut self.stall_ms)) * MS_NS
    }

    fn happen(&mut self) {
        if !self.begun {
            return;
        }
        if self.next.is_none() {
            self.next = self.story.next();
            let looks = self.next.as_ref().map_or(0, |burst| burst.looks);
            self.looks_left = u32::from(looks) * self.slowness;
        }
        if self.looks_left > 0 {
            self.looks_left -= 1;
        } else if let Some(burst) = self.next.take() {
            burst.acts.iter().for_each(|act| self.act(act));
        }
    }

    fn act(&mut self, act: &Act) {
        let on = |line: u8| line % self.plan.lines;
        let place = |line: u8| usize::from(on(line));
        let thrown = matches!(act, Act::Frame(..));
        self.seen.borrow_mut().troubles += u64::from(!thrown);
        match *act {
            Act::Frame(line, frame) => {
                let fits = self.net.intrude(on(line), frame);
                self.seen.borrow_mut().thrown += u64::from(fits);
            }
            Act::Trouble(line, trouble) => self.net.trouble(on(line), trouble),
            Act::BusOff(line, off) => self.net.bus_off(on(line), off),
            Act::NoRoom(line, times) => self.no_room[place(line)] = times,
            Act::Lose(line, frames) => self.lose[place(line)] = frames,
            Act::Spoil(tampering) => self.spoil.set(Some(tampering)),
            Act::Power(axis, on) => self.net.power(self.watched[usize::from(axis)].node, on),
            Act::Stuck(axis) => {
                let node = self.watched[usize::from(axis)].node;
                self.net.motor(node).unwrap().stuck = true;
            }
            Act::Stall(ms) => self.stall_ms = ms,
            Act::Leap(ms) => self.skew_ns += i64::from(ms) * i64::try_from(MS_NS).unwrap(),
        }
    }

    /// Every axis is where it may be, and was no faster than it may be.
    fn look(&mut self, passed_ns: u64) {
        let mut seen = self.seen.borrow_mut();
        seen.looks += 1;
        let seconds = TimeNs(passed_ns).seconds();
        for watched in &mut self.watched {
            let node = watched.node;
            let position = self.net.motor(node).unwrap().position_counts;
            let (low, high) = watched.range;
            seen.must((low..=high).contains(&position), || {
                format!("node {node} is at {position}, outside {low} to {high}")
            });
            let way = (position - watched.before).abs();
            if way.is_finite() {
                let reach = watched.speed_max * seconds;
                seen.must(way <= reach + 1.0, || {
                    format!("node {node} went {way} where {reach} is as far as it can")
                });
                seen.travelled += way;
                if reach > 10.0 {
                    seen.speed_share = seen.speed_share.max(way / reach);
                }
            }
            watched.before = position;
        }
    }

    /// A set-point goes to where its axis may be or says that it is; after a fault the master leads nobody.
    fn check(&self, frame: &Frame) {
        let mut seen = self.seen.borrow_mut();
        if let Cob::ReceivePdo(PdoNumber::FIRST, node) = Cob::of(frame.id) {
            let [c0, c1, p0, p1, p2, p3] = frame.data().try_into().unwrap();
            let command = ControlView(u16::from_le_bytes([c0, c1])).command();
            let target = i32::from_le_bytes([p0, p1, p2, p3]);
            let axis = self.watched.iter().find(|axis| axis.node == node).unwrap();
            let (low, high) = axis.planned;
            let may = (low..=high).contains(&f64::from(target)) || axis.told == Some(target);
            let enables = command == Command::EnableOperation;
            seen.must(may || !enables, || {
                format!("node {node} is sent to {target}")
            });
            let stops = matches!(command, Command::QuickStop | Command::DisableVoltage);
            seen.must(stops || !self.latched, || {
                format!("{command:?} for node {node} after a fault")
            });
        }
        let starts = frame.id.raw() == 0
            && matches!(nmt::NmtView(frame.data()).command(), Ok(NmtCommand::Start));
        seen.must(!(starts && self.latched), || {
            "drives are started after a fault".to_owned()
        });
    }
}

impl Bus for Noisy {
    fn now(&self) -> TimeNs {
        TimeNs(self.net.now().0.saturating_add_signed(self.skew_ns))
    }

    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        frames.iter().for_each(|frame| self.check(frame));
        let no_room = &mut self.no_room[usize::from(line)];
        let room = if *no_room == 0 {
            frames.len()
        } else {
            *no_room -= 1;
            usize::from(*no_room) % frames.len().max(1)
        };
        self.net.send(line, &frames[..room])
    }

    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        let (lose, watched) = (&mut self.lose[usize::from(line)], &mut self.watched);
        let mut lost = 0;
        self.net.receive(line, &mut |received| {
            if let Received::Frame(frame) = received {
                if *lose > 0 {
                    *lose -= 1;
                    lost += 1;
                    return;
                }
                note(watched, &frame);
            }
            sink(received);
        });
        if lost > 0 {
            sink(Received::Trouble(Trouble::Lost(lost)));
        }
    }

    fn flush(&mut self, line: u8) {
        self.net.flush(line);
    }

    fn wait(&mut self, until: TimeNs) {
        while self.now() < until {
            let left_ns = until.since(self.now()).min(LOOK_NS);
            let now = self.net.now();
            self.happen();
            self.net.advance(now.plus_ns(left_ns));
            self.look(left_ns);
        }
    }
}

/// Where a drive says that it is.
fn note(watched: &mut [Watched; 7], frame: &Frame) {
    if let Cob::TransmitPdo(PdoNumber::FIRST, node) = Cob::of(frame.id)
        && let [_, _, p0, p1, p2, p3, _, _] = *frame.data()
        && let Some(axis) = watched.iter_mut().find(|axis| axis.node == node)
    {
        axis.told = Some(i32::from_le_bytes([p0, p1, p2, p3]));
    }
}
