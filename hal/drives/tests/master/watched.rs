//! A second master that commands our drives, and trouble with the bus, while the arm is brought up.

use std::cell::RefCell;
use std::rc::Rc;

use super::*;
use trocar_canopen::cia301::NmtState;
use trocar_canopen::cia301::emcy::ErrorCode;

/// What only our master may say, and what anybody may.
fn said() -> ([Frame; 9], [Frame; 8]) {
    let ours = [
        frame(0x080, &[]),
        frame(0x203, &[6, 0, 0, 0, 0, 0]),
        frame(0x77F, &[5]),
        // NMT to all, and to node 3.
        frame(0x000, &[0x80, 0]),
        frame(0x000, &[0x02, 3]),
        frame(0x000, &[0x81, 3]),
        // Writing to its dictionary: a position offset, a segment, a block.
        frame(0x603, &[0x23, 0xB0, 0x60, 0, 0, 1, 0, 0]),
        frame(0x603, &[0x01, 1, 2, 3, 4, 5, 6, 7]),
        frame(0x603, &[0xC2, 0xB0, 0x60, 0, 4, 0, 0, 0]),
    ];
    let anybodys = [
        frame(0x100, &[]),
        frame(0x20B, &[0x0F, 0, 0, 0, 0, 0]),
        frame(0x77E, &[5]),
        frame(0x000, &[0x01, 11]),
        frame(0x18B, &[0; 8]),
        frame(0x08B, &[0x10, 0x23, 3, 0, 0, 0, 0, 0]),
        frame(0x603, &[0x40, 0x64, 0x60, 0, 0, 0, 0, 0]),
        frame(0x60B, &[0x23, 0xB0, 0x60, 0, 0, 1, 0, 0]),
    ];
    (ours, anybodys)
}

fn refusal(frame: &Frame) -> String {
    format!("bus 0: another master sends {frame}")
}

#[test]
fn another_master_is_noticed_before_a_word_is_said() {
    let plan = plan(1, 2 * MS);
    let scan = |heard: &Frame| {
        let mut net = network(&plan);
        net.intrude(0, *heard);
        let scanned = Offline::new(net, &plan).unwrap().scan();
        scanned.map(|_| ()).map_err(|error| error.to_string())
    };
    let (ours, anybodys) = said();
    for heard in ours {
        assert_eq!(scan(&heard), Err(refusal(&heard)));
    }
    for heard in anybodys {
        assert_eq!(scan(&heard), Ok(()), "{heard}");
    }
}

/// A bus on which something happens once so many frames of ours have been sent.
struct Disturbed {
    net: Rc<RefCell<Net>>,
    sent: Rc<RefCell<usize>>,
    at: usize,
    /// When it happened.
    happened: Option<TimeNs>,
    /// What of ours went out since, but for the frames of the same moment.
    after: Rc<RefCell<Vec<Frame>>>,
    what: Rc<dyn Fn(&mut Net)>,
}

impl Bus for Disturbed {
    fn now(&self) -> TimeNs {
        self.net.borrow().now()
    }

    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        let mut net = self.net.borrow_mut();
        let count = net.send(line, frames);
        let before = *self.sent.borrow();
        *self.sent.borrow_mut() += count;
        if (before..before + count).contains(&self.at) {
            (self.what)(&mut net);
            self.happened = Some(net.now());
        }
        // Frames that were queued before take the bus for as long.
        let through = |happened: TimeNs| net.now() > happened.plus_ns(2 * MS);
        if self.happened.is_some_and(through) {
            self.after.borrow_mut().extend(&frames[..count]);
        }
        count
    }

    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        self.net.borrow_mut().receive(line, sink);
    }

    fn flush(&mut self, line: u8) {
        self.net.borrow_mut().flush(line);
    }

    fn wait(&mut self, until: TimeNs) {
        self.net.borrow_mut().advance(until);
    }
}

/// How bring-up ended, and how many frames of ours were sent after each of its steps.
pub(super) struct Outcome {
    pub(super) sent: [usize; 4],
    pub(super) end: Result<(), String>,
    pub(super) torques: bool,
    /// What of ours went out after what happened.
    after: Vec<Frame>,
    /// Whether every node is stopped in the end.
    pub(super) stopped: bool,
}

/// Bring-up with `what` after our frame number `at`. The drives are looked at half a second later.
pub(super) fn bring_up(lines: u8, at: usize, what: impl Fn(&mut Net) + 'static) -> Outcome {
    bring_up_of(lines, drive, at, what)
}

