//! The vector instructions that products use, by processor.
//!
//! Two levels of x86-64: AVX-512 (V4), and AVX2 with FMA (V3). Which one a machine has is asked at
//! run time; nothing is compiled for the machine at hand.

use pulp::Simd;

/// Into all levels of cache.
const TO_ALL: i32 = 3;

/// Into the second level and those below.
const TO_SECOND: i32 = 2;

/// A processor's vectors: eight numbers in single precision or 16, and multiplications fused with
/// additions.
pub(super) trait Vectors: Simd {
    /// Numbers in single precision.
    fn single(self, from: &[f32]) -> Self::f32s;

    /// Finite numbers in half precision, widened.
    fn half(self, from: &[u16]) -> Self::f32s;

    /// Upper halves of numbers in single precision, with zeros as their lower halves.
    fn brain(self, from: &[u16]) -> Self::f32s;

    /// Asks for the memory at `at` to be brought to the named levels of cache, without waiting for
    /// it; it may be anybody's.
    fn ask<const LEVELS: i32>(self, at: *const i8);

    /// Asks for the memory `bytes` after `at`.
    #[inline(always)]
    fn fetch<T>(self, at: &T, bytes: usize) {
        let at = core::ptr::from_ref(at).cast::<i8>();
        self.ask::<TO_ALL>(at.wrapping_add(bytes));
    }

    /// Asks for the memory at `at` to be brought to the second-level cache.
    #[inline(always)]
    fn fetch_near<T>(self, at: &T) {
        self.ask::<TO_SECOND>(core::ptr::from_ref(at).cast());
    }
}

/// A kernel over a processor's SIMD vectors.
///
/// `run` is compiled once for each level; what it calls must be inlined into it, or the
/// instructions are not used.
pub(super) trait SimdKernel {
    fn run<V: Vectors>(self, simd: V);
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use pulp::x86::{V3, V4};
    use pulp::{Simd, cast};

    use super::{SimdKernel, Vectors};

    /// A processor whose vector instructions are known here.
    #[derive(Clone, Copy, Debug)]
    pub(crate) enum Processor {
        /// AVX-512.
        V4(V4),
        /// AVX2 and FMA.
        V3(V3),
    }

    impl Processor {
        /// The one that this runs on, if it is known.
        pub(crate) fn found() -> Option<Self> {
            let wide = V4::try_new().map(Self::V4);
            wide.or_else(|| V3::try_new().map(Self::V3))
        }

        /// All that this one can be taken for.
        #[cfg(test)]
        pub(crate) fn all() -> Vec<Self> {
            let wide = V4::try_new().map(Self::V4);
            let narrow = V3::try_new().map(Self::V3);
            wide.into_iter().chain(narrow).collect()
        }

        /// Numbers of a vector.
        pub(in crate::layers) const fn lanes(self) -> usize {
            match self {
                Self::V4(_) => 16,
                Self::V3(_) => 8,
            }
        }

        /// Does `work` with the vectors of this one.
        pub(in crate::layers) fn run<W: SimdKernel>(self, work: W) {
            match self {
                Self::V4(simd) => simd.vectorize(
                    #[inline(always)]
                    || work.run(simd),
                ),
                Self::V3(simd) => simd.vectorize(
                    #[inline(always)]
                    || work.run(simd),
                ),
            }
        }
    }

    /// The first array of `from`, which is no shorter.
    #[inline(always)]
    fn array<T: Copy, const N: usize>(from: &[T]) -> [T; N] {
        let (arrays, _) = from[..N].as_chunks();
        arrays[0]
    }

    impl Vectors for V4 {
        #[inline(always)]
        fn single(self, from: &[f32]) -> Self::f32s {
            cast(array::<f32, 16>(from))
        }

        #[inline(always)]
        fn half(self, from: &[u16]) -> Self::f32s {
            cast(self.avx512f._mm512_cvtph_ps(cast(array::<u16, 16>(from))))
        }

        #[inline(always)]
        fn brain(self, from: &[u16]) -> Self::f32s {
            let low = self
                .avx512f
                ._mm512_cvtepu16_epi32(cast(array::<u16, 16>(from)));
            cast(self.avx512f._mm512_slli_epi32::<16>(low))
        }

        #[inline(always)]
        fn ask<const LEVELS: i32>(self, at: *const i8) {
            self.sse._mm_prefetch::<LEVELS>(at);
        }
    }

    impl Vectors for V3 {
        #[inline(always)]
        fn single(self, from: &[f32]) -> Self::f32s {
            cast(array::<f32, 8>(from))
        }

        /// By whole numbers: instructions for it are no part of what this level promises.
        #[inline(always)]
        fn half(self, from: &[u16]) -> Self::f32s {
            let low = self.avx2._mm256_cvtepu16_epi32(cast(array::<u16, 8>(from)));
            let sign = self.splat_u32s(0x8000_0000);
            let sign = self.and_u32s(cast(self.avx2._mm256_slli_epi32::<16>(low)), sign);
            let rest = self.splat_u32s(0x7fff << 13);
            let rest = self.and_u32s(cast(self.avx2._mm256_slli_epi32::<13>(low)), rest);
            let normal = self.add_u32s(rest, self.splat_u32s((127 - 15) << 23));
            // With the least exponent of normal numbers, of which just that number is taken away
            // again.
            let least = (127 - 14) << 23;
            let below = self.transmute_f32s_u32s(self.add_u32s(rest, self.splat_u32s(least)));
            let below = self.sub_f32s(below, self.splat_f32s(f32::from_bits(least)));
            let is_below = self.less_than_u32s(rest, self.splat_u32s(1 << 23));
            let below = self.transmute_u32s_f32s(below);
            let size = self.select_u32s(is_below, below, normal);
            self.transmute_f32s_u32s(self.or_u32s(sign, size))
        }

        #[inline(always)]
        fn brain(self, from: &[u16]) -> Self::f32s {
            let low = self.avx2._mm256_cvtepu16_epi32(cast(array::<u16, 8>(from)));
            cast(self.avx2._mm256_slli_epi32::<16>(low))
        }

        #[inline(always)]
        fn ask<const LEVELS: i32>(self, at: *const i8) {
            self.sse._mm_prefetch::<LEVELS>(at);
        }
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::Processor;

/// Processors of other kinds use the network library.
#[cfg(not(target_arch = "x86_64"))]
mod other {
    use super::SimdKernel;

    #[derive(Clone, Copy, Debug)]
    pub(crate) enum Processor {}

    impl Processor {
        pub(crate) const fn found() -> Option<Self> {
            None
        }

        #[cfg(test)]
        pub(crate) const fn all() -> Vec<Self> {
            Vec::new()
        }

        pub(in crate::layers) const fn lanes(self) -> usize {
            match self {}
        }

        pub(in crate::layers) fn run<W: SimdKernel>(self, _: W) {
            match self {}
        }
    }
}

#[cfg(not(target_arch = "x86_64"))]
pub(crate) use other::Processor;
