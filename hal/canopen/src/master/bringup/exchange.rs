//! SDO transfers and NMT with several nodes at a time: each axis has a sequence of its own, a
//! future, and one loop receives for all of them.
//!
//! The loop polls every sequence after each look at the buses, so nothing has to wake anything and
//! no other executor is needed.

use core::cell::{Cell, RefCell};
use core::future::poll_fn;
use core::ops::Range;
use core::pin::{Pin, pin};
use core::task::{Context, Poll, Waker};

use super::super::cycle::LINES_MAX;
use super::super::link::{Bus, ControllerEvent, Received};
use super::super::plan::ArmPlan;
use super::BringUpError;
use super::timed::{LOOK_NS, TIMEOUT_NS};
use super::watched::MonitoredBuses;
use crate::Frame;
use crate::cia301::cob::SYNC_ID;
use crate::cia301::sync::Sync;
use hal::TimeNs;
use hal::tail::TAIL_AXES;

/// SYNC periods between two set-points of a drive that is homed: the transfers that ask for its
/// status word need room on the bus.
const HOMING_CYCLES: u64 = 2;

/// Bits of a bus for each transfer, of which its two frames take at most 270: all transfers
/// together leave half of the bus to others, who may lead drives on it. A heartbeat that waits
/// behind transfers would hold up the SYNC behind it.
const TRANSFER_BITS: u64 = 540;

/// A ticket lock: who may begin the next transfer on a bus.
#[derive(Debug, Default)]
struct TicketLock {
    /// Tickets issued, and tickets served.
    given: Cell<u64>,
    taken: Cell<u64>,
    /// When the next one may be taken.
    next: Cell<TimeNs>,
}

/// The buses, as all sequences use them.
pub(in super::super) struct Exchange<'a, B> {
    bus: RefCell<&'a mut B>,
    lines: Range<u8>,
    /// Looks at the buses so far.
    looks: Cell<u64>,
    /// What came with the newest look.
    frames: RefCell<Vec<(u8, Frame)>>,
    /// Buses that our controller has left, or whose interface is down.
    off: [Cell<bool>; LINES_MAX],
    /// Set-points that go out with each SYNC, with their buses.
    set_points: [Cell<Option<(u8, Frame)>>; TAIL_AXES],
    turns: [TicketLock; LINES_MAX],
    /// Least time between the beginnings of two transfers, ns.
    transfer_ns: u64,
    sync: Frame,
    sync_period_ns: u64,
    next_sync: Cell<TimeNs>,
    /// SYNCs that went out so far.
    syncs: Cell<u64>,
    /// Whether axes that home are to stop.
    cancelled: Option<fn() -> bool>,
}

/// What goes out when.
struct Pace {
    sync: Frame,
    sync_period_ns: u64,
    transfer_ns: u64,
}

impl Pace {
    fn of(plan: &ArmPlan) -> Self {
        let counted = Sync::counted(1).filter(|_| plan.sync_counter != 0);
        Self {
            sync: counted.unwrap_or(Sync::PLAIN).emit(plan.sync_id),
            sync_period_ns: HOMING_CYCLES * plan.cycle_ns,
            transfer_ns: TRANSFER_BITS * 1_000_000_000 / u64::from(plan.bit_rate.max(1)),
        }
    }
}

impl<'a, B: Bus> Exchange<'a, B> {
    fn new(bus: &'a mut B, lines: Range<u8>, pace: Pace) -> Self {
        let Pace {
            sync,
            sync_period_ns,
            transfer_ns,
        } = pace;
        let next_sync = Cell::new(bus.now());
        Self {
            bus: RefCell::new(bus),
            lines,
            looks: Cell::new(0),
            frames: RefCell::default(),
            off: Default::default(),
            set_points: Default::default(),
            turns: Default::default(),
            transfer_ns,
            sync,
            sync_period_ns,
            next_sync,
            syncs: Cell::new(0),
            cancelled: None,
        }
    }

    pub(super) fn now(&self) -> TimeNs {
        self.bus.borrow().now()
    }

    /// Whether axes that home are to stop.
    pub(super) fn is_cancelled(&self) -> bool {
        self.cancelled.is_some_and(|cancelled| cancelled())
    }

