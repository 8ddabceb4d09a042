//! ACT's temporal ensembling as published: one answer a step, every answer's opinion on the present
//! step blended.
//!
//! This counts steps and blends rows of numbers. The controller's own aggregation goes by due time,
//! bears late and missing answers, and blends rotations on the sphere; on answers that come every
//! step, on time, the two agree.
//!
//! Source: reference note on policies, sections 2.8 and 3.5; checked against golden numbers in
//! `tests/golden/`.

use std::collections::VecDeque;

/// A coming step's rows so far.
#[derive(Clone, Debug)]
struct Blend {
    /// Weighted sum of the rows.
    weighted: Vec<f64>,
    /// Sum of their weights.
    weight: f64,
    rows: i32,
}

/// Why a chunk could not be blended with those before it.
#[derive(Debug, PartialEq, thiserror::Error)]
#[error("a chunk of {actual} numbers for {rows} actions of {width}")]
pub struct ChunkShapeError {
    /// Actions in a chunk.
    pub rows: usize,
    /// Numbers in an action.
    pub width: usize,
    /// Numbers in the chunk.
    pub actual: usize,
}

/// Blends overlapping chunks: of the rows for one step, row i has the weight `exp(-decay * i)`,
/// with i = 0 the oldest.
#[derive(Clone, Debug)]
pub struct TemporalEnsemble {
    decay: f64,
    rows: usize,
    width: usize,
    /// The next step first; one fewer than a chunk has rows, and empty before the first chunk.
    coming: VecDeque<Blend>,
}

impl TemporalEnsemble {
    /// For chunks of `rows` actions of `width` numbers. A positive `decay` lets old answers weigh
    /// more, a negative one new answers.
    #[must_use]
    pub const fn new(decay: f64, rows: usize, width: usize) -> Self {
        Self {
            decay,
            rows,
            width,
            coming: VecDeque::new(),
        }
    }

    /// Forgets every chunk.
    pub fn reset(&mut self) {
        self.coming.clear();
    }

    /// The action for the step at which `chunk` (rows of actions, the first for this step) was
    /// predicted.
    ///
    /// # Errors
    /// [`ChunkShapeError`] if the chunk has another size.
    pub fn next(&mut self, chunk: &[f32]) -> Result<Vec<f32>, ChunkShapeError> {
        let (rows, width) = (self.rows, self.width);
        if rows == 0 || width == 0 || chunk.len() != rows * width {
            let actual = chunk.len();
            return Err(ChunkShapeError {
                rows,
                width,
                actual,
            });
        }
        let empty = Blend {
            weighted: vec![0.0; width],
            weight: 0.0,
            rows: 0,
        };
        self.coming.resize(rows, empty);
        for (blend, row) in self.coming.iter_mut().zip(chunk.chunks_exact(width)) {
            let weight = (-self.decay * f64::from(blend.rows)).exp();
            for (sum, &value) in blend.weighted.iter_mut().zip(row) {
                *sum += weight * f64::from(value);
            }
            blend.weight += weight;
            blend.rows += 1;
        }
        let Some(now) = self.coming.pop_front() else {
            return Ok(Vec::new());
        };
        #[expect(
            clippy::cast_possible_truncation,
            reason = "networks compute in single precision"
        )]
        let mean = |sum: &f64| (sum / now.weight) as f32;
        Ok(now.weighted.iter().map(mean).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::TemporalEnsemble;

    #[test]
    fn of_two_opinions_the_older_weighs_more() {
        let mut ensemble = TemporalEnsemble::new(0.5, 2, 1);
        assert_eq!(ensemble.next(&[1.0, 10.0]).unwrap(), [1.0]);
        let weight = (-0.5_f64).exp();
        let expected = (10.0 + weight * 20.0) / (1.0 + weight);
        let action = ensemble.next(&[20.0, 30.0]).unwrap()[0];
        assert!((f64::from(action) - expected).abs() < 1e-6, "{action}");
        ensemble.reset();
        assert_eq!(ensemble.next(&[7.0, 8.0]).unwrap(), [7.0]);
    }

    #[test]
    fn a_chunk_of_another_size_is_refused() {
        let mut ensemble = TemporalEnsemble::new(0.01, 2, 3);
        let error = ensemble.next(&[0.0; 5]).unwrap_err().to_string();
        assert_eq!(error, "a chunk of 5 numbers for 2 actions of 3");
    }
}
