//! From a study's file to its cells.
//!
//! Each grid is walked place by place (`places`), and at each place each network becomes a
//! recording, a training and an evaluation, or an evaluation alone if it is not trained. Cells are
//! told apart by their addresses alone, so that what two grids or two places need is made once.
//! Nothing is run here.

use std::collections::{BTreeMap, BTreeSet};

use super::StudyError;
use super::address::Address;
use super::axis::{Axis, Coordinates};
use super::file::{
    ExecutionSection, GridSection, NetworkSection, PolicyKind, RecordingSection, StudyFile,
};
use super::job::{EvaluationJob, Job, Kind, PolicyInput, RecordingJob, TaskInput, TrainingJob};
use super::materials::Materials;
use super::places::{cell_record, evaluation_label, grid_record, places, titles};
use super::plan::{Cell, Entry, Plan, STUDY_FORMAT, StudyRecord};

/// Options that the study itself gives to its cells. A file that sets one of them in `options`
/// would have two, and the cell would not be what its address says.
const TAKEN: [&str; 20] = [
    "--task",
    "--out",
    "--data",
    "--json",
    "--episodes",
    "--seed",
    "--jobs",
    "--resume",
    "--cameras",
    "--depth",
    "--source",
    "--scene",
    "--policy",
    "--preset",
    "--steps",
    "--batch",
    "--device",
    "--threads",
    "--save-every",
    "--view",
];

/// The cells of `file`, whose text is `text`. `materials` are the hashes of all that the file
/// names; the same file with the same materials gives the same cells in the same order.
///
/// # Errors
/// [`StudyError::BadCell`] and [`StudyError::Overlap`].
pub fn expand(file: &StudyFile, text: &str, materials: &Materials) -> Result<Plan, StudyError> {
    let mut expansion = Expansion {
        file,
        materials,
        cells: BTreeMap::new(),
        order: Vec::new(),
        entries: Vec::new(),
    };
    expansion.check_options()?;
    for grid in &file.grid {
        expansion.grid(grid)?;
    }
    expansion.check_overlap()?;
    expansion.plan(text)
}

/// What has been met so far.
struct Expansion<'a> {
    file: &'a StudyFile,
    materials: &'a Materials,
    /// Each cell once; of a recording the number of episodes grows as places ask for more.
    cells: BTreeMap<Address, Cell>,
    /// Addresses in the order in which they were met.
    order: Vec<Address>,
    /// Every evaluation at its place, in the order of the grids; one cell may stand at several.
    entries: Vec<Entry>,
}

