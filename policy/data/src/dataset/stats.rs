//! Statistics of a dataset, exact over all recorded rows and over a subsample of the images.
//!
//! LeRobot's `stats.json`: `min`, `max`, `mean`, `std` and five quantiles a dimension, and the
//! `count` of rows. Quantiles need all values, so columns are kept as sorted lists: 8 bytes a
//! number, about 25 MB for an hour of one arm at 30 frames a second.

use serde_json::{Value, json};

/// Quantiles that LeRobot's normalisers know.
const QUANTILES: [(&str, f64); 5] = [
    ("q01", 0.01),
    ("q10", 0.1),
    ("q50", 0.5),
    ("q90", 0.9),
    ("q99", 0.99),
];

/// All values of one feature, one sorted list a dimension.
#[derive(Clone, Debug)]
pub(crate) struct ColumnStats {
    /// By dimension, ascending.
    sorted: Vec<Vec<f64>>,
}

impl ColumnStats {
    pub(crate) fn new(width: usize) -> Self {
        Self {
            sorted: vec![Vec::new(); width],
        }
    }

    /// Adds rows, each as wide as the feature.
    ///
    /// O(n) for rows that come behind n old ones, by the stable sort's runs. NaN would sort last;
    /// the writer refuses it before.
    pub(crate) fn extend(&mut self, rows: impl Iterator<Item = impl IntoIterator<Item = f64>>) {
        for row in rows {
            for (values, value) in self.sorted.iter_mut().zip(row) {
                values.push(value);
            }
        }
        // The sort finds the old values in order, so this merges rather than sorts anew.
        self.sorted
            .iter_mut()
            .for_each(|values| values.sort_by(f64::total_cmp));
    }

    /// The summary, one number a dimension; `None` before the first row.
    ///
    /// O(n): mean and variance are summed anew in two passes, which loses less than running sums.
    pub(crate) fn to_json(&self) -> Option<Value> {
        let count = self.sorted.first().map_or(0, Vec::len);
        if count == 0 {
            return None;
        }
        let summaries: Vec<Summary> = self
            .sorted
            .iter()
            .map(|values| Summary::of_sorted(values))
            .collect();
        Some(summary_json(&summaries, count, |value| value))
    }
}

/// How often each of the 256 values occurred in each colour channel.
#[derive(Clone, Debug)]
pub(crate) struct ImageStats {
    /// Counts by value (256), then channel.
    histogram: Vec<[u64; 3]>,
    /// Images, not pixels: LeRobot's `count` of a camera.
    image_count: usize,
}

impl ImageStats {
    pub(crate) fn new() -> Self {
        Self {
            histogram: vec![[0; 3]; 256],
            image_count: 0,
        }
    }

    /// Counts an RGB image.
    pub(crate) fn add(&mut self, rgb: &[u8]) {
        for pixel in rgb.chunks_exact(3) {
            for (channel, &value) in pixel.iter().enumerate() {
                self.histogram[usize::from(value)][channel] += 1;
            }
        }
        self.image_count += 1;
    }

    /// Adds the counts of `other`; exact and independent of the order.
    pub(crate) fn merge(&mut self, other: &Self) {
        for (mine, theirs) in self
            .histogram
            .iter_mut()
            .flatten()
            .zip(other.histogram.iter().flatten())
        {
            *mine += theirs;
        }
        self.image_count += other.image_count;
    }

    /// The summary with values in [0, 1], one number a channel, shaped (3, 1, 1); `None` before the
    /// first image.
    pub(crate) fn to_json(&self) -> Option<Value> {
        if self.image_count == 0 {
            return None;
        }
        let summaries: Vec<Summary> = (0..3)
            .map(|channel| {
                let counts: Vec<u64> = self
                    .histogram
                    .iter()
                    .map(|counts| counts[channel])
                    .collect();
                Summary::of_histogram(&counts)
            })
            .collect();
        Some(summary_json(&summaries, self.image_count, |value| {
            json!([[value]])
        }))
    }
}

/// Statistics of one dimension. The standard deviation divides by the count, not by one less.
struct Summary {
    min: f64,
    max: f64,
    mean: f64,
    std: f64,
    /// In the order of [`QUANTILES`].
    quantiles: [f64; QUANTILES.len()],
}

impl Summary {
    /// Of a list that is sorted and not empty; the standard deviation is that of the population.
    #[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
    fn of_sorted(values: &[f64]) -> Self {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values
            .iter()
            .map(|value| (value - mean) * (value - mean))
            .sum::<f64>()
            / count;
        Self {
            min: values[0],
            max: values[values.len() - 1],
            mean,
            std: variance.sqrt(),
            quantiles: QUANTILES.map(|(_, at)| interpolate(values, at)),
        }
    }

