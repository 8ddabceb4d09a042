//! One number for all commands of a run, and one for all inputs. Hot path: bounded, no allocation,
//! no I/O, no lock.
//!
//! Numbers go in by their bits, so `0.0` and `-0.0` differ, and two NaN are the same only with the
//! same payload. Each word is taken in from its lowest byte on. The hash tells runs apart; it is not
//! collision-resistant.

use hal::{ArmCommand, ArmError, ArmState, Chunk, TimeNs};

use super::mode::OperatorEvent;

/// FNV-1a's offset basis and prime for 64 bits (Fowler, Noll and Vo).
const OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const PRIME: u64 = 0x0000_0100_0000_01b3;

/// FNV-1a, 64 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Fnv1a(u64);

impl Fnv1a {
    const fn new() -> Self {
        Self(OFFSET)
    }

    /// Eight rounds of `(hash ^ byte) * prime`.
    fn word(&mut self, word: u64) {
        for byte in word.to_le_bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(PRIME);
        }
    }

    fn numbers<'a>(&mut self, values: impl IntoIterator<Item = &'a f64>) {
        for value in values {
            self.word(value.to_bits());
        }
    }
}

/// FNV-1a, 64 bits, over the bits of what every command tells the drives: all of it but the
/// accelerations, which are information. Two runs tell their drives the same if and only if their
/// hashes are the same (but for a collision).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandHash(Fnv1a);

impl CommandHash {
    /// The hash of no command.
    #[must_use]
    pub const fn new() -> Self {
        Self(Fnv1a::new())
    }

    /// The hash whose [`Self::value`] was `value`, to go on with.
    #[must_use]
    pub const fn resumed(value: u64) -> Self {
        Self(Fnv1a(value))
    }

    /// Takes in one command: stamp, joint positions and velocities, jaw, and whether the drives
    /// hold torque.
    pub fn add(&mut self, command: &ArmCommand) {
        let Self(hash) = self;
        hash.word(command.stamp.0);
        hash.numbers(command.position.iter().chain(command.velocity.iter()));
        hash.numbers([&command.jaw_position, &command.jaw_velocity]);
        hash.word(u64::from(command.enabled));
    }

    /// The hash so far.
    #[must_use]
    pub const fn value(self) -> u64 {
        self.0.0
    }
}

impl Default for CommandHash {
    fn default() -> Self {
        Self::new()
    }
}

/// FNV-1a, 64 bits, over the bits of everything that the controller was given: two runs saw the
/// same if and only if their hashes are the same (but for a collision).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputHash(Fnv1a);

impl InputHash {
    /// The hash of no input.
    #[must_use]
    pub const fn new() -> Self {
        Self(Fnv1a::new())
    }

    /// The hash whose [`Self::value`] was `value`, to go on with.
    #[must_use]
    pub const fn resumed(value: u64) -> Self {
        Self(Fnv1a(value))
    }

    /// Takes in the chunk that the arm `arm`, counted from 0, is given in the coming tick, up to
    /// its length.
    pub fn chunk(&mut self, arm: usize, chunk: &Chunk) {
        let Self(hash) = self;
        // The first arm goes without its number, so that the hash of a run of one arm is what it
        // always was.
        if arm > 0 {
            hash.word(arm as u64);
        }
        for word in [chunk.observed_at.0, chunk.sequence, chunk.step_ns] {
            hash.word(word);
        }
        hash.word(u64::from(chunk.len));
        hash.word(u64::from(chunk.reserved));
        for target in chunk.valid_targets() {
            hash.numbers(&target.position_m);
            hash.numbers(&target.rotation_xyzw);
            hash.word(target.jaw.to_bits());
        }
    }

