//! What the cameras show, on its way to the pages: the newest picture of each stream, older ones
//! are dropped.
//!
//! Who draws hands over planes ([`FrameTap`]) and goes on; a thread of its own compresses what some
//! page wants, once for all of them; each page then takes the newest picture when it has room for
//! one.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::body::Bytes;
use hal::{Intrinsics, Pose, TimeNs};
use tokio::sync::watch;

use super::drawn::{Drawn, Pixels, Plane, Stream};
use super::encode;
use super::path::Lenses;
use crate::rt::MonotonicClock;

/// Least time between two pictures of a stream, ns: 30 a second.
pub(crate) const BETWEEN_NS: u64 = 33_000_000;

/// A picture that is older than this has another clock than the run's, ns.
const AGE_NS_MAX: u64 = 10_000_000_000;

/// The planes of a frame, row-major from the top left.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FramePlanes<'a> {
    /// sRGB bytes, 3 a pixel.
    pub(crate) colour: &'a [u8],
    /// Metres; 0 where nothing was hit. Empty if it is not known.
    pub(crate) depth_m: &'a [f32],
    /// What was hit; 0 is nothing. Empty if it is not known.
    pub(crate) instance: &'a [u8],
}

/// A picture as pages get it.
#[derive(Clone, Debug)]
pub(super) struct Picture {
    /// Counts all pictures.
    pub(super) number: u64,
    /// The whole message.
    pub(super) message: Bytes,
}

/// Where pictures wait for pages.
#[derive(Debug)]
pub(super) struct Board {
    /// The streams that some page wants, a bit each.
    wanted: AtomicU64,
    drawn: Mutex<Waiting>,
    fresh: Condvar,
    newest: Mutex<BTreeMap<Stream, Picture>>,
    /// Where the cameras that were drawn last are.
    lenses: Mutex<Lenses>,
    /// The clock of the run that is shown, of which pictures have their time.
    clock: Mutex<Option<MonotonicClock>>,
    /// The number of the newest picture.
    changed: watch::Sender<u64>,
}