fn bring_up_of(
    lines: u8,
    drive: fn(usize) -> Node,
    at: usize,
    what: impl Fn(&mut Net) + 'static,
) -> Outcome {
    let plan = plan(lines, 2 * MS);
    let net = Rc::new(RefCell::new(network_of(&plan, drive)));
    let sent = Rc::new(RefCell::new(0));
    let noted = Rc::default();
    let bus = Disturbed {
        after: Rc::clone(&noted),
        net: Rc::clone(&net),
        sent: Rc::clone(&sent),
        at,
        happened: None,
        what: Rc::new(what),
    };
    let mut after = [0; 4];
    let mut note = |step: usize| after[step] = *sent.borrow();
    let steps = || -> Result<(), BringUpError> {
        let scanned = Offline::new(bus, &plan)?.scan()?;
        note(0);
        let identified = scanned.check_identity()?;
        note(1);
        let mapped = identified.map()?;
        note(2);
        let homed = mapped.home()?;
        note(3);
        homed.enable().map(|_| ())
    };
    let end = steps().map_err(|error| error.to_string());
    let mut net = net.borrow_mut();
    let later = net.now().plus_ns(500 * MS);
    net.advance(later);
    let has_torque = |axis| net.node(node(axis)).unwrap().power_state().has_torque();
    Outcome {
        sent: after,
        end,
        torques: (0..TAIL_AXES).any(has_torque),
        after: noted.take(),
        stopped: (0..TAIL_AXES)
            .all(|axis| net.node(node(axis)).unwrap().nmt_state() == NmtState::Stopped),
    }
}

/// Questions to the nodes between the last reference and their start.
pub(super) const QUESTIONS: usize = 4 * TAIL_AXES;

pub(super) const NEVER: usize = usize::MAX;

/// Another master ends the bring up in whatever step it is heard.
#[test]
fn second_master_ends_every_step_of_bring_up() {
    let [scanned, identified, mapped, homed] = bring_up(1, NEVER, |_| {}).sent;
    let (ours, _) = said();
    // A few frames into each step.
    for at in [3, scanned + 9, identified + 40, mapped + 20] {
        // A write of his that a drive refuses, so nothing else ends it.
        for heard in [ours[7], ours[1]] {
            let outcome = bring_up(1, at, move |net| assert!(net.intrude(0, heard)));
            assert_eq!(outcome.end, Err(refusal(&heard)), "{at}");
            assert!(!outcome.torques && outcome.stopped);
            let steps = [scanned, identified, mapped, homed];
            let done = outcome.sent.iter().filter(|sent| **sent > 0).count();
            assert_eq!(done, steps.iter().filter(|end| **end <= at).count(), "{at}");
        }
    }
    // One that resets a node is the cause, not that it then is not as it was set.
    let reset = frame(0x000, &[0x81, 3]);
    let outcome = bring_up(1, mapped + 20, move |net| assert!(net.intrude(0, reset)));
    assert_eq!(outcome.end, Err(refusal(&reset)));
}

/// Once another master was heard no drive is given torque or changed.
#[test]
fn no_drive_gets_torque_after_a_second_master() {
    let [_, identified, mapped, homed] = bring_up(1, NEVER, |_| {}).sent;
    let harms = |frame: &Frame| match frame.id.raw() {
        0x201..=0x207 => frame.data()[0] & 0b10 != 0,
        0x601..=0x607 => frame.data()[0] != 0x40,
        0x000 => frame.data()[0] != 0x02,
        _ => false,
    };
    let stranger = said().0[1];
    let mut heard_ours = 0;
    for at in (identified..homed).step_by(7) {
        let outcome = bring_up(1, at, move |net| assert!(net.intrude(0, stranger)));
        assert_eq!(outcome.end, Err(refusal(&stranger)), "{at} of {mapped}");
        let harmful: Vec<_> = outcome.after.iter().filter(|frame| harms(frame)).collect();
        assert!(harmful.is_empty() && outcome.stopped, "{at}: {harmful:?}");
        heard_ours += outcome.after.len();
    }
    assert!(heard_ours > 0);
}

/// A drive that has its reference when another master is heard loses its torque at once.
#[test]
fn second_master_during_homing_takes_the_torque() {
    let [_, _, mapped, homed] = bring_up(1, NEVER, |_| {}).sent;
    let his = frame(0x203, &[0x0F, 0, 0, 0, 0, 0]);
    for at in (mapped..homed).step_by(5) {
        let seen = Rc::new(RefCell::new(0_u32));
        let counted = Rc::clone(&seen);
        let outcome = bring_up(1, at, move |net| {
            assert!(net.intrude(0, his));
            let counted = Rc::clone(&counted);
            net.tamper(Box::new(move |_, _, heard| {
                // Set-points and SYNCs of ours that nodes still hear.
                let cyclic = matches!(heard.id.raw(), 0x201..=0x207 | 0x080) && *heard != his;
                *counted.borrow_mut() += u32::from(cyclic);
                Tampering::Pass
            }));
        });
        assert_eq!(outcome.end, Err(refusal(&his)));
        assert!(outcome.stopped && !outcome.torques);
        // Those that were queued when it spoke, of which a queue holds 16.
        assert!(*seen.borrow() <= 16, "{at}: {}", seen.borrow());
    }
}

#[test]
fn a_master_that_was_there_before_us_is_not_disturbed() {
    let plan = plan(1, 2 * MS);
    let mut net = network(&plan);
    let said = Rc::new(RefCell::new(0));
    let counted = Rc::clone(&said);
    let his = frame(0x203, &[6, 0, 0, 0, 0, 0]);
    net.intrude(0, his);
    net.tamper(Box::new(move |_, _, heard| {
        *counted.borrow_mut() += u32::from(heard.id.raw() == 0x000);
        Tampering::Pass
    }));
    let scanned = Offline::new(net, &plan).unwrap().scan();
    let error = scanned.map(|_| ()).unwrap_err().to_string();
    assert_eq!((error, *said.borrow()), (refusal(&his), 0));
}

