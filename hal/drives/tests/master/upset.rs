//! What happens to a drive while the arm is brought up: what counts is what happens to it after it
//! was set up.

use super::watched::{NEVER, Outcome, QUESTIONS, bring_up};
use super::*;
use trocar_canopen::cia301::emcy::ErrorCode;
use trocar_canopen::master::bringup::Scanned;

type What = fn(&mut Net);

/// Node 3, the one of axis 2, has lost and got its power.
fn reboots(net: &mut Net) {
    net.poke(node(2), |now, drive, out| drive.power_on(now, out));
}

fn fails(net: &mut Net) {
    net.poke(node(2), |now, drive, out| {
        drive.fail(now, ErrorCode::OVER_CURRENT, 2, out);
    });
}

const WHO: &str = "node 3 (axis 2, bus 0)";
const REBOOTED: &str = "booted up again";
const FAILED: &str = "emergency 2310h, continuous over-current";

/// A drive that was set up and is reset or fails ends the bring up with its cause and nothing has
/// torque.
#[test]
fn reset_or_fault_of_a_set_up_drive_ends_the_bring_up() {
    let [_, identified, mapped, homed] = bring_up(1, NEVER, |_| {}).sent;
    // It has its settings, and another node lacks its last one.
    let set_up = mapped - 1;
    assert!(identified < set_up);
    let cases = [
        (set_up, "while the nodes were set up"),
        ((mapped + homed) / 2, "while the axes were homed"),
        (homed - 1, "while the axes were homed"),
    ];
    for (at, step) in cases {
        for (what, told) in [(reboots as What, REBOOTED), (fails, FAILED)] {
            let outcome = bring_up(1, at, what);
            assert_eq!(outcome.end, Err(format!("{WHO}: {told}, {step}")), "{at}");
            assert!(!outcome.torques && outcome.stopped, "{step}");
        }
    }
}

/// A reset in the middle of its settings undoes half of them and is noticed.
#[test]
fn reset_during_bring_up_is_reported() {
    let [_, identified, mapped, _] = bring_up(1, NEVER, |_| {}).sent;
    let outcome = bring_up(1, (identified + mapped) / 2, reboots);
    let told = format!("{WHO}: {REBOOTED}, while the nodes were set up");
    assert_eq!(outcome.end, Err(told));
    assert!(!outcome.torques && outcome.stopped);
}

/// On a bus that is not listened to it is noticed before the nodes start.
#[test]
fn reset_on_another_bus_is_noticed_before_the_start() {
    // The last axis is homed on bus 2; node 3 is on bus 0.
    let homed = bring_up(3, NEVER, |_| {}).sent[3];
    for (what, told) in [(reboots as What, REBOOTED), (fails, FAILED)] {
        let outcome = bring_up(3, homed - 9, what);
        let told = format!("{WHO}: {told}, while the axes were homed");
        assert_eq!(outcome.end, Err(told));
        assert!(!outcome.torques && outcome.stopped);
    }
}

/// What a drive has to tell of the time before it was set up does not end it.
#[test]
fn emergencies_of_before_the_settings_do_not_count() {
    let [scanned, identified, mapped, _] = bring_up(1, NEVER, |_| {}).sent;
    // That it lost a master whom it had, or has no voltage yet.
    let tells: [What; 2] = [
        |net| assert!(net.intrude(0, frame(0x083, &[0x30, 0x81, 0x11, 0, 0, 0, 0, 0]))),
        |net| assert!(net.intrude(0, frame(0x083, &[0x20, 0x32, 0x05, 0, 0, 0, 0, 0]))),
    ];
    let its_own = (identified + mapped) / 2;
    for at in [0, 4, scanned - 1, scanned + 9, identified + 20, its_own] {
        for tells in tells {
            assert_eq!(bring_up(1, at, tells).end, Ok(()), "{at}");
        }
    }
    // It boots up again before it has been told anything.
    for at in [scanned - 1, scanned + 9, identified - 1] {
        assert_eq!(bring_up(1, at, reboots).end, Ok(()), "{at}");
    }
}

#[test]
fn reset_on_any_bus_is_noticed_while_nodes_are_set_up() {
    let [_, identified, mapped, _] = bring_up(3, NEVER, |_| {}).sent;
    for at in [identified + 5, (identified + mapped) / 2] {
        for axis in [0, 3, 6] {
            let outcome = bring_up(3, at, move |net| {
                net.poke(node(axis), |now, drive, out| drive.power_on(now, out));
            });
            let told = format!("{REBOOTED}, while the nodes were set up");
            let end = outcome.end.unwrap_err();
            let name = format!("node {} (axis {axis}, ", axis + 1);
            assert!(end.starts_with(&name) && end.ends_with(&told), "{end}");
            assert!(!outcome.torques && outcome.stopped);
        }
    }
}

