//! How the results of a study were made: training curves, time and memory, programs and hashes. It
//! closes a report: whoever doubts a figure finds here which program made it, from what, and at
//! what cost.

use std::collections::BTreeSet;

use super::document::{Block, Inline, TableCell, paragraph};
use super::load::{Made, Results};
use super::plots::{Plot, Series};
use crate::study::axis::Axis;
use crate::study::estimate::in_words;
use crate::study::job::Kind;
use crate::study::plan::Entry;

/// The losses of every network's trainings, a colour a task. A training whose losses are not kept
/// is only counted. One plot for each network; none at all if no curve is kept.
pub(super) fn training_curves(results: &Results) -> Vec<Block> {
    let study = &results.study;
    let trained = || {
        study
            .entries
            .iter()
            .filter(|entry| entry.training.is_some())
    };
    let networks = each_once(trained().map(|entry| &entry.at.network));
    let tasks = each_once(trained().map(|entry| &entry.at.task));
    let mut blocks: Vec<Block> = networks
        .into_iter()
        .filter_map(|network| network_curves(results, network, &tasks))
        .collect();
    if !blocks.is_empty() {
        blocks.insert(0, Block::Heading(2, "Training curves".to_owned()));
    }
    blocks
}

/// What comes, without repetition, in the order in which it comes first.
///
/// Quadratic, over a handful of names.
fn each_once<'a>(names: impl Iterator<Item = &'a String>) -> Vec<&'a String> {
    let mut list = Vec::new();
    for name in names {
        if !list.contains(&name) {
            list.push(name);
        }
    }
    list
}

/// The losses of one network's trainings, if any are kept. Their axis is logarithmic, since they
/// fall by decades.
fn network_curves(results: &Results, network: &str, tasks: &[&String]) -> Option<Block> {
    let (series, trainings) = loss_series(results, network, tasks);
    let count = series.len();
    let plot = Plot {
        title: results.study.title_of(Axis::Network, network),
        x: "step".to_owned(),
        y: "loss".to_owned(),
        logarithmic: true,
        series,
    };
    let title = format!(
        "{}: losses, a colour a task; those of {count} of {trainings} trainings are kept",
        plot.title
    );
    Some(Block::Plot {
        title,
        svg: plot.svg()?,
    })
}

/// The losses that are kept of one network's trainings, and how many trainings it has. A training
/// that stands at several places is counted once. A task has one colour in all plots of a report.
fn loss_series(results: &Results, network: &str, tasks: &[&String]) -> (Vec<Series>, usize) {
    let study = &results.study;
    let (mut seen, mut series) = (BTreeSet::new(), Vec::new());
    for entry in &study.entries {
        let Some(address) = entry.training.as_ref() else {
            continue;
        };
        if entry.at.network != network || !seen.insert(address) {
            continue;
        }
        let kept = results.trainings.get(address).map(|made| &made.curve);
        let Some(curve) = kept.filter(|curve| !curve.is_empty()) else {
            continue;
        };
        let colour = tasks.iter().position(|task| **task == entry.at.task);
        series.push(Series {
            name: study.title_of(Axis::Task, &entry.at.task),
            colour: colour.unwrap_or(0),
            points: curve.iter().map(|row| (row.step, row.loss)).collect(),
            intervals: Vec::new(),
        });
    }
    (series, seen.len())
}

/// What the table of time and memory has in its columns.
const COSTS_HEAD: [&str; 8] = [
    "",
    "of",
    "cells",
    "time each, median",
    "time in all",
    "memory",
    "memory on the GPU",
    "GPU",
];

/// Time and memory, by what was made.
pub(super) fn costs(results: &Results) -> Vec<Block> {
    let groups = groups(results);
    if groups.is_empty() {
        return Vec::new();
    }
    let rows = groups.iter();
    let rows = rows.map(|(kind, name, made)| cost(*kind, name, made));
    let note = "Time is that of a cell's own process, beside whatever else ran on the machine; memory is the greatest of any cell.";
    vec![
        Block::Heading(2, "Time and memory".to_owned()),
        paragraph(note),
        Block::Table {
            head: COSTS_HEAD.map(str::to_owned).to_vec(),
            rows: rows.collect(),
        },
    ]
}

/// What was made, each once, by its kind and by its task or its network. In the order of the kinds;
/// what is not done, or damaged, is in none.
fn groups(results: &Results) -> Vec<(Kind, String, Vec<&Made>)> {
    let mut groups: Vec<(Kind, String, Vec<&Made>)> = Vec::new();
    let mut seen = BTreeSet::new();
    for entry in &results.study.entries {
        for (kind, name, made) in made_for(results, entry) {
            let Some(made) = made.filter(|made| seen.insert(made.manifest.address.clone())) else {
                continue;
            };
            match groups.iter_mut().find(|(k, n, _)| *k == kind && *n == name) {
                Some((_, _, list)) => list.push(made),
                None => groups.push((kind, name, vec![made])),
            }
        }
    }
    groups.sort_by_key(|(kind, _, _)| *kind);
    groups
}

