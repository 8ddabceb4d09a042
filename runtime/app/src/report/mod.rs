//! Reports of studies: one page with every table beside the published figures, curves, comparisons,
//! losses, times and hashes.
//!
//! `load` reads the study's folders, `tables`, `compare`, `causes` and `statistics` count, `rates`,
//! `losses`, `making`, `plots` and `strips` turn that into the blocks of `document`, which `page`
//! puts in order and `html` or `markdown` writes. Nothing is run here, and no cell is changed.

mod causes;
pub mod compare;
pub mod document;
pub mod html;
pub mod load;
mod losses;
mod making;
pub mod markdown;
mod page;
pub mod plots;
mod rates;
pub mod statistics;
mod strips;
pub mod tables;

use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::session::outputs::is_standard_output;
use crate::study::StudyError;
use crate::study::files::{write_json, write_whole};
use crate::study::job::Kind;
use compare::Comparison;
use document::Block;
use load::Results;
use statistics::Score;
use tables::Table;

/// The figures of a report, for scripts: the same for the same cells, wherever and in how many
/// shards they were made.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// The study's title.
    pub title: String,
    /// The address of its evaluations together.
    pub grid: String,
    /// Evaluations that are done, and all.
    pub evaluations: [usize; 2],
    /// All trials.
    pub total: Score,
    /// The tables.
    pub tables: Vec<Table>,
    /// Two by two, of each table.
    pub comparisons: Vec<Vec<Comparison>>,
}

/// A report that was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// Its files.
    pub files: Vec<PathBuf>,
    /// Evaluations that are done, and all.
    pub evaluations: [usize; 2],
    /// What is not what was written, with the reason.
    pub damaged: Vec<String>,
}

/// Reads the study in `folders` and writes its report to `out`, `.html` or `.md`, and its figures
/// to `json`.
///
/// # Errors
/// [`StudyError`] if a folder is no study's or of another grid, or `out` can't be written or is of
/// another kind.
pub fn write(folders: &[PathBuf], out: &Path, json: Option<&Path>) -> Result<Written, StudyError> {
    let kind = kind_of(out)?;
    let results = Results::read(folders)?;
    let mut files = vec![out.to_owned()];
    let blocks = page::blocks(&results, &folder_of(out));
    match kind {
        PageKind::Html => {
            write_whole(out, html::page(&results.study.title, &blocks).as_bytes())?;
        }
        PageKind::Markdown => files.extend(write_markdown(&blocks, out)?),
    }
    let figures = figures(&results);
    if let Some(path) = json {
        write_figures(&figures, path)?;
        files.push(path.to_owned());
    }
    Ok(Written {
        files,
        evaluations: figures.evaluations,
        damaged: results.damaged,
    })
}

/// Told by the file's ending.
#[derive(Clone, Copy)]
enum PageKind {
    Html,
    Markdown,
}

/// # Errors
/// `BadArgument` for any other ending, before anything is read.
fn kind_of(out: &Path) -> Result<PageKind, StudyError> {
    match out.extension().and_then(|kind| kind.to_str()) {
        Some("html") => Ok(PageKind::Html),
        Some("md") => Ok(PageKind::Markdown),
        _ => Err(StudyError::BadArgument(format!(
            "--out {}: a report is FILE.html or FILE.md",
            out.display()
        ))),
    }
}

/// Writes a page to `out` and what is attached to it beside that; gives the files of the latter.
fn write_markdown(blocks: &[Block], out: &Path) -> Result<Vec<PathBuf>, StudyError> {
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    let folder = format!("{stem}_files");
    let (text, attachments) = markdown::text(blocks, &folder);
    let mut files = Vec::new();
    for attachment in attachments {
        let path = out.with_file_name(&folder).join(attachment.name);
        write_whole(&path, &attachment.bytes)?;
        files.push(path);
    }
    write_whole(out, text.as_bytes())?;
    Ok(files)
}

/// Writes `figures` to the file at `path` or to the standard output.
fn write_figures(figures: &Figures, path: &Path) -> Result<(), StudyError> {
    if !is_standard_output(path) {
        return write_json(path, figures);
    }
    let text = serde_json::to_string_pretty(figures);
    let text = text.map_err(|error| StudyError::io(path, error))?;
    let written = writeln!(std::io::stdout(), "{text}");
    written.map_err(|error| StudyError::io(path, error))
}

/// The folder of `file`, absolute if the system tells where we are, as the folders of results are
/// made too.
fn folder_of(file: &Path) -> PathBuf {
    let parent = file.parent().unwrap_or_else(|| Path::new(""));
    std::path::absolute(parent.join(".")).unwrap_or_else(|_| parent.to_owned())
}

/// What of a report a script may want, made from the same tables.
fn figures(results: &Results) -> Figures {
    let tables = tables::tables(results);
    let all = results.study.count_of(Kind::Evaluation);
    Figures {
        title: results.study.title.clone(),
        grid: results.study.grid.to_string(),
        evaluations: [results.evaluations.len(), all],
        total: page::total(results),
        comparisons: tables
            .iter()
            .map(|table| compare::comparisons(results, table))
            .collect(),
        tables,
    }
}