/// What it said before our reset went out counts for nothing.
#[test]
fn boot_up_of_before_is_no_answer_to_our_reset() {
    let plan = plan(3, 2 * MS);
    let mut net = network(&plan);
    net.tamper(Box::new(|_, _, heard| {
        match (heard.id.raw(), heard.data()) {
            (0x000, [0x81, 4]) => Tampering::Drop,
            _ => Tampering::Pass,
        }
    }));
    // While the buses are listened to.
    net.poke(node(3), |now, drive, out| drive.power_on(now, out));
    let scanned = Offline::new(net, &plan).unwrap().scan();
    let refusal = "node 4 (axis 3, bus 1): does not answer to a reset";
    assert_eq!(scanned.map(|_| ()).unwrap_err().to_string(), refusal);
}

/// That all is well that there is no SYNC yet and what other drives tell does not end it.
#[test]
fn harmless_emergencies_do_not_end_the_bring_up() {
    let [_, _, mapped, homed] = bring_up(1, NEVER, |_| {}).sent;
    let told = [
        (0x083, 0x0000_u16),
        (0x083, 0x8130),
        (0x083, 0x8250),
        (0x083, 0x8700),
        // Of another arm's node.
        (0x08B, 0x2310),
    ];
    for (id, code) in told {
        let [low, high] = code.to_le_bytes();
        for at in [mapped + 3, (mapped + homed) / 2, homed - 1] {
            let outcome = bring_up(1, at, move |net| {
                assert!(net.intrude(0, frame(id, &[low, high, 0x11, 0, 0, 0, 0, 0])));
                assert!(net.intrude(0, frame(0x70B, &[0])));
                // Too short for an emergency.
                assert!(net.intrude(0, frame(0x083, &[0x10, 0x23])));
            });
            assert_eq!(outcome.end, Ok(()), "{id:x} {code:x} {at}");
        }
    }
    // All that it tells otherwise does.
    let outcome = bring_up(1, homed - 1, |net| {
        assert!(net.intrude(0, frame(0x083, &[0x50, 0x81, 0x11, 0, 0, 0, 0, 0])));
    });
    let refusal =
        format!("{WHO}: emergency 8150h, identifier collision, while the axes were homed");
    assert_eq!(outcome.end, Err(refusal));
}

/// That there is no SYNC yet is no fault between the start of the nodes and the SYNC and one after
/// it.
#[test]
fn missing_sync_is_a_fault_after_the_first_sync_only() {
    let started = bring_up(1, NEVER, |_| {}).sent[3] + QUESTIONS;
    for code in [0x8130_u16, 0x8250, 0x8700] {
        let [low, high] = code.to_le_bytes();
        let told = frame(0x083, &[low, high, 0x11, 0, 0, 0, 0, 0]);
        // The first node is told to start, the last one, and one of the first SYNCs.
        for (at, is_fault) in [(0, false), (6, false), (25, true)] {
            let outcome = bring_up(1, started + at, move |net| assert!(net.intrude(0, told)));
            let name = ErrorCode(code);
            let fault = is_fault.then(|| format!("{WHO}: emergency {name}"));
            assert_eq!(outcome.end.err(), fault, "{code:x} {at}");
        }
    }
}

#[test]
fn a_drive_that_is_in_fault_from_the_start_says_why() {
    let scanned = bring_up(1, NEVER, |_| {}).sent[0];
    let outcome = bring_up(1, scanned + 9, fails);
    let told =
        format!("{WHO}: is in fault: 2310h, continuous over-current; bring-up resets no faults");
    assert_eq!(outcome.end, Err(told));
    assert!(!outcome.torques);
}

/// Once homed, the answers of node 3 about an object are these bytes.
fn answering(at: usize, asked: [u8; 3], data: [u8; 4]) -> Outcome {
    bring_up(1, at, move |net| {
        net.tamper(Box::new(move |_, _, heard| match heard.data() {
            [kind @ 0x43..=0x4F, rest @ ..] if heard.id.raw() == 0x583 && rest[..3] == asked => {
                let answer = [&[*kind], &asked[..], &data[..]].concat();
                Tampering::Replace(frame(0x583, &answer))
            }
            _ => Tampering::Pass,
        }));
    })
}

/// A drive that has an error which it told before it counted gets no torque.
#[test]
fn drive_with_an_earlier_error_gets_no_torque() {
    let homed = bring_up(1, NEVER, |_| {}).sent[3];
    let errors = [
        (0x21_u8, "21h: generic, device profile"),
        (0x02, "02h: current"),
        (0x1D, "1Dh: generic, voltage, temperature, communication"),
        (0xC1, "C1h: generic, reserved, manufacturer"),
    ];
    for (register, text) in errors {
        let outcome = answering(homed - 1, [0x01, 0x10, 0], [register, 0, 0, 0]);
        let told = "has an error before the first SYNC, its 1001h says";
        assert_eq!(outcome.end, Err(format!("{WHO}: {told} {text}")));
        assert!(!outcome.torques && outcome.stopped);
    }
    // That it misses the SYNC.
    for register in [0x00, 0x01, 0x11] {
        let outcome = answering(homed - 1, [0x01, 0x10, 0], [register, 0, 0, 0]);
        assert_eq!(outcome.end, Ok(()), "{register:x}");
    }
}

