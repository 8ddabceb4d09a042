//! Seeded random numbers: the same seed and stream name give the same numbers on every machine.

use hal::random::{SplitMix64, fnv_1a};

/// Generator xoshiro256++ (Blackman and Vigna, "Scrambled linear pseudorandom number generators",
/// 2021), its state filled by `SplitMix64` as its authors recommend.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rng {
    state: [u64; 4],
}

impl Rng {
    /// The generator of `seed`.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let mut mixer = SplitMix64::new(seed);
        Self {
            state: std::array::from_fn(|_| mixer.next_u64()),
        }
    }

    /// A generator of its own for one use of `seed`.
    ///
    /// Whatever draws from the stream `name` does not shift any other stream, so a new random
    /// quantity leaves the old ones as they were.
    #[must_use]
    pub fn stream(seed: u64, name: &str) -> Self {
        // The hash keeps names apart; the mixers behind it spread the bits.
        Self::new(SplitMix64::new(seed).next_u64() ^ fnv_1a(name.bytes()))
    }

    /// The next 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        let [a, b, c, d] = self.state;
        let result = a.wrapping_add(d).rotate_left(23).wrapping_add(a);
        let c = c ^ a;
        let d = d ^ b;
        self.state = [a ^ d, b ^ c, c ^ (b << 17), d.rotate_left(45)];
        result
    }

    /// Uniform in `[0, 1)`, with 53 random bits.
    pub fn unit(&mut self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "53 bits are exact")]
        let numerator = (self.next_u64() >> 11) as f64;
        numerator / 9_007_199_254_740_992.0
    }

    /// Uniform in `[low, high)`; `low` if the range is empty.
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Uniform among `0..count`; 0 if there are none.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "counts of choices are small"
    )]
    pub fn below(&mut self, count: usize) -> usize {
        (self.unit() * count as f64) as usize
    }

    /// True with the given probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_outputs_of_both_algorithms() {
        // First words of SplitMix64 from 1234567 and of xoshiro256++ from state 1, 2, 3, 4, as
        // published with them.
        let mut mixer = SplitMix64::new(1_234_567);
        assert_eq!(mixer.next_u64(), 6_457_827_717_110_365_317);
        assert_eq!(mixer.next_u64(), 3_203_168_211_198_807_973);
        let mut rng = Rng {
            state: [1, 2, 3, 4],
        };
        let words: [u64; 5] = std::array::from_fn(|_| rng.next_u64());
        assert_eq!(
            words,
            [
                41_943_041,
                58_720_359,
                3_588_806_011_781_223,
                3_591_011_842_654_386,
                9_228_616_714_210_784_205
            ]
        );
    }

    #[test]
    fn range_is_covered_and_never_left() {
        let mut rng = Rng::new(7);
        let draws: Vec<f64> = (0..10_000).map(|_| rng.range(-2.0, 3.0)).collect();
        assert!(draws.iter().all(|x| (-2.0..3.0).contains(x)));
        assert!(draws.iter().any(|x| *x < -1.99) && draws.iter().any(|x| *x > 2.99));
        let mean = draws.iter().sum::<f64>() / 10_000.0;
        assert!((mean - 0.5).abs() < 0.05, "{mean}");
    }

    #[test]
    fn streams_of_one_seed_differ_and_repeat() {
        let first = Rng::stream(3, "needle").next_u64();
        assert_eq!(first, Rng::stream(3, "needle").next_u64());
        assert_ne!(first, Rng::stream(3, "expert").next_u64());
        assert_ne!(first, Rng::stream(4, "needle").next_u64());
    }
}
