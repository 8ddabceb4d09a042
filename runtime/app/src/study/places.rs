//! The places of a grid, and what they and their cells are called. A place is a value on each axis
//! of the grid; networks vary fastest, tasks slowest.

use std::collections::{BTreeMap, BTreeSet};

use super::axis::{Axis, Coordinates};
use super::file::{GridSection, StudyFile};
use super::plan::{Cell, CellRecord, GridRecord};

/// `TASK, NETWORK[, N of RECORDING][, seed S], NEEDLE, VIEW, EXECUTION: N trials`, without what the
/// place does not have. For people alone: a cell is known by its address.
pub(super) fn evaluation_label(grid: &GridSection, at: &Coordinates, seed: Option<u64>) -> String {
    let mut label = format!("{}, {}", at.task, at.network);
    if let (Some(demonstrations), Some(recording)) = (at.demonstrations, &at.recording) {
        label += &format!(", {demonstrations} of {recording}");
    }
    if let Some(seed) = seed {
        label += &format!(", seed {seed}");
    }
    for place in [&at.needle, &Some(at.view.clone()), &at.execution]
        .into_iter()
        .flatten()
    {
        label += &format!(", {place}");
    }
    label + &format!(": {} trials", grid.trials)
}

/// What `study.json` keeps of a cell: enough for a report to name it, and to find what it needs.
pub(super) fn cell_record(cell: &Cell) -> CellRecord {
    CellRecord {
        kind: cell.job.kind(),
        label: cell.label.clone(),
        inputs: cell.job.inputs(),
    }
}

/// What `study.json` keeps of a grid, so that a report needs no study's file.
pub(super) fn grid_record(grid: &GridSection) -> GridRecord {
    GridRecord {
        name: grid.name.clone(),
        title: grid.title.clone(),
        note: grid.note.clone(),
        columns: grid.columns,
        curve: grid.curve,
        trials: grid.trials,
        first_seed: grid.first_seed,
        published: grid.published.clone(),
    }
}

/// What no axis has placed yet. The view is `train` where a grid names none.
fn unplaced() -> Coordinates {
    Coordinates {
        task: String::new(),
        network: String::new(),
        recording: None,
        demonstrations: None,
        needle: None,
        view: "train".to_owned(),
        execution: None,
    }
}

/// Every place of `grid`; what is not trained has no recording and no number of demonstrations. The
/// order is that of `AXES`, which tables keep.
pub(super) fn places(file: &StudyFile, grid: &GridSection) -> Vec<Coordinates> {
    let places = vec![unplaced()];
    let places = each(places, &grid.tasks, |at, task| at.task = task);
    let places = each(places, &grid.recordings, |at, name| {
        at.recording = Some(name)
    });
    let places = each(places, &grid.needles, |at, needle| at.needle = Some(needle));
    let places = each(places, &grid.views, |at, view| at.view = view);
    let places = each(places, &grid.executions, |at, name| {
        at.execution = Some(name)
    });
    let places = each(places, &grid.demonstrations, |at, count| {
        at.demonstrations = Some(count)
    });
    let places = each(places, &grid.networks, |at, network| at.network = network);
    distinct(file, places)
}

/// Each of `places` once, without what only the training of a network depends on where none is
/// trained.
fn distinct(file: &StudyFile, mut places: Vec<Coordinates>) -> Vec<Coordinates> {
    let mut seen = BTreeSet::new();
    places.retain_mut(|at| {
        let network = file.network.get(&at.network);
        if !network.is_some_and(|network| network.policy.is_trained()) {
            (at.recording, at.demonstrations) = (None, None);
        }
        seen.insert(at.clone())
    });
    places
}

/// Each of `places` with each of `values`; an axis without values leaves them as they are.
/// Multiplies the number of places by the number of values, so that the last axis varies fastest.
fn each<T: Clone>(
    places: Vec<Coordinates>,
    values: &[T],
    set: impl Fn(&mut Coordinates, T),
) -> Vec<Coordinates> {
    if values.is_empty() {
        return places;
    }
    let mut product = Vec::with_capacity(places.len() * values.len());
    for at in &places {
        for value in values {
            let mut place = at.clone();
            set(&mut place, value.clone());
            product.push(place);
        }
    }
    product
}

/// The titles that the file gives to names of its tables; a name without one is shown as it is. The
/// other axes have no names to give titles to.
pub(super) fn titles(file: &StudyFile) -> BTreeMap<Axis, BTreeMap<String, String>> {
    fn of<'a>(
        named: impl Iterator<Item = (&'a String, &'a Option<String>)>,
    ) -> BTreeMap<String, String> {
        named
            .filter_map(|(name, title)| Some((name.clone(), title.clone()?)))
            .collect()
    }
    let tasks = file.task.iter().map(|(name, it)| (name, &it.title));
    let networks = file.network.iter().map(|(name, it)| (name, &it.title));
    let recordings = file.recording.iter().map(|(name, it)| (name, &it.title));
    let executions = file.execution.iter().map(|(name, it)| (name, &it.title));
    BTreeMap::from([
        (Axis::Task, of(tasks)),
        (Axis::Network, of(networks)),
        (Axis::Recording, of(recordings)),
        (Axis::Execution, of(executions)),
    ])
}
