//! Values as words of 64 bits, and back. Hot path: bounded, no allocation, no I/O, no lock; but
//! reading back allocates.

use hal::{ArmError, Chunk, TimeNs};
use nalgebra::Vector3;

use super::{HeldChunk, Snapshot, SnapshotError};

/// A value that is state as a whole. The bits of numbers stay.
pub(crate) trait Words: Sized {
    /// Names, types and order of its parts.
    const LAYOUT: u64;

    /// How many words it takes at most.
    const WORDS_MAX: usize;

    /// Adds it to a snapshot.
    fn put(&self, to: &mut Snapshot);

    /// Reads it back.
    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError>;
}

/// A part of a controller, of which something is state.
pub(crate) trait Stateful {
    /// Names, types and order of what is state.
    const LAYOUT: u64;

    /// How many words its state takes at most.
    const WORDS_MAX: usize;

    /// Adds its state to a snapshot.
    fn save(&self, to: &mut Snapshot);

    /// Takes over the state of another that was built from the same configuration. It is of no use
    /// after an error.
    fn restore(&mut self, from: &mut Reader<'_>) -> Result<(), SnapshotError>;
}

impl<T: Words> Stateful for T {
    const LAYOUT: u64 = <T as Words>::LAYOUT;
    const WORDS_MAX: usize = <T as Words>::WORDS_MAX;

    fn save(&self, to: &mut Snapshot) {
        self.put(to);
    }

    fn restore(&mut self, from: &mut Reader<'_>) -> Result<(), SnapshotError> {
        *self = T::take(from)?;
        Ok(())
    }
}

/// What is left to be read of a snapshot.
///
/// Reads in the order in which the words were put. A value that a controller cannot hold is an
/// error, so that a damaged log does not become a state.
pub(crate) struct Reader<'a> {
    words: core::slice::Iter<'a, u64>,
    held: &'a [HeldChunk],
    chunks: &'a [Chunk],
}

impl<'a> Reader<'a> {
    pub(super) fn new(words: &'a [u64], held: &'a [HeldChunk], chunks: &'a [Chunk]) -> Self {
        Self {
            words: words.iter(),
            held,
            chunks,
        }
    }

    /// The next word.
    pub(crate) fn word(&mut self) -> Result<u64, SnapshotError> {
        self.words.next().copied().ok_or(SnapshotError::Impossible)
    }

    /// The chunks that the arm `arm` held, with their places.
    pub(crate) fn chunks(&self, arm: usize) -> impl Iterator<Item = (usize, &'a Chunk)> {
        let held = self.held.iter().zip(self.chunks);
        let own = held.filter(move |(held, _)| held.arm == arm);
        own.map(|(held, chunk)| (held.slot, chunk))
    }

    /// That nothing is left.
    pub(crate) fn finish(mut self) -> Result<(), SnapshotError> {
        possible(self.words.next().is_none())
    }
}

/// An error unless `holds`.
pub(crate) const fn possible(holds: bool) -> Result<(), SnapshotError> {
    if holds {
        Ok(())
    } else {
        Err(SnapshotError::Impossible)
    }
}

/// The layout of what is called `name`, with these `parts`: FNV-1a, 64 bits.
///
/// A constant of the type: a snapshot with other fields, other names or another order is refused
/// before a word of it is read.
pub(crate) const fn layout(name: &str, parts: &[u64]) -> u64 {
    let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
    let mut at = 0;
    while at < name.len() {
        hash = (hash ^ name.as_bytes()[at] as u64).wrapping_mul(0x0000_0100_0000_01b3);
        at += 1;
    }
    at = 0;
    while at < parts.len() {
        let mut byte = 0;
        while byte < 8 {
            let value = (parts[at] >> (8 * byte)) & 0xff;
            hash = (hash ^ value).wrapping_mul(0x0000_0100_0000_01b3);
            byte += 1;
        }
        at += 1;
    }
    hash
}

/// Makes [`Words`] of a structure that is state with all of its fields.
macro_rules! words {
    ($name:ident { $($field:ident: $kind:ty),+ $(,)? }) => {
        impl $crate::snapshot::Words for $name {
            const LAYOUT: u64 = $crate::snapshot::layout(
                concat!(stringify!($name), $(" ", stringify!($field)),+),
                &[$(<$kind as $crate::snapshot::Words>::LAYOUT),+],
            );
            const WORDS_MAX: usize = 0 $(+ <$kind as $crate::snapshot::Words>::WORDS_MAX)+;

            fn put(&self, to: &mut $crate::snapshot::Snapshot) {
                let Self { $($field),+ } = self;
                $(<$kind as $crate::snapshot::Words>::put($field, to);)+
            }

            fn take(
                from: &mut $crate::snapshot::Reader<'_>,
            ) -> Result<Self, $crate::snapshot::SnapshotError> {
                Ok(Self { $($field: <$kind as $crate::snapshot::Words>::take(from)?),+ })
            }
        }
    };
}

