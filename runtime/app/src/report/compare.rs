//! Two policies compared by trials of the same seed.

use std::collections::BTreeMap;

use serde::Serialize;

use super::load::Results;
use super::statistics::{Pairs, holm};
use super::tables::{Table, entries_of};
use crate::study::axis::Coordinates;

/// Two columns of a row, compared by trials of the same seed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// The row.
    pub row: Vec<String>,
    /// The first column.
    pub first: String,
    /// The second column.
    pub second: String,
    /// Pairs of trials.
    pub pairs: Pairs,
    /// McNemar's exact test.
    pub p: f64,
    /// The same, corrected by Holm's method for the number of comparisons in the table.
    pub p_holm: f64,
}

/// Every two columns of every row in which both have trials of the same seeds.
#[must_use]
pub fn comparisons(results: &Results, table: &Table) -> Vec<Comparison> {
    let mut found = Vec::new();
    for row in &table.rows {
        for (index, first) in row.places.iter().enumerate() {
            for (offset, second) in row.places[index + 1..].iter().enumerate() {
                let (Some(one), Some(other)) = (first, second) else {
                    continue;
                };
                let pairs = pairs(results, table, &one.at, &other.at);
                if pairs == Pairs::default() {
                    continue;
                }
                found.push(Comparison {
                    row: row.labels.clone(),
                    first: table.columns[index].clone(),
                    second: table.columns[index + 1 + offset].clone(),
                    pairs,
                    p: pairs.mcnemar(),
                    p_holm: 1.0,
                });
            }
        }
    }
    let corrected = holm(
        &found
            .iter()
            .map(|comparison| comparison.p)
            .collect::<Vec<_>>(),
    );
    for (comparison, p) in found.iter_mut().zip(corrected) {
        comparison.p_holm = p;
    }
    found
}

/// Trials at two places that have the same seed and, of what is trained, come from the same training seed.
fn pairs(results: &Results, table: &Table, one: &Coordinates, other: &Coordinates) -> Pairs {
    let of = |at: &Coordinates| {
        let mut trials = BTreeMap::new();
        for entry in entries_of(&results.study, &table.grid) {
            let evaluation = results
                .evaluations
                .get(&entry.evaluation)
                .filter(|_| entry.at == *at);
            for trial in evaluation
                .into_iter()
                .flat_map(|evaluation| &evaluation.trials)
            {
                if !trial.invalid {
                    trials.insert((entry.training_seed, trial.seed), trial.success);
                }
            }
        }
        trials
    };
    let (ours, theirs) = (of(one), of(other));
    let untrained = |seed: u64| theirs.get(&(None, seed));
    let mut pairs = Pairs::default();
    for ((training, seed), success) in &ours {
        // The expert has no training seed: each training is compared with the same trials of it.
        let partner = theirs.get(&(*training, *seed)).or_else(|| untrained(*seed));
        if let Some(partner) = partner {
            pairs.add(*success, *partner);
        }
    }
    pairs
}
