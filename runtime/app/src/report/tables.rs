//! The tables of a report: success rates at the places of a grid, beside published ones.

use serde::Serialize;

use super::load::{Evaluation, Results};
use super::statistics::Score;
use crate::study::axis::{AXES, Axis, Coordinates};
use crate::study::plan::{Entry, GridRecord, StudyRecord};

/// What was found at one place of a grid.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Place {
    /// Where.
    pub at: Coordinates,
    /// Every training seed, with its trials if there are any.
    pub by_seed: Vec<(Option<u64>, Option<Score>)>,
    /// The trials of all training seeds; none while one of them is missing.
    pub score: Option<Score>,
    /// The published rate.
    pub published: Option<f64>,
    /// Hashes of the commands of all trials, which tell whether two results are the same to the
    /// bit.
    pub command_hashes: Vec<String>,
}

/// A row of a table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Where it lies on the table's row axes.
    pub labels: Vec<String>,
    /// One for each column.
    pub places: Vec<Option<Place>>,
}

/// A grid as a table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// The grid.
    pub grid: GridRecord,
    /// The axes that its rows lie on.
    pub row_axes: Vec<Axis>,
    /// Names of its columns on the grid's column axis.
    pub columns: Vec<String>,
    /// Its rows.
    pub rows: Vec<Row>,
}

/// The tables of `results`, in the order of their grids.
#[must_use]
pub fn tables(results: &Results) -> Vec<Table> {
    results
        .study
        .grids
        .iter()
        .map(|grid| table(results, grid))
        .collect()
}

/// The grid's entries at its rows and columns. Each place looks through all of them, some hundreds.
fn table(results: &Results, grid: &GridRecord) -> Table {
    let entries = entries_of(&results.study, grid);
    let row_axes = row_axes(&entries, grid.columns);
    let mut columns: Vec<String> = Vec::new();
    for entry in &entries {
        push_new(&mut columns, entry.at.on(grid.columns));
    }
    let mut rows = empty_rows(&entries, &row_axes);
    for row in &mut rows {
        for column in &columns {
            let here = entries.iter().filter(|entry| {
                labels_on(&row_axes, &entry.at) == row.labels
                    && entry.at.on(grid.columns) == *column
            });
            row.places.push(place(results, grid, here.copied()));
        }
    }
    Table {
        grid: grid.clone(),
        row_axes,
        columns,
        rows,
    }
}

/// The names of the place `at` on each of `axes`; empty on an axis on which it has none.
fn labels_on(axes: &[Axis], at: &Coordinates) -> Vec<String> {
    axes.iter().map(|axis| at.on(*axis)).collect()
}

/// The rows on which `entries` lie, without their places.
fn empty_rows(entries: &[&Entry], axes: &[Axis]) -> Vec<Row> {
    let mut rows: Vec<Row> = Vec::new();
    for entry in entries {
        let labels = labels_on(axes, &entry.at);
        if !rows.iter().any(|row| row.labels == labels) {
            rows.push(Row {
                labels,
                places: Vec::new(),
            });
        }
    }
    rows
}

/// The entries of `grid`.
#[must_use]
pub fn entries_of<'a>(study: &'a StudyRecord, grid: &GridRecord) -> Vec<&'a Entry> {
    study
        .entries
        .iter()
        .filter(|entry| entry.grid == grid.name)
        .collect()
}

/// Axes other than that of the columns on which the grid has more than one place; the task if there
/// is none.
fn row_axes(entries: &[&Entry], columns: Axis) -> Vec<Axis> {
    let varies = |axis: Axis| {
        let mut places: Vec<String> = Vec::new();
        for entry in entries {
            let place = entry.at.on(axis);
            // What is not trained has no place on some axes, and stands in every row of them.
            if !place.is_empty() {
                push_new(&mut places, place);
            }
        }
        places.len() > 1
    };
    let axes: Vec<Axis> = AXES
        .into_iter()
        .filter(|axis| *axis != columns && varies(*axis))
        .collect();
    if axes.is_empty() {
        vec![Axis::Task]
    } else {
        axes
    }
}

/// In the order in which they come, as the study's file has them.
fn push_new(list: &mut Vec<String>, value: String) {
    if !list.contains(&value) {
        list.push(value);
    }
}

/// Of all trials in order, invalid ones too.
fn command_hashes<'a>(evaluations: impl Iterator<Item = &'a Evaluation>) -> Vec<String> {
    let trials = evaluations.flat_map(|evaluation| &evaluation.trials);
    trials.map(|trial| trial.command_hash.clone()).collect()
}

/// None without an entry. The score is that of all training seeds together, since each is one
/// sample of the same recipe.
fn place<'a>(
    results: &Results,
    grid: &GridRecord,
    entries: impl Iterator<Item = &'a Entry>,
) -> Option<Place> {
    let entries: Vec<&Entry> = entries.collect();
    let at = entries.first()?.at.clone();
    let found: Vec<Option<&Evaluation>> = entries
        .iter()
        .map(|entry| results.evaluations.get(&entry.evaluation))
        .collect();
    let seeds = entries.iter().map(|entry| entry.training_seed);
    let by_seed: Vec<_> = seeds
        .zip(found.iter().map(|found| found.map(Evaluation::score)))
        .collect();
    let scores: Option<Vec<Score>> = by_seed.iter().map(|(_, score)| *score).collect();
    Some(Place {
        published: published(grid, &at),
        command_hashes: command_hashes(found.iter().flatten().copied()),
        score: scores.map(|scores| scores.into_iter().fold(Score::default(), Score::plus)),
        by_seed,
        at,
    })
}

/// The first published rate whose coordinates are those of `at`.
fn published(grid: &GridRecord, at: &Coordinates) -> Option<f64> {
    let rates = &grid.published.as_ref()?.rates;
    let agrees = |asked: Option<&String>, here: &str| asked.is_none_or(|asked| asked == here);
    let found = rates.iter().find(|rate| {
        agrees(rate.task.as_ref(), &at.task)
            && agrees(rate.network.as_ref(), &at.network)
            && agrees(
                rate.needle.as_ref(),
                at.needle.as_deref().unwrap_or_default(),
            )
            && agrees(rate.view.as_ref(), &at.view)
            && rate
                .demonstrations
                .is_none_or(|asked| at.demonstrations == Some(asked))
    });
    found.map(|rate| rate.rate)
}

impl Table {
    /// Mean rates of each column over the rows, ours and the published; none where a row is
    /// missing.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "there are few rows")]
    pub fn means(&self) -> Vec<(Option<f64>, Option<f64>)> {
        let count = self.rows.len() as f64;
        let mean =
            |values: Option<Vec<f64>>| values.map(|values| values.iter().sum::<f64>() / count);
        (0..self.columns.len())
            .map(|column| {
                let places = || self.rows.iter().map(move |row| row.places[column].as_ref());
                let ours = places().map(|place| Some(place?.score?.rate().0)).collect();
                let published = places().map(|place| place?.published).collect();
                (mean(ours), mean(published))
            })
            .collect()
    }
}
