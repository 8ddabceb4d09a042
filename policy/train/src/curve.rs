//! The losses of a run over its steps, and their table on disk.

use core::fmt::Write as _;

use serde::{Deserialize, Serialize};

/// One row: means since the row before.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurveRow {
    /// Steps done.
    pub step: u64,
    /// What is minimised.
    pub loss: f64,
    /// Mean absolute error of the normalised actions.
    pub l1: f64,
    /// Kullback-Leibler divergence of the latent.
    pub kl: f64,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f64,
    /// Learning rate of the last step.
    pub lr: f64,
    /// Mean absolute error of held-out frames, normalised, if some are held out.
    pub validation_l1: Option<f64>,
}

/// All rows of a run.
///
/// Written as CSV beside a checkpoint, drawn by [`Self::to_svg`], and kept in a run's state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LossCurve {
    /// In order of the steps.
    pub rows: Vec<CurveRow>,
}

impl LossCurve {
    /// The table as comma-separated values with a head line; what is not there is empty.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut text = "step,loss,l1,kl,gradient_norm,lr,validation_l1\n".to_owned();
        for row in &self.rows {
            let CurveRow {
                step,
                loss,
                l1,
                kl,
                gradient_norm,
                lr,
                validation_l1,
            } = row;
            let validation = validation_l1.map(|l1| l1.to_string()).unwrap_or_default();
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "{step},{loss},{l1},{kl},{gradient_norm},{lr},{validation}"
            );
        }
        text
    }

    /// The last row.
    #[must_use]
    pub fn last(&self) -> Option<&CurveRow> {
        self.rows.last()
    }
}

#[cfg(test)]
mod tests {
    use super::{CurveRow, LossCurve};

    #[test]
    fn table_has_a_head_and_one_line_a_row() {
        let row = CurveRow {
            step: 5,
            loss: 1.5,
            l1: 0.5,
            kl: 0.1,
            gradient_norm: 2.0,
            lr: 1e-4,
            validation_l1: None,
        };
        let text = LossCurve { rows: vec![row] }.to_csv();
        assert_eq!(
            text,
            "step,loss,l1,kl,gradient_norm,lr,validation_l1\n5,1.5,0.5,0.1,2,0.0001,\n"
        );
    }
}
