//! What devices ask for, from events as the kernel tells them.

use std::path::Path;
use std::sync::Arc;

use evdev::{AbsoluteAxisCode as Abs, EventType, KeyCode as Key, RelativeAxisCode as Rel};
use hal::TimeNs;

use super::device::{ButtonAction, Device};
use super::events::{Event, Source};
use super::hand::{DeviceAxes, VirtualHand};
use super::{Hands, InputDevices};
use crate::session::teleop::{Driver, EpisodeCommand};

const SYN: Event = Event {
    kind: 0,
    code: 0,
    value: 0,
};

fn key(key: Key, value: i32) -> Event {
    Event {
        kind: EventType::KEY.0,
        code: key.code(),
        value,
    }
}

fn axis(axis: Abs, value: i32) -> Event {
    Event {
        kind: EventType::ABSOLUTE.0,
        code: axis.0,
        value,
    }
}

fn rel(axis: Rel, value: i32) -> Event {
    Event {
        kind: EventType::RELATIVE.0,
        code: axis.0,
        value,
    }
}

fn ms(ms: u64) -> TimeNs {
    TimeNs(ms * 1_000_000)
}

/// A device after `events` that all came at 0.
fn after(events: &[Event]) -> Device {
    let mut device = Device::default();
    for event in events {
        device.take(*event, ms(0));
    }
    device
}

/// A key moves a hand whose clutch is held, a tap a little, and nothing when the clutch is let go.
#[test]
fn keys_move_a_hand_that_holds_its_clutch() {
    let mut device = after(&[key(Key::KEY_F, 1), key(Key::KEY_UP, 1), key(Key::KEY_M, 1)]);
    let mut hand = VirtualHand::default();
    let mut go = |device: &mut Device, from: u64, to: u64| {
        for step in from..to {
            hand.go(&device.asked(ms(20 * step), 0.0), 0.02, 0.3);
        }
        hand
    };
    let one = go(&mut device, 0, 1).told();
    let further = go(&mut device, 1, 50).told();
    let (first, risen) = (one.at[1], further.at[1]);
    assert!(one.clutch && first > 0.0 && first < 0.001, "{first}");
    // It grows to 0.1 m/s in 0.4 s.
    assert!((risen - 0.084).abs() < 0.002, "{risen}");
    assert_eq!((further.at[0], further.jaw), (0.0, 1.0));
    // A key that goes on being held repeats itself; that is no new press.
    assert_eq!(device.take(key(Key::KEY_F, 2), ms(0)), None);
    device.take(key(Key::KEY_F, 0), ms(0));
    let left = go(&mut device, 50, 60).told();
    assert!(!left.clutch);
    let stays = left
        .at
        .iter()
        .zip(further.at)
        .all(|(one, other)| (one - other).abs() < 1e-12);
    assert!(stays);
    device.take(key(Key::KEY_F, 1), ms(1200));
    let again = go(&mut device, 60, 61).told();
    assert!(again.at[1].abs() < 0.003, "it begins anew: {:?}", again.at);
}

/// A gamepad's sticks have a dead zone, its trigger is the jaw, its shoulder the clutch; ranges are
/// the device's own.
#[test]
fn a_gamepad_asks_by_its_sticks() {
    let ranges = [(Abs::ABS_Y.0, (0, 255))].into_iter().collect();
    let mut device = Device::new(false, ranges);
    for event in [
        key(Key::BTN_TL, 1),
        axis(Abs::ABS_X, 32_767),
        axis(Abs::ABS_Y, 0),
        axis(Abs::ABS_RX, 3000),
        axis(Abs::ABS_HAT0X, -1),
        axis(Abs::ABS_RZ, 255),
    ] {
        device.take(event, ms(0));
    }
    let DeviceAxes {
        clutch,
        way,
        turn,
        trigger,
        ..
    } = device.asked(ms(0), 0.0);
    assert!(clutch && trigger == Some(1.0));
    assert!(
        (way.x - 0.12).abs() < 1e-9 && (way.y - 0.12).abs() < 1e-9 && way.z == 0.0,
        "{way}"
    );
    assert!(
        turn.x == 0.0 && (turn.y - 1.0).abs() < 1e-9 && turn.z == 0.0,
        "{turn}"
    );
    assert_eq!(
        device.take(key(Key::BTN_START, 1), ms(0)),
        Some(ButtonAction::EpisodeCommand(EpisodeCommand::Start))
    );
    assert_eq!(
        device.take(key(Key::BTN_WEST, 1), ms(0)),
        Some(ButtonAction::OtherArm)
    );
    assert_eq!(
        device.take(key(Key::BTN_TR, 1), ms(0)),
        Some(ButtonAction::HandBack)
    );
}

