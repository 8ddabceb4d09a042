//! Success rates and their comparison.

use serde::Serialize;

use crate::session::summary::wilson_interval;

/// Trials by how they ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Score {
    /// Trials that succeeded.
    pub successes: usize,
    /// Trials that count: those that succeeded and those that were lost.
    pub trials: usize,
    /// Trials in which the simulation left its bounds, which do not count.
    pub invalid: usize,
}

impl Score {
    /// Success rate and Wilson's 95 % interval.
    #[must_use]
    pub fn rate(&self) -> (f64, [f64; 2]) {
        wilson_interval(self.successes, self.trials)
    }

    /// Both together.
    #[must_use]
    pub const fn plus(self, other: Self) -> Self {
        Self {
            successes: self.successes + other.successes,
            trials: self.trials + other.trials,
            invalid: self.invalid + other.invalid,
        }
    }
}

/// Pairs of trials with the same seed, of two policies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Pairs {
    /// Both succeeded.
    pub both: usize,
    /// The first alone succeeded.
    pub first: usize,
    /// The second alone succeeded.
    pub second: usize,
    /// Neither succeeded.
    pub neither: usize,
}

impl Pairs {
    /// Adds a pair.
    pub const fn add(&mut self, first: bool, second: bool) {
        match (first, second) {
            (true, true) => self.both += 1,
            (true, false) => self.first += 1,
            (false, true) => self.second += 1,
            (false, false) => self.neither += 1,
        }
    }

    /// McNemar's exact test, two-sided: how probable a difference at least as large as this is if
    /// both succeed equally often.
    ///
    /// Twice the tail of the binomial distribution of the discordant pairs, at most 1.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "trial counts are small")]
    pub fn mcnemar(&self) -> f64 {
        let (few, all) = (self.first.min(self.second), self.first + self.second);
        // In logarithms: 2^-n is below the smallest number from a thousand pairs on.
        let mut term = -(all as f64) * core::f64::consts::LN_2;
        let mut tail = term.exp();
        for k in 0..few {
            term += ((all - k) as f64).ln() - ((k + 1) as f64).ln();
            tail += term.exp();
        }
        (2.0 * tail).min(1.0)
    }
}

/// Holm's correction of `p` for there being several comparisons, in the same order.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "there are few comparisons")]
pub fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|&a, &b| p[a].total_cmp(&p[b]));
    let mut corrected = vec![0.0; p.len()];
    let mut largest = 0.0_f64;
    for (rank, index) in order.into_iter().enumerate() {
        largest = largest.max((p[index] * (p.len() - rank) as f64).min(1.0));
        corrected[index] = largest;
    }
    corrected
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_matches_newcombes_table() {
        // Newcombe, Statistics in Medicine 17 (1998), table I, method 3 (score without continuity
        // correction).
        for (successes, trials, low, high) in [
            (81, 263, 0.2553, 0.3662),
            (15, 148, 0.0624, 0.1605),
            (0, 20, 0.0, 0.1611),
            (1, 29, 0.0061, 0.1718),
        ] {
            let score = Score {
                successes,
                trials,
                invalid: 3,
            };
            let (_, interval) = score.rate();
            let close = (interval[0] - low).abs() < 5.1e-5 && (interval[1] - high).abs() < 5.1e-5;
            assert!(close, "{successes} of {trials}: {interval:?}");
        }
    }

    #[test]
    fn mcnemar_matches_published_values() {
        let pairs = |first, second| Pairs {
            both: 21,
            first,
            second,
            neither: 12,
        };
        // Fay, R Journal 2 (2010), exact2x2: discordant pairs 9 and 2, p = 0.06543.
        let p = pairs(9, 2).mcnemar();
        assert!((p - 0.06543).abs() < 5e-6, "{p}");
        assert!((pairs(2, 9).mcnemar() - p).abs() < 1e-15);
        // The sign test of 6 to 0.
        assert!((pairs(6, 0).mcnemar() - 0.03125).abs() < 1e-12);
        assert!(
            (pairs(5, 5).mcnemar() - 1.0).abs() < 1e-12
                && (pairs(0, 0).mcnemar() - 1.0).abs() < 1e-12
        );
        // Far beyond what 2^-n can be written as.
        let p = pairs(3000, 2900).mcnemar();
        assert!(p > 0.19 && p < 0.21, "{p}");
    }

    #[test]
    fn holm_multiplies_and_keeps_the_order() {
        // The worked example of Holm's method with 0.01, 0.04, 0.03 and 0.005.
        let corrected = holm(&[0.01, 0.04, 0.03, 0.005]);
        for (found, expected) in corrected.iter().zip([0.03, 0.06, 0.06, 0.02]) {
            assert!((found - expected).abs() < 1e-12, "{corrected:?}");
        }
        assert!(holm(&[]).is_empty());
    }
}
