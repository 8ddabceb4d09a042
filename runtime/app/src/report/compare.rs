//! Two policies compared by trials of the same seed. Trials of one seed begin in the same scene, so
//! that they are pairs: McNemar's exact test asks how probable a difference at least as large as
//! theirs is if both succeed equally often, and Holm's method corrects it for the number of
//! comparisons in a table.

use std::collections::BTreeMap;

use serde::Serialize;

use super::load::Results;
use super::statistics::{Pairs, holm};
use super::tables::{Row, Table, entries_of};
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
                if pairs != Pairs::default() {
                    let columns = [index, index + 1 + offset];
                    found.push(comparison(table, row, columns, pairs));
                }
            }
        }
    }
    correct(&mut found);
    found
}

/// Two `columns` in `row`, not corrected yet.
fn comparison(table: &Table, row: &Row, columns: [usize; 2], pairs: Pairs) -> Comparison {
    let [first, second] = columns.map(|column| table.columns[column].clone());
    Comparison {
        row: row.labels.clone(),
        first,
        second,
        pairs,
        p: pairs.mcnemar(),
        p_holm: 1.0,
    }
}

/// Corrects the probabilities for how many comparisons there are.
fn correct(comparisons: &mut [Comparison]) {
    let p: Vec<f64> = comparisons.iter().map(|comparison| comparison.p).collect();
    for (comparison, p) in comparisons.iter_mut().zip(holm(&p)) {
        comparison.p_holm = p;
    }
}

/// Whether the valid trials at `at` succeeded, by training seed and trial seed. A trial that
/// several entries have is there once.
fn successes(
    results: &Results,
    table: &Table,
    at: &Coordinates,
) -> BTreeMap<(Option<u64>, u64), bool> {
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
}

/// Trials at two places that have the same seed and, of what is trained, come from the same
/// training seed.
fn pairs(results: &Results, table: &Table, one: &Coordinates, other: &Coordinates) -> Pairs {
    let (ours, theirs) = (
        successes(results, table, one),
        successes(results, table, other),
    );
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
