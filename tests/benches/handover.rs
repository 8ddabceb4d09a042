//! A camera frame from writer to readers: through shared memory against a copy of the same bytes
//! through a pipe and a Unix socket.

#![expect(
    clippy::expect_used,
    reason = "a bench can't go on without its subject"
)]

mod support;

use std::error::Error;
use std::io::{self, Read, Write, pipe};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::thread::{self, JoinHandle};

use criterion::Criterion;
use hal::{Intrinsics, Pose, TimeNs};
use trocar::histogram::Histogram;
use trocar::rt::MonotonicClock;
use trocar_topics::{CameraTopic, FrameHeader, FrameLoan, FrameSubscriber, TopicNode};

const SIDE_PIXELS: u32 = 512;
/// Colour, depth and instance ids of one pixel.
const BYTES_PER_PIXEL: usize = 3 + 4 + 1;
const RUNS: u32 = 2_000;
/// What every instance id of a frame is, to see that it has arrived.
const MARK: u8 = 0xa5;

/// A reader in a thread of its own, and the times at which it had each frame.
struct Reader {
    frames: Box<dyn Write>,
    arrivals: Receiver<TimeNs>,
    thread: JoinHandle<Vec<u8>>,
}

impl Reader {
    /// A reader of `size_bytes` a time from `input`, which `frames` leads to.
    fn spawn(
        clock: MonotonicClock,
        size_bytes: usize,
        (mut input, frames): (impl Read + Send + 'static, impl Write + 'static),
    ) -> Self {
        let (arrived, arrivals) = channel();
        let thread = thread::spawn(move || {
            let mut bytes = vec![0; size_bytes];
            while input.read_exact(&mut bytes).is_ok() {
                if arrived.send(clock.now()).is_err() {
                    break;
                }
            }
            bytes
        });
        Self {
            frames: Box::new(frames),
            arrivals,
            thread,
        }
    }

    /// Writes `bytes`; the reader may have them any time.
    fn send(&mut self, bytes: &[u8]) {
        self.frames.write_all(bytes).expect("the way is open");
    }

    /// What the reader has read last.
    fn finish(self) -> Vec<u8> {
        drop(self.frames);
        self.thread.join().expect("the reader does not panic")
    }
}

fn header() -> FrameHeader {
    let intrinsics = Intrinsics::from_vertical_fov(SIDE_PIXELS, SIDE_PIXELS, 0.62);
    FrameHeader::new(TimeNs(0), 1, intrinsics, &Pose::identity())
}

/// Marks the frame, so that the reader can tell; the renderer would fill it here.
fn mark(loan: &mut FrameLoan) {
    let (_, _, instance) = loan.planes();
    instance[0] = MARK;
}

/// Loan, send, newest of each reader, drop, in one thread.
fn topic(
    criterion: &mut Criterion,
    node: &TopicNode,
    readers: usize,
) -> Result<Histogram, Box<dyn Error>> {
    let clock = MonotonicClock::new();
    let header = header();
    let pixels = header.intrinsics.pixel_count();
    let camera = format!("near_{readers}");
    let publisher = CameraTopic::publisher(node, &camera, pixels)?;
    let subscribers = (0..readers).map(|_| CameraTopic::subscriber(node, &camera));
    let mut subscribers: Vec<_> = subscribers.collect::<Result<_, _>>()?;
    Ok(support::measure(
        criterion,
        &format!("handover/iceoryx2, readers {readers}"),
        RUNS,
        || {
            let before = clock.now();
            let mut loan = publisher.loan(&header).expect("a buffer is free");
            mark(&mut loan);
            loan.send().expect("published");
            for subscriber in &mut subscribers {
                expect_a_frame(subscriber);
            }
            clock.now().since(before)
        },
    ))
}

fn expect_a_frame(subscriber: &mut FrameSubscriber) {
    let newest = subscriber.newest().expect("received");
    let view = newest.expect("there is one");
    assert_eq!(view.instance()[0], MARK, "the frame arrives");
}

/// A thread that sleeps on the run's events, and the times at which it had each frame.
struct Woken {
    arrivals: Receiver<TimeNs>,
    thread: JoinHandle<()>,
}

/// Nobody sleeps for longer without looking whether it is over.
const LOOK_NS: u64 = 100_000_000;

