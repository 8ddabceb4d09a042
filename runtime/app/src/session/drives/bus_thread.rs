//! The thread that keeps emulated drives and their world going, in step with the clock on the wall.
//!
//! One loop: let the drives live until now, hand on what happened, sleep until the next frame or
//! the next thing a drive wants to say. The drives' time is the wall's, less the stalls
//! ([`TURN_NS_MAX`]). System calls are the sockets' and the sleeps; it is not hot-path code as the
//! control thread is, and allocates where drives do.

use std::sync::atomic::{AtomicBool, Ordering};

use hal::{TICK_NS, TimeNs};
use rtrb::Producer;
use trocar_canopen::master::{Bus as _, CanConfig};
use trocar_canopen::socket::SocketBus;
use trocar_drives::Station;
use trocar_tasks::scene::SceneSnapshot;
use trocar_tasks::simulation::Simulation;

use super::bench::{Bench, Listener};
use super::inject::InjectedFault;
use super::seen::Seen;
use super::stalls::Stalls;
use super::stops::Stop;
use crate::histogram::Histogram;
use crate::mailbox::MailboxWriter;
use crate::rig::can_clock::CanClock;
use crate::rt::{MonotonicClock, RtOptions, configure_thread, sleep_ns, slow_motion};
use crate::session::SessionError;
use crate::session::world_report::WorldState;

/// Priority under `SCHED_FIFO`: below a control thread's.
const PRIORITY: u8 = 70;

/// The drives are looked after at least this often, ns.
const TURN_NS: u64 = 1_000_000;

/// When the master has spoken, its drives are looked after this part of its cycle later at the
/// latest.
///
/// A drive's answer must be on the wire within the cycle in which it was asked.
const SOON: u64 = 4;

/// Time from one look to the next at least, unless something comes, ns.
///
/// Keeps a bus full of frames from becoming a busy loop.
const WAIT_NS_MIN: u64 = 20_000;

/// Time between two looks for a page, ns of the drives.
const SEEN_NS: u64 = 50_000_000;

/// The longest time that passes for the drives at once, ns. What this thread was kept from its work
/// for beyond that does not pass for them at all: no real drive stands still because a computer is
/// busy.
const TURN_NS_MAX: u64 = 5_000_000;

/// What one instant of the world looks like.
///
/// Goes through a mailbox, so a slow first thread skips instants.
#[derive(Clone, Copy, Debug)]
pub(in crate::session) struct Shown {
    /// On the system's clock.
    pub(in crate::session) stamp: TimeNs,
    /// Policy steps of 40 ms in the drives' time.
    pub(in crate::session) sequence: u64,
    /// Phase, verdict and what scripted experts see.
    pub(in crate::session) world: WorldState,
    /// Poses of all bodies, for renderers.
    pub(in crate::session) snapshot: SceneSnapshot,
}

/// What there is to tell.
#[derive(Clone, Copy, Debug)]
pub(super) enum Notice {
    /// All drives are enabled for the first time, in the drives' time.
    Begun(TimeNs),
    /// A drive stopped following and its axis rests.
    Stopped(Stop),
    /// The fault at this place among those given has begun.
    Injected(usize),
    /// An error frame is to be sent on this line.
    BusOff(u8),
}

/// The thread before it runs.
pub(super) struct BusThread<'a> {
    /// The world that the drives move, if there is one.
    pub(super) simulation: Option<Simulation>,
    /// May have more arms than are used.
    pub(super) can: &'a CanConfig,
    /// How many of its arms there are.
    pub(super) arms: usize,
    /// Of nodes that are among these arms.
    pub(super) faults: &'a [InjectedFault],
    /// On all interfaces; the place of an interface is its line.
    pub(super) bus: SocketBus<CanClock>,
    /// How many interfaces there are.
    pub(super) lines: u8,
    /// Never written without a world.
    pub(super) shown: MailboxWriter<Shown>,
    /// To the first thread, in order.
    pub(super) notices: Producer<Notice>,
    /// For a page, if there is one.
    pub(super) seen: Option<MailboxWriter<Seen>>,
    /// Set by either side: the thread ends at its next turn, at most a millisecond later.
    pub(super) stop: &'a AtomicBool,
}

/// What it leaves behind.
pub(super) struct BusEnd {
    /// The drives' time at the end.
    pub(super) now: TimeNs,
    /// When the episode began, in it.
    pub(super) begun: Option<TimeNs>,
    /// Time that did not pass for the drives, ns.
    pub(super) stalled_ns: u64,
    /// How long a look at the buses and the world took.
    pub(super) turns: Histogram,
    /// How the world stands, if there is one.
    pub(super) world: Option<WorldState>,
    /// How busy each line was, ns, and with how many frames.
    pub(super) busy: Vec<(u64, u64)>,
    /// Frames that found no room.
    pub(super) lost: u64,
}

/// Hands on what the bench reports.
///
/// Turns the bench's reports into mailbox writes and notices, with the stalls that only this thread
/// knows.
struct Messenger {
    clock: MonotonicClock,
    shown: MailboxWriter<Shown>,
    notices: Producer<Notice>,
    stalls: Stalls,
    /// For a page, and when it last got something, in the drives' time.
    seen: Option<MailboxWriter<Seen>>,
    seen_at: TimeNs,
}