#[derive(Debug, Default)]
struct Waiting {
    drawn: BTreeMap<Stream, Drawn>,
    /// When the newest of each was taken.
    taken: BTreeMap<Stream, TimeNs>,
    closed: bool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Board {
    pub(super) fn new() -> Self {
        Self {
            wanted: AtomicU64::new(0),
            drawn: Mutex::default(),
            fresh: Condvar::new(),
            newest: Mutex::default(),
            lenses: Mutex::default(),
            clock: Mutex::default(),
            changed: watch::Sender::new(0),
        }
    }

    /// From now on these streams are wanted.
    pub(super) fn want(&self, streams: impl Iterator<Item = Stream>) {
        let bits = streams.fold(0, |bits, stream| bits | stream.bit());
        self.wanted.store(bits, Ordering::Relaxed);
    }

    pub(super) fn wants(&self, stream: Stream) -> bool {
        self.wanted.load(Ordering::Relaxed) & stream.bit() != 0
    }

    /// Hears of every new picture.
    pub(super) fn watch(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// The newest picture of one of `streams` that is newer than the one in `seen`; of several the
    /// one that was seen longest ago.
    pub(super) fn newer(
        &self,
        streams: &[Stream],
        seen: &BTreeMap<Stream, u64>,
    ) -> Option<(Stream, Picture)> {
        let newest = lock(&self.newest);
        let number = |stream: &Stream| seen.get(stream).copied().unwrap_or(0);
        let fresh = streams.iter().filter_map(|stream| {
            let picture = newest.get(stream)?;
            (picture.number > number(stream)).then_some((*stream, picture))
        });
        let next = fresh.min_by_key(|(stream, _)| number(stream));
        next.map(|(stream, picture)| (stream, picture.clone()))
    }

    /// The lenses of the cameras that pages look at, and where they are.
    pub(super) fn lenses(&self) -> Lenses {
        let mut lenses = lock(&self.lenses).clone();
        lenses.retain(|&camera, _| {
            Plane::ALL
                .iter()
                .any(|&plane| self.wants(Stream { camera, plane }))
        });
        lenses
    }

    /// From now on pictures have their time by `clock`.
    pub(super) fn follow(&self, clock: MonotonicClock) {
        *lock(&self.clock) = Some(clock);
    }

    /// How long ago the picture was taken whose time is `seconds`; none of a picture of no run.
    pub(super) fn age_ns(&self, seconds: f64) -> Option<u64> {
        let now = (*lock(&self.clock))?.now();
        let taken_ns = Duration::try_from_secs_f64(seconds).ok()?.as_nanos();
        let age_ns = now.since(TimeNs(u64::try_from(taken_ns).ok()?));
        (age_ns > 0 && age_ns < AGE_NS_MAX).then_some(age_ns)
    }

    /// Puts up a compressed picture, or where everything is.
    pub(super) fn put_up(&self, stream: Stream, message: Vec<u8>) {
        let message = Bytes::from(message);
        let mut newest = lock(&self.newest);
        let number = *self.changed.borrow() + 1;
        newest.insert(stream, Picture { number, message });
        self.changed.send_replace(number);
    }

    /// Compresses what comes until the board is closed.
    pub(super) fn compress(&self) {
        while let Some(drawn) = self.next_drawn() {
            if let Some(message) = encode::message(&drawn) {
                self.put_up(drawn.stream, message);
            }
        }
    }

    fn next_drawn(&self) -> Option<Drawn> {
        let mut waiting = lock(&self.drawn);
        loop {
            if waiting.closed {
                return None;
            }
            if let Some((_, drawn)) = waiting.drawn.pop_first() {
                return Some(drawn);
            }
            let woken = self.fresh.wait(waiting);
            waiting = woken.unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Ends the thread that compresses.
    pub(super) fn close(&self) {
        lock(&self.drawn).closed = true;
        self.fresh.notify_all();
    }
}

/// The end of whoever draws. It never waits for a page.
#[derive(Clone, Debug)]
pub(crate) struct FrameTap(pub(super) Arc<Board>);

impl FrameTap {
    /// Whether any page looks at the camera of this index.
    pub(crate) fn wants(&self, camera: usize) -> bool {
        u8::try_from(camera).is_ok_and(|camera| {
            let mut streams = Plane::ALL.into_iter().map(|plane| Stream { camera, plane });
            streams.any(|stream| self.0.wants(stream))
        })
    }

    /// Whether any page looks at any camera.
    pub(crate) fn wants_any(&self) -> bool {
        self.0.wanted.load(Ordering::Relaxed) != 0
    }

    /// Shows what is wanted of a frame that the camera with this `lens` took at `stamp` from there
    /// in the scene, unless the one before is younger than a thirtieth of a second.
    pub(crate) fn show(
        &self,
        camera: usize,
        stamp: TimeNs,
        (lens, camera_in_scene): (&Intrinsics, &Pose),
        planes: &FramePlanes<'_>,
    ) {
        let Ok(camera) = u8::try_from(camera) else {
            return;
        };
        lock(&self.0.lenses).insert(camera, (*lens, *camera_in_scene));
        for plane in Plane::ALL {
            let stream = Stream { camera, plane };
            if self.0.wants(stream) && self.is_due(stream, stamp) {
                let pixels = match plane {
                    Plane::Colour => Pixels::Colour(planes.colour.to_vec()),
                    Plane::Depth => Pixels::Depth(planes.depth_m.to_vec()),
                    Plane::Ids => Pixels::Ids(planes.instance.to_vec()),
                };
                let drawn = Drawn {
                    stream,
                    stamp,
                    width: lens.width,
                    height: lens.height,
                    pixels,
                };
                lock(&self.0.drawn).drawn.insert(stream, drawn);
                self.0.fresh.notify_one();
            }
        }
    }

    fn is_due(&self, stream: Stream, stamp: TimeNs) -> bool {
        let mut waiting = lock(&self.0.drawn);
        let before = waiting.taken.get(&stream);
        let due = before.is_none_or(|before| stamp.since(*before) >= BETWEEN_NS || stamp < *before);
        if due {
            waiting.taken.insert(stream, stamp);
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLOUR: Stream = Stream {
        camera: 0,
        plane: Plane::Colour,
    };

    fn shown(tap: &FrameTap, ms: u64) {
        let lens = Intrinsics::from_vertical_fov(8, 8, 1.0);
        let planes = FramePlanes {
            colour: &[100; 192],
            depth_m: &[0.1; 64],
            instance: &[1; 64],
        };
        let seen_from = (&lens, &Pose::identity());
        tap.show(0, TimeNs(ms * 1_000_000), seen_from, &planes);
    }

    /// A page that is slow sees the newest picture, and none of those before it.
    #[test]
    fn the_newest_picture_wins() {
        let board = Arc::new(Board::new());
        let tap = FrameTap(Arc::clone(&board));
        shown(&tap, 0);
        assert!(lock(&board.drawn).drawn.is_empty(), "nobody looks");
        board.want([COLOUR].into_iter());
        assert!(tap.wants(0) && !tap.wants(1) && tap.wants_any());
        for round in 0..50 {
            shown(&tap, 40 * round);
        }
        let drawn = board.next_drawn().unwrap();
        assert_eq!(drawn.stamp, TimeNs(49 * 40_000_000));
        assert!(lock(&board.drawn).drawn.is_empty());
        for _ in 0..3 {
            board.put_up(COLOUR, encode::message(&drawn).unwrap());
        }
        let mut seen = BTreeMap::new();
        let (stream, picture) = board.newer(&[COLOUR], &seen).unwrap();
        assert_eq!(picture.number, 3);
        seen.insert(stream, picture.number);
        assert!(board.newer(&[COLOUR], &seen).is_none());
    }

    #[test]
    fn there_are_at_most_thirty_a_second() {
        let board = Arc::new(Board::new());
        let tap = FrameTap(Arc::clone(&board));
        board.want([COLOUR].into_iter());
        let mut shows = 0;
        for ms in 0..1000 {
            shown(&tap, ms);
            shows += lock(&board.drawn).drawn.len();
            lock(&board.drawn).drawn.clear();
        }
        assert!((25..=31).contains(&shows), "{shows}");
    }

    /// Of several streams the one comes next that was seen longest ago.
    #[test]
    fn no_stream_waits_for_ever() {
        let board = Board::new();
        let other = Stream {
            camera: 1,
            plane: Plane::Ids,
        };
        let mut seen = BTreeMap::new();
        let mut order = Vec::new();
        for _ in 0..4 {
            board.put_up(COLOUR, vec![0]);
            board.put_up(other, vec![0]);
            let (stream, picture) = board.newer(&[COLOUR, other], &seen).unwrap();
            seen.insert(stream, picture.number);
            order.push(stream);
        }
        assert_eq!(order, [COLOUR, other, COLOUR, other]);
    }

    #[test]
    fn every_camera_has_bits_of_its_own() {
        let streams = (0..=255).flat_map(|camera| Plane::ALL.map(|plane| Stream { camera, plane }));
        let bits: Vec<u64> = streams.map(Stream::bit).filter(|bit| *bit != 0).collect();
        assert_eq!(bits.len(), 64);
        assert_eq!(bits.iter().fold(0, |all, bit| all | bit).count_ones(), 64);
    }

    #[test]
    fn pictures_have_an_age_by_the_clock_of_their_run() {
        let board = Board::new();
        assert_eq!(board.age_ns(0.0), None, "no run");
        let clock = MonotonicClock::new();
        board.follow(clock);
        clock.wait_until(TimeNs(2_000_000));
        let age_ns = board.age_ns(0.001).unwrap();
        assert!((1_000_000..=clock.now().0).contains(&age_ns), "{age_ns}");
        for seconds in [1e6, 1e300, -1.0, f64::NAN] {
            assert_eq!(board.age_ns(seconds), None, "{seconds}");
        }
    }

    #[test]
    fn a_closed_board_ends_its_thread() {
        let board = Arc::new(Board::new());
        let thread = std::thread::spawn({
            let board = Arc::clone(&board);
            move || board.compress()
        });
        board.close();
        thread.join().unwrap();
    }
}
