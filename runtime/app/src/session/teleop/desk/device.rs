//! What a keyboard, a gamepad or a SpaceMouse asks for: the same controls as those of the page.

use std::collections::BTreeMap;

use evdev::{AbsoluteAxisCode as Abs, EventType, KeyCode as Key};
use hal::TimeNs;
use nalgebra::Vector3;

use super::super::EpisodeCommand;
use super::events::Event;
use super::hand::DeviceAxes;

// Of a hand: the tip makes a part of the way.
const KEY_M_S: f64 = 0.1;
const KEY_RAD_S: f64 = 0.8;
const JAW_1_S: f64 = 1.2;
const STICK_M_S: f64 = 0.12;
const STICK_RAD_S: f64 = 1.0;

/// Share of its way within which a stick or a cap rests.
const STICK_DEAD: f64 = 0.15;
const CAP_DEAD: f64 = 0.03;

/// What a cap tells when it is pushed as far as it goes.
const CAP_FULL: f64 = 350.0;

/// A cap whose deflections are told as ways tells them again and again while it is pushed.
const SILENT_NS: u64 = 200_000_000;

/// `SYN_DROPPED`: events were lost.
const DROPPED: u16 = 3;

/// The first buttons of a SpaceMouse.
const CAP_CLUTCH: Key = Key::BTN_0;
const CAP_JAW: Key = Key::BTN_1;

/// What a key does while the clutch is held: of the way, of the turn, or the jaw (6).
const KEYS: [(Key, usize, f64); 14] = [
    (Key::KEY_RIGHT, 0, 1.0),
    (Key::KEY_LEFT, 0, -1.0),
    (Key::KEY_UP, 1, 1.0),
    (Key::KEY_DOWN, 1, -1.0),
    (Key::KEY_PAGEDOWN, 2, 1.0),
    (Key::KEY_PAGEUP, 2, -1.0),
    (Key::KEY_I, 3, 1.0),
    (Key::KEY_K, 3, -1.0),
    (Key::KEY_J, 4, 1.0),
    (Key::KEY_L, 4, -1.0),
    (Key::KEY_U, 5, 1.0),
    (Key::KEY_O, 5, -1.0),
    (Key::KEY_M, 6, 1.0),
    (Key::KEY_N, 6, -1.0),
];

/// What is said by a press, and by nothing that is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ButtonAction {
    /// This arm is to be moved.
    Arm(usize),
    /// The other one is.
    OtherArm,
    /// What is to become of the demonstration.
    EpisodeCommand(EpisodeCommand),
    /// The policy gets the arms back.
    HandBack,
}

const PRESSES: [(Key, ButtonAction); 13] = [
    (Key::KEY_1, ButtonAction::Arm(0)),
    (Key::KEY_2, ButtonAction::Arm(1)),
    (Key::BTN_WEST, ButtonAction::OtherArm),
    (Key::KEY_B, ButtonAction::HandBack),
    (Key::BTN_TR, ButtonAction::HandBack),
    (
        Key::KEY_G,
        ButtonAction::EpisodeCommand(EpisodeCommand::Start),
    ),
    (
        Key::BTN_START,
        ButtonAction::EpisodeCommand(EpisodeCommand::Start),
    ),
    (
        Key::KEY_Y,
        ButtonAction::EpisodeCommand(EpisodeCommand::Keep),
    ),
    (
        Key::BTN_SOUTH,
        ButtonAction::EpisodeCommand(EpisodeCommand::Keep),
    ),
    (
        Key::KEY_Z,
        ButtonAction::EpisodeCommand(EpisodeCommand::Redo),
    ),
    (
        Key::BTN_SELECT,
        ButtonAction::EpisodeCommand(EpisodeCommand::Redo),
    ),
    (
        Key::KEY_X,
        ButtonAction::EpisodeCommand(EpisodeCommand::Discard),
    ),
    (
        Key::BTN_EAST,
        ButtonAction::EpisodeCommand(EpisodeCommand::Discard),
    ),
];

/// A device as its events left it.
#[derive(Debug, Default)]
pub(super) struct Device {
    is_cap: bool,
    ranges: BTreeMap<u16, (i32, i32)>,
    /// Keys that are down, since when.
    down: BTreeMap<u16, TimeNs>,
    /// Absolute axes as the device tells them, -1 to 1, a trigger 0 to 1.
    axes: BTreeMap<u16, f64>,
    /// Deflections of a cap, way and turn, and when each of both was told; what this frame says of
    /// them.
    cap: [f64; 6],
    told: [Option<TimeNs>; 2],
    frame: [Option<f64>; 6],
    /// Whether the jaw is to change its direction, and which one it has.
    flips: bool,
    closing: f64,
}

impl Device {
    pub(super) fn new(is_cap: bool, ranges: BTreeMap<u16, (i32, i32)>) -> Self {
        Self {
            is_cap,
            ranges,
            ..Self::default()
        }
    }

    /// As if all were let go: keys have to be pressed anew.
    pub(super) fn clear(&mut self) {
        let ranges = core::mem::take(&mut self.ranges);
        *self = Self::new(self.is_cap, ranges);
    }

    /// Takes in an event that came `now`.
    pub(super) fn take(&mut self, event: Event, now: TimeNs) -> Option<ButtonAction> {
        let Event { kind, code, value } = event;
        match EventType(kind) {
            EventType::KEY if value == 1 => return self.press(code, now),
            EventType::KEY if value == 0 => {
                self.down.remove(&code);
                if code == CAP_CLUTCH.code() {
                    self.closing = 0.0;
                }
            }
            EventType::ABSOLUTE => self.turn_to(code, value),
            EventType::RELATIVE => self.deflect(code, value),
            EventType::SYNCHRONIZATION if code == DROPPED => self.clear(),
            EventType::SYNCHRONIZATION => self.end_frame(now),
            _ => {}
        }
        None
    }

