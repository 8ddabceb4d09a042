//! What a report says, in which order. From the rates, which one reads, to the hashes, which one
//! looks up.

use super::document::{Block, Inline, paragraph};
use super::load::Results;
use super::losses::losses_of_trials;
use super::making::{costs, provenance, training_curves};
use super::rates::{compared, curves, rates, reasons};
use super::statistics::Score;
use super::tables::{self, Table};
use super::{causes, compare};
use crate::study::job::Kind;
use crate::study::plan::GridRecord;

/// The blocks of a report; links lead from the folder `from`.
#[must_use]
pub(super) fn blocks(results: &Results, from: &std::path::Path) -> Vec<Block> {
    let study = &results.study;
    let mut blocks = vec![Block::Heading(1, study.title.clone())];
    blocks.extend(summary(results));
    for table in tables::tables(results) {
        blocks.extend(section(results, &table));
    }
    blocks.extend(losses_of_trials(results, from));
    blocks.extend(training_curves(results));
    blocks.extend(costs(results));
    blocks.extend(provenance(results));
    blocks
}

/// How much of the study is done, and what was left out because its files are not what was written.
fn summary(results: &Results) -> Vec<Block> {
    let cells = |kind: Kind| results.study.count_of(kind);
    let mut blocks = vec![paragraph(format!(
        "{} of {} evaluations, {} of {} trainings and {} of {} recordings are done. Rates stand with Wilson's 95 % interval; \
         trials in which the simulation left its bounds are invalid and counted apart.",
        results.evaluations.len(),
        cells(Kind::Evaluation),
        results.trainings.len(),
        cells(Kind::Training),
        results.recordings.len(),
        cells(Kind::Recording),
    ))];
    for damaged in &results.damaged {
        blocks.push(Block::Paragraph(vec![
            Inline::Strong("Left out: ".to_owned()),
            Inline::Text(damaged.clone()),
        ]));
    }
    blocks
}

/// One grid: its rates, curves and comparisons, and why its trials were lost.
fn section(results: &Results, table: &Table) -> Vec<Block> {
    let grid = &table.grid;
    let mut blocks = vec![Block::Heading(2, grid.title.clone())];
    if !grid.note.is_empty() {
        blocks.push(paragraph(grid.note.clone()));
    }
    blocks.push(paragraph(how(grid)));
    blocks.push(rates(&results.study, table));
    blocks.extend(curves(&results.study, table));
    blocks.extend(comparisons(results, table));
    let losses = causes::losses(results, table);
    if !losses.is_empty() {
        blocks.push(Block::Details(
            "Why trials were lost".to_owned(),
            vec![reasons(&results.study, table, &losses)],
        ));
    }
    blocks
}

/// The columns of `table` two by two, if there are any to compare.
fn comparisons(results: &Results, table: &Table) -> Option<Block> {
    let comparisons = compare::comparisons(results, table);
    let count = comparisons.len();
    (count > 0).then(|| {
        Block::Details(
            format!(
                "Trials of the same seed, two by two (McNemar's exact test, {count} comparisons)"
            ),
            vec![compared(&results.study, table, &comparisons)],
        )
    })
}

/// Trials and seeds in a sentence, and the source of the published figures in another.
fn how(grid: &GridRecord) -> String {
    let last = grid.first_seed + (grid.trials as u64).saturating_sub(1);
    let mut text = format!(
        "{} trials of each training, seeds {} to {last}.",
        grid.trials, grid.first_seed
    );
    if let Some(published) = &grid.published {
        text += &format!(" Beside them: {}", published.source);
        if let Some(trials) = published.trials {
            text += &format!(", {trials} trials each");
        }
        text += ".";
    }
    text
}

/// All trials of a study by how they ended. One that several grids share is counted once.
#[must_use]
pub(super) fn total(results: &Results) -> Score {
    let scores = results
        .evaluations
        .values()
        .map(super::load::Evaluation::score);
    scores.fold(Score::default(), Score::plus)
}
