//! Modes of operation, and the interpolation period of the cyclic ones.
//!
//! CiA 402-2: tables 59 (6060h), 61 (6502h), 138 and 139 (60C2h).

use crate::WireError;

/// A mode of operation, as 6060h asks for it and 6061h shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// No mode.
    None,
    /// The drive makes the profile to a position.
    ProfilePosition,
    /// Frequency converter's velocity.
    Velocity,
    /// The drive makes the profile to a velocity.
    ProfileVelocity,
    /// The drive makes the profile to a torque.
    ProfileTorque,
    /// The drive finds its reference.
    Homing,
    /// Positions with the drive's interpolation.
    InterpolatedPosition,
    /// A position each SYNC.
    CyclicPosition,
    /// A velocity each SYNC.
    CyclicVelocity,
    /// A torque each SYNC.
    CyclicTorque,
}

impl Mode {
    /// Its number.
    #[must_use]
    pub const fn raw(self) -> i8 {
        match self {
            Self::None => 0,
            Self::ProfilePosition => 1,
            Self::Velocity => 2,
            Self::ProfileVelocity => 3,
            Self::ProfileTorque => 4,
            Self::Homing => 6,
            Self::InterpolatedPosition => 7,
            Self::CyclicPosition => 8,
            Self::CyclicVelocity => 9,
            Self::CyclicTorque => 10,
        }
    }

    /// Its bit in 6502h; none for no mode.
    #[must_use]
    pub const fn supported_bit(self) -> u32 {
        match self {
            Self::None => 0,
            Self::ProfilePosition => 1 << 0,
            Self::Velocity => 1 << 1,
            Self::ProfileVelocity => 1 << 2,
            Self::ProfileTorque => 1 << 3,
            Self::Homing => 1 << 5,
            Self::InterpolatedPosition => 1 << 6,
            Self::CyclicPosition => 1 << 7,
            Self::CyclicVelocity => 1 << 8,
            Self::CyclicTorque => 1 << 9,
        }
    }
}

impl TryFrom<i8> for Mode {
    type Error = WireError;

    fn try_from(raw: i8) -> Result<Self, WireError> {
        Ok(match raw {
            0 => Self::None,
            1 => Self::ProfilePosition,
            2 => Self::Velocity,
            3 => Self::ProfileVelocity,
            4 => Self::ProfileTorque,
            6 => Self::Homing,
            7 => Self::InterpolatedPosition,
            8 => Self::CyclicPosition,
            9 => Self::CyclicVelocity,
            10 => Self::CyclicTorque,
            _ => {
                return Err(WireError::Value {
                    field: "mode of operation",
                    value: u32::from(raw.cast_unsigned()),
                });
            }
        })
    }
}

/// The period that 60C2h says, ns: `value * 10^exponent` seconds; none if it is zero, or no whole
/// number of nanoseconds, or longer than 255 s.
#[must_use]
pub fn period_ns(value: u8, exponent: i8) -> Option<u64> {
    if value == 0 || !(-9..=0).contains(&exponent) {
        return None;
    }
    let power = u32::from((exponent + 9).unsigned_abs());
    Some(u64::from(value) * 10_u64.pow(power))
}

/// The value and exponent that say `period_ns` exactly, none if there are none.
#[must_use]
pub fn period_parameter(period_ns: u64) -> Option<(u8, i8)> {
    let (mut value, mut exponent) = (period_ns, -9_i8);
    while value > 0 && value.is_multiple_of(10) && exponent < 0 {
        value /= 10;
        exponent += 1;
    }
    u8::try_from(value)
        .ok()
        .filter(|&value| value > 0)
        .map(|value| (value, exponent))
}
