//! Buses in memory on which a story happens, and a watch over the master and the motors.

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::vec::IntoIter;

use hal::TimeNs;
use trocar_canopen::Frame;
use trocar_canopen::cia301::cob::PdoNumber;
use trocar_canopen::cia301::{Cob, NmtCommand, nmt};
use trocar_canopen::cia402::{Command, ControlView};
use trocar_canopen::master::{ArmPlan, Bus, ControllerEvent, Received};
use trocar_drives::{Network, Tampering};

use crate::life::{Act, Burst, Scenario};
use crate::promises::{Ages, Leads, Stamped, answers, leads, stop_ns};
use crate::seen::{Seen, Watched, note};

/// How often motors are looked at, and bursts may begin, ns.
const LOOK_NS: u64 = 500_000;
const MS_NS: u64 = 1_000_000;

pub(crate) struct Noisy {
    net: Network<Stamped>,
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
    /// Since when the master knows of a fault.
    latched: Option<TimeNs>,
    /// SYNCs that the master gave each bus, whether its clock jumped since the newest, and how old
    /// what it measured is.
    syncs: [u64; 3],
    clock_jumped: bool,
    ages: Ages,
    seen: Rc<RefCell<Seen>>,
}

impl Noisy {
    pub(crate) fn new(mut net: Network<Stamped>, plan: &ArmPlan, life: &Scenario) -> Self {
        let spoil: Rc<Cell<Option<Tampering>>> = Rc::default();
        let spoilt = Rc::clone(&spoil);
        net.tamper(Box::new(move |_, _, _| {
            spoilt.take().unwrap_or(Tampering::Pass)
        }));
        let watched = plan.axes.map(|axis| Watched::of(&axis));
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
            latched: None,
            syncs: [0; 3],
            clock_jumped: false,
            ages: Ages::new(),
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
        self.latched.get_or_insert(self.net.now());
    }

    /// SYNCs that the master gave each bus.
    pub(crate) const fn syncs(&self) -> [u64; 3] {
        self.syncs
    }

    /// Whether the master's clock has jumped since [`Self::clear_clock_jump`].
    pub(crate) const fn has_clock_jumped(&self) -> bool {
        self.clock_jumped
    }

    pub(crate) fn clear_clock_jump(&mut self) {
        self.clock_jumped = false;
    }

    /// How old what the master measures is, and the time of the buses.
    pub(crate) fn ages(&mut self) -> (&mut Ages, TimeNs) {
        let now = self.net.now();
        (&mut self.ages, now)
    }

    /// A stranger says `frame`: what it leads and whose name it takes.
    fn beware(&mut self, frame: &Frame) {
        if let Some(axis) = answers(&self.plan, frame) {
            self.ages.void(axis);
        }
        let now = self.net.now();
        match leads(&self.plan, frame) {
            Leads::Nobody => {}
            Leads::Axis(axis) => self.watched[axis].led = now,
            Leads::AxisForGood(axis) => self.watched[axis].led_for_good = true,
            Leads::All => self.watched.iter_mut().for_each(|axis| axis.led = now),
        }
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
                self.beware(&frame);
                let fits = self.net.intrude(line % self.plan.lines, frame);
                self.seen.borrow_mut().thrown += u64::from(fits);
            }
            Act::ControllerEvent(line, trouble) => self.net.trouble(on(line), trouble),
            Act::BusOff(line, off) => self.net.bus_off(on(line), off),
            Act::NoRoom(line, times) => self.no_room[place(line)] = times,
            Act::Lose(line, frames) => self.lose[place(line)] = frames,
            Act::Spoil(tampering) => {
                if let Tampering::Replace(frame) = tampering {
                    self.beware(&frame);
                    // Whenever it comes.
                    self.watched
                        .iter_mut()
                        .for_each(|axis| axis.led_for_good = true);
                }
                self.spoil.set(Some(tampering));
            }
            Act::Power(axis, on) => {
                self.ages.void(usize::from(axis));
                self.net.power(self.watched[usize::from(axis)].node, on);
            }
            Act::Stuck(axis) => {
                let node = self.watched[usize::from(axis)].node;
                self.net.motor(node).unwrap().ideal.stuck = true;
            }
            Act::Stall(ms) => self.stall_ms = ms,
            Act::ClockJump(ms) => {
                self.clock_jumped = true;
                self.skew_ns += i64::from(ms) * i64::try_from(MS_NS).unwrap();
            }
        }
    }

    /// Every axis is where it may be, and was no faster than it may be.
    fn look(&mut self, passed_ns: u64) {
        let mut seen = self.seen.borrow_mut();
        seen.looks += 1;
        let seconds = TimeNs(passed_ns).seconds();
        let (now, stop_ns) = (self.net.now(), stop_ns(&self.plan));
        for watched in &mut self.watched {
            let node = watched.node;
            let position = self.net.motor(node).unwrap().ideal.position_counts;
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
                let still = self.latched.filter(|_| !watched.led_for_good);
                let still = still.is_some_and(|at| now.since(at.max(watched.led)) > stop_ns);
                seen.stills += u64::from(still);
                seen.must(!still || way <= 1e-6, || {
                    format!("node {node} moves by {way} long after a fault")
                });
                seen.travelled += way;
                if reach > 10.0 {
                    seen.speed_share = seen.speed_share.max(way / reach);
                }
            }
            watched.before = position;
        }
    }

    /// A set-point goes to where its axis may be or says that it is; after a fault the master leads
    /// nobody.
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
            seen.must(stops || self.latched.is_none(), || {
                format!("{command:?} for node {node} after a fault")
            });
        }
        let starts = frame.id.raw() == 0
            && matches!(nmt::NmtView(frame.data()).command(), Ok(NmtCommand::Start));
        seen.must(!(starts && self.latched.is_some()), || {
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
        let beats = frames.iter().filter(|frame| frame.id == self.plan.sync_id);
        self.syncs[usize::from(line)] += u64::try_from(beats.count()).unwrap();
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
        let (plan, ages, now) = (&self.plan, &mut self.ages, self.net.now());
        let mut lost = 0;
        self.net.receive(line, &mut |received| {
            if let Received::Frame(frame) = received {
                if *lose > 0 {
                    *lose -= 1;
                    lost += 1;
                    return;
                }
                note(watched, &frame);
                if let Some(axis) = answers(plan, &frame) {
                    ages.on_answer(axis, frame.data(), now);
                }
            }
            sink(received);
        });
        if lost > 0 {
            sink(Received::ControllerEvent(ControllerEvent::Lost(lost)));
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
