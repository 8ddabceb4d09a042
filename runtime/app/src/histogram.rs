//! Hot path: bounded, no allocation, no I/O, no lock. Durations counted in buckets, for
//! percentiles.
//!
//! Buckets are exact below 64 ns and at most 1/32 (3.2 %) wide above, over all of `u64`.
//!
//! A value's bucket is its octave and the five bits behind its leading one, as in HdrHistogram: one
//! `leading_zeros` and a shift, whatever the value.

/// Sub-buckets an octave.
const SUB_BITS: u32 = 5;
const SUB_COUNT: usize = 1 << SUB_BITS;
/// Values below this have a bucket each.
const EXACT: usize = 2 * SUB_COUNT;
/// Of all of `u64`: 1920, which is 15 kB of counts.
const BUCKETS: usize = EXACT + (u64::BITS - SUB_BITS - 1) as usize * SUB_COUNT;

/// Durations, ns. Recording takes constant time and no memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Histogram {
    counts: Vec<u64>,
    count: u64,
    sum_ns: u128,
    min_ns: u64,
    max_ns: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self::new()
    }
}

impl Histogram {
    /// An empty histogram; takes all the memory that it will need.
    #[must_use]
    pub fn new() -> Self {
        Self {
            counts: vec![0; BUCKETS],
            count: 0,
            sum_ns: 0,
            min_ns: u64::MAX,
            max_ns: 0,
        }
    }

    /// Counts one duration.
    pub fn record(&mut self, duration_ns: u64) {
        if let Some(count) = self.counts.get_mut(bucket_of(duration_ns)) {
            *count += 1;
        }
        self.count += 1;
        self.sum_ns += u128::from(duration_ns);
        self.min_ns = self.min_ns.min(duration_ns);
        self.max_ns = self.max_ns.max(duration_ns);
    }

    /// Adds what `other` has counted.
    pub fn merge(&mut self, other: &Self) {
        for (mine, theirs) in self.counts.iter_mut().zip(&other.counts) {
            *mine += theirs;
        }
        self.count += other.count;
        self.sum_ns += other.sum_ns;
        self.min_ns = self.min_ns.min(other.min_ns);
        self.max_ns = self.max_ns.max(other.max_ns);
    }

    /// How many durations were recorded.
    #[must_use]
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// The longest, ns; 0 if there is none.
    #[must_use]
    pub const fn max(&self) -> u64 {
        self.max_ns
    }

    /// The shortest, ns; 0 if there is none.
    #[must_use]
    pub const fn min(&self) -> u64 {
        if self.count == 0 { 0 } else { self.min_ns }
    }

    /// The mean, ns, rounded down; 0 if there is none.
    #[must_use]
    pub fn mean(&self) -> u64 {
        self.sum_ns
            .checked_div(u128::from(self.count))
            .and_then(|mean| u64::try_from(mean).ok())
            .unwrap_or(0)
    }

    /// The buckets that hold any durations, in ascending order: the largest that each counts, ns,
    /// and how many it has.
    pub fn buckets(&self) -> impl Iterator<Item = (u64, u64)> {
        let held = self.counts.iter().enumerate();
        let held = held.filter(|(_, count)| **count > 0);
        held.map(|(bucket, count)| (last_of(bucket), *count))
    }

    /// The least duration, ns, that a `fraction` (0 to 1) of all do not exceed; up to 3.2 % above
    /// it, never above the longest. 0 if there is none. Looks through all buckets.
    #[must_use]
    pub fn percentile(&self, fraction: f64) -> u64 {
        let rank = rank(fraction, self.count);
        let mut seen = 0;
        for (bucket, count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= rank && seen > 0 {
                return last_of(bucket).clamp(self.min(), self.max_ns);
            }
        }
        self.max_ns
    }
}

/// How many of `count` values make up `fraction` of them, at least one.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "counts of a run are exact in f64; the fraction is clamped; a float cast saturates"
)]
fn rank(fraction: f64, count: u64) -> u64 {
    ((fraction.clamp(0.0, 1.0) * count as f64).ceil() as u64).clamp(1, count.max(1))
}

/// The bucket that `value` is counted in.
const fn bucket_of(value: u64) -> usize {
    if value < EXACT as u64 {
        #[expect(clippy::cast_possible_truncation, reason = "below 64")]
        return value as usize;
    }
    let shift = u64::BITS - 1 - value.leading_zeros() - SUB_BITS;
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the leading six bits, 32 to 63"
    )]
    let leading = (value >> shift) as usize;
    shift as usize * SUB_COUNT + leading
}

/// The largest value that is counted in `bucket`.
const fn last_of(bucket: usize) -> u64 {
    if bucket < EXACT {
        return bucket as u64;
    }
    let shift = bucket / SUB_COUNT - 1;
    let leading = (bucket % SUB_COUNT + SUB_COUNT) as u64;
    (leading << shift) | ((1 << shift) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_tile_the_whole_range() {
        assert_eq!((bucket_of(0), bucket_of(u64::MAX)), (0, BUCKETS - 1));
        assert_eq!(last_of(BUCKETS - 1), u64::MAX);
        for bucket in 0..BUCKETS - 1 {
            let last = last_of(bucket);
            assert_eq!(
                (bucket_of(last), bucket_of(last + 1)),
                (bucket, bucket + 1),
                "bucket {bucket}"
            );
        }
    }

    #[test]
    fn percentiles_of_a_ramp_are_within_a_bucket() {
        let mut histogram = Histogram::new();
        for duration_ns in 1..=100_000 {
            histogram.record(duration_ns);
        }
        for (fraction, exact) in [(0.5, 50_000), (0.99, 99_000), (0.999, 99_900), (0.001, 100)] {
            let reported = histogram.percentile(fraction);
            assert!(
                (exact..=exact + exact / 31).contains(&reported),
                "p{fraction}: {reported} for {exact}"
            );
        }
        assert_eq!(
            (histogram.percentile(0.0), histogram.percentile(1.0)),
            (1, 100_000)
        );
        assert_eq!(
            (histogram.min(), histogram.mean(), histogram.max()),
            (1, 50_000, 100_000)
        );
    }

    #[test]
    fn one_outlier_shows_in_max_and_not_in_the_median() {
        let mut histogram = Histogram::new();
        (0..999).for_each(|_| histogram.record(40));
        histogram.record(u64::MAX);
        assert_eq!(
            (
                histogram.percentile(0.5),
                histogram.percentile(0.999),
                histogram.max()
            ),
            (40, 40, u64::MAX)
        );
    }

    #[test]
    fn only_buckets_that_hold_any_are_listed() {
        let mut histogram = Histogram::new();
        for duration_ns in [7, 1_000, 7, 1_001] {
            histogram.record(duration_ns);
        }
        let buckets: Vec<_> = histogram.buckets().collect();
        assert_eq!(buckets, [(7, 2), (1_007, 2)]);
    }

    #[test]
    fn empty_histogram_reports_zeros() {
        let histogram = Histogram::default();
        let all = [
            histogram.count(),
            histogram.min(),
            histogram.mean(),
            histogram.max(),
            histogram.percentile(0.99),
        ];
        assert_eq!(all, [0; 5]);
    }

    #[test]
    fn merged_halves_equal_the_whole() {
        let (mut odd, mut even, mut all) = (Histogram::new(), Histogram::new(), Histogram::new());
        for value in 0..5_000_u64 {
            let half = if value % 2 == 0 { &mut even } else { &mut odd };
            half.record(value * value);
            all.record(value * value);
        }
        odd.merge(&even);
        assert_eq!(odd, all);
    }
}