/// A cap's axes are x to the right, y towards the person, z down; one that says nothing for long is
/// let go of.
#[test]
fn a_cap_moves_the_way_it_is_pushed() {
    let mut device = after(&[
        key(Key::BTN_0, 1),
        rel(Rel::REL_Z, -350),
        SYN,
        rel(Rel::REL_RY, 350),
        SYN,
    ]);
    let asked = device.asked(ms(100), 0.0);
    assert!(asked.clutch && asked.trigger.is_none());
    assert!(
        asked.way.x == 0.0 && (asked.way.y - 0.12).abs() < 1e-9,
        "{}",
        asked.way
    );
    assert!((asked.turn.z - 1.0).abs() < 1e-9, "{}", asked.turn);
    // A turn that springs back is told by nothing; a way that is told again and again does not hold
    // it.
    device.take(rel(Rel::REL_Z, -350), ms(290));
    device.take(SYN, ms(290));
    let asked = device.asked(ms(300), 0.0);
    assert!(
        asked.way.y > 0.0 && asked.turn.norm() == 0.0,
        "{}",
        asked.turn
    );
    // An axis that a frame does not tell is 0 again.
    device.take(rel(Rel::REL_X, 100), ms(310));
    device.take(SYN, ms(310));
    let asked = device.asked(ms(320), 0.0);
    assert!(asked.way.x > 0.0 && asked.way.y == 0.0, "{}", asked.way);
    let asked = device.asked(ms(600), 0.0);
    assert!(asked.clutch && asked.way.norm() == 0.0 && asked.turn.norm() == 0.0);
    // The second button closes the jaw, or opens it.
    device.take(key(Key::BTN_1, 1), ms(400));
    assert!(device.asked(ms(400), 0.1).jaw > 0.0);
    device.take(key(Key::BTN_1, 1), ms(400));
    assert!(device.asked(ms(400), 0.9).jaw < 0.0);
}

/// Events were lost: whatever was held has to be pressed anew.
#[test]
fn lost_events_let_go() {
    let mut device = after(&[key(Key::KEY_F, 1), key(Key::KEY_UP, 1)]);
    assert!(device.asked(ms(0), 0.0).clutch);
    device.take(Event { code: 3, ..SYN }, ms(0));
    let asked = device.asked(ms(0), 0.0);
    assert!(!asked.clutch && asked.way.norm() == 0.0);
}

/// What can't be read is named.
#[test]
fn what_is_no_device_is_refused() {
    for (path, reason) in [
        (
            "/dev/input/event9999",
            "--hands /dev/input/event9999: No such file",
        ),
        ("/dev/null", "--hands /dev/null: no input device"),
        ("/", "neither an input device nor a file"),
    ] {
        let error = Source::open(Path::new(path)).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }
}

/// One device moves the chosen arm of two, two devices have one each.
#[test]
fn each_device_has_its_arm() {
    let mut desk = InputDevices::new(Arc::new(Hands::new()));
    desk.devices = vec![Some(Device::default())];
    assert_eq!((desk.arm_of(0, 1), desk.arm_of(0, 2)), (0, 0));
    desk.take(0, key(Key::KEY_2, 1));
    assert_eq!((desk.arm_of(0, 1), desk.arm_of(0, 2)), (0, 1));
    desk.devices.push(Some(Device::default()));
    assert_eq!((desk.arm_of(0, 2), desk.arm_of(1, 2)), (0, 1));
}

/// Beside a policy whoever takes the clutch drives; B hands back, and the clutch has to be taken
/// anew.
#[test]
fn a_key_hands_back_to_the_policy() {
    let hands = Arc::new(Hands::new());
    hands.begin(1, false);
    hands.beside_policy();
    let mut desk = InputDevices::new(Arc::clone(&hands));
    desk.devices = vec![Some(Device::default())];
    let drives = |desk: &mut InputDevices, events: &[Event]| {
        for event in events {
            desk.take(0, *event);
        }
        desk.tell();
        hands.driver(true)
    };
    let (policy, operator) = (Some(Driver::Policy), Some(Driver::Operator));
    assert_eq!(drives(&mut desk, &[]), policy);
    assert_eq!(drives(&mut desk, &[key(Key::KEY_F, 1)]), operator);
    // An open hand holds the arms.
    assert_eq!(drives(&mut desk, &[key(Key::KEY_F, 0)]), operator);
    assert_eq!(drives(&mut desk, &[key(Key::KEY_F, 1)]), operator);
    assert_eq!(drives(&mut desk, &[key(Key::KEY_B, 1)]), policy);
    assert_eq!(drives(&mut desk, &[]), policy, "the clutch is still held");
    assert_eq!(drives(&mut desk, &[key(Key::KEY_F, 0)]), policy);
    assert_eq!(drives(&mut desk, &[key(Key::KEY_F, 1)]), operator);
    let counts = hands.summary().interventions.unwrap();
    assert_eq!((counts.taken_over, counts.handed_back), (2, 1));
}