/// What anybody may say and another arm's master does not end it.
#[test]
fn other_traffic_does_not_end_the_bring_up() {
    let undisturbed = bring_up(1, NEVER, |_| {});
    assert_eq!(undisturbed.end, Ok(()));
    let [scanned, .., homed] = undisturbed.sent;
    for at in [scanned + 9, homed + QUESTIONS + 6] {
        let outcome = bring_up(1, at, |net| {
            for heard in said().1 {
                // An answer to a question of his would be taken for one of ours.
                if heard.id.raw() != 0x603 {
                    assert!(net.intrude(0, heard));
                }
            }
        });
        assert_eq!(outcome.end, Ok(()), "{at}");
    }
}

/// What happens between the start of the nodes and the first SYNC is a fault.
#[test]
fn trouble_before_the_first_sync_is_a_fault() {
    type What = fn(&mut Net);
    let cases: [(What, &str); 7] = [
        (
            |net| net.bus_off(1, true),
            "bus 1: our controller is bus-off",
        ),
        (
            |net| net.trouble(0, ControllerEvent::Down),
            "bus 0: the interface is down",
        ),
        (
            |net| net.trouble(2, ControllerEvent::Restarted),
            "bus 2: our controller is bus-off",
        ),
        (
            |net| assert!(net.intrude(1, frame(0x204, &[0x0F, 0, 0, 0, 0, 0]))),
            "bus 1: another node sends 204h, which only this master may",
        ),
        (
            |net| assert!(net.intrude(0, frame(0x603, &[0x01, 1, 2, 3, 4, 5, 6, 7]))),
            "bus 0: another node sends 603h, which only this master may",
        ),
        (
            |net| {
                net.poke(node(6), |now, drive, out| {
                    drive.fail(now, ErrorCode::OVER_CURRENT, 2, out);
                });
            },
            "node 7 (axis 6, bus 2): emergency 2310h, continuous over-current",
        ),
        (
            |net| net.poke(node(2), |now, drive, out| drive.power_on(now, out)),
            "node 3 (axis 2, bus 0): was reset while in use",
        ),
    ];
    let undisturbed = bring_up(3, NEVER, |_| {});
    assert_eq!(undisturbed.end, Ok(()));
    // The seventh of them is told to start.
    let last = undisturbed.sent[3] + QUESTIONS + 6;
    for (what, fault) in cases {
        let outcome = bring_up(3, last, what);
        assert_eq!(outcome.end, Err(fault.to_owned()));
        assert!(!outcome.torques, "{fault}");
    }
}

/// A controller event on a bus that is not listened to ends the bring up before the nodes start.
#[test]
fn trouble_on_any_bus_ends_the_bring_up() {
    let undisturbed = bring_up(3, NEVER, |_| {});
    let homed = undisturbed.sent[3];
    // The last axis is homed on bus 2; nothing is asked on bus 0 any more.
    for trouble in [
        ControllerEvent::BusOff,
        ControllerEvent::Restarted,
        ControllerEvent::Down,
    ] {
        let asked = bring_up(3, homed + QUESTIONS - 2, move |net| net.trouble(0, trouble));
        assert_eq!(asked.end, Err("bus 0: bus-off or down".to_owned()));
        assert!(asked.sent[3] == homed && !asked.torques);
        let outcome = bring_up(3, homed - 1, move |net| net.trouble(0, trouble));
        assert_eq!(outcome.end, Err("bus 0: bus-off or down".to_owned()));
        assert!(outcome.sent[3] == 0 && !outcome.torques, "{trouble:?}");
    }
    // Even that it is back, once bring-up has begun.
    let outcome = bring_up(3, 0, |net| net.trouble(0, ControllerEvent::Restarted));
    assert_eq!(outcome.end, Err("bus 0: bus-off or down".to_owned()));
}

#[test]
fn a_drive_that_does_not_let_go_after_its_reference_is_stopped() {
    // Pre-operational would not stop it.
    let stubborn = |axis| {
        let config = AxisConfig {
            stops_in_pre_operational: false,
            ..axis_config(axis)
        };
        Node::new(node(axis), &config)
    };
    let outcome = bring_up_of(1, stubborn, 0, |net| {
        net.tamper(Box::new(|_, _, heard| match heard.data() {
            // Let go, it is told, and hears that it is to stay enabled.
            [0x00, rest @ ..] if heard.id.raw() == 0x203 => {
                let said = [&[0x0F], rest].concat();
                Tampering::Replace(frame(0x203, &said))
            }
            _ => Tampering::Pass,
        }));
    });
    let refusal = "node 3 (axis 2, bus 0): homing failed, status word ";
    assert!(outcome.end.unwrap_err().starts_with(refusal));
    assert!(!outcome.torques);
}