    /// Takes what has come, and sends set-points and SYNC if they are due.
    fn look(&self) {
        let mut bus = self.bus.borrow_mut();
        let mut frames = self.frames.borrow_mut();
        frames.clear();
        for line in self.lines.clone() {
            bus.receive(line, &mut |received| match received {
                Received::Frame(frame) => frames.push((line, frame)),
                // What a controller that was restarted has missed is not known.
                Received::ControllerEvent(
                    ControllerEvent::BusOff | ControllerEvent::Restarted | ControllerEvent::Down,
                ) => {
                    self.off[usize::from(line)].set(true);
                }
                Received::ControllerEvent(_) => {}
            });
        }
        self.looks.set(self.looks.get() + 1);
        let now = bus.now();
        if now >= self.next_sync.get() && self.send_set_points(*bus) {
            self.next_sync.set(now.plus_ns(self.sync_period_ns));
        }
    }

    /// Sends the set-points, and on each bus that has any the SYNC after them; tells whether there
    /// are any and all found room. What found none is sent again with the next look.
    fn send_set_points(&self, bus: &mut B) -> bool {
        let (mut any, mut all) = (false, true);
        for line in self.lines.clone() {
            let set_points = self.set_points.iter().filter_map(Cell::get);
            let mut frames: Vec<Frame> = set_points
                .filter_map(|(on, frame)| (on == line).then_some(frame))
                .collect();
            if frames.is_empty() {
                continue;
            }
            frames.push(self.sync);
            any = true;
            all &= bus.send(line, &frames) == frames.len();
        }
        if any && all {
            self.syncs.set(self.syncs.get() + 1);
        }
        any && all
    }

    /// The buses, between two looks.
    pub(super) fn with_bus<T>(&self, act: impl FnOnce(&mut B) -> T) -> T {
        act(&mut self.bus.borrow_mut())
    }

    fn pause(&self) {
        let mut bus = self.bus.borrow_mut();
        let until = bus.now().plus_ns(LOOK_NS);
        bus.wait(until);
    }

    async fn next_look(&self) {
        let looks = self.looks.get();
        poll_fn(|_| {
            if self.looks.get() > looks {
                Poll::Ready(())
            } else {
                Poll::Pending
            }
        })
        .await;
    }

    const fn is_off(&self, line: u8) -> bool {
        self.off[line as usize].get()
    }

    /// Waits until a transfer may begin on `line`: one after the other, in the order in which they
    /// ask.
    pub(in super::super) async fn transfer_turn(&self, line: u8) {
        let turns = &self.turns[usize::from(line)];
        let turn = turns.given.get();
        turns.given.set(turn + 1);
        while turns.taken.get() != turn || self.now() < turns.next.get() {
            self.next_look().await;
        }
        turns.taken.set(turn + 1);
        turns.next.set(self.now().plus_ns(self.transfer_ns));
    }

    /// Sends `frame`, waiting for room.
    pub(in super::super) async fn send(&self, line: u8, frame: Frame) -> Result<(), BringUpError> {
        let end = self.now().plus_ns(TIMEOUT_NS);
        loop {
            if self.is_off(line) {
                return Err(BringUpError::Off { line });
            }
            if self.bus.borrow_mut().send(line, &[frame]) > 0 {
                return Ok(());
            }
            if self.now() >= end {
                return Err(BringUpError::CannotSend { line });
            }
            self.next_look().await;
        }
    }

    /// What `pick` finds among the frames that come on `line` within `limit_ns`; none if nothing
    /// came.
    pub(in super::super) async fn expect<T>(
        &self,
        line: u8,
        limit_ns: u64,
        mut pick: impl FnMut(&Frame) -> Option<T>,
    ) -> Result<Option<T>, BringUpError> {
        let end = self.now().plus_ns(limit_ns);
        loop {
            self.next_look().await;
            if self.is_off(line) {
                return Err(BringUpError::Off { line });
            }
            let found = {
                let frames = self.frames.borrow();
                let mut here = frames.iter().filter(|(on, _)| *on == line);
                here.find_map(|(_, frame)| pick(frame))
            };
            if found.is_some() || self.now() >= end {
                return Ok(found);
            }
        }
    }

    /// Gives the drive of `axis` this set-point with each SYNC from now on, or none any more.
    pub(super) fn set_point(&self, axis: usize, set_point: Option<(u8, Frame)>) {
        self.set_points[axis].set(set_point);
    }

