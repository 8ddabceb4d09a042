//! Buses in memory on which strangers talk, and a watch over the motors.

use std::cell::RefCell;
use std::rc::Rc;

use hal::TimeNs;
use hal::can::Frame;
use hal::can::bus::{IdealMotor, Network};
use hal::can::master::{ArmPlan, Bus, Received};

use crate::frames::{Mood, Random};

/// How often strangers may talk and motors are looked at, ns.
const LOOK_NS: u64 = 500_000;
/// Most frames of strangers in that time; a bus carries four.
const BURST: u64 = 4;
/// From this cycle on an arm leaves half of its bus to others.
const ROOMY_NS: u64 = 4_000_000;

/// What was thrown and what moved.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen {
    /// Frames that found room on the bus.
    pub(crate) thrown: u64,
    /// How far all motors went together, counts.
    pub(crate) travelled: f64,
    /// Times at which all motors were looked at.
    pub(crate) looks: u64,
    /// Greatest share of its drive's greatest speed that an axis had.
    pub(crate) speed_share: f64,
}

impl Seen {
    pub(crate) fn add(&mut self, other: &Self) {
        self.thrown += other.thrown;
        self.travelled += other.travelled;
        self.looks += other.looks;
        self.speed_share = self.speed_share.max(other.speed_share);
    }
}

/// Range and greatest speed of a drive, counts, and where its motor was.
#[derive(Clone, Copy)]
struct Watched {
    range: (f64, f64),
    speed_max: f64,
    before: f64,
}

pub(crate) struct Noisy {
    net: Network<IdealMotor>,
    plan: ArmPlan,
    seed: u64,
    random: Random,
    /// Nobody talks as long as there is none.
    mood: Option<Mood>,
    watched: [Watched; 7],
    seen: Rc<RefCell<Seen>>,
}

impl Noisy {
    pub(crate) fn new(net: Network<IdealMotor>, plan: &ArmPlan, seed: u64, mood: Mood) -> Self {
        let watched = plan.axes.map(|axis| {
            let drive = axis.drive(0);
            Watched {
                range: (drive.range.0.into(), drive.range.1.into()),
                speed_max: drive.speed_max.into(),
                before: f64::NAN,
            }
        });
        Self {
            net,
            plan: *plan,
            seed,
            random: Random::new(seed),
            mood: (mood == Mood::FromTheStart).then_some(mood),
            watched,
            seen: Rc::default(),
        }
    }

    /// What happens on these buses, also when they are gone.
    pub(crate) fn seen(&self) -> Rc<RefCell<Seen>> {
        Rc::clone(&self.seen)
    }

    /// Strangers begin to talk.
    pub(crate) fn begin(&mut self, mood: Mood) {
        self.mood = Some(mood);
    }

    fn talk(&mut self) {
        let Some(mood) = self.mood else { return };
        // Where the arm leaves them little of the bus they are silent most of the time, or they would own it.
        if self.plan.cycle_ns < ROOMY_NS && self.random.below(3) > 0 {
            return;
        }
        for _ in 0..self.random.below(BURST + 1) {
            let frame = mood.frame(&mut self.random);
            let line = u8::try_from(self.random.below(self.plan.lines.into())).unwrap();
            let fits = self.net.intrude(line, frame);
            self.seen.borrow_mut().thrown += u64::from(fits);
        }
    }

    /// Every axis is where it may be, and was no faster than it may be.
    fn look(&mut self, passed_ns: u64) {
        let mut seen = self.seen.borrow_mut();
        seen.looks += 1;
        let seconds = TimeNs(passed_ns).seconds();
        for (axis, watched) in self.plan.axes.iter().zip(&mut self.watched) {
            let position = self.net.motor(axis.node).unwrap().position_counts;
            let (low, high) = watched.range;
            let (seed, node) = (self.seed, axis.node);
            assert!(
                (low..=high).contains(&position),
                "seed {seed}: {node} at {position}"
            );
            let way = (position - watched.before).abs();
            if way.is_finite() {
                let reach = watched.speed_max * seconds;
                assert!(
                    way <= reach + 1.0,
                    "seed {seed}: {node} went {way} of {reach}"
                );
                seen.travelled += way;
                if reach > 10.0 {
                    seen.speed_share = seen.speed_share.max(way / reach);
                }
            }
            watched.before = position;
        }
    }
}

impl Bus for Noisy {
    fn now(&self) -> TimeNs {
        self.net.now()
    }

    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        self.net.send(line, frames)
    }

    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        self.net.receive(line, sink);
    }

    fn flush(&mut self, line: u8) {
        self.net.flush(line);
    }

    fn wait(&mut self, until: TimeNs) {
        while self.net.now() < until {
            let now = self.net.now();
            let next = TimeNs(until.0.min(now.0 + LOOK_NS));
            self.talk();
            self.net.advance(next);
            self.look(next.since(now));
        }
    }
}
