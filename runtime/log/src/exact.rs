//! Floating-point numbers in JSON that come back bit for bit, also the non-finite ones, which JSON
//! lacks.
//!
//! The shortest decimal that reads back as the same double (17 digits at most) also keeps `-0.0`
//! and subnormal numbers. Texts stand for what JSON has no number for; other texts are refused.

use core::fmt;

use hal::TipTarget;
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A double in JSON: finite ones as their shortest exact decimal, the others as `"inf"`, `"-inf"`
/// or `"nan:<16 hex digits>"`, the digits being the bits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Exact(pub(super) f64);

/// Bytes of its JSON at most: a sign, 17 digits, the point, and an exponent such as `e-308`.
pub(super) const EXACT_BYTES_MAX: usize = 24;

/// What the text of a NaN begins with.
const NAN: &str = "nan:";

impl Serialize for Exact {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self(value) = *self;
        if value.is_finite() {
            return serializer.serialize_f64(value);
        }
        if value.is_nan() {
            return serializer.collect_str(&format_args!("{NAN}{:016x}", value.to_bits()));
        }
        serializer.serialize_str(if value > 0.0 { "inf" } else { "-inf" })
    }
}

impl<'de> Deserialize<'de> for Exact {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ExactVisitor)
    }
}

/// Takes a JSON number or one of the texts.
struct ExactVisitor;

impl Visitor<'_> for ExactVisitor {
    type Value = Exact;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, \"inf\", \"-inf\" or \"nan:<bits>\"")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Exact, E> {
        Ok(Exact(value))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Exact, E> {
        let value = match text {
            "inf" => Some(f64::INFINITY),
            "-inf" => Some(f64::NEG_INFINITY),
            _ => text
                .strip_prefix(NAN)
                .and_then(|digits| u64::from_str_radix(digits, 16).ok())
                .map(f64::from_bits)
                .filter(|value| value.is_nan()),
        };
        value
            .map(Exact)
            .ok_or_else(|| E::invalid_value(serde::de::Unexpected::Str(text), &self))
    }
}

/// A target as position x, y, z, quaternion x, y, z, w, jaw.
///
/// m and rad, in the arm's RCM frame.
pub(super) fn numbers(target: &TipTarget) -> [Exact; 8] {
    let ([x, y, z], [qx, qy, qz, qw]) = (target.position_m, target.rotation_xyzw);
    [x, y, z, qx, qy, qz, qw, target.jaw].map(Exact)
}

/// The target with these [`numbers`].
pub(super) fn target(numbers: &[Exact; 8]) -> TipTarget {
    let [x, y, z, qx, qy, qz, qw, jaw] = numbers.map(|Exact(value)| value);
    TipTarget {
        position_m: [x, y, z],
        rotation_xyzw: [qx, qy, qz, qw],
        jaw,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn returned(value: f64) -> f64 {
        let text = serde_json::to_string(&Exact(value)).unwrap();
        assert!(text.len() <= EXACT_BYTES_MAX, "{text}");
        let Exact(back) = serde_json::from_str(&text).unwrap();
        back
    }

    #[test]
    fn awkward_numbers_return_with_the_same_bits() {
        let quiet = f64::from_bits(0x7ff8_0000_dead_beef);
        let awkward = [
            0.0,
            -0.0,
            5e-324,
            -5e-324,
            f64::MIN_POSITIVE,
            f64::MAX,
            -1.234_567_890_123_456_7e-308,
            1e308,
            0.1,
            f64::INFINITY,
            f64::NEG_INFINITY,
        ];
        for value in awkward.into_iter().chain([f64::NAN, -f64::NAN, quiet]) {
            assert_eq!(returned(value).to_bits(), value.to_bits(), "{value:?}");
        }
    }

    #[test]
    fn a_hundred_thousand_random_bit_patterns_return() {
        let mut state = 1_u64;
        for _ in 0..100_000 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let value = f64::from_bits(state);
            assert_eq!(returned(value).to_bits(), value.to_bits(), "{state:016x}");
        }
    }

    #[test]
    fn other_texts_are_refused() {
        for text in [
            "\"\"",
            "\"NaN\"",
            "\"nan:3ff0000000000000\"",
            "\"nan:zz\"",
            "null",
        ] {
            assert!(serde_json::from_str::<Exact>(text).is_err(), "{text}");
        }
    }
}
