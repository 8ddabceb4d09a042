//! Weights as they lie in memory: in the fewest bits that hold every one of them exactly.

use half::{bf16, f16};

use super::PANEL;
use crate::layers::vectors::Vectors;

/// A row of a panel in half precision (f16), bits.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(super) struct F16([u16; PANEL]);

/// A row of a panel in bfloat16, bits.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(super) struct Bf16([u16; PANEL]);

/// A row of a panel in single precision.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct F32(pub(super) [f32; PANEL]);

/// How a row of a panel lies in memory.
pub(super) trait Stored: Copy + Sync {
    /// The numbers from `part` whole vectors on.
    fn widened<V: Vectors>(&self, simd: V, part: usize) -> V::f32s;
}

/// For each panel of outputs, for each row: a number for each output, zeros where there is none.
///
/// Weights that were stored in half precision fit `F16`, those rounded to bfloat16 fit `Bf16`: half
/// the memory to read for the same numbers.
#[derive(Debug)]
pub(super) enum Weights {
    F16(Vec<F16>),
    Bf16(Vec<Bf16>),
    F32(Vec<F32>),
}

impl Weights {
    /// Of `values` `(outputs, rows)`.
    pub(super) fn new(values: &[f32], rows: usize) -> Self {
        if let Some(panels) = panels(values, rows).map(F16::holding).collect() {
            return Self::F16(panels);
        }
        if let Some(panels) = panels(values, rows).map(Bf16::holding).collect() {
            return Self::Bf16(panels);
        }
        Self::F32(panels(values, rows).map(F32).collect())
    }
}

/// The rows of `values` `(outputs, rows)` panel by panel: a number for each output, zeros where
/// there is none.
pub(super) fn panels(values: &[f32], rows: usize) -> impl Iterator<Item = [f32; PANEL]> {
    assert!(rows > 0, "a matrix without rows");
    values.chunks(rows * PANEL).flat_map(move |panel| {
        (0..rows).map(move |row| {
            let mut numbers = [0.0; PANEL];
            for (number, output) in numbers.iter_mut().zip(panel.chunks_exact(rows)) {
                *number = output[row];
            }
            numbers
        })
    })
}

impl F16 {
    /// The numbers, if all can be held as they are, to the bit.
    fn holding(row: [f32; PANEL]) -> Option<Self> {
        let halves = row.map(f16::from_f32);
        // Finite, since widening by whole numbers knows no others.
        let same = |(half, number): (&f16, &f32)| {
            half.is_finite() && half.to_f32().to_bits() == number.to_bits()
        };
        let exact = halves.iter().zip(&row).all(same);
        exact.then(|| Self(halves.map(f16::to_bits)))
    }
}

impl Stored for F16 {
    #[inline(always)]
    fn widened<V: Vectors>(&self, simd: V, part: usize) -> V::f32s {
        simd.half(&self.0[part * V::F32_LANES..][..V::F32_LANES])
    }
}

impl Bf16 {
    /// The numbers, if all can be held as they are, to the bit.
    fn holding(row: [f32; PANEL]) -> Option<Self> {
        let exact = row.iter().all(|number| number.to_bits() << 16 == 0);
        exact.then(|| Self(row.map(|number| bf16::from_f32(number).to_bits())))
    }
}

impl Stored for Bf16 {
    #[inline(always)]
    fn widened<V: Vectors>(&self, simd: V, part: usize) -> V::f32s {
        simd.brain(&self.0[part * V::F32_LANES..][..V::F32_LANES])
    }
}

impl Stored for F32 {
    #[inline(always)]
    fn widened<V: Vectors>(&self, simd: V, part: usize) -> V::f32s {
        simd.single(&self.0[part * V::F32_LANES..][..V::F32_LANES])
    }
}
