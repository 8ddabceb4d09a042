//! Frames of all kinds, those that mean something more often than others.

use proptest::prelude::*;
use proptest::sample::select;
use proptest::strategy::Union;
use trocar_canopen::{CanId, Frame, Payload};

/// What kind of frames an arm meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mood {
    /// As `Meaning` but for those that only this arm's master may send and those that say that a
    /// drive has failed, so that the arm lives on among them.
    Bystander,
    /// What drives say, in their name: answers, heartbeats, emergencies.
    Drives,
    /// Identifiers that mean something to these drives and this master, with bytes that half make
    /// sense.
    Meaning,
    /// Any identifier, any bytes.
    Anything,
}

impl Mood {
    /// Its frames.
    pub(crate) fn frames(self) -> BoxedStrategy<Frame> {
        match self {
            Self::Bystander => bystander(),
            Self::Drives => drive(),
            Self::Meaning => meaning(),
            Self::Anything => anything(),
        }
    }
}

pub(crate) fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::new(CanId::truncated(id), Payload::truncated(data))
}

/// Arbitrary bytes, half the time eight of them.
pub(crate) fn payload() -> impl Strategy<Value = Payload> {
    let length = prop_oneof![0..=8_usize, Just(8)];
    (any::<u64>(), length)
        .prop_map(|(bytes, length)| Payload::truncated(&bytes.to_le_bytes()[..length]))
}

/// Any identifier, any bytes.
pub(crate) fn anything() -> BoxedStrategy<Frame> {
    (any::<u16>(), payload())
        .prop_map(|(id, payload)| Frame::new(CanId::truncated(id), payload))
        .boxed()
}

/// One of `choices`, or now and then any byte.
pub(crate) fn mostly(choices: &'static [u8]) -> impl Strategy<Value = u8> {
    prop_oneof![4 => select(choices), 1 => any::<u8>()]
}

/// Those of an arm and one that is nobody's.
fn node() -> impl Strategy<Value = u16> {
    1..=8_u16
}

/// Any bytes under one of `bases` and a node.
fn told(bases: &'static [u16]) -> BoxedStrategy<Frame> {
    (select(bases), node(), payload())
        .prop_map(|(base, node, payload)| Frame::new(CanId::truncated(base + node), payload))
        .boxed()
}

/// Control words on the way to enabled and from there.
pub(crate) const CONTROLS: [u8; 8] = [0x00, 0x02, 0x06, 0x07, 0x0F, 0x0F, 0x1F, 0x80];
/// Low bytes of status words that code a state, and some that do not.
const STATES: [u8; 8] = [0x37, 0x27, 0x40, 0x21, 0x33, 0x17, 0x08, 0x03];
/// Objects of any drive that matter most, and some that are not there.
const OBJECTS: [u16; 29] = [
    0x1000, 0x1003, 0x1005, 0x1010, 0x1011, 0x1014, 0x1016, 0x1017, 0x1018, 0x1019, 0x1029, 0x1400,
    0x1600, 0x1800, 0x1A00, 0x2000, 0x6007, 0x6040, 0x605A, 0x6060, 0x6065, 0x607A, 0x607C, 0x607D,
    0x607F, 0x6080, 0x6085, 0x60C2, 0x5FFF,
];

fn meaning() -> BoxedStrategy<Frame> {
    let nmt = (
        mostly(&[0x01, 0x02, 0x80, 0x81, 0x82]),
        mostly(&[0, 1, 3, 7, 9]),
    );
    let nmt = nmt.prop_map(|(command, node)| frame(0x000, &[command, node]));
    let sync = (select(&[0x080, 0x100][..]), any::<u8>(), 0..4_usize);
    let sync = sync.prop_map(|(id, counter, length)| frame(id, &[counter][..length / 3]));
    let set_point = (
        select(&[0x200, 0x200, 0x300, 0x400, 0x500][..]),
        node(),
        select(&CONTROLS[..]),
        any::<[u8; 3]>(),
        mostly(&[0, 0xFF]),
    );
    let set_point = set_point.prop_map(|(base, node, control, [a, b, c], high)| {
        frame(base + node, &[control, 0, a, b, c, high])
    });
    let download = (
        node(),
        select(&[0x2F, 0x2B, 0x23, 0x23, 0x21, 0x00, 0x01, 0xC2][..]),
        select(&OBJECTS[..]),
        mostly(&[0, 0, 1, 2, 3]),
        mostly(&[0, 1, 3, 8]),
        any::<[u8; 3]>(),
    );
    let download = download.prop_map(|(node, command, object, sub, first, [a, b, c])| {
        let [low, high] = object.to_le_bytes();
        frame(0x600 + node, &[command, low, high, sub, first, a, b, c])
    });
    prop_oneof![
        3 => bystander(),
        2 => drive(),
        3 => set_point,
        1 => sync,
        1 => nmt,
        1 => download,
    ]
    .boxed()
}

fn drive() -> BoxedStrategy<Frame> {
    // Most of them as good as true, so that the arm lives on.
    let true_answer = (node(), any::<[u8; 3]>());
    let true_answer = true_answer.prop_map(|(node, [position, more, torque])| {
        frame(0x180 + node, &[0x37, 0x12, position, more, 0, 0, torque, 0])
    });
    let answer = (node(), select(&STATES[..]), any::<[u8; 4]>());
    let answer = answer.prop_map(|(node, state, [high, a, b, torque])| {
        frame(0x180 + node, &[state, high, a, b, 0, 0, torque, 0])
    });
    let heartbeat = (node(), mostly(&[5, 5, 5, 4, 0, 0x7F]));
    let heartbeat = heartbeat.prop_map(|(node, state)| frame(0x700 + node, &[state]));
    prop_oneof![
        25 => true_answer,
        9 => bystander(),
        3 => told(&[0x180]),
        1 => answer,
        1 => heartbeat,
        1 => told(&[0x080]),
    ]
    .boxed()
}

fn bystander() -> BoxedStrategy<Frame> {
    // Reads and their segments of any object, with or without sense; writes are not a bystander's.
    // What is written is anything, unless it is read.
    let read = (
        node(),
        select(&[0x40, 0x40, 0x60, 0x70, 0x80, 0xA0][..]),
        select(&OBJECTS[..]),
        mostly(&[0, 0, 1, 2, 3]),
        mostly(&[0, 1, 8]),
        any::<[u8; 3]>(),
    );
    let read = read.prop_map(|(node, command, object, sub, first, [a, b, c])| {
        let [low, high] = object.to_le_bytes();
        frame(0x600 + node, &[command, low, high, sub, first, a, b, c])
    });
    let other_arm = told(&[0x08A, 0x18A, 0x20A, 0x58A, 0x60A, 0x70A]);
    Union::new_weighted(vec![
        (4, read.boxed()),
        (1, told(&[0x580])),
        (1, other_arm),
        (1, told(&[0x280, 0x380, 0x480])),
        (1, told(&[0x780, 0x7C0])),
    ])
    .boxed()
}