/// A restart of which nobody has heard is noticed by what it undoes.
#[test]
fn unheard_restart_is_noticed_by_its_lost_settings() {
    let homed = bring_up(1, NEVER, |_| {}).sent[3];
    let unheard = |net: &mut Net| {
        net.tamper(Box::new(|_, _, heard| match heard.id.raw() {
            0x703 => Tampering::Drop,
            _ => Tampering::Pass,
        }));
    };
    let resets: [What; 2] = [reboots, |net| {
        let reset = frame(0x000, &[0x82, 3]);
        net.poke(node(2), |now, drive, out| drive.on_frame(now, &reset, out));
    }];
    let forgotten = |object: &str, found: u32, told: u32| {
        let values = format!("{object} is {found:#x} and was set to {told:#x}");
        Err(format!(
            "{WHO}: {values}: it must have been reset unnoticed"
        ))
    };
    for resets in resets {
        let outcome = bring_up(1, homed - 1, move |net| {
            unheard(net);
            resets(net);
        });
        assert_eq!(outcome.end, forgotten("1017:00", 0, 100));
        assert!(!outcome.torques && outcome.stopped);
    }
    // One that has stored its heartbeat.
    let outcome = answering(homed - 1, [0x60, 0x60, 0], [0; 4]);
    assert_eq!(outcome.end, forgotten("6060:00", 0, 8));
    // And its mode: 0.3 units are 30 000 counts.
    let outcome = answering(homed - 1, [0x7C, 0x60, 0], [0; 4]);
    assert_eq!(outcome.end, forgotten("607C:00", 0, 30_000));
    assert!(!outcome.torques && outcome.stopped);
}

/// What happens while the nodes are asked once more ends it on whatever bus.
#[test]
fn reset_during_the_last_check_ends_the_bring_up() {
    let homed = bring_up(3, NEVER, |_| {}).sent[3];
    // Node 3 has answered; the last node, on another bus, is asked.
    for (what, told) in [(reboots as What, REBOOTED), (fails, FAILED)] {
        let outcome = bring_up(3, homed + QUESTIONS - 2, what);
        let told = format!("{WHO}: {told}, before the first SYNC");
        assert_eq!(outcome.end, Err(told));
        assert!(outcome.sent[3] == homed && !outcome.torques && outcome.stopped);
    }
}

/// Frames that are lost before they are read end it once we have said something.
#[test]
fn lost_frames_end_the_bring_up() {
    let [scanned, identified, mapped, homed] = bring_up(3, NEVER, |_| {}).sent;
    let cases = [
        (2, 0, "while the nodes were looked for"),
        (scanned + 9, 0, "while the nodes were looked for"),
        (identified + 40, 0, "while the nodes were set up"),
        // On a bus that is not listened to.
        (identified + 40, 2, "while the nodes were set up"),
        (mapped + 5, 0, "while the axes were homed"),
        (homed - 1, 1, "while the axes were homed"),
        (homed + 3, 0, "before the first SYNC"),
    ];
    for (at, line, step) in cases {
        let outcome = bring_up(3, at, move |net| {
            net.trouble(line, ControllerEvent::Lost(5))
        });
        let told = format!("bus {line}: 5 frames were lost before they were read, {step}");
        assert_eq!(outcome.end, Err(told), "{at}");
        assert!(!outcome.torques && outcome.stopped);
    }
    // Before our first word they are none of ours.
    let plan = plan(3, 2 * MS);
    let mut net = network(&plan);
    net.trouble(1, ControllerEvent::Lost(5));
    assert!(Offline::new(net, &plan).unwrap().scan().is_ok());
}

#[test]
fn two_nodes_with_one_number_are_no_arm() {
    let plan = plan(1, 2 * MS);
    let mut net = network(&plan);
    net.add(0, drive(2), IdealMotor::default());
    // They have met before: that is none of ours.
    net.wait(TimeNs(500 * MS));
    let scanned = Offline::new(net, &plan).unwrap().scan();
    let error = scanned
        .and_then(Scanned::check_identity)
        .map(|_| ())
        .unwrap_err();
    let told = "emergency 8150h, identifier collision, while the nodes were looked for";
    assert_eq!(error.to_string(), format!("{WHO}: {told}"));
    // One that told it before we began is by itself now.
    let mut net = network(&plan);
    net.intrude(0, frame(0x083, &[0x50, 0x81, 0x11, 0, 0, 0, 0, 0]));
    net.wait(TimeNs(500 * MS));
    assert!(Offline::new(net, &plan).unwrap().scan().is_ok());
}