    fn press(&mut self, code: u16, now: TimeNs) -> Option<ButtonAction> {
        self.down.insert(code, now);
        self.flips |= code == CAP_JAW.code() && self.is_down(CAP_CLUTCH);
        let said = PRESSES.iter().find(|(key, _)| key.code() == code);
        said.map(|(_, said)| *said)
    }

    fn is_down(&self, key: Key) -> bool {
        self.down.contains_key(&key.code())
    }

    fn turn_to(&mut self, code: u16, value: i32) {
        if self.is_cap {
            if let Some(axis) = self.cap.get_mut(usize::from(code)) {
                *axis = f64::from(value) / CAP_FULL;
                self.told = [None; 2];
            }
            return;
        }
        let (low, high) = self.ranges.get(&code).copied().unwrap_or(usual(Abs(code)));
        let (low, high) = (f64::from(low), f64::from(high));
        let share = (f64::from(value) - low) / (high - low).max(1.0);
        let is_trigger = matches!(Abs(code), Abs::ABS_Z | Abs::ABS_RZ);
        let value = if is_trigger { share } else { 2.0 * share - 1.0 };
        self.axes.insert(code, value);
    }

    fn deflect(&mut self, code: u16, value: i32) {
        if let Some(axis) = self.frame.get_mut(usize::from(code)) {
            *axis = Some(f64::from(value) / CAP_FULL);
        }
    }

    /// A frame tells way or turn; an axis of it that is not told is 0.
    fn end_frame(&mut self, now: TimeNs) {
        for (half, axes) in [0..3, 3..6].into_iter().enumerate() {
            let told = &self.frame[axes.clone()];
            if told.iter().any(Option::is_some) {
                for axis in axes {
                    self.cap[axis] = self.frame[axis].unwrap_or(0.0);
                }
                self.told[half] = Some(now);
            }
        }
        self.frame = [None; 6];
    }

    /// What it asks for `now`; the jaw of its hand is closed so far, 0 to 1.
    pub(super) fn asked(&mut self, now: TimeNs, jaw: f64) -> DeviceAxes {
        if core::mem::take(&mut self.flips) {
            self.closing = if jaw < 0.5 { 1.0 } else { -1.0 };
        }
        let keys = self.by_keys(now);
        keys.and(self.by_pad()).and(self.by_cap(now))
    }

    fn by_keys(&self, now: TimeNs) -> DeviceAxes {
        let mut asked = [0.0; 7];
        for (key, axis, sign) in KEYS {
            if let Some(since) = self.down.get(&key.code()) {
                // A tap moves little: the speed grows while a key is held.
                let held_s = TimeNs(now.since(*since)).seconds();
                let pace = if axis < 6 {
                    (0.2 + 2.0 * held_s).min(1.0)
                } else {
                    1.0
                };
                asked[axis] += sign * pace;
            }
        }
        let [x, y, z, a, b, c, jaw] = asked;
        DeviceAxes {
            clutch: self.is_down(Key::KEY_F),
            way: KEY_M_S * Vector3::new(x, y, z),
            turn: KEY_RAD_S * Vector3::new(a, b, c),
            jaw: JAW_1_S * jaw,
            trigger: None,
        }
    }

    fn by_pad(&self) -> DeviceAxes {
        let axis = |axis: Abs| self.axes.get(&axis.0).copied().unwrap_or(0.0);
        let stick = |which: Abs| fine(axis(which), STICK_DEAD);
        let way = Vector3::new(stick(Abs::ABS_X), -stick(Abs::ABS_Y), stick(Abs::ABS_RY));
        let cross = [Abs::ABS_HAT0Y, Abs::ABS_HAT0X].map(|hat| -axis(hat));
        let turn = Vector3::new(cross[0], cross[1], -stick(Abs::ABS_RX));
        DeviceAxes {
            clutch: self.is_down(Key::BTN_TL),
            way: STICK_M_S * way,
            turn: STICK_RAD_S * turn,
            jaw: 0.0,
            trigger: Some(axis(Abs::ABS_RZ).clamp(0.0, 1.0)),
        }
    }

    fn by_cap(&self, now: TimeNs) -> DeviceAxes {
        let mut asked = DeviceAxes {
            clutch: self.is_down(CAP_CLUTCH),
            jaw: JAW_1_S * self.closing,
            ..DeviceAxes::default()
        };
        let [x, y, z, a, b, c] = self.cap.map(|value| fine(value, CAP_DEAD));
        // The kernel passes on no 0: a half that springs back reports nothing.
        let holds = |told: Option<TimeNs>| told.is_none_or(|told| now.since(told) <= SILENT_NS);
        let [way, turn] = self.told.map(holds);
        // Its axes are x to the right, y towards the person, z down.
        if way {
            asked.way = STICK_M_S * Vector3::new(x, -z, y);
        }
        if turn {
            asked.turn = STICK_RAD_S * Vector3::new(a, -c, b);
        }
        asked
    }
}

/// A deflection beyond the dead zone, finer near its middle.
fn fine(value: f64, dead: f64) -> f64 {
    let beyond = (value.abs() - dead).max(0.0) / (1.0 - dead);
    value.signum() * beyond.min(1.0).powi(2)
}

/// The ends of a gamepad's axis, where it does not tell them.
const fn usual(axis: Abs) -> (i32, i32) {
    match axis {
        Abs::ABS_Z | Abs::ABS_RZ => (0, 255),
        Abs::ABS_HAT0X | Abs::ABS_HAT0Y => (-1, 1),
        _ => (-32768, 32767),
    }
}