    /// Takes in the rest of one arm's input: its time, the measurement or why there is none, and
    /// the operator's wish.
    ///
    /// Of two arms the first comes first, after the chunks of both.
    pub fn tick(
        &mut self,
        now: TimeNs,
        measured: &Result<ArmState, ArmError>,
        operator: Option<OperatorEvent>,
    ) {
        let Self(hash) = self;
        hash.word(now.0);
        match *measured {
            Ok(ref arm) => {
                hash.word(0);
                hash.word(arm.stamp.0);
                for vector in [&arm.position, &arm.velocity, &arm.effort] {
                    hash.numbers(vector);
                }
                hash.numbers([&arm.jaw_position, &arm.jaw_velocity, &arm.jaw_effort]);
            }
            Err(ArmError::MeasurementLost { age_ns }) => {
                hash.word(1);
                hash.word(age_ns);
            }
            Err(ArmError::DriveFault { axis, code }) => {
                hash.word(2);
                hash.word(u64::from(axis));
                hash.word(u64::from(code));
            }
            Err(ArmError::EndOfRecording) => hash.word(3),
        }
        hash.word(match operator {
            None => 0,
            Some(OperatorEvent::Enable) => 1,
            Some(OperatorEvent::Disable) => 2,
            Some(OperatorEvent::Pause) => 3,
            Some(OperatorEvent::Resume) => 4,
            Some(OperatorEvent::Clear) => 5,
            Some(OperatorEvent::Speed { percent }) => 6 | u64::from(percent) << 8,
            Some(OperatorEvent::TakeOver) => 7,
            Some(OperatorEvent::HandBack) => 8,
            Some(OperatorEvent::GoOn) => 9,
        });
    }

    /// The hash so far.
    #[must_use]
    pub const fn value(self) -> u64 {
        self.0.0
    }
}

impl Default for InputHash {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::{CommandHash, Fnv1a, InputHash};
    use crate::OperatorEvent;
    use hal::{ArmCommand, ArmError, JointVector, TimeNs};

    #[test]
    fn words_hash_like_the_published_fnv_1a() {
        let mut hash = Fnv1a::new();
        hash.word(u64::from_le_bytes(*b"foobarba"));
        let mut expected: u64 = 0xcbf2_9ce4_8422_2325;
        for byte in b"foobarba" {
            expected = (expected ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
        assert_eq!(hash.0, expected);
        assert_eq!(CommandHash::new().value(), 0xcbf2_9ce4_8422_2325);
    }

    #[test]
    fn one_flipped_bit_changes_the_hash() {
        let command = ArmCommand {
            stamp: TimeNs(7),
            position: JointVector::new(0.1, 0.2, 0.1, 0.0, 0.0, 0.0),
            velocity: JointVector::zeros(),
            acceleration: JointVector::zeros(),
            jaw_position: 0.3,
            jaw_velocity: 0.0,
            enabled: true,
        };
        let hash_of = |command: &ArmCommand| {
            let mut hash = CommandHash::new();
            hash.add(command);
            hash.value()
        };
        let mut other = command;
        other.position[4] = f64::from_bits(1);
        assert_ne!(hash_of(&command), hash_of(&other));
        assert_eq!(hash_of(&command), hash_of(&command));
    }

    /// Every reason for no measurement and every wish hashes differently.
    #[test]
    fn missing_measurements_and_wishes_hash_differently() {
        let errors = [
            ArmError::MeasurementLost { age_ns: 0 },
            ArmError::MeasurementLost { age_ns: 1 },
            ArmError::DriveFault { axis: 0, code: 1 },
            ArmError::DriveFault { axis: 1, code: 0 },
            ArmError::EndOfRecording,
        ];
        let wishes = [
            None,
            Some(OperatorEvent::Enable),
            Some(OperatorEvent::Disable),
            Some(OperatorEvent::Pause),
            Some(OperatorEvent::Resume),
            Some(OperatorEvent::Clear),
            Some(OperatorEvent::Speed { percent: 0 }),
            Some(OperatorEvent::Speed { percent: 100 }),
        ];
        let mut values = std::collections::BTreeSet::new();
        for error in errors {
            for wish in wishes {
                let mut hash = InputHash::new();
                hash.tick(TimeNs(5), &Err(error), wish);
                values.insert(hash.value());
            }
        }
        assert_eq!(values.len(), errors.len() * wishes.len());
    }
}
