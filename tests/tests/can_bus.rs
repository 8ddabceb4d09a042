//! A real CAN bus: the kernel's CAN sockets, can-utils, python canopen and Wireshark's dissector,
//! on virtual interfaces.
//!
//! `make test-can` runs these where the interfaces are, which is why a plain `cargo test` leaves
//! them out; see `.ci/with-vcan`.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "in a test, a failure to set up is a failure"
)]

#[path = "can_bus/batch.rs"]
mod batch;
#[path = "can_bus/bring_up.rs"]
mod bring_up;
#[path = "can_bus/drives.rs"]
mod drives;
#[path = "can_bus/faults.rs"]
mod faults;
#[path = "can_bus/heard.rs"]
mod heard;
#[expect(dead_code, reason = "over CAN fewer faults are injected")]
#[path = "faults/matrix.rs"]
mod matrix;
#[path = "can_bus/page.rs"]
mod page;
#[path = "can_bus/pair.rs"]
mod pair;
#[path = "can_bus/peer.rs"]
mod peer;
#[expect(dead_code, reason = "over CAN it does not misbehave")]
#[path = "faults/performer.rs"]
mod performer;
#[path = "can_bus/process.rs"]
mod process;
#[path = "can_bus/robot.rs"]
mod robot;
#[path = "can_bus/take_down.rs"]
mod take_down;

use std::process::Command;
use std::time::Duration;

use socketcan::id::ERR_MASK_ALL;
use socketcan::{
    CanFrame, CanSocket, EmbeddedFrame as _, Frame as _, Socket as _, SocketOptions as _,
    StandardId,
};
use tests::{repository, scratch};

use heard::receive;
use peer::{Peer, alone, said};

/// Anything takes less time than this: it is how long a test waits for what never comes.
const PATIENCE: Duration = Duration::from_secs(240);

fn bus() -> CanSocket {
    CanSocket::open("vcan0").unwrap()
}

fn frame(id: u16, data: &[u8]) -> CanFrame {
    CanFrame::new(StandardId::new(id).unwrap(), data).unwrap()
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn frames_pass_between_two_sockets_in_order() {
    let _turn = alone();
    let (sender, receiver) = (bus(), bus());
    for count in 0..100 {
        sender.write_frame(&frame(0x123, &[count, 0, 255])).unwrap();
    }
    for count in 0..100 {
        assert_eq!(receive(&receiver, 0x123).data(), [count, 0, 255]);
    }
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn buses_are_apart() {
    let _turn = alone();
    let first = bus();
    let others = ["vcan1", "vcan2"].map(|name| CanSocket::open(name).unwrap());
    for (id, other) in (0x201..).zip(&others) {
        other.write_frame(&frame(id, &[1])).unwrap();
    }
    bus().write_frame(&frame(0x203, &[2])).unwrap();
    // Nothing came before it.
    let heard = first.read_frame_timeout(PATIENCE).unwrap();
    assert_eq!(heard.raw_id(), 0x203);
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn candump_prints_what_we_send() {
    let _turn = alone();
    // It ends after two frames.
    let dump = Peer::listening("candump", &["-L", "-n", "2", "vcan0"]);
    let bus = bus();
    bus.write_frame(&frame(0x080, &[])).unwrap();
    bus.write_frame(&frame(0x605, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]))
        .unwrap();
    let printed = dump.finish();
    let frames: Vec<_> = printed
        .lines()
        .filter_map(|line| line.split(' ').nth(2))
        .collect();
    assert_eq!(frames, ["080#", "605#4000100000000000"]);
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn we_receive_what_cansend_sends() {
    let _turn = alone();
    let bus = bus();
    let sent = Command::new("cansend")
        .args(["vcan0", "185#37020001FFFF"])
        .status()
        .unwrap();
    assert!(sent.success());
    assert_eq!(receive(&bus, 0x185).data(), [0x37, 2, 0, 1, 0xFF, 0xFF]);
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn an_injected_bus_off_reaches_only_those_who_asked_for_errors() {
    let _turn = alone();
    let (deaf, alert) = (bus(), bus());
    alert.set_error_filter(ERR_MASK_ALL).unwrap();
    let sent = Command::new("cansend")
        .args(["vcan0", "20000040#0000000000000000"])
        .status()
        .unwrap();
    assert!(sent.success());
    let CanFrame::Error(error) = alert.read_frame_timeout(PATIENCE).unwrap() else {
        panic!("an error frame was sent");
    };
    assert!(error.into_error().is_bus_off(), "class 40h is bus-off");
    bus().write_frame(&frame(0x7FF, &[])).unwrap();
    assert_eq!(deaf.read_frame_timeout(PATIENCE).unwrap().raw_id(), 0x7FF);
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn a_python_node_answers_sdo_requests_in_raw_frames() {
    let _turn = alone();
    let drive = Peer::drives("5");
    let bus = bus();
    let exchange = |request: [u8; 8]| {
        bus.write_frame(&frame(0x605, &request)).unwrap();
        receive(&bus, 0x585).data().to_vec()
    };
    assert_eq!(
        exchange([0x40, 0x00, 0x10, 0, 0, 0, 0, 0]),
        [0x43, 0x00, 0x10, 0, 0x92, 0x01, 0x02, 0x00],
        "device type 1000h is 00020192h, expedited"
    );
    assert_eq!(
        exchange([0x2B, 0x17, 0x10, 0, 0xE8, 0x03, 0, 0]),
        [0x60, 0x17, 0x10, 0, 0, 0, 0, 0],
        "the heartbeat time 1017h may be written"
    );
    assert_eq!(
        exchange([0x40, 0xFF, 0x5F, 0, 0, 0, 0, 0]),
        [0x80, 0xFF, 0x5F, 0, 0x00, 0x00, 0x02, 0x06],
        "there is no 5FFFh"
    );
    drive.stop();
}

/// A Python master and Python drives agree and Wireshark understands them.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn python_master_and_python_drives_agree() {
    let _turn = alone();
    let capture = scratch("can_bus").join("capture.log");
    let dump = Peer::logging(&capture);
    let drives = Peer::drives("1,2");
    let master = Command::new("python3")
        .arg(repository().join("tests/can/master.py"))
        .arg("--eds")
        .arg(repository().join("tests/can/peer_drive.eds"))
        .args(["--nodes", "1,2"])
        .output()
        .unwrap();
    drives.stop();
    dump.stop();
    assert!(master.status.success(), "{}", said(&master));
    let frames = std::fs::read_to_string(&capture).unwrap();
    let count = frames.lines().count();
    assert!(count > 1000, "only {count} frames were seen");
    assert_eq!(dissected(&capture, "canopen").len(), count);
    assert_eq!(
        dissected(&capture, "_ws.malformed || _ws.expert"),
        [""; 0],
        "Wireshark finds fault with these"
    );
    for filter in [
        "canopen.nmt_ctrl.cd",
        "canopen.sdo.abort_code == 0x06020000",
        "canopen.em.err_code == 0x8611",
    ] {
        assert!(
            !dissected(&capture, filter).is_empty(),
            "no frame matches {filter}"
        );
    }
}

/// The frames of a candump log that Wireshark's CANopen dissector, and `filter`, accept, a line for
/// each.
fn dissected(capture: &std::path::Path, filter: &str) -> Vec<String> {
    let output = Command::new("tshark")
        .args(["-d", "can.subdissector,canopen", "-Y", filter, "-r"])
        .arg(capture)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", said(&output));
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .map(str::to_owned)
        .collect()
}
