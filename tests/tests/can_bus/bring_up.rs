//! A run is interrupted while it brings its drives up: nothing has torque afterwards.

use socketcan::{CanDataFrame, CanFrame, EmbeddedFrame as _, Frame as _, Socket as _};
use trocar_canopen::cia402::Status;

use super::heard::{await_frame, receive};
use super::pair::{Pair, pass_ms};
use super::peer::alone;
use super::{bus, frame};

/// What a heartbeat says of a stopped node, and the NMT command that lets it answer.
const STOPPED: u8 = 0x04;
const ENTER_PRE_OPERATIONAL: u8 = 0x80;

/// A frame by which a stage of the bring-up is known.
type Stage = fn(&CanDataFrame) -> bool;

/// Reads who node 1 is.
fn identifies(frame: &CanDataFrame) -> bool {
    frame.raw_id() == 0x601 && frame.data()[..3] == [0x40, 0x18, 0x10]
}

/// Writes what node 4 is to be sent.
fn maps(frame: &CanDataFrame) -> bool {
    frame.raw_id() == 0x604 && frame.data()[1..3] == [0x00, 0x16]
}

/// Gives node 1 torque, first to find its reference.
fn enables(frame: &CanDataFrame) -> bool {
    frame.raw_id() == 0x201 && frame.data()[0] == 0x0F
}

/// Lets the last node go, which has found its reference.
fn lets_go(frame: &CanDataFrame) -> bool {
    frame.raw_id() == 0x207 && frame.data()[0] == 0x00
}

/// Whether the drive of `node` says that its motor has torque. A stopped node answers nobody before
/// it is pre-operational.
fn has_torque(node: u16) -> bool {
    let bus = bus();
    if receive(&bus, 0x700 + node).data() == [STOPPED] {
        let [_, low] = node.to_be_bytes();
        bus.write_frame(&frame(0x000, &[ENTER_PRE_OPERATIONAL, low]))
            .unwrap();
    }
    let read = frame(0x600 + node, &[0x40, 0x41, 0x60, 0, 0, 0, 0, 0]);
    bus.write_frame(&read).unwrap();
    let answer = receive(&bus, 0x580 + node);
    let word = u16::from_le_bytes([answer.data()[4], answer.data()[5]]);
    Status::parse(word).unwrap().state.has_torque()
}

fn assert_no_torque(stage: &str) {
    for _ in 0..2 {
        let torque: Vec<u16> = (1..=7).filter(|node| has_torque(*node)).collect();
        assert_eq!(torque, [0; 0], "{stage}");
        pass_ms(100);
    }
}

/// A run that is interrupted while it brings its drives up leaves them without torque.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn interrupted_bring_up_leaves_no_torque() {
    let _turn = alone();
    let pair = Pair::talking("can_impatient");
    let stages: [(&str, &str, Stage); 3] = [
        ("-INT", "identity", identifies),
        ("-TERM", "mapping", maps),
        ("-INT", "references", enables),
    ];
    for (signal, name, stage) in stages {
        let bus = bus();
        let run = pair.run("expert");
        await_frame(&bus, stage);
        run.signal(signal);
        let (code, said) = run.wait();
        assert_eq!(code, Some(1), "{name}: {said}");
        let why = "interrupted before the drives were enabled";
        assert!(said.contains(why), "{name}: {said}");
        assert_no_torque(name);
    }
}

/// A run that is interrupted while its drives are enabled leads them to rest and lets go.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn interrupted_enabling_leaves_no_torque() {
    let _turn = alone();
    let pair = Pair::start("can_impatient_late", &[], &[]);
    let bus = bus();
    let run = pair.run("expert");
    await_frame(&bus, lets_go);
    await_frame(&bus, enables);
    run.signal("-TERM");
    let (code, result) = run.end();
    assert_eq!(code, Some(1), "{result}");
    assert_eq!(result["reason"], "interrupted", "{result}");
    assert_no_torque("enabling");
    let drives = pair.end();
    assert_eq!(drives["success"], false, "{drives}");
}

/// Before the drives are enabled an interrupted run never enables one.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn interrupted_run_enables_no_drive() {
    let _turn = alone();
    let pair = Pair::talking("can_impatient_early");
    let bus = bus();
    let run = pair.run("noop");
    await_frame(&bus, maps);
    run.signal("-INT");
    let (code, said) = run.wait();
    assert_eq!(code, Some(1), "{said}");
    let heard = std::iter::from_fn(|| bus.read_frame_timeout(std::time::Duration::ZERO).ok());
    let enabling = heard.filter(|heard| matches!(heard, CanFrame::Data(frame) if enables(frame)));
    assert_eq!(enabling.count(), 0);
    let drives = pair.end();
    assert!(drives["begun_s"].is_null(), "{drives}");
    assert_eq!(drives["stops"].as_array().map(Vec::len), Some(0));
}