impl Messenger {
    /// Drops the notice if 256 wait already.
    fn notify(&mut self, what: Notice) {
        // Full only without a reader, to whom it could matter.
        let _gone = self.notices.push(what);
    }

    /// Hands on what `look` sees, if there is a page and it is time for it.
    fn show(&mut self, now: TimeNs, lost: u64, look: impl FnOnce() -> Seen) {
        if let Some(to) = &mut self.seen
            && now.since(self.seen_at) >= SEEN_NS
        {
            self.seen_at = now;
            to.put(Seen {
                stalled_ns: self.stalls.total_ns(),
                lost,
                ..look()
            });
        }
    }
}

impl Listener for Messenger {
    fn stopped(&mut self, stop: Stop) {
        let last_word = stop.sync.unwrap_or(stop.at).0;
        // A SYNC that came while this process stood still was received after it.
        let start = TimeNs(last_word.saturating_sub(TURN_NS_MAX));
        let stalled_ns = self.stalls.since(start);
        self.notify(Notice::Stopped(Stop { stalled_ns, ..stop }));
    }

    fn injected(&mut self, place: usize) {
        self.notify(Notice::Injected(place));
    }

    fn begun(&mut self, at: TimeNs) {
        self.notify(Notice::Begun(at));
    }

    fn step(&mut self, sequence: u64, world: &WorldState, simulation: &Simulation) {
        self.shown.put(Shown {
            stamp: self.clock.to_system(self.clock.now()),
            sequence,
            world: *world,
            snapshot: simulation.snapshot(),
        });
    }

    fn bus_off(&mut self, line: u8) {
        self.notify(Notice::BusOff(line));
    }
}

/// Held by this thread: when it ends for whatever reason, so does the process.
///
/// Also on a panic: the first thread would otherwise wait for a world that no longer turns.
pub(in crate::session) struct EndsAll<'a>(pub(in crate::session) &'a AtomicBool);

impl Drop for EndsAll<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

impl BusThread<'_> {
    /// Runs until it is stopped.
    ///
    /// A priority that is refused is no error. [`Histogram`] `turns` has the time of each look
    /// without the sleep.
    ///
    /// # Errors
    /// From the bench; the drives have then stopped, as if their power was cut.
    pub(super) fn run(self) -> Result<BusEnd, SessionError> {
        let _ends = EndsAll(self.stop);
        // Not strict: without it the drives are only less punctual.
        let _granted = configure_thread(&RtOptions {
            priority: Some(PRIORITY),
            cpu: None,
            lock_stack: false,
            strict: false,
        });
        let clock = MonotonicClock::new();
        let (mut bench, network) = Bench::new(self.simulation, (self.can, self.arms), self.faults)?;
        let mut station = Station::new(network, self.bus, self.lines);
        let mut messenger = Messenger {
            clock,
            shown: self.shown,
            notices: self.notices,
            stalls: Stalls::new(),
            seen: self.seen,
            seen_at: TimeNs(0),
        };
        let (mut last, mut now) = (clock.now(), TimeNs(0));
        let mut turns = Histogram::new();
        let mut failure = None;
        let cycle_ns = self.can.arms.iter().map(|arm| arm.plan.cycle_ns).min();
        let soon_ns = cycle_ns.unwrap_or(TICK_NS) / SOON;
        while !self.stop.load(Ordering::Acquire) && failure.is_none() {
            let wall = clock.now();
            let gap_ns = wall.since(last);
            let turn_ns = gap_ns.min(TURN_NS_MAX);
            last = wall;
            messenger.stalls.note(now, gap_ns - turn_ns);
            now = now.plus_ns(turn_ns);
            station.turn_until(now, TICK_NS, &mut |at, network| {
                if failure.is_none() {
                    failure = bench.step(at, network, &mut messenger).err();
                }
            });
            let (lost, network) = (station.lost(), station.network_mut());
            messenger.show(now, lost, || bench.seen(network, self.lines));
            // Their words leave together when the last of them has had its time on the wire.
            let next = match (network.silent_at(), network.has_pending_frames()) {
                (Some(at), _) => at,
                (None, true) => now.plus_ns(soon_ns),
                (None, false) => now.plus_ns(TURN_NS),
            };
            let wait_ns = next.since(now).clamp(WAIT_NS_MIN, TURN_NS);
            let spent_ns = clock.now().since(wall);
            turns.record(spent_ns);
            let left_ns = wait_ns.saturating_sub(spent_ns).max(WAIT_NS_MIN);
            let bus = station.bus_mut();
            if !bus.wait_for_frames(left_ns * slow_motion()) {
                // An interface in trouble would wake us again and again.
                sleep_ns(left_ns);
            }
        }
        if let Some(failure) = failure {
            return Err(failure);
        }
        let lost = station.lost();
        let network = station.network_mut();
        Ok(BusEnd {
            now: network.now(),
            begun: bench.begun(),
            stalled_ns: messenger.stalls.total_ns(),
            turns,
            world: bench.world(network),
            busy: Bench::busy(network, self.lines),
            lost,
        })
    }
}