impl Expansion<'_> {
    /// Every list of options of the file, with its key.
    fn options(&self) -> impl Iterator<Item = (String, &Vec<String>)> {
        let networks = self.file.network.iter().flat_map(|(name, network)| {
            let own = network.on.iter().filter_map(move |(task, on)| {
                Some((
                    format!("network.{name}.on.{task}.options"),
                    on.options.as_ref()?,
                ))
            });
            own.chain([(format!("network.{name}.options"), &network.options)])
        });
        let recordings = self
            .file
            .recording
            .iter()
            .map(|(name, r)| (format!("recording.{name}.options"), &r.options));
        networks.chain(recordings)
    }

    /// # Errors
    /// `BadCell` with the key whose options hold one of `TAKEN`.
    fn check_options(&self) -> Result<(), StudyError> {
        for (key, options) in self.options() {
            let taken = options.iter().find(|option| {
                let name = option.split('=').next().unwrap_or(option);
                TAKEN.contains(&name)
            });
            if let Some(option) = taken {
                let reason = format!("{option} is the study's own to give");
                return Err(self.materials.bad(&key, reason));
            }
        }
        Ok(())
    }

    /// Adds the cells of all places of `grid`, one training for each of its training seeds.
    fn grid(&mut self, grid: &GridSection) -> Result<(), StudyError> {
        for at in places(self.file, grid) {
            let Some(network) = self.file.network.get(&at.network) else {
                continue;
            };
            if network.policy.is_trained() {
                for &seed in &grid.training_seeds {
                    self.trained(grid, &at, network, seed)?;
                }
            } else {
                let policy = self.untrained(&at.network, network)?;
                let evaluation = self.evaluation_of(grid, &at, policy, None)?;
                self.entries.push(Entry {
                    grid: grid.name.clone(),
                    at,
                    training_seed: None,
                    evaluation,
                    training: None,
                    recording: None,
                });
            }
        }
        Ok(())
    }

    /// The policy of a network that is not trained here: a built-in one by its name, or a
    /// checkpoint by its hash, so that it is another cell when the checkpoint's files change.
    fn untrained(&self, name: &str, network: &NetworkSection) -> Result<PolicyInput, StudyError> {
        if network.policy != PolicyKind::Checkpoint {
            return Ok(PolicyInput::Named(network.policy.as_str()));
        }
        let found = self.materials.checkpoints.get(name);
        let (sha256, folder) = found.cloned().ok_or_else(|| {
            self.materials
                .bad(&format!("network.{name}"), "no checkpoint")
        })?;
        Ok(PolicyInput::Checkpoint { sha256, folder })
    }

    /// Adds recording, training and evaluation of one place and one training seed. A network that
    /// learns from point clouds has their configuration among its files.
    fn trained(
        &mut self,
        grid: &GridSection,
        at: &Coordinates,
        network: &NetworkSection,
        seed: u64,
    ) -> Result<(), StudyError> {
        let network = &network.in_task(&at.task);
        let demonstrations = at.demonstrations.unwrap_or_default();
        let (recording, cameras) = self.recording(at, network, demonstrations)?;
        let mut files = self.materials.files(&network.options)?;
        if network.policy.needs_depth() {
            files.extend(self.materials.clouds(&network.options));
        }
        let shared = &self.file.training;
        let job = TrainingJob {
            code: self.materials.code.clone(),
            recording: recording.clone(),
            demonstrations,
            policy: network.policy.as_str(),
            cameras,
            preset: network.preset.clone(),
            steps: network.steps,
            batch: network.batch,
            augment: network.augment,
            bf16: network.bf16,
            options: network.options.clone(),
            files,
            device: shared.device,
            threads: shared.threads,
            seed,
            save_every: shared.save_every,
        };
        let recorded = at.on(Axis::Recording);
        let label = format!(
            "{}, {}, {demonstrations} of {recorded}, seed {seed}",
            at.task, at.network
        );
        let training = self.add(label, Job::Training(job))?;
        let policy = PolicyInput::Training(training.clone());
        let evaluation = self.evaluation_of(grid, at, policy, Some(seed))?;
        self.entries.push(Entry {
            grid: grid.name.clone(),
            at: at.clone(),
            training_seed: Some(seed),
            evaluation,
            training: Some(training),
            recording: Some(recording),
        });
        Ok(())
    }

    /// The recording, and those of its cameras that the network sees, if not all.
    ///
    /// A recording with cameras of its own is shared by networks that see different ones of them;
    /// without them it has exactly those of the network. Depth is recorded as soon as the network
    /// needs it.
    fn recording(
        &mut self,
        at: &Coordinates,
        network: &NetworkSection,
        demonstrations: usize,
    ) -> Result<(Address, Option<String>), StudyError> {
        let name = at.on(Axis::Recording);
        let key = format!("recording.{name}");
        let section = self.file.recording.get(&name);
        let section = section.ok_or_else(|| self.materials.bad(&key, "there is none"))?;
        let options = recording_options(section);
        let seen = network.cameras.clone().unwrap_or_default();
        let (cameras, seen) = match &section.cameras {
            Some(recorded) => (recorded.clone(), Some(seen)),
            None => (seen, None),
        };
        let depth = section.depth || network.policy.needs_depth();
        let with_depth = if depth { " with depth" } else { "" };
        let label = format!("{}, {cameras} camera(s){with_depth}, {name}", at.task);
        let job = RecordingJob {
            code: self.materials.code.clone(),
            task: self.task(&at.task)?,
            cameras,
            depth,
            seed: section.seed,
            files: self.materials.files(&options)?,
            options,
            episodes: demonstrations,
        };
        let address = self.add(label, Job::Recording(job))?;
        self.need_demonstrations(&address, demonstrations);
        Ok((address, seen))
    }

    /// Has the recording at `address` made with `count` demonstrations or more: fewer are the first
    /// ones of more.
    fn need_demonstrations(&mut self, address: &Address, count: usize) {
        if let Some(Cell {
            job: Job::Recording(job),
            ..
        }) = self.cells.get_mut(address)
        {
            job.episodes = job.episodes.max(count);
        }
    }

    /// # Errors
    /// `BadCell` for a name that the file does not have.
    fn task(&self, name: &str) -> Result<TaskInput, StudyError> {
        let task = self.materials.tasks.get(name).cloned();
        task.ok_or_else(|| self.materials.bad(&format!("task.{name}"), "there is none"))
    }

    /// The execution mode at a place; only a network has chunks to which it applies.
    fn execution(
        &self,
        grid: &GridSection,
        at: &Coordinates,
        policy: &PolicyInput,
    ) -> Result<ExecutionSection, StudyError> {
        let name = at.execution.as_ref();
        let execution = name.and_then(|name| self.file.execution.get(name));
        let execution = execution.cloned().unwrap_or_default();
        if execution.changes_checkpoint() && matches!(policy, PolicyInput::Named(_)) {
            let reason = format!(
                "{} has no chunks that an execution mode could change",
                at.network
            );
            return Err(self.materials.bad(&format!("grid {}", grid.name), reason));
        }
        Ok(execution)
    }

    /// Adds the evaluation of `policy`, whose training seed is `seed` if it was trained; the seed
    /// is in the label only, since the policy's address has it already.
    fn evaluation_of(
        &mut self,
        grid: &GridSection,
        at: &Coordinates,
        policy: PolicyInput,
        seed: Option<u64>,
    ) -> Result<Address, StudyError> {
        let execution = self.execution(grid, at, &policy)?;
        let job = EvaluationJob {
            code: self.materials.code.clone(),
            task: self.task(&at.task)?,
            policy,
            needle: at.needle.clone(),
            view: at.view.clone(),
            execution,
            trials: grid.trials,
            first_seed: grid.first_seed,
            device: self.file.evaluation.device,
            precision: self.file.evaluation.precision,
        };
        let label = evaluation_label(grid, at, seed);
        self.add(label, Job::Evaluation(job))
    }

    /// Adds a cell, if there is none like it. Its label is that of the place that came first.
    fn add(&mut self, label: String, job: Job) -> Result<Address, StudyError> {
        let recipe = job
            .recipe()
            .map_err(|error| self.materials.bad(&label, error.to_string()))?;
        let address = Address::of(&recipe);
        if !self.cells.contains_key(&address) {
            self.order.push(address.clone());
            let cell = Cell {
                address: address.clone(),
                label,
                job,
            };
            self.cells.insert(address.clone(), cell);
        }
        Ok(address)
    }

    /// None for what is not trained, which has seen no seeds.
    fn recording_of(&self, entry: &Entry) -> Option<&RecordingJob> {
        match &self.cells.get(entry.recording.as_ref()?)?.job {
            Job::Recording(job) => Some(job),
            Job::Training(_) | Job::Evaluation(_) => None,
        }
    }

    /// No policy may be evaluated on seeds that its demonstrations may have. A recording may try
    /// more seeds than it keeps (`recorded_seeds`); all of them count as seen.
    ///
    /// # Errors
    /// `Overlap` with both ranges, also if a range would pass the last seed.
    fn check_overlap(&self) -> Result<(), StudyError> {
        for entry in &self.entries {
            let grid = self.file.grid.iter().find(|grid| grid.name == entry.grid);
            let (Some(job), Some(grid)) = (self.recording_of(entry), grid) else {
                continue;
            };
            let (first, end) = recorded_seeds(job);
            let trials_end = grid.first_seed.saturating_add(grid.trials as u64);
            if first < trials_end && grid.first_seed < end || end == u64::MAX {
                return Err(StudyError::Overlap {
                    path: self.materials.path.clone(),
                    grid: grid.name.clone(),
                    recording: entry.at.on(Axis::Recording),
                    trials: format!("{} to {}", grid.first_seed, trials_end - 1),
                    recorded: format!("{first} to {}", end - 1),
                });
            }
        }
        Ok(())
    }

    /// The cells by kind, those of a kind in the order in which they were met.
    fn sorted(&self) -> Vec<Cell> {
        let mut cells: Vec<Cell> = Vec::new();
        for kind in Kind::ALL {
            let of_kind = self
                .order
                .iter()
                .filter_map(|address| self.cells.get(address));
            cells.extend(of_kind.filter(|cell| cell.job.kind() == kind).cloned());
        }
        cells
    }

    /// The grid's own address is over the evaluations alone: they contain everything else, and it
    /// tells whether two folders are shards of one study.
    fn plan(self, text: &str) -> Result<Plan, StudyError> {
        let addresses: BTreeSet<&Address> =
            self.entries.iter().map(|entry| &entry.evaluation).collect();
        // How many demonstrations there are to be is part of the grid, though of no recording's
        // address.
        let grid = Address::of(&serde_json::json!({ "evaluations": addresses }));
        let cells = self.sorted();
        let record = StudyRecord {
            format: STUDY_FORMAT,
            title: self.file.title.clone(),
            grid,
            code: self.materials.code.clone(),
            text: text.to_owned(),
            grids: self.file.grid.iter().map(grid_record).collect(),
            entries: self.entries,
            cells: cells
                .iter()
                .map(|cell| (cell.address.clone(), cell_record(cell)))
                .collect(),
            titles: titles(self.file),
        };
        Ok(Plan { cells, record })
    }
}

/// The options of `record` that `section` stands for.
fn recording_options(section: &RecordingSection) -> Vec<String> {
    let mut options = Vec::new();
    if let Some(share) = section.disturb {
        options.extend(["--disturb".to_owned(), share.to_string()]);
    }
    if !section.vary.is_empty() {
        options.extend(["--vary".to_owned(), section.vary.join(",")]);
    }
    options.extend(section.options.iter().cloned());
    options
}

/// The first seed that `job` may record, and the one after the last.
fn recorded_seeds(job: &RecordingJob) -> (u64, u64) {
    // `record` gives up after 4 n + 20 attempts, the last of which may come n at a time.
    let attempts = (job.episodes as u64).saturating_mul(5).saturating_add(20);
    (job.seed, job.seed.saturating_add(attempts))
}
