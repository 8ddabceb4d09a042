//! The tables and curves of success rates, comparisons and reasons. What `tables`, `compare` and
//! `causes` have counted becomes blocks of the page here; nothing is computed but formats.

use super::compare::Comparison;
use super::document::{Block, Inline, TableCell, Tone, plain};
use super::plots::{Plot, Series};
use super::statistics::Score;
use super::tables::{Place, Row, Table};
use crate::study::axis::Axis;
use crate::study::plan::StudyRecord;

/// The table of `table`'s grid: a row for each place on the row axes, a column for each on the
/// column axis, and a last row of means unless the rows are points of a curve.
pub(super) fn rates(study: &StudyRecord, table: &Table) -> Block {
    let mut rows: Vec<Vec<TableCell>> = Vec::new();
    for Row {
        labels: names,
        places,
    } in &table.rows
    {
        let mut row = labels(study, &table.row_axes, names);
        row.extend(
            places
                .iter()
                .map(|place| place.as_ref().map_or_else(TableCell::default, rate)),
        );
        rows.push(row);
    }
    // Over a curve's points a mean says nothing.
    if table.rows.len() > 1 && table.grid.curve.is_none() {
        rows.push(means(table));
    }
    Block::Table {
        head: head(study, table),
        rows,
    }
}

/// The last row: the mean of each column. Empty where a place is missing, since a mean over other
/// rows would compare what is not comparable.
fn means(table: &Table) -> Vec<TableCell> {
    let mut row = vec![TableCell::default(); table.row_axes.len()];
    if let Some(first) = row.first_mut() {
        *first = TableCell::text("mean");
    }
    row.extend(
        table
            .means()
            .into_iter()
            .map(|(ours, published)| mean(ours, published)),
    );
    row
}

/// A rate with everything that stands beside it. While a training seed is missing that is said in
/// place of the rate: a part of the trials has another expectation.
fn rate(place: &Place) -> TableCell {
    let mut cell = TableCell {
        number: true,
        ..TableCell::default()
    };
    match &place.score {
        None => cell.lines.push(plain(missing(place))),
        Some(score) => {
            cell.tone = tone(Some(score.rate().0), place.published);
            cell.lines.extend(score_lines(place, score));
        }
    }
    if let Some(published) = place.published {
        cell.lines
            .push(vec![Inline::Small(format!("published {published:.2}"))]);
    }
    cell
}

/// What is said of a place whose trials are not all there.
fn missing(place: &Place) -> &'static str {
    if place.by_seed.iter().all(|(_, score)| score.is_none()) {
        "not run"
    } else {
        "not all seeds run"
    }
}

/// The rate, its interval, invalid trials if there are any, and each training's successes if there
/// are several.
///
/// The interval is Wilson's, 95 %.
fn score_lines(place: &Place, score: &Score) -> Vec<Vec<Inline>> {
    let (rate, [low, high]) = score.rate();
    let mut lines = vec![
        vec![Inline::Strong(format!("{rate:.2}"))],
        plain(format!(
            "{} of {}, {low:.2} to {high:.2}",
            score.successes, score.trials
        )),
    ];
    if score.invalid > 0 {
        lines.push(plain(format!("{} invalid", score.invalid)));
    }
    if place.by_seed.len() > 1 {
        let each = place
            .by_seed
            .iter()
            .filter_map(|(_, score)| Some(score.as_ref()?.successes.to_string()));
        lines.push(plain(format!(
            "by training: {}",
            each.collect::<Vec<_>>().join(", ")
        )));
    }
    lines
}

/// Ours above the published mean, each only if it is over all rows.
fn mean(ours: Option<f64>, published: Option<f64>) -> TableCell {
    let mut cell = TableCell {
        number: true,
        tone: tone(ours, published),
        ..TableCell::default()
    };
    if let Some(ours) = ours {
        cell.lines.push(vec![Inline::Strong(format!("{ours:.2}"))]);
    }
    if let Some(published) = published {
        cell.lines
            .push(vec![Inline::Small(format!("published {published:.2}"))]);
    }
    cell
}

/// Published rates have two decimals, so that ours is below only if it is by more than half a unit
/// of the second.
fn tone(ours: Option<f64>, published: Option<f64>) -> Tone {
    match (ours, published) {
        (Some(ours), Some(published)) if ours < published - 0.005 => Tone::Below,
        (Some(_), Some(_)) => Tone::Reached,
        _ => Tone::Plain,
    }
}

/// A plot for each place on the axes other than the curve's and the columns'. None of a grid
/// without a curve. A place on the curve's axis that is no number has no point.
pub(super) fn curves(study: &StudyRecord, table: &Table) -> Vec<Block> {
    let Some(axis) = table.grid.curve else {
        return Vec::new();
    };
    let Some(along) = table.row_axes.iter().position(|found| *found == axis) else {
        return Vec::new();
    };
    let mut plots: Vec<(Vec<String>, Plot)> = Vec::new();
    for row in &table.rows {
        let Ok(x) = row.labels[along].parse::<f64>() else {
            continue;
        };
        let mut names = row.labels.clone();
        names.remove(along);
        if !plots.iter().any(|(found, _)| *found == names) {
            plots.push((names.clone(), empty_plot(study, table, axis, &names)));
        }
        let Some((_, plot)) = plots.iter_mut().find(|(found, _)| *found == names) else {
            continue;
        };
        add_points(plot, x, row);
    }
    let drawn = plots.into_iter();
    drawn.filter_map(|(_, plot)| draw(plot, axis)).collect()
}

