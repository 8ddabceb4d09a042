//! A camera of one's own: publishes frames on the topics of a run, where `trocar run --safety FILE
//! --topics NAME` looks for them.
//!
//! ```sh
//! cargo run --release -p trocar --example own_camera -- cameras endoscope 512
//! ```
//!
//! Or where a robot of one's own does (`own_robot.rs`). The number is the width and height in
//! pixels.
//!
//! This one draws a bar that moves to the right; a real one would copy what its driver hands it, or
//! have the driver write in place ([`FramePublisher::loan`](trocar_topics::FramePublisher::loan)).
//! A frame is of the size that the policy was trained with, and its stamp is the time of its
//! exposure on `CLOCK_MONOTONIC`: frames that are older than 0.5 s, or further ahead than 40 ms,
//! are refused.

use hal::{Intrinsics, Pose, TICK_NS};
use trocar::rt::{self, MonotonicClock, Periodic};
use trocar_topics::{CameraTopic, FrameHeader, TopicError, TopicNode};

/// Vertical field of view, rad.
const VIEW_RAD: f64 = 0.9;

/// Time between two frames, ns: 25 a second.
const FRAME_NS: u64 = 40 * TICK_NS;

/// Distance of everything that is seen, m.
const DEPTH_M: f32 = 0.1;

/// Publishes frames of `side` by `side` pixels of the camera `name` on `topics`, until `ends` says
/// so of their number or a signal comes; gives how many it published.
///
/// # Errors
/// [`TopicError`]: no shared memory, or another publisher of this camera.
pub fn run(
    topics: &str,
    name: &str,
    side: u32,
    ends: impl Fn(u64) -> bool,
) -> Result<u64, TopicError> {
    let node = TopicNode::join(topics)?;
    let lens = Intrinsics::from_vertical_fov(side, side, VIEW_RAD);
    let mut camera = CameraTopic::publisher(&node, name, lens.pixel_count())?;
    let clock = MonotonicClock::new();
    let mut periodic = Periodic::new(clock, clock.now().plus_ns(FRAME_NS), FRAME_NS);
    let mut sequence = 0;
    while !ends(sequence) && !rt::interrupted() {
        let exposed = clock.to_system(clock.now());
        let header = FrameHeader::new(exposed, sequence, lens, &Pose::identity());
        camera.publish_with(&header, |colour, depth_m, instance| {
            draw(sequence, side, colour);
            depth_m.fill(DEPTH_M);
            instance.fill(0);
        })?;
        sequence += 1;
        periodic.wait();
    }
    Ok(sequence)
}

/// A white bar on grey, one pixel further to the right with each frame.
fn draw(sequence: u64, side: u32, colour: &mut [u8]) {
    let width = u64::from(side);
    let columns = (0..width).cycle();
    for (pixel, column) in colour.chunks_exact_mut(3).zip(columns) {
        let bar = (column + width - sequence % width) % width < 16;
        pixel.fill(if bar { 255 } else { 96 });
    }
}

#[expect(clippy::print_stdout, reason = "an example tells what it does")]
fn main() -> Result<(), Box<dyn core::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let topics = arguments.next().unwrap_or_else(|| "cameras".to_owned());
    let name = arguments.next().unwrap_or_else(|| "endoscope".to_owned());
    let side: u32 = match arguments.next() {
        Some(side) => side.parse()?,
        None => 256,
    };
    rt::catch_interrupts()?;
    println!("camera {name} on topics {topics}, 25 frames a second, until Ctrl-C");
    let frames = run(&topics, &name, side, |_| false)?;
    println!("{frames} frames");
    Ok(())
}