impl Woken {
    fn spawn(
        node: &TopicNode,
        camera: &str,
        clock: MonotonicClock,
        over: &Arc<AtomicBool>,
    ) -> Result<Self, Box<dyn Error>> {
        let (events, over) = (node.events()?, Arc::clone(over));
        let mut frames = CameraTopic::subscriber(node, camera)?;
        let (arrived, arrivals) = channel();
        let thread = thread::spawn(move || {
            while !over.load(Ordering::Acquire) {
                events.wait(LOOK_NS);
                if let Some(view) = frames.newest().expect("received") {
                    assert_eq!(view.instance()[0], MARK, "the frame arrives");
                    let _over = arrived.send(clock.now());
                }
            }
        });
        Ok(Self { arrivals, thread })
    }
}

/// The same to other threads, which the publisher wakes; until the last of them has it.
fn topic_and_wake(
    criterion: &mut Criterion,
    node: &TopicNode,
    readers: usize,
) -> Result<Histogram, Box<dyn Error>> {
    let clock = MonotonicClock::new();
    let header = header();
    let pixels = header.intrinsics.pixel_count();
    let camera = format!("far_{readers}");
    let publisher = CameraTopic::publisher(node, &camera, pixels)?;
    let over = Arc::new(AtomicBool::new(false));
    let woken = (0..readers).map(|_| Woken::spawn(node, &camera, clock, &over));
    let woken = woken.collect::<Result<Vec<_>, _>>()?;
    let times = support::measure(
        criterion,
        &format!("handover/iceoryx2, other threads woken {readers}"),
        RUNS,
        || {
            let before = clock.now();
            let mut loan = publisher.loan(&header).expect("a buffer is free");
            mark(&mut loan);
            loan.send().expect("published");
            last_of(woken.iter().map(|reader| &reader.arrivals), before)
        },
    );
    over.store(true, Ordering::Release);
    for reader in woken {
        reader.thread.join().expect("the reader does not panic");
    }
    Ok(times)
}

/// The time from `before` until every reader has what it was sent, ns.
fn last_of<'a>(arrivals: impl Iterator<Item = &'a Receiver<TimeNs>>, before: TimeNs) -> u64 {
    let had = arrivals.map(|arrivals| arrivals.recv().expect("the reader lives"));
    had.map(|had| had.since(before)).max().unwrap_or(0)
}

/// All bytes of the frame into the buffers of other threads, each on a way of its own; until the
/// last of them has it.
fn through<I: Read + Send + 'static, O: Write + 'static>(
    criterion: &mut Criterion,
    (name, readers): (&str, usize),
    way: impl Fn() -> io::Result<(I, O)>,
) -> Result<Histogram, Box<dyn Error>> {
    let clock = MonotonicClock::new();
    let frame = vec![MARK; header().intrinsics.pixel_count() * BYTES_PER_PIXEL];
    let mut reading = Vec::with_capacity(readers);
    for _ in 0..readers {
        reading.push(Reader::spawn(clock, frame.len(), way()?));
    }
    let name = format!("handover/{name}, readers {readers}");
    let times = support::measure(criterion, &name, RUNS, || {
        let before = clock.now();
        reading.iter_mut().for_each(|reader| reader.send(&frame));
        last_of(reading.iter().map(|reader| &reader.arrivals), before)
    });
    if reading.into_iter().any(|reader| reader.finish() != frame) {
        return Err(format!("{name} brought other bytes").into());
    }
    Ok(times)
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut criterion = support::criterion();
    let node = TopicNode::join(&format!("bench-{}", std::process::id()))?;
    let us = |times: &Histogram, share| TimeNs(times.percentile(share)).seconds() * 1e6;
    for readers in [1, 2] {
        let near = topic(&mut criterion, &node, readers)?;
        let far = topic_and_wake(&mut criterion, &node, readers)?;
        let pipe = through(&mut criterion, ("pipe", readers), pipe)?;
        let socket = through(&mut criterion, ("socket", readers), UnixStream::pair)?;
        for (name, times) in [("alone", &near), ("with the wake-up", &far)] {
            let ours = us(times, 0.5);
            let ratio = us(&pipe, 0.5).min(us(&socket, 0.5)) / ours;
            let figure = format!(
                "512x512 hand-over {name}, {readers} readers: p50 {ours:.2} us, p99 {:.2} us; pipe {:.0} us, socket {:.0} us; {ratio:.1} times cheaper",
                us(times, 0.99),
                us(&pipe, 0.5),
                us(&socket, 0.5)
            );
            support::report(&figure, "at least 20 times cheaper", ratio / 20.0);
        }
    }
    criterion.final_summary();
    Ok(())
}
