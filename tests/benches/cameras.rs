//! Eight cameras at 60 Hz with two readers each: frames that a reader missed, how late they came,
//! and whether memory grows.
//!
//! Runs for 5 s, or as long as `TROCAR_CAMERAS_S` says, s.

#![expect(
    clippy::expect_used,
    reason = "a bench can't go on without its subject"
)]

use std::error::Error;
use std::fs;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use hal::{Intrinsics, Pose, TimeNs};
use trocar::histogram::Histogram;
use trocar::rt::{MonotonicClock, Periodic, RtOptions, configure_thread, sleep_ns};
use trocar_topics::{CameraTopic, FrameHeader, FramePublisher, FrameSubscriber, TopicNode};

const CAMERAS: usize = 8;
const READERS: usize = 2;
const SIDE_PIXELS: u32 = 512;
const PERIOD_NS: u64 = 1_000_000_000 / 60;
const SECONDS: u64 = 5;
/// Periods until every buffer has been used once.
const WARM_UP: u64 = 30;
/// What is no growth: a few pages of whoever else is in the process.
const GROWTH_MAX_KIB: i64 = 256;

/// What a reader has seen of all cameras.
struct Seen {
    frames: u64,
    missed: u64,
    /// From the frame's stamp, which is taken before it is filled.
    late: Histogram,
}

/// Under `SCHED_FIFO` where the system grants it, so that a busy machine counts less.
fn punctual(priority: u8) {
    let options = RtOptions {
        priority: Some(priority),
        cpu: None,
        lock_stack: false,
        strict: false,
    };
    let _report = configure_thread(&options);
}

/// Looks at all cameras every half a millisecond until `over`.
fn read(mut cameras: Vec<FrameSubscriber>, clock: MonotonicClock, over: &AtomicBool) -> Seen {
    punctual(20);
    let mut last = vec![0; cameras.len()];
    let (mut frames, mut missed, mut late) = (0, 0, Histogram::new());
    while !over.load(Ordering::Acquire) {
        for (camera, last) in cameras.iter_mut().zip(&mut last) {
            let Some(view) = camera.newest().expect("received") else {
                continue;
            };
            let header = view.header();
            let mark = header.sequence.to_le_bytes()[0];
            assert!(view.instance().first() == Some(&mark) && view.colour().last() == Some(&mark));
            late.record(clock.now().since(header.stamp));
            missed += header.sequence - *last - 1;
            *last = header.sequence;
            frames += 1;
        }
        sleep_ns(500_000);
    }
    Seen {
        frames,
        missed,
        late,
    }
}

/// Fills and publishes a frame of each camera.
fn publish(cameras: &mut [FramePublisher], sequence: u64, clock: MonotonicClock) {
    let intrinsics = Intrinsics::from_vertical_fov(SIDE_PIXELS, SIDE_PIXELS, 0.62);
    let mark = sequence.to_le_bytes()[0];
    for camera in cameras {
        let header = FrameHeader::new(clock.now(), sequence, intrinsics, &Pose::identity());
        let fill = |colour: &mut [u8], depth_m: &mut [f32], instance: &mut [u8]| {
            colour.fill(mark);
            depth_m.fill(0.1);
            instance.fill(mark);
        };
        camera.publish_with(&header, fill).expect("published");
    }
}

/// Memory of this process that is in memory, KiB; what it shares counts.
fn resident_kib() -> i64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let number = line.and_then(|line| line.split_whitespace().next());
    number.and_then(|kib| kib.parse().ok()).unwrap_or(0)
}

/// How many periods there were, how many were skipped, and by how much memory grew, KiB.
fn write(mut cameras: Vec<FramePublisher>, seconds: u64, clock: MonotonicClock) -> (u64, u64, i64) {
    punctual(30);
    let begin = clock.now().plus_ns(PERIOD_NS);
    let mut periodic = Periodic::new(clock, begin, PERIOD_NS);
    let (mut skipped, mut warm_kib) = (0, 0);
    let periods = (seconds * 1_000_000_000 / PERIOD_NS).max(2 * WARM_UP);
    for sequence in 1..=periods {
        skipped += periodic.wait().skipped;
        publish(&mut cameras, sequence, clock);
        if sequence == WARM_UP {
            warm_kib = resident_kib();
        }
    }
    let grown_kib = resident_kib() - warm_kib;
    // The last frames are read too.
    sleep_ns(20_000_000);
    (periods, skipped, grown_kib)
}

const fn verdict(met: bool) -> &'static str {
    if met { "met" } else { "MISSED" }
}

#[expect(clippy::print_stdout, reason = "a bench tells a person")]
fn main() -> Result<(), Box<dyn Error>> {
    let seconds = std::env::var("TROCAR_CAMERAS_S").map_or(Ok(SECONDS), |text| text.parse())?;
    let node = TopicNode::join(&format!("bench-{}", std::process::id()))?;
    let pixels = Intrinsics::from_vertical_fov(SIDE_PIXELS, SIDE_PIXELS, 0.62).pixel_count();
    let names: Vec<String> = (0..CAMERAS)
        .map(|index| format!("camera_{index}"))
        .collect();
    let publishers = names
        .iter()
        .map(|name| CameraTopic::publisher(&node, name, pixels));
    let publishers: Vec<_> = publishers.collect::<Result<_, _>>()?;
    let mut readers = Vec::with_capacity(READERS);
    for _ in 0..READERS {
        let cameras = names
            .iter()
            .map(|name| CameraTopic::subscriber(&node, name));
        readers.push(cameras.collect::<Result<Vec<_>, _>>()?);
    }
    let (clock, over) = (MonotonicClock::new(), AtomicBool::new(false));
    let ((periods, skipped, grown_kib), seen) = thread::scope(|scope| {
        let reading = readers
            .into_iter()
            .map(|cameras| scope.spawn(|| read(cameras, clock, &over)));
        let reading: Vec<_> = reading.collect();
        let written = write(publishers, seconds, clock);
        over.store(true, Ordering::Release);
        let seen = reading
            .into_iter()
            .map(|reader| reader.join().expect("no panic"));
        (written, seen.collect::<Vec<Seen>>())
    });
    println!("{CAMERAS} cameras, {periods} frames each at 60 Hz, {skipped} periods skipped");
    for (reader, seen) in seen.iter().enumerate() {
        let us = |share| TimeNs(seen.late.percentile(share)).seconds() * 1e6;
        println!(
            "reader {reader}: {} frames, {} missed; late by p50 {:.0} us, p99 {:.0} us",
            seen.frames,
            seen.missed,
            us(0.5),
            us(0.99)
        );
    }
    let all = periods * CAMERAS as u64;
    let whole = |seen: &Seen| seen.missed == 0 && seen.frames == all;
    println!("no frame missed: {}", verdict(seen.iter().all(whole)));
    let steady = verdict(grown_kib <= GROWTH_MAX_KIB);
    println!("memory grew by {grown_kib} KiB, at most {GROWTH_MAX_KIB}: {steady}");
    Ok(())
}
