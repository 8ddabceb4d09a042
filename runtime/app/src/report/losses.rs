//! Lost trials one by one, with film strips and logs. Their number is bounded, so that a report of
//! thousands of losses can still be sent.

use std::path::{Component, Path, PathBuf};

use super::document::{Block, Inline, TableCell, paragraph, plain};
use super::load::{Evaluation, Results, Trial};
use super::strips;

/// Strips of one evaluation that are shown.
const STRIPS_EACH: usize = 2;

/// Strips of a whole report: it is to stay small enough to be sent.
const STRIPS_ALL: usize = 60;

/// The lost and the invalid trials of every evaluation; links lead from the folder `from`.
#[must_use]
pub(super) fn losses_of_trials(results: &Results, from: &Path) -> Vec<Block> {
    let blocks = evaluations_with_losses(results, from);
    if blocks.is_empty() {
        return blocks;
    }
    let head = [
        Block::Heading(2, "Lost trials".to_owned()),
        paragraph(
            "Strips run from a trial's beginning to its end. Logs open in Foxglove; trocar replay and trocar verify read them.",
        ),
    ];
    head.into_iter().chain(blocks).collect()
}

/// In the order of the grids, folded up; strips stop at `STRIPS_ALL`, rows of the tables don't.
fn evaluations_with_losses(results: &Results, from: &Path) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut room = STRIPS_ALL;
    for (address, evaluation) in results.in_order() {
        let lost: Vec<&Trial> = evaluation
            .trials
            .iter()
            .filter(|trial| trial.is_lost() || trial.invalid)
            .collect();
        if lost.is_empty() {
            continue;
        }
        let mut inner = vec![trials(evaluation, &lost, from)];
        let pictures = lost.iter().filter_map(|trial| picture(evaluation, trial));
        inner.extend(pictures.take(room.min(STRIPS_EACH)));
        room -= inner.len() - 1;
        let cell = results.study.cells.get(address);
        let label = cell.map_or_else(|| address.to_string(), |cell| cell.label.clone());
        blocks.push(Block::Details(
            format!("{label}: {} lost or invalid", lost.len()),
            inner,
        ));
    }
    blocks
}

fn picture(evaluation: &Evaluation, trial: &Trial) -> Option<Block> {
    let png = strips::strip_of(evaluation, trial)?;
    let title = format!(
        "seed {}: {}, {:.2} s",
        trial.seed, trial.reason, trial.seconds
    );
    Some(Block::Picture { title, png })
}

/// A link from the folder `from` to the file at `path`.
fn link(from: &Path, path: &Path) -> Inline {
    let name = path.file_name().unwrap_or_default();
    Inline::Link {
        text: name.to_string_lossy().into_owned(),
        target: relative(from, path).display().to_string(),
    }
}

/// Seed, reason and time of each, with its log if that was kept.
fn trials(evaluation: &Evaluation, lost: &[&Trial], from: &Path) -> Block {
    let head = ["seed", "reason", "after", "log"]
        .map(str::to_owned)
        .to_vec();
    let rows = lost.iter().map(|trial| {
        let invalid = if trial.invalid { "invalid: " } else { "" };
        let log = strips::log_of(evaluation, trial);
        let log = log.map_or_else(|| plain("not kept"), |path| vec![link(from, &path)]);
        vec![
            TableCell::number(trial.seed.to_string()),
            TableCell::text(format!("{invalid}{}", trial.reason)),
            TableCell::number(format!("{:.2} s", trial.seconds)),
            TableCell {
                lines: vec![log],
                ..TableCell::default()
            },
        ]
    });
    Block::Table {
        rows: rows.collect(),
        head,
    }
}

/// The way from the folder `from` to `to`, both absolute or both relative to the same place. Links
/// of a report hold as long as it and the study's folder stay where they are to each other.
#[must_use]
pub(super) fn relative(from: &Path, to: &Path) -> PathBuf {
    let from: Vec<Component<'_>> = from
        .components()
        .filter(|part| *part != Component::CurDir)
        .collect();
    let to: Vec<Component<'_>> = to
        .components()
        .filter(|part| *part != Component::CurDir)
        .collect();
    let common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    let up = from[common..].iter().map(|_| Component::ParentDir);
    up.chain(to[common..].iter().copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_lead_from_the_report_to_the_log() {
        let way = |from: &str, to: &str| {
            relative(Path::new(from), Path::new(to))
                .display()
                .to_string()
        };
        assert_eq!(way("/a/b", "/a/b/c/d.mcap"), "c/d.mcap");
        assert_eq!(way("/a/b/r", "/a/c/d.mcap"), "../../c/d.mcap");
        assert_eq!(way("", "runs/x"), "runs/x");
        assert_eq!(way("./out", "runs/x"), "../runs/x");
    }
}
