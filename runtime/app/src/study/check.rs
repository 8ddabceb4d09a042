//! Whether a study's file makes sense, beyond its form. `file` has read it, with unknown keys
//! refused; `expand` and `scenes` find what only all cells together show. The first defect ends the
//! check.

use std::collections::BTreeSet;

use hal::config::{ConfigError, Source};

use super::file::{
    GridSection, NetworkSection, PolicyKind, RunSection, StudyFile, TrainingSection,
};

/// Longest name of a task, a network, a recording, an execution mode or a grid.
///
/// Names stand in labels and in keys of `study.json`; of letters, digits, `-` and `_` alone they
/// need no quoting anywhere.
const NAME_BYTES_MAX: usize = 64;

impl StudyFile {
    /// Checks what was read from `source`. Names come before what refers to them, so that a
    /// misspelt one is reported where it stands.
    ///
    /// # Errors
    /// [`ConfigError`] naming file, line and key.
    pub(super) fn check(&self, source: &Source) -> Result<(), ConfigError> {
        check_counts(&self.run, &self.training, source)?;
        self.check_names(source)?;
        for (name, network) in &self.network {
            self.check_network(name, network, source)?;
        }
        if self.grid.is_empty() {
            return Err(source.out_of_range("grid", "[]", "one [[grid]] or more"));
        }
        let mut seen = BTreeSet::new();
        for (index, grid) in self.grid.iter().enumerate() {
            let key = format!("grid.{index}.name");
            check_name(&key, &grid.name, source)?;
            if !seen.insert(&grid.name) {
                return Err(source.out_of_range(&key, &grid.name, "names that no other grid has"));
            }
            self.check_grid(index, grid, source)?;
        }
        Ok(())
    }

    /// The names of tables must be plain.
    fn check_names(&self, source: &Source) -> Result<(), ConfigError> {
        let names = [
            ("task", self.task.keys().collect::<Vec<_>>()),
            ("network", self.network.keys().collect()),
            ("recording", self.recording.keys().collect()),
            ("execution", self.execution.keys().collect()),
        ];
        for (table, names) in names {
            for name in names {
                check_name(&format!("{table}.{name}"), name, source)?;
            }
        }
        Ok(())
    }

    /// A checkpoint for `policy = "checkpoint"` and for no other; cameras for what is trained,
    /// since their number shapes the network; in `on` only tasks of this file; no zero steps or
    /// batches.
    fn check_network(
        &self,
        name: &str,
        network: &NetworkSection,
        source: &Source,
    ) -> Result<(), ConfigError> {
        let key = |key: &str| format!("network.{name}.{key}");
        let is_checkpoint = network.policy == PolicyKind::Checkpoint;
        if network.checkpoint.is_some() != is_checkpoint {
            let value = network.checkpoint.as_deref().unwrap_or("none");
            let allowed = "a folder for policy = \"checkpoint\", and nothing for others";
            return Err(source.out_of_range(&key("checkpoint"), value, allowed));
        }
        if network.policy.is_trained() && network.cameras.is_none() {
            let allowed = "single, multi or cameras' names, for a policy that is trained";
            return Err(source.out_of_range(&key("cameras"), "none", allowed));
        }
        let mut tasks = network.on.keys();
        if let Some(task) = tasks.find(|task| !self.task.contains_key(*task)) {
            let allowed = format!("the study's tasks: {}", joined(self.task.keys()));
            return Err(source.out_of_range(&key("on"), task, &allowed));
        }
        if has_zero_count(network) {
            return Err(source.out_of_range(&key("steps"), "0", "1 or more, as is batch"));
        }
        Ok(())
    }

    /// Axes, what its trainings need, trials, and published rates from 0 to 1.
    fn check_grid(
        &self,
        index: usize,
        grid: &GridSection,
        source: &Source,
    ) -> Result<(), ConfigError> {
        self.check_axes(index, grid, source)?;
        self.check_training(index, grid, source)?;
        check_trials(index, grid, source)?;
        for (number, rate) in grid.published.iter().flat_map(|p| &p.rates).enumerate() {
            let key = format!("grid.{index}.published.rates.{number}.rate");
            source.check_range(&key, rate.rate, 0.0, 1.0)?;
        }
        Ok(())
    }

    /// The values of a grid's axes must be distinct and known.
    fn check_axes(
        &self,
        index: usize,
        grid: &GridSection,
        source: &Source,
    ) -> Result<(), ConfigError> {
        let at = |key: &str| format!("grid.{index}.{key}");
        check_list(&at("tasks"), &grid.tasks, self.task.keys(), source)?;
        check_list(&at("networks"), &grid.networks, self.network.keys(), source)?;
        let (recordings, executions) = (self.recording.keys(), self.execution.keys());
        check_known(&at("recordings"), &grid.recordings, recordings, source)?;
        check_known(&at("executions"), &grid.executions, executions, source)?;
        check_distinct(&at("needles"), &grid.needles, source)?;
        check_distinct(&at("demonstrations"), &grid.demonstrations, source)?;
        check_distinct(&at("training_seeds"), &grid.training_seeds, source)?;
        let views = ["train", "view1", "view2"].map(str::to_owned);
        check_known(&at("views"), &grid.views, views.iter(), source)
    }

