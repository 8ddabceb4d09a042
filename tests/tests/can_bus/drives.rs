//! `trocar drives` among tools that others have written: they lead its drives by the data sheet, and understand each frame.

use std::path::{Path, PathBuf};
use std::process::Command;

use socketcan::{CanSocket, EmbeddedFrame as _};
use tests::{repository, scratch};

use crate::peer::{Peer, alone, said};
use crate::{bus, dissected, profile, receive};

/// Counts by which an axis with inertia and friction may be away from the last four targets of a slow master. Of the nodes that
/// are led the first, which has the least way to go, is one of the wrist's, with few counts a turn and much friction.
const TOLERANCE: &str = "300";

/// Drives of `task`'s arms on the first bus, whose last node is `last`.
fn drives(task: &str, last: &str) -> Peer {
    let options = ["--task", task, "--topics", "can_bus_drives"];
    Peer::trocar_drives(profile(), &options, &format!(" {last} on vcan0"))
}

/// The frames of a candump log, as `185#0102`.
fn frames(log: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(log).unwrap();
    let frame = |line: &str| line.split(' ').nth(2).map(str::to_owned);
    text.lines().filter_map(frame).collect()
}

fn cansend(frame: &str) {
    let sent = Command::new("cansend")
        .args(["vcan0", frame])
        .status()
        .unwrap();
    assert!(sent.success());
}

/// What `id` says to `frame`.
fn answer(bus: &CanSocket, frame: &str, id: u16) -> Vec<u8> {
    cansend(frame);
    receive(bus, id).data().to_vec()
}

/// Lets the master in python lead `nodes`; gives the log of all frames.
fn lead(test: &str, task: &str, nodes: &str, last: &str) -> PathBuf {
    let capture = scratch(test).join("capture.log");
    let dump = Peer::logging(&capture);
    let drives = drives(task, last);
    let master = Command::new("python3")
        .arg(repository().join("tests/can/master.py"))
        .arg("--eds")
        .arg(repository().join("config/eds/trocar_drive.eds"))
        .args(["--nodes", nodes, "--period", "0.02"])
        .args(["--amplitude", "3000", "--tolerance", TOLERANCE])
        .output()
        .unwrap();
    let printed = drives.interrupt();
    dump.stop();
    assert!(master.status.success(), "{}{printed}", said(&master));
    capture
}

/// Wireshark finds fault with no frame, and finds the services that were used.
fn assert_understood(capture: &Path) {
    let count = frames(capture).len();
    assert!(count > 1000, "only {count} frames were seen");
    assert_eq!(dissected(capture, "canopen").len(), count);
    assert_eq!(dissected(capture, "_ws.malformed || _ws.expert"), [""; 0]);
    for filter in [
        "canopen.nmt_ctrl.cd",
        "canopen.sdo.abort_code == 0x06020000",
        "canopen.em.err_code == 0x8611",
    ] {
        assert!(
            !dissected(capture, filter).is_empty(),
            "nothing matches {filter}"
        );
    }
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn a_master_in_python_leads_the_drives_of_the_command_line_and_wireshark_agrees() {
    let _turn = alone();
    let capture = lead("drives_led", "needle-lift", "7,3,1", "7");
    assert_understood(&capture);
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn a_master_in_python_leads_drives_of_two_arms_on_one_bus() {
    let _turn = alone();
    let capture = lead("drives_of_two_arms", "needle-handover", "15,13,2", "17");
    assert_understood(&capture);
    // Both arms' drives are there, but only those that were led have answered a SYNC.
    let frames = frames(&capture);
    let says = |start: &str| frames.iter().any(|frame| frame.starts_with(start));
    assert!(says("182#") && says("18D#") && says("18F#") && !says("181#") && !says("18B#"));
    assert!(says("702#") && says("70F#"));
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn cansend_leads_a_drive_and_candump_shows_what_it_says() {
    let _turn = alone();
    let log = scratch("drives_by_hand").join("capture.log");
    let dump = Peer::logging(&log);
    let drives = drives("needle-lift", "7");
    let bus = bus();
    // A reset is answered with a boot-up.
    assert_eq!(answer(&bus, "000#8103", 0x703), [0]);
    // Device type 1000h is 00020192h.
    let device = answer(&bus, "603#4000100000000000", 0x583);
    assert_eq!(device, [0x43, 0x00, 0x10, 0, 0x92, 0x01, 0x02, 0x00]);
    // There is no 5FFFh.
    let refused = answer(&bus, "603#40FF5F0000000000", 0x583);
    assert_eq!(refused, [0x80, 0xFF, 0x5F, 0, 0x00, 0x00, 0x02, 0x06]);
    // A heartbeat every 100 ms.
    let taken = answer(&bus, "603#2B17100064000000", 0x583);
    assert_eq!(taken, [0x60, 0x17, 0x10, 0, 0, 0, 0, 0]);
    assert_eq!(receive(&bus, 0x703).data(), [0x7F]);
    // TPDO 1 at every SYNC.
    let taken = answer(&bus, "603#2F00180201000000", 0x583);
    assert_eq!(taken, [0x60, 0x00, 0x18, 2, 0, 0, 0, 0]);
    // Operational, it answers one: switch-on disabled, with voltage and no quick stop, remote.
    cansend("000#0103");
    while receive(&bus, 0x703).data() != [5] {}
    let status = answer(&bus, "080#", 0x183);
    assert_eq!(status[..2], [0x70, 0x02]);
    // Stopped, it has no dictionary, and starts again.
    cansend("000#0203");
    while receive(&bus, 0x703).data() != [4] {}
    cansend("603#4000100000000000");
    cansend("000#8103");
    while receive(&bus, 0x703).data() != [0] {}
    let _ = drives.interrupt();
    dump.stop();
    let frames = frames(&log);
    for frame in [
        "703#00",
        "583#4300100092010200",
        "583#80FF5F0000000206",
        "583#6017100000000000",
        "703#7F",
        "703#05",
        "703#04",
    ] {
        assert!(
            frames.iter().any(|seen| seen == frame),
            "{frame} in {frames:?}"
        );
    }
    let answers = frames.iter().filter(|frame| frame.starts_with("583#43"));
    assert_eq!(answers.count(), 1, "a stopped node answers nothing");
    assert_eq!(dissected(&log, "_ws.malformed || _ws.expert"), [""; 0]);
}
