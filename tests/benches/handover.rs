//! A camera frame from writer to reader: through shared memory against a copy of the same bytes through a pipe.

#![expect(
    clippy::expect_used,
    reason = "a bench can't go on without its subject"
)]

mod support;

use std::error::Error;
use std::io::{PipeWriter, Read, Write, pipe};
use std::sync::mpsc::{Receiver, channel};
use std::thread::{self, JoinHandle};

use criterion::Criterion;
use hal::{Intrinsics, Pose, TimeNs};
use trocar::histogram::Histogram;
use trocar::rt::MonotonicClock;
use trocar_topics::{CameraTopic, FrameHeader, FrameLoan, TopicNode};

const SIDE_PIXELS: u32 = 512;
/// Colour, depth and instance ids of one pixel.
const BYTES_PER_PIXEL: usize = 3 + 4 + 1;
const RUNS: u32 = 2_000;
/// What every instance id of a frame is, to see that it has arrived.
const MARK: u8 = 0xa5;

/// A reader in a thread of its own, and the times at which it had each frame.
struct Reader {
    frames: PipeWriter,
    arrivals: Receiver<TimeNs>,
    thread: JoinHandle<Vec<u8>>,
}

impl Reader {
    /// A reader of `size_bytes` a time from a pipe; `on_read` sees them before the time is taken.
    fn spawn(
        clock: MonotonicClock,
        size_bytes: usize,
        mut on_read: impl FnMut(&[u8]) + Send + 'static,
    ) -> Result<Self, Box<dyn Error>> {
        let (mut input, frames) = pipe()?;
        let (arrived, arrivals) = channel();
        let thread = thread::spawn(move || {
            let mut bytes = vec![0; size_bytes];
            while input.read_exact(&mut bytes).is_ok() {
                on_read(&bytes);
                if arrived.send(clock.now()).is_err() {
                    break;
                }
            }
            bytes
        });
        Ok(Self {
            frames,
            arrivals,
            thread,
        })
    }

    /// Writes `bytes` and gives the time at which the reader had them.
    fn send(&mut self, bytes: &[u8]) -> TimeNs {
        self.frames.write_all(bytes).expect("the pipe is open");
        self.arrivals.recv().expect("the reader lives")
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

/// Loan, send, newest, drop, in one thread.
fn topic(criterion: &mut Criterion, node: &TopicNode) -> Result<Histogram, Box<dyn Error>> {
    let clock = MonotonicClock::new();
    let header = header();
    let pixels = header.intrinsics.pixel_count();
    let publisher = CameraTopic::publisher(node, "near", pixels)?;
    let mut subscriber = CameraTopic::subscriber(node, "near")?;
    Ok(support::measure(
        criterion,
        "handover/iceoryx2",
        RUNS,
        || {
            let before = clock.now();
            let mut loan = publisher.loan(&header).expect("a buffer is free");
            mark(&mut loan);
            loan.send().expect("published");
            let view = subscriber
                .newest()
                .expect("received")
                .expect("there is one");
            assert_eq!(view.instance()[0], MARK, "the frame arrives");
            drop(view);
            clock.now().since(before)
        },
    ))
}

/// The same to another thread, which a byte in a pipe wakes.
fn topic_and_wake(
    criterion: &mut Criterion,
    node: &TopicNode,
) -> Result<Histogram, Box<dyn Error>> {
    let clock = MonotonicClock::new();
    let header = header();
    let pixels = header.intrinsics.pixel_count();
    let publisher = CameraTopic::publisher(node, "far", pixels)?;
    let mut subscriber = CameraTopic::subscriber(node, "far")?;
    let mut reader = Reader::spawn(clock, 1, move |_| {
        let view = subscriber
            .newest()
            .expect("received")
            .expect("there is one");
        assert_eq!(view.instance()[0], MARK, "the frame arrives");
    })?;
    let times = support::measure(
        criterion,
        "handover/iceoryx2, other thread woken",
        RUNS,
        || {
            let before = clock.now();
            let mut loan = publisher.loan(&header).expect("a buffer is free");
            mark(&mut loan);
            loan.send().expect("published");
            reader.send(&[1]).since(before)
        },
    );
    reader.finish();
    Ok(times)
}

/// All bytes of the frame through a pipe into the other thread's buffer.
fn through_pipe(criterion: &mut Criterion) -> Result<Histogram, Box<dyn Error>> {
    let clock = MonotonicClock::new();
    let frame = vec![MARK; header().intrinsics.pixel_count() * BYTES_PER_PIXEL];
    let mut reader = Reader::spawn(clock, frame.len(), |_| {})?;
    let times = support::measure(criterion, "handover/pipe", RUNS, || {
        let before = clock.now();
        reader.send(&frame).since(before)
    });
    if reader.finish() != frame {
        return Err("the pipe brought other bytes".into());
    }
    Ok(times)
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut criterion = support::criterion();
    let node = TopicNode::join(&format!("bench-{}", std::process::id()))?;
    let near = topic(&mut criterion, &node)?;
    let far = topic_and_wake(&mut criterion, &node)?;
    let pipe = through_pipe(&mut criterion)?;
    let us = |times: &Histogram| TimeNs(times.percentile(0.5)).seconds() * 1e6;
    for (name, times) in [("alone", &near), ("with the reader's wake-up", &far)] {
        let ratio = us(&pipe) / us(times);
        let figure = format!(
            "512x512 hand-over {name}: p50 {:.2} us, pipe {:.2} us, {ratio:.1} times cheaper",
            us(times),
            us(&pipe)
        );
        support::report(&figure, "at least 20 times cheaper", ratio / 20.0);
    }
    criterion.final_summary();
    Ok(())
}
