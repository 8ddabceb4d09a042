//! Frames of all kinds, and the numbers that they are made of (splitmix64).

use hal::can::{CanId, Frame, Payload};

/// A seeded stream.
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub(crate) fn below(&mut self, count: u64) -> u64 {
        self.next() % count
    }

    fn pick<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[usize::try_from(self.below(choices.len() as u64)).unwrap()]
    }

    /// Arbitrary bytes, half the time eight of them.
    fn payload(&mut self) -> Payload {
        let length = if self.below(2) == 0 { 8 } else { self.below(9) };
        let bytes = self.next().to_le_bytes();
        Payload::truncated(&bytes[..usize::try_from(length).unwrap()])
    }
}

/// What kind of frames a life meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mood {
    /// Any identifier, any bytes.
    Anything,
    /// Identifiers that mean something to these drives and this master, with bytes that half make sense.
    Meaning,
    /// What drives say, in their name: answers, heartbeats, emergencies.
    Drives,
    /// As `Meaning` but for those that only this arm's master may send and those that say that a drive has failed, so that the
    /// arm lives on among them.
    Bystander,
    /// As `Meaning`, and during the bring-up too.
    FromTheStart,
}

impl Mood {
    /// Each life has its own.
    pub(crate) fn of(seed: u64) -> Self {
        match seed % 8 {
            0 => Self::Anything,
            1 | 2 => Self::Drives,
            3 => Self::Meaning,
            4..=6 => Self::Bystander,
            _ => Self::FromTheStart,
        }
    }

    /// A frame of this mood.
    pub(crate) fn frame(self, random: &mut Random) -> Frame {
        match self {
            Self::Anything => {
                let [low, high, ..] = random.next().to_le_bytes();
                let id = CanId::truncated(u16::from_le_bytes([low, high]));
                Frame::new(id, random.payload())
            }
            Self::Meaning | Self::FromTheStart => meaning(random),
            Self::Drives => drive(random),
            Self::Bystander => bystander(random),
        }
    }
}

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::new(CanId::truncated(id), Payload::truncated(data))
}

/// Control words on the way to enabled and from there.
const CONTROLS: [u8; 8] = [0x00, 0x02, 0x06, 0x07, 0x0F, 0x0F, 0x1F, 0x80];
/// Low bytes of status words that code a state, and some that do not.
const STATES: [u8; 8] = [0x40, 0x21, 0x33, 0x37, 0x37, 0x17, 0x08, 0x03];
/// Objects of any drive that matter most, and some that are not there.
const OBJECTS: [u16; 28] = [
    0x1000, 0x1003, 0x1005, 0x1010, 0x1011, 0x1014, 0x1016, 0x1017, 0x1018, 0x1019, 0x1029, 0x1400,
    0x1600, 0x1800, 0x1A00, 0x2000, 0x6007, 0x6040, 0x605A, 0x6060, 0x6065, 0x607A, 0x607C, 0x607D,
    0x6080, 0x6085, 0x60C2, 0x5FFF,
];

fn meaning(random: &mut Random) -> Frame {
    let node = u16::try_from(random.below(8)).unwrap() + 1;
    let [a, b, c, d, ..] = random.next().to_le_bytes();
    match random.below(10) {
        0 => {
            let command = random.pick(&[0x01, 0x02, 0x80, 0x81, 0x82, a]);
            frame(0x000, &[command, random.pick(&[0, 1, 3, 7, 9, b])])
        }
        1 => {
            let length = usize::from(random.below(4) == 0);
            frame(random.pick(&[0x080, 0x100]), &[a][..length])
        }
        2..=4 => {
            let id = random.pick(&[0x200, 0x200, 0x300, 0x400, 0x500]) + node;
            frame(
                id,
                &[
                    random.pick(&CONTROLS),
                    0,
                    a,
                    b,
                    c,
                    random.pick(&[0, 0xFF, d]),
                ],
            )
        }
        5 | 6 => drive(random),
        _ => bystander(random),
    }
}

fn drive(random: &mut Random) -> Frame {
    let node = u16::try_from(random.below(8)).unwrap() + 1;
    let [a, b, c, d, ..] = random.next().to_le_bytes();
    match random.below(40) {
        0 => frame(0x080 + node, random.payload().as_slice()),
        1 => frame(0x700 + node, &[random.pick(&[0, 4, 5, 5, 5, 0x7F, a])]),
        2..=4 => frame(0x180 + node, random.payload().as_slice()),
        5 => frame(0x180 + node, &[random.pick(&STATES), c, a, b, 0, 0, d, 0]),
        // Most of them as good as true, so that the arm lives on.
        6..=30 => frame(0x180 + node, &[0x37, 0x12, a, b, 0, 0, c, 0]),
        _ => bystander(random),
    }
}

fn bystander(random: &mut Random) -> Frame {
    let node = u16::try_from(random.below(8)).unwrap() + 1;
    let [a, b, c, d, ..] = random.next().to_le_bytes();
    match random.below(8) {
        // Reads and their segments of any object, with or without sense; writes are not a bystander's.
        0..=3 => {
            let command = random.pick(&[0x40, 0x40, 0x60, 0x70, 0x80, 0xA0]);
            let [low, high] = random.pick(&OBJECTS).to_le_bytes();
            let sub = random.pick(&[0, 0, 1, 2, 3, b]);
            // What is written is anything, unless it is read.
            let data = [command, low, high, sub, random.pick(&[0, 1, 8, c]), d, b, a];
            frame(0x600 + node, &data)
        }
        4 => frame(0x580 + node, random.payload().as_slice()),
        // The other arm's.
        5 => {
            let other = node + 10;
            let base = random.pick(&[0x080, 0x180, 0x200, 0x580, 0x600, 0x700]);
            frame(base + other, random.payload().as_slice())
        }
        6 => frame(
            random.pick(&[0x280, 0x380, 0x480]) + node,
            random.payload().as_slice(),
        ),
        _ => frame(0x780 + u16::from(a & 0x7F), random.payload().as_slice()),
    }
}
