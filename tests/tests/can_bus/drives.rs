//! `trocar drives` among tools that others have written: they lead its drives by the data sheet,
//! and understand each frame.

use std::path::{Path, PathBuf};
use std::process::Command;

use hal::config::Source;
use socketcan::{CanSocket, EmbeddedFrame as _};
use tests::{repository, scratch};
use trocar_canopen::bus_load::bits::exact;
use trocar_canopen::master::CanConfig;
use trocar_canopen::{CanId, Frame, Payload};
use trocar_log::RunLog;

use crate::heard::{await_data, receive};
use crate::pair::until;
use crate::peer::{Peer, alone, said, state_folder};
use crate::{bus, dissected};

/// Counts by which an axis with inertia and friction may be away from the last four targets of a
/// slow master. Of the nodes that are led the first, which has the least way to go, is one of the
/// wrist's, with few counts a turn and much friction.
const TOLERANCE: &str = "300";

/// How much slower than real time a run and its drives live, so that a kernel inside a kernel on a
/// busy machine keeps up.
const SLOW: u64 = 6;

/// Nobody else's.
const TOPICS: &str = "can_bus_drives";

/// Drives of `task`'s arms on the first bus, whose last node is `last`.
fn drives(task: &str, last: &str, slow: u64, more: &[&str]) -> Peer {
    let arguments = ["drives", "--task", task, "--topics", TOPICS];
    let arguments = [&arguments[..], more].concat();
    Peer::trocar(slow, &arguments, &format!(" {last} on vcan0"))
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
    let drives = drives(task, last, 1, &[]);
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

/// A master in Python leads the drives of the command line and Wireshark agrees.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn python_master_commands_trocar_drives() {
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
    let drives = drives("needle-lift", "7", 1, &[]);
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
    await_data(&bus, 0x703, &[5]);
    let status = answer(&bus, "080#", 0x183);
    assert_eq!(status[..2], [0x70, 0x02]);
    // Stopped, it has no dictionary, and starts again.
    cansend("000#0203");
    await_data(&bus, 0x703, &[4]);
    cansend("603#4000100000000000");
    cansend("000#8103");
    await_data(&bus, 0x703, &[0]);
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

/// The frame of a candump log's line.
fn parsed(text: &str) -> Frame {
    let (id, data) = text.split_once('#').unwrap();
    let byte = |place: usize| u8::from_str_radix(&data[place..place + 2], 16).unwrap();
    let bytes: Vec<u8> = (0..data.len()).step_by(2).map(byte).collect();
    let id = CanId::new(u16::from_str_radix(id, 16).unwrap()).unwrap();
    Frame::new(id, Payload::new(&bytes).unwrap())
}

/// The shipped nodes on a SYNC that a busy machine keeps up with.
fn slow_config(folder: &Path) -> (PathBuf, CanConfig) {
    let file = folder.join("can.toml");
    let text = std::fs::read_to_string(repository().join("config/can.toml")).unwrap();
    let slow = text.replace("\ncycle_us = 2000", "\ncycle_us = 4000");
    std::fs::write(&file, &slow).unwrap();
    let config = CanConfig::load(&Source::embedded("can.toml", &slow)).unwrap();
    (file, config)
}

/// A run loads its bus as the plan says and Wireshark understands its master.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn bus_load_of_a_run_matches_its_plan() {
    let _turn = alone();
    let folder = scratch("drives_run");
    let (file, config) = slow_config(&folder);
    let file = file.to_str().unwrap();
    let log = folder.join("capture.log");
    let dump = Peer::logging(&log);
    let mut drives = drives("needle-lift", "7", SLOW, &["--config", file]);
    let run = ["run", "--task", "needle-lift", "--policy", "noop"];
    let on_can = ["--backend", "can", "--topics", TOPICS, "--can-config", file];
    let run = Peer::trocar(SLOW, &[&run[..], &on_can].concat(), "");
    drives.await_word("the episode begins");
    until("there are 250 SYNCs", || {
        frames(&log)
            .iter()
            .filter(|it| it.starts_with("080#"))
            .count()
            > 250
    });
    let printed = run.interrupt();
    let _ = drives.interrupt();
    dump.stop();
    // Nobody asked for a log.
    let kept = state_folder().join(format!("trocar/black-box/{TOPICS}.mcap"));
    let kept = RunLog::open(&kept).unwrap();
    assert!(kept.cut().is_none() && kept.tick_count() > 100, "{printed}");
    assert_eq!(dissected(&log, "_ws.malformed || _ws.expert"), [""; 0]);
    // A SYNC, and what comes until the next one: on a busy machine some answers are a cycle late.
    let frames: Vec<Frame> = frames(&log).iter().map(|frame| parsed(frame)).collect();
    let load = config.arms[0].plan.traffic(0).load();
    assert_eq!((load.least, load.room), (1489, 4000));
    let (mut cycles, mut whole) = (0, 0);
    for cycle in frames.split(|frame| frame.id.raw() == 0x080).skip(1) {
        let exchanged = |frame: &&Frame| matches!(frame.id.raw(), 0x181..=0x207);
        let exchanged: Vec<&Frame> = cycle.iter().filter(exchanged).collect();
        cycles += 1;
        if exchanged.len() == 14 {
            whole += 1;
            let bits: u32 = exchanged.iter().map(|frame| exact(frame)).sum();
            let sync = exact(&Frame::new(CanId::new(0x080).unwrap(), Payload::EMPTY));
            let bits = u64::from(bits + sync);
            assert!((load.least..=load.most).contains(&bits), "{bits} bits");
        }
    }
    assert!(cycles > 100 && whole > 50, "{whole} of {cycles}: {printed}");
}