    /// Whether a network of this name makes trainings; no for a name that the file does not have.
    fn is_trained(&self, network: &str) -> bool {
        let network = self.network.get(network);
        network.is_some_and(|network| network.policy.is_trained())
    }

    /// A grid with networks that are trained needs something to train them with.
    fn check_training(
        &self,
        index: usize,
        grid: &GridSection,
        source: &Source,
    ) -> Result<(), ConfigError> {
        if grid.networks.iter().any(|name| self.is_trained(name)) {
            let needed = "one or more, since networks of this grid are trained";
            for (key, empty) in [
                ("recordings", grid.recordings.is_empty()),
                ("demonstrations", grid.demonstrations.is_empty()),
                ("training_seeds", grid.training_seeds.is_empty()),
            ] {
                if empty {
                    let key = format!("grid.{index}.{key}");
                    return Err(source.out_of_range(&key, "[]", needed));
                }
            }
        }
        Ok(())
    }
}

/// How many demonstrations and trials a grid has, and from which seed on. A policy's trial seeds
/// run from `first_seed` without wrapping around.
fn check_trials(index: usize, grid: &GridSection, source: &Source) -> Result<(), ConfigError> {
    let at = |key: &str| format!("grid.{index}.{key}");
    if grid.demonstrations.contains(&0) {
        return Err(source.out_of_range(&at("demonstrations"), "0", "[1, 1000000]"));
    }
    if grid.trials == 0 || grid.trials > 1_000_000 {
        let trials = grid.trials.to_string();
        return Err(source.out_of_range(&at("trials"), &trials, "[1, 1000000]"));
    }
    if grid.first_seed.checked_add(grid.trials as u64).is_none() {
        let seed = grid.first_seed.to_string();
        return Err(source.out_of_range(&at("first_seed"), &seed, "[0, 2^64 - trials)"));
    }
    Ok(())
}

/// Whether `network` is to be trained for no steps or in batches of none.
fn has_zero_count(network: &NetworkSection) -> bool {
    let elsewhere = network.on.values().filter_map(|on| on.steps);
    let steps = network.steps.into_iter().chain(elsewhere);
    let batch = network.batch.map(|batch| batch as u64);
    steps.chain(batch).any(|count| count == 0)
}

/// Shares and jobs divide whole GPUs and cores (`schedule`), so that none may be zero.
fn check_counts(
    run: &RunSection,
    training: &TrainingSection,
    source: &Source,
) -> Result<(), ConfigError> {
    for (key, value) in [
        ("run.trainings_per_gpu", run.trainings_per_gpu),
        ("run.evaluations_per_gpu", run.evaluations_per_gpu),
        ("run.record_jobs", run.record_jobs),
        ("run.eval_jobs", run.eval_jobs),
        ("training.threads", training.threads),
    ] {
        if !(1..=1024).contains(&value) {
            return Err(source.out_of_range(key, &value.to_string(), "[1, 1024]"));
        }
    }
    Ok(())
}

/// # Errors
/// An empty or long name, or one with other characters than letters, digits, `-` and `_`.
fn check_name(key: &str, name: &str, source: &Source) -> Result<(), ConfigError> {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if (1..=NAME_BYTES_MAX).contains(&name.len()) && name.chars().all(plain) {
        return Ok(());
    }
    let allowed = format!("1 to {NAME_BYTES_MAX} plain letters, digits, - and _");
    Err(source.out_of_range(key, name, &allowed))
}

/// `names` must not be empty, be distinct, and be among `known`.
fn check_list<'a>(
    key: &str,
    names: &[String],
    known: impl Iterator<Item = &'a String>,
    source: &Source,
) -> Result<(), ConfigError> {
    if names.is_empty() {
        return Err(source.out_of_range(key, "[]", "one or more: a grid without cells is none"));
    }
    check_known(key, names, known, source)
}

/// `names` must be distinct and among `known`; an empty list passes. The error lists what there is.
fn check_known<'a>(
    key: &str,
    names: &[String],
    known: impl Iterator<Item = &'a String>,
    source: &Source,
) -> Result<(), ConfigError> {
    check_distinct(key, names, source)?;
    let known: Vec<&String> = known.collect();
    match names.iter().find(|name| !known.contains(name)) {
        None => Ok(()),
        Some(name) => {
            let allowed = format!("what this file has: {}", joined(known.into_iter()));
            Err(source.out_of_range(key, name, &allowed))
        }
    }
}

/// Compares each value with all before it: lists have a few entries. A value that stands twice
/// would count its cells twice in a table.
fn check_distinct<T: PartialEq + std::fmt::Display>(
    key: &str,
    values: &[T],
    source: &Source,
) -> Result<(), ConfigError> {
    for (index, value) in values.iter().enumerate() {
        if values[..index].contains(value) {
            let value = format!("{value} twice");
            return Err(source.out_of_range(key, &value, "a list of different values"));
        }
    }
    Ok(())
}

fn joined<'a>(names: impl Iterator<Item = &'a String>) -> String {
    names.map(String::as_str).collect::<Vec<_>>().join(", ")
}