/// Makes a structure [`Stateful`] of which the first fields are state and the others, all named,
/// are not.
macro_rules! state {
    (
        $name:ident { $($field:ident: $kind:ty),+ $(,)? }
        beside { $($(#[$attribute:meta])* $beside:ident),+ $(,)? }
    ) => {
        impl $crate::snapshot::Stateful for $name {
            const LAYOUT: u64 = $crate::snapshot::layout(
                concat!(stringify!($name), $(" ", stringify!($field)),+),
                &[$(<$kind as $crate::snapshot::Stateful>::LAYOUT),+],
            );
            const WORDS_MAX: usize = 0 $(+ <$kind as $crate::snapshot::Stateful>::WORDS_MAX)+;

            fn save(&self, to: &mut $crate::snapshot::Snapshot) {
                let Self { $($field,)+ $($(#[$attribute])* $beside: _,)+ } = self;
                $(<$kind as $crate::snapshot::Stateful>::save($field, to);)+
            }

            fn restore(
                &mut self,
                from: &mut $crate::snapshot::Reader<'_>,
            ) -> Result<(), $crate::snapshot::SnapshotError> {
                let Self { $($field,)+ $($(#[$attribute])* $beside: _,)+ } = self;
                $(<$kind as $crate::snapshot::Stateful>::restore($field, from)?;)+
                Ok(())
            }
        }
    };
}

pub(crate) use {state, words};

impl Words for u64 {
    const LAYOUT: u64 = layout("u64", &[]);
    const WORDS_MAX: usize = 1;

    fn put(&self, to: &mut Snapshot) {
        to.push(*self);
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        from.word()
    }
}

impl Words for f64 {
    const LAYOUT: u64 = layout("f64", &[]);
    const WORDS_MAX: usize = 1;

    fn put(&self, to: &mut Snapshot) {
        to.push(self.to_bits());
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        from.word().map(Self::from_bits)
    }
}

/// Makes [`Words`] of smaller whole numbers.
macro_rules! whole_numbers {
    ($($kind:ty),+) => {$(
        impl Words for $kind {
            const LAYOUT: u64 = layout(stringify!($kind), &[]);
            const WORDS_MAX: usize = 1;

            fn put(&self, to: &mut Snapshot) {
                to.push(*self as u64);
            }

            fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
                Self::try_from(from.word()?).map_err(|_| SnapshotError::Impossible)
            }
        }
    )+};
}

whole_numbers!(u8, u16, usize);

impl Words for bool {
    const LAYOUT: u64 = layout("bool", &[]);
    const WORDS_MAX: usize = 1;

    fn put(&self, to: &mut Snapshot) {
        to.push(u64::from(*self));
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        match from.word()? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(SnapshotError::Impossible),
        }
    }
}

impl Words for TimeNs {
    const LAYOUT: u64 = layout("TimeNs", &[]);
    const WORDS_MAX: usize = 1;

    fn put(&self, to: &mut Snapshot) {
        let Self(ns) = self;
        ns.put(to);
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        from.word().map(Self)
    }
}

impl<T: Words> Words for Option<T> {
    const LAYOUT: u64 = layout("Option", &[T::LAYOUT]);
    const WORDS_MAX: usize = 1 + T::WORDS_MAX;

    fn put(&self, to: &mut Snapshot) {
        self.is_some().put(to);
        if let Some(value) = self {
            value.put(to);
        }
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        bool::take(from)?.then(|| T::take(from)).transpose()
    }
}

impl<A: Words, B: Words> Words for (A, B) {
    const LAYOUT: u64 = layout("pair", &[A::LAYOUT, B::LAYOUT]);
    const WORDS_MAX: usize = A::WORDS_MAX + B::WORDS_MAX;

    fn put(&self, to: &mut Snapshot) {
        let (first, second) = self;
        first.put(to);
        second.put(to);
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        Ok((A::take(from)?, B::take(from)?))
    }
}

impl<T: Words, const N: usize> Words for [T; N] {
    const LAYOUT: u64 = layout("array", &[T::LAYOUT, N as u64]);
    const WORDS_MAX: usize = N * T::WORDS_MAX;

    fn put(&self, to: &mut Snapshot) {
        for value in self {
            value.put(to);
        }
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        let all: Result<Vec<T>, _> = (0..N).map(|_| T::take(from)).collect();
        Self::try_from(all?).map_err(|_| SnapshotError::Impossible)
    }
}

impl Words for Vector3<f64> {
    const LAYOUT: u64 = layout("Vector3", &[]);
    const WORDS_MAX: usize = 3;

    fn put(&self, to: &mut Snapshot) {
        for number in self.iter() {
            number.put(to);
        }
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        <[f64; 3]>::take(from).map(Self::from)
    }
}

impl Words for ArmError {
    const LAYOUT: u64 = layout(
        "ArmError MeasurementLost age_ns DriveFault axis code EndOfRecording",
        &[],
    );
    /// Of a drive's fault.
    const WORDS_MAX: usize = 3;

    fn put(&self, to: &mut Snapshot) {
        match self {
            Self::MeasurementLost { age_ns } => (0_u64, *age_ns).put(to),
            Self::DriveFault { axis, code } => (1_u64, (*axis, *code)).put(to),
            Self::EndOfRecording => to.push(2),
        }
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        Ok(match from.word()? {
            0 => Self::MeasurementLost {
                age_ns: u64::take(from)?,
            },
            1 => Self::DriveFault {
                axis: u8::take(from)?,
                code: u16::take(from)?,
            },
            2 => Self::EndOfRecording,
            _ => return Err(SnapshotError::Impossible),
        })
    }
}