    /// Waits until a SYNC has gone out on `line` and its answer may be there.
    pub(super) async fn next_sync(&self, line: u8) -> Result<(), BringUpError> {
        let (before, end) = (self.syncs.get(), self.now().plus_ns(TIMEOUT_NS));
        while self.syncs.get() == before {
            if self.is_off(line) {
                return Err(BringUpError::Off { line });
            }
            if self.now() >= end {
                return Err(BringUpError::CannotSend { line });
            }
            self.next_look().await;
        }
        self.next_look().await;
        Ok(())
    }
}

fn poll<F: Future>(sequence: Pin<&mut F>) -> Poll<F::Output> {
    sequence.poll(&mut Context::from_waker(Waker::noop()))
}

/// Polls each of `sequences` that has no result yet.
fn poll_all<F: Future>(sequences: &mut [Pin<Box<F>>], results: &mut [Option<F::Output>]) {
    for (sequence, result) in sequences.iter_mut().zip(results) {
        if result.is_none()
            && let Poll::Ready(ended) = poll(sequence.as_mut())
        {
            *result = Some(ended);
        }
    }
}

/// A sequence with one node of `line`, as it is outside of bring-up.
pub(in super::super) fn alone<B: Bus, T>(
    bus: &mut B,
    line: u8,
    sequence: impl AsyncFnOnce(&Exchange<'_, B>) -> T,
) -> T {
    let pace = Pace {
        sync: Sync::PLAIN.emit(SYNC_ID),
        sync_period_ns: 0,
        transfer_ns: 0,
    };
    let exchange = Exchange::new(bus, line..line + 1, pace);
    let mut sequence = pin!(sequence(&exchange));
    loop {
        exchange.look();
        if let Poll::Ready(result) = poll(sequence.as_mut()) {
            return result;
        }
        exchange.pause();
    }
}

impl<B: Bus> MonitoredBuses<B> {
    /// The sequence of each of `axes`, side by side. The first error ends all of them, and so does
    /// what [`Self::judge`] will name.
    pub(super) fn side_by_side<T>(
        &mut self,
        plan: &ArmPlan,
        axes: &[usize],
        sequence: impl AsyncFn(&Exchange<'_, Self>, usize) -> Result<T, BringUpError>,
    ) -> Result<Vec<T>, BringUpError> {
        let ended = self.run(plan, axes, sequence, |results, bus| {
            bus.is_upset() || results.iter().any(|result| matches!(result, Some(Err(_))))
        });
        let mut results = Vec::with_capacity(axes.len());
        let mut unfinished = false;
        for result in ended {
            match result {
                Some(Ok(value)) => results.push(value),
                Some(Err(error)) => return self.judge(Err(error)),
                None => unfinished = true,
            }
        }
        // Only what `judge` names leaves a sequence without an end.
        assert!(!unfinished || self.is_upset(), "a sequence has no end");
        self.judge(Ok(results))
    }

    /// The same, but each sequence goes on to its end, whatever becomes of the others.
    pub(super) fn each_to_its_end<T>(
        &mut self,
        plan: &ArmPlan,
        axes: &[usize],
        sequence: impl AsyncFn(&Exchange<'_, Self>, usize) -> Result<T, BringUpError>,
    ) -> Vec<Result<T, BringUpError>> {
        let ended = self.run(plan, axes, sequence, |_, _| false);
        ended.into_iter().flatten().collect()
    }

    /// What became of each sequence by the time that all are at their end, or `ends` says so.
    fn run<T>(
        &mut self,
        plan: &ArmPlan,
        axes: &[usize],
        sequence: impl AsyncFn(&Exchange<'_, Self>, usize) -> Result<T, BringUpError>,
        ends: impl Fn(&[Option<Result<T, BringUpError>>], &Self) -> bool,
    ) -> Vec<Option<Result<T, BringUpError>>> {
        let exchange = Exchange {
            cancelled: self.cancelled,
            ..Exchange::new(self, 0..plan.lines, Pace::of(plan))
        };
        let sequences = axes.iter();
        let sequences = sequences.map(|&axis| Box::pin(sequence(&exchange, axis)));
        let mut sequences: Vec<_> = sequences.collect();
        let mut results: Vec<_> = axes.iter().map(|_| None).collect();
        loop {
            exchange.look();
            poll_all(&mut sequences, &mut results);
            if results.iter().all(Option::is_some) || ends(&results, &**exchange.bus.borrow()) {
                break;
            }
            exchange.pause();
        }
        drop(sequences);
        results
    }
}
