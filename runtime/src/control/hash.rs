//! One number for all commands of a run. Hot path: bounded, no allocation, no I/O, no lock.

use hal::ArmCommand;

/// FNV-1a, 64 bits, over the bits of every command: two runs are the same if and only if their hashes are (but for a
/// collision).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandHash(u64);

const OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const PRIME: u64 = 0x0000_0100_0000_01b3;

impl CommandHash {
    /// The hash of no command.
    #[must_use]
    pub const fn new() -> Self {
        Self(OFFSET)
    }

    /// Takes in one command: stamp, joint positions and velocities, jaw, and whether the drives hold torque.
    pub fn add(&mut self, command: &ArmCommand) {
        self.word(command.stamp.0);
        for value in command.position.iter().chain(command.velocity.iter()) {
            self.word(value.to_bits());
        }
        self.word(command.jaw_position.to_bits());
        self.word(command.jaw_velocity.to_bits());
        self.word(u64::from(command.enabled));
    }

    /// The hash so far.
    #[must_use]
    pub const fn value(self) -> u64 {
        self.0
    }

    fn word(&mut self, word: u64) {
        for byte in word.to_le_bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(PRIME);
        }
    }
}

impl Default for CommandHash {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::CommandHash;
    use hal::{ArmCommand, JointVector, TimeNs};

    #[test]
    fn words_hash_like_the_published_fnv_1a() {
        let mut hash = CommandHash::new();
        hash.word(u64::from_le_bytes(*b"foobarba"));
        let mut expected: u64 = 0xcbf2_9ce4_8422_2325;
        for byte in b"foobarba" {
            expected = (expected ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
        assert_eq!(hash.value(), expected);
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
}
