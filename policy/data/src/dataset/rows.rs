//! The numbers of a dataset's frames, taken out of its data files and checked against the table of
//! episodes.
//!
//! A file is read column by column as a whole, checked, and only then appended; what is damaged
//! never gets into a [`Dataset`](super::Dataset).

use std::ops::Range;

use super::{
    ACTION_WIDTH, DatasetError, STATE_WIDTH, TIP_POSE_WIDTH,
    listed::Listed,
    schema::{ACTION, EPISODE_INDEX, STATE, TIP_POSE},
    table::Table,
};

/// The numbers of some frames; a vector has as many rows a frame as there are arms. Widened to
/// `f64`, in which stored `f32` are exact.
#[derive(Debug, Default)]
pub(super) struct Rows {
    pub(super) state: Vec<[f64; STATE_WIDTH]>,
    pub(super) tip_pose: Vec<[f64; TIP_POSE_WIDTH]>,
    pub(super) action: Vec<[f64; ACTION_WIDTH]>,
    /// By frame: where its images are.
    pub(super) place: Vec<Place>,
}

impl Rows {
    /// Appends the rows of another dataset, whose first table is the `tables`th of this one.
    pub(super) fn append(&mut self, other: Self, tables: usize) {
        self.state.extend(other.state);
        self.tip_pose.extend(other.tip_pose);
        self.action.extend(other.action);
        let moved = |place: Place| Place {
            table: tables + place.table,
            ..place
        };
        self.place.extend(other.place.into_iter().map(moved));
    }
}

/// Where a frame is stored.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Index into the dataset's tables.
    pub(super) table: usize,
    /// Row within that file.
    pub(super) row: usize,
}

/// The numbers of one data file. Dropped when the rows of the wanted episodes are taken over.
pub(super) struct FileRows {
    arms: usize,
    state: Vec<[f64; STATE_WIDTH]>,
    tip_pose: Vec<[f64; TIP_POSE_WIDTH]>,
    action: Vec<[f64; ACTION_WIDTH]>,
    /// The episode that each row says it belongs to.
    pub(super) episode_index: Vec<i64>,
}

impl FileRows {
    /// All columns of numbers, which must have the same number of rows.
    pub(super) fn read(table: &Table, arms: usize) -> Result<Self, DatasetError> {
        let file = Self {
            arms,
            state: table.vectors(STATE, arms)?,
            tip_pose: table.vectors(TIP_POSE, arms)?,
            action: table.vectors(ACTION, arms)?,
            episode_index: table.integers(EPISODE_INDEX)?,
        };
        let rows = file.episode_index.len();
        for (name, found) in [
            (STATE, file.state.len()),
            (TIP_POSE, file.tip_pose.len()),
            (ACTION, file.action.len()),
        ] {
            table.check_rows(name, found / arms.max(1), rows)?;
        }
        Ok(file)
    }

    /// Adds the rows `range`, which are finite, out of `file`, the dataset's `table`th.
    pub(super) fn append(
        &self,
        rows: &mut Rows,
        (table, file): (usize, &Table),
        range: Range<usize>,
    ) -> Result<(), DatasetError> {
        let of_arms = self.arms * range.start..self.arms * range.end;
        for (name, bad) in [
            (STATE, not_finite(&self.state[of_arms.clone()])),
            (TIP_POSE, not_finite(&self.tip_pose[of_arms.clone()])),
            (ACTION, not_finite(&self.action[of_arms.clone()])),
        ] {
            if let Some((vector, value)) = bad {
                let row = range.start + vector / self.arms.max(1);
                let what = format!("{name} in row {row}");
                return Err(file.mismatch(&what, value.to_string(), "finite".to_owned()));
            }
        }
        rows.state.extend_from_slice(&self.state[of_arms.clone()]);
        rows.tip_pose
            .extend_from_slice(&self.tip_pose[of_arms.clone()]);
        rows.action.extend_from_slice(&self.action[of_arms]);
        rows.place.extend(range.map(|row| Place { table, row }));
        Ok(())
    }
}

/// The first number that is NaN or infinite, and the vector that has it.
fn not_finite<const N: usize>(vectors: &[[f64; N]]) -> Option<(usize, f64)> {
    let mut numbers = vectors.as_flattened().iter().copied().enumerate();
    let (place, value) = numbers.find(|(_, value)| !value.is_finite())?;
    Some((place / N, value))
}

/// An episode has to lie where the table of episodes says, and nowhere else: the rows `range` of
/// the file's `indices` of episodes.
///
/// Four ways to be wrong: the file goes on after an episode that should be alone in it, it ends too
/// early, a row belongs to another episode, or the list leaves a gap.
pub(super) fn check_episode(
    table: &Table,
    listed: &Listed,
    next: usize,
    (indices, range): (&[i64], Range<usize>),
) -> Result<(), DatasetError> {
    let what = format!("episode {}", listed.index);
    if listed.alone && indices.len() > range.end {
        let expected = format!("{}, its length in meta/episodes.jsonl", listed.len);
        return Err(table.mismatch(&what, format!("{} rows long", indices.len()), expected));
    }
    let Some(rows) = indices.get(range) else {
        let found = "cut off by the end of the file".to_owned();
        return Err(table.mismatch(&what, found, format!("{} rows", listed.len)));
    };
    let is_other = |index: &&i64| usize::try_from(**index) != Ok(listed.index);
    if let Some(other) = rows.iter().find(is_other) {
        let found = format!("mixed with rows of episode {other}");
        return Err(table.mismatch(&what, found, "whole".to_owned()));
    }
    if listed.len == 0 || listed.start != next {
        let found = format!("{} frames from frame {}", listed.len, listed.start);
        return Err(table.mismatch(&what, found, format!("at least one, from frame {next}")));
    }
    Ok(())
}
