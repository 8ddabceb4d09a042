//! The end of a run: what the drives are told until none has torque, whatever the operator does
//! meanwhile.

use std::fs;
use std::path::Path;

use socketcan::{EmbeddedFrame as _, Frame as _};
use tests::scratch;

use super::bus;
use super::heard::await_frame;
use super::pair::{Pair, pass_ms};
use super::peer::{Peer, alone};

/// Cycles of 2 ms for which drives with a brake stay supplied.
const BRAKE_CYCLES: usize = 1000;

/// The first two bytes of each frame `id` in a candump log, as a number, in order.
fn words(log: &str, id: &str) -> Vec<u16> {
    let frames = log.lines().filter_map(|line| line.split(' ').nth(2));
    let data = frames.filter_map(|frame| frame.strip_prefix(id)?.strip_prefix('#'));
    let word = |text: &str| u16::from_str_radix(text.get(..4)?, 16).ok();
    data.filter_map(word).map(u16::swap_bytes).collect()
}

/// Control words without repetitions, each with how often it was sent.
fn told(log: &str, node: u16) -> Vec<(u16, usize)> {
    let mut told: Vec<(u16, usize)> = Vec::new();
    for word in words(log, &format!("{:03X}", 0x200 + node)) {
        match told.last_mut() {
            Some((last, count)) if *last == word => *count += 1,
            _ => told.push((word, 1)),
        }
    }
    told
}

/// The drives of nodes 1 to 7 were taken down state by state, and the last that each said is that
/// it is switch-on disabled.
fn assert_taken_down(capture: &Path) {
    let log = fs::read_to_string(capture).unwrap();
    for node in 1..=7 {
        let told = told(&log, node);
        let end: Vec<u16> = told.iter().rev().take(4).map(|(word, _)| *word).collect();
        assert_eq!(
            end,
            [0x0000, 0x0006, 0x0007, 0x000F],
            "node {node}: {told:?}"
        );
        let (_, held) = told[told.len() - 3];
        // A SYNC that a busy machine misses is not made up for.
        assert!(2 * held > BRAKE_CYCLES, "node {node}: {told:?}");
        let status = words(&log, &format!("{:03X}", 0x180 + node)).pop().unwrap();
        assert_eq!(status & 0x4F, 0x40, "node {node}: {status:04X}h");
    }
}

/// A second interrupt while drives are taken down leaves out no state.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn second_interrupt_skips_no_state_of_take_down() {
    let _turn = alone();
    let capture = scratch("can_take_down").join("capture.log");
    let pair_changes = [("brake_ms = 0", "brake_ms = 2000")];
    let mut pair = Pair::start("can_take_down_pair", &pair_changes, &[]);
    let run = pair.run("noop");
    pair.drives.await_word("the episode begins");
    let dump = Peer::logging(&capture);
    pass_ms(200);
    run.signal("-INT");
    pass_ms(700);
    // While the brakes close, for which there is more time than for all before.
    let bus = bus();
    await_frame(&bus, |frame| {
        frame.raw_id() == 0x201 && frame.data()[..2] == [0x07, 0x00]
    });
    run.signal("-INT");
    let (code, run) = run.end();
    dump.stop();
    assert_eq!(code, Some(1), "{run}");
    assert_eq!(run["reason"], "interrupted", "{run}");
    let arm = &run["can"]["arms"][0];
    assert!(arm["fault"].is_null(), "{run}");
    assert_eq!(arm["confirmed_down"], true, "{run}");
    assert_taken_down(&capture);
    let drives = pair.end();
    let stops = drives["stops"].as_array().unwrap();
    assert_eq!(stops.len(), 7, "{drives}");
    for stop in stops {
        assert_eq!(stop["cause"], "its master switched it off", "{stop}");
    }
}
