//! A study as cells that depend on each other: recordings, trainings, evaluations.

use std::collections::{BTreeMap, BTreeSet};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::address::Address;
use super::axis::{Axis, Coordinates};
use super::file::Published;
use super::job::{Job, Kind};

/// A cell: something to be made once, wherever it is needed.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// Its address.
    pub address: Address,
    /// What it is, for people.
    pub label: String,
    /// What it is made of.
    pub job: Job,
}

/// A cell as a study's folder remembers it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellRecord {
    /// Its kind.
    pub kind: Kind,
    /// What it is, for people.
    pub label: String,
    /// The cells that it needs.
    pub inputs: Vec<Address>,
}

/// An evaluation at its place in a grid, of one training seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// The grid's name.
    pub grid: String,
    /// The place.
    pub at: Coordinates,
    /// The seed of the training, of what is trained.
    pub training_seed: Option<u64>,
    /// The evaluation.
    pub evaluation: Address,
    /// The training, of what is trained.
    pub training: Option<Address>,
    /// The recording, of what is trained.
    pub recording: Option<Address>,
}

/// A grid as a table of the report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GridRecord {
    /// Its name.
    pub name: String,
    /// Its heading.
    pub title: String,
    /// A sentence under the heading.
    pub note: String,
    /// What its columns are.
    pub columns: Axis,
    /// What its curve runs over.
    pub curve: Option<Axis>,
    /// Trials of each evaluation.
    pub trials: usize,
    /// Seed of the first.
    pub first_seed: u64,
    /// Published figures beside it.
    pub published: Option<Published>,
}

/// Everything about a study that its results are read by: `study.json` in its folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StudyRecord {
    /// Version of this form.
    pub format: u32,
    /// The study's title.
    pub title: String,
    /// The address of all its evaluations together.
    pub grid: Address,
    /// The program that its addresses are of.
    pub code: String,
    /// The file that the study came from.
    pub text: String,
    /// The tables.
    pub grids: Vec<GridRecord>,
    /// The evaluations at their places.
    pub entries: Vec<Entry>,
    /// The cells.
    pub cells: BTreeMap<Address, CellRecord>,
    /// What reports call names on an axis.
    pub titles: BTreeMap<Axis, BTreeMap<String, String>>,
}

/// [`StudyRecord::format`] of this program.
pub const STUDY_FORMAT: u32 = 1;

impl StudyRecord {
    /// What `name` on `axis` is called.
    #[must_use]
    pub fn title_of(&self, axis: Axis, name: &str) -> String {
        let title = self.titles.get(&axis).and_then(|titles| titles.get(name));
        title.map_or_else(|| name.to_owned(), Clone::clone)
    }

    /// How many cells of `kind` there are.
    #[must_use]
    pub fn count_of(&self, kind: Kind) -> usize {
        let cells = self.cells.values();
        cells.filter(|cell| cell.kind == kind).count()
    }
}

/// A study, ready to be run.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Its cells: each after those that it needs.
    pub cells: Vec<Cell>,
    /// What its folder remembers.
    pub record: StudyRecord,
}

/// A part of a study: the `index`th of `count`, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("{text}: a shard is i/n, such as 2/8, with i from 1 to n");
        let (index, count) = text.split_once('/').ok_or_else(wrong)?;
        let (index, count) = (index.parse().ok(), count.parse().ok());
        match (index, count) {
            (Some(index), Some(count)) if (1..=count).contains(&index) && count <= 100_000 => {
                Ok(Self { index, count })
            }
            _ => Err(wrong()),
        }
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl Plan {
    /// The cell at `address`.
    #[must_use]
    pub fn cell(&self, address: &Address) -> Option<&Cell> {
        self.cells.iter().find(|cell| cell.address == *address)
    }

    /// The cells of `shard`, or all.
    ///
    /// What is dealt out is trainings, each with the evaluations that need it, and evaluations that
    /// need none; in order of their addresses, in which neither tasks nor networks follow a
    /// pattern. Every shard has the recordings that it needs.
    #[must_use]
    pub fn part(&self, shard: Option<Shard>) -> BTreeSet<Address> {
        let Some(shard) = shard else {
            return self.cells.iter().map(|cell| cell.address.clone()).collect();
        };
        let mut part = self.dealt(shard);
        for cell in &self.cells {
            let of_part = cell.job.inputs().iter().any(|input| part.contains(input));
            if cell.job.kind() == Kind::Evaluation && of_part {
                part.insert(cell.address.clone());
            }
        }
        for cell in &self.cells {
            if cell.job.kind() == Kind::Training && part.contains(&cell.address) {
                part.extend(cell.job.inputs());
            }
        }
        part
    }

    /// What is dealt out to `shard`.
    fn dealt(&self, shard: Shard) -> BTreeSet<Address> {
        let dealt: BTreeSet<&Address> = self
            .cells
            .iter()
            .filter(|cell| is_dealt(cell))
            .map(|cell| &cell.address)
            .collect();
        dealt
            .into_iter()
            .enumerate()
            .filter(|(place, _)| place % shard.count + 1 == shard.index)
            .map(|(_, address)| address.clone())
            .collect()
    }
}

/// Whether a cell is of those that are dealt out to shards.
fn is_dealt(cell: &Cell) -> bool {
    match cell.job.kind() {
        Kind::Recording => false,
        Kind::Training => true,
        Kind::Evaluation => cell.job.inputs().is_empty(),
    }
}