/// What was made for `entry`: its recording by the task, its training and its evaluation by the
/// network.
fn made_for<'a>(results: &'a Results, entry: &Entry) -> [(Kind, String, Option<&'a Made>); 3] {
    let network = results.study.title_of(Axis::Network, &entry.at.network);
    let task = results.study.title_of(Axis::Task, &entry.at.task);
    let recording = entry.recording.as_ref();
    let recording = recording.and_then(|address| results.recordings.get(address));
    let training = entry.training.as_ref();
    let training = training.and_then(|address| results.trainings.get(address));
    let evaluation = results.evaluations.get(&entry.evaluation);
    [
        (Kind::Recording, task, recording),
        (
            Kind::Training,
            network.clone(),
            training.map(|training| &training.made),
        ),
        (
            Kind::Evaluation,
            network,
            evaluation.map(|evaluation| &evaluation.made),
        ),
    ]
}

/// A row of the table: the median is the upper of the two middle ones; memory is the greatest of
/// all, and empty if no cell has it; GPUs are named once each.
fn cost(kind: Kind, name: &str, made: &[&Made]) -> Vec<TableCell> {
    let mut seconds: Vec<f64> = made.iter().map(|made| made.manifest.seconds).collect();
    seconds.sort_by(f64::total_cmp);
    let greatest = |of: fn(&Made) -> Option<u64>| made.iter().filter_map(|made| of(made)).max();
    let mut gpus: Vec<&str> = made
        .iter()
        .filter_map(|made| made.manifest.gpu.as_deref())
        .collect();
    gpus.sort_unstable();
    gpus.dedup();
    vec![
        TableCell::text(kind.as_str()),
        TableCell::text(name),
        TableCell::number(made.len().to_string()),
        TableCell::number(in_words(seconds[seconds.len() / 2])),
        TableCell::number(in_words(seconds.iter().sum())),
        TableCell::number(memory(greatest(|made| made.manifest.memory_bytes))),
        TableCell::number(memory(greatest(|made| made.manifest.gpu_memory_bytes))),
        TableCell::text(gpus.join(", ")),
    ]
}

/// GB of 10^9 bytes, with one decimal.
#[expect(clippy::cast_precision_loss, reason = "to a tenth of a GB")]
fn memory(bytes: Option<u64>) -> String {
    bytes.map_or_else(String::new, |bytes| format!("{:.1} GB", bytes as f64 / 1e9))
}

/// Programs, machines, addresses, and the file that the study came from. What is long is folded
/// away: all cells, and the text of the study's file as it was run.
pub(super) fn provenance(results: &Results) -> Vec<Block> {
    let study = &results.study;
    vec![
        Block::Heading(2, "Versions and hashes".to_owned()),
        versions(results),
        Block::Details(
            format!("All {} cells with their addresses", study.cells.len()),
            vec![all_cells(results)],
        ),
        Block::Details(
            "The study's file".to_owned(),
            vec![Block::Verbatim(study.text.clone())],
        ),
    ]
}

/// All cells that are done, by kind, those of a kind by address.
fn all_made(results: &Results) -> impl Iterator<Item = &Made> {
    let trainings = results.trainings.values().map(|training| &training.made);
    let evaluations = results
        .evaluations
        .values()
        .map(|evaluation| &evaluation.made);
    results
        .recordings
        .values()
        .chain(trainings)
        .chain(evaluations)
}

/// A cell of fixed-width text, as for a hash.
fn code(text: String) -> TableCell {
    TableCell {
        lines: vec![vec![Inline::Code(text)]],
        ..TableCell::default()
    }
}

/// Several executables or machines stand side by side where cells were made by several.
fn versions(results: &Results) -> Block {
    let distinct = |of: fn(&Made) -> String| {
        let mut found: Vec<String> = all_made(results).map(of).collect();
        found.sort_unstable();
        found.dedup();
        found.join(", ")
    };
    let row = |name: &str, value: String| vec![TableCell::text(name), code(value)];
    Block::Table {
        head: ["what", "value"].map(str::to_owned).to_vec(),
        rows: vec![
            row("grid", results.study.grid.to_string()),
            row("program in addresses", results.study.code.clone()),
            row(
                "executables (SHA-256)",
                distinct(|made| made.manifest.executable_sha256.clone()),
            ),
            row("machines", distinct(|made| made.manifest.host.clone())),
        ],
    }
}

/// Every cell of the study with its address in full, which is the name of its folder.
fn all_cells(results: &Results) -> Block {
    let mut rows = Vec::new();
    for (address, cell) in &results.study.cells {
        let made = all_made(results).find(|made| made.manifest.address == *address);
        rows.push(vec![
            TableCell::text(cell.kind.as_str()),
            code(address.to_string()),
            TableCell::text(cell.label.clone()),
            TableCell::text(made.map_or("not there", |_| "done")),
        ]);
    }
    Block::Table {
        head: ["", "address", "what", "state"].map(str::to_owned).to_vec(),
        rows,
    }
}