/// Adds the rates of `row` at `x` to the series of its columns.
///
/// Each with its interval; a column whose trials are not all there has none here.
fn add_points(plot: &mut Plot, x: f64, row: &Row) {
    for (series, place) in plot.series.iter_mut().zip(&row.places) {
        if let Some(score) = place.as_ref().and_then(|place| place.score) {
            let (rate, interval) = score.rate();
            series.points.push((x, rate));
            series.intervals.push(interval);
        }
    }
}

/// None if no column has a point.
fn draw(mut plot: Plot, axis: Axis) -> Option<Block> {
    plot.series.retain(|series| !series.points.is_empty());
    Some(Block::Plot {
        title: format!("{}: success rate over {}", plot.title, axis.heading()),
        svg: plot.svg()?,
    })
}

/// Its title names the place; its series are the table's columns in their order, so that a column
/// has the same colour in all plots of the grid.
fn empty_plot(study: &StudyRecord, table: &Table, axis: Axis, names: &[String]) -> Plot {
    let others = table.row_axes.iter().filter(|found| **found != axis);
    let title: Vec<String> = others
        .zip(names)
        .map(|(axis, name)| study.title_of(*axis, name))
        .collect();
    let series = columns(study, table).into_iter().enumerate();
    Plot {
        title: if title.is_empty() {
            table.grid.title.clone()
        } else {
            title.join(", ")
        },
        x: axis.heading().to_owned(),
        y: "success rate".to_owned(),
        logarithmic: false,
        series: series
            .map(|(colour, name)| Series {
                name,
                colour,
                ..Series::default()
            })
            .collect(),
    }
}

/// The table of `comparisons`: how many pairs of trials ended how, McNemar's p and Holm's.
pub(super) fn compared(study: &StudyRecord, table: &Table, comparisons: &[Comparison]) -> Block {
    let mut head: Vec<String> = table
        .row_axes
        .iter()
        .map(|axis| axis.heading().to_owned())
        .collect();
    let names = [
        "A",
        "B",
        "both",
        "A alone",
        "B alone",
        "neither",
        "p",
        "p by Holm",
    ];
    head.extend(names.map(str::to_owned));
    let rows = comparisons.iter();
    Block::Table {
        rows: rows.map(|row| comparison(study, table, row)).collect(),
        head,
    }
}

fn comparison(study: &StudyRecord, table: &Table, comparison: &Comparison) -> Vec<TableCell> {
    let title = |name: &str| TableCell::text(study.title_of(table.grid.columns, name));
    let mut row = labels(study, &table.row_axes, &comparison.row);
    row.extend([title(&comparison.first), title(&comparison.second)]);
    let pairs = comparison.pairs;
    let counts = [pairs.both, pairs.first, pairs.second, pairs.neither];
    row.extend(counts.map(|count| TableCell::number(count.to_string())));
    row.extend([comparison.p, comparison.p_holm].map(|p| TableCell::number(probability(p))));
    row
}

/// Three decimals; below 0.0005, which would read 0.000, one digit and the power of ten.
fn probability(p: f64) -> String {
    if p < 0.0005 {
        format!("{p:.0e}")
    } else {
        format!("{p:.3}")
    }
}

/// The table of lost trials by reason: a row for each, most frequent first, and a count a column;
/// empty for 0.
pub(super) fn reasons(
    study: &StudyRecord,
    table: &Table,
    losses: &[(String, Vec<usize>)],
) -> Block {
    let mut head = vec!["reason".to_owned()];
    head.extend(columns(study, table));
    let rows = losses.iter().map(|(reason, counts)| {
        let mut row = vec![TableCell::text(reason.clone())];
        row.extend(counts.iter().map(|count| {
            TableCell::number(if *count == 0 {
                String::new()
            } else {
                count.to_string()
            })
        }));
        row
    });
    Block::Table {
        rows: rows.collect(),
        head,
    }
}

fn head(study: &StudyRecord, table: &Table) -> Vec<String> {
    let rows = table.row_axes.iter().map(|axis| axis.heading().to_owned());
    rows.chain(columns(study, table)).collect()
}

/// Titles of the columns, by which the file's own names are shown.
fn columns(study: &StudyRecord, table: &Table) -> Vec<String> {
    let title = |name: &String| study.title_of(table.grid.columns, name);
    table.columns.iter().map(title).collect()
}

/// The titles of `names`, which lie on `axes` in this order.
fn labels(study: &StudyRecord, axes: &[Axis], names: &[String]) -> Vec<TableCell> {
    let named = axes.iter().zip(names);
    named
        .map(|(axis, name)| TableCell::text(study.title_of(*axis, name)))
        .collect()
}