    /// Of 8-bit values given by their counts, not all zero, scaled to [0, 1]. A quantile is the
    /// lowest value at or below which its share of pixels lies.
    #[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
    fn of_histogram(counts: &[u64]) -> Self {
        let weighted = || {
            counts
                .iter()
                .zip(0_u32..)
                .map(|(&count, value)| (count as f64, f64::from(value) / 255.0))
        };
        let total: f64 = weighted().map(|(count, _)| count).sum();
        let mean = weighted().map(|(count, value)| count * value).sum::<f64>() / total;
        let variance = weighted()
            .map(|(count, value)| count * (value - mean) * (value - mean))
            .sum::<f64>()
            / total;
        let present = || {
            weighted()
                .filter(|&(count, _)| count > 0.0)
                .map(|(_, value)| value)
        };
        let quantile = |at: f64| {
            let mut below = 0.0;
            weighted()
                .find(|&(count, _)| {
                    below += count;
                    below >= at * total && count > 0.0
                })
                .map_or(1.0, |(_, value)| value)
        };
        Self {
            min: present().fold(1.0, f64::min),
            max: present().fold(0.0, f64::max),
            mean,
            std: variance.sqrt(),
            quantiles: QUANTILES.map(|(_, at)| quantile(at)),
        }
    }
}

/// Value at the fraction `at` of a sorted list, linear between neighbours. NumPy's default method,
/// place `at * (n - 1)`.
#[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "0 <= place < len"
)]
fn interpolate(sorted: &[f64], at: f64) -> f64 {
    let place = at * (sorted.len() - 1) as f64;
    let low = place.floor() as usize;
    let high = (low + 1).min(sorted.len() - 1);
    sorted[low] + (place - place.floor()) * (sorted[high] - sorted[low])
}

/// LeRobot's object of statistics; `shape` nests each number as the feature's shape has it.
fn summary_json<T: serde::Serialize>(
    summaries: &[Summary],
    count: usize,
    shape: impl Fn(f64) -> T,
) -> Value {
    let of = |part: &dyn Fn(&Summary) -> f64| {
        json!(summaries.iter().map(|s| shape(part(s))).collect::<Vec<_>>())
    };
    let mut object = serde_json::Map::new();
    object.insert("min".to_owned(), of(&|s| s.min));
    object.insert("max".to_owned(), of(&|s| s.max));
    object.insert("mean".to_owned(), of(&|s| s.mean));
    object.insert("std".to_owned(), of(&|s| s.std));
    object.insert("count".to_owned(), json!([count]));
    for (index, (name, _)) in QUANTILES.iter().enumerate() {
        object.insert((*name).to_owned(), of(&|s| s.quantiles[index]));
    }
    Value::Object(object)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn column_summary_equals_hand_computed_values() {
        let mut stats = ColumnStats::new(1);
        assert!(stats.to_json().is_none());
        stats.extend([[4.0], [1.0]].into_iter());
        stats.extend([[3.0], [2.0], [5.0]].into_iter());
        let json = stats.to_json().unwrap();
        assert_eq!(json["min"], json!([1.0]));
        assert_eq!(json["max"], json!([5.0]));
        assert_eq!(json["mean"], json!([3.0]));
        assert_eq!(json["std"], json!([2.0_f64.sqrt()]));
        assert_eq!(json["count"], json!([5]));
        assert_eq!(json["q50"], json!([3.0]));
        assert!((json["q10"][0].as_f64().unwrap() - 1.4).abs() < 1e-12);
    }

    #[test]
    fn image_summary_is_per_channel_and_scaled_to_one() {
        let mut stats = ImageStats::new();
        let mut other = ImageStats::new();
        other.add(&[0, 51, 255, 255, 51, 255]);
        stats.merge(&other);
        let json = stats.to_json().unwrap();
        assert_eq!(json["mean"], json!([[[0.5]], [[0.2]], [[1.0]]]));
        assert_eq!(json["min"], json!([[[0.0]], [[0.2]], [[1.0]]]));
        assert_eq!(json["std"], json!([[[0.5]], [[0.0]], [[0.0]]]));
        assert_eq!(json["q99"], json!([[[1.0]], [[0.2]], [[1.0]]]));
        assert_eq!(json["count"], json!([1]));
    }
}
