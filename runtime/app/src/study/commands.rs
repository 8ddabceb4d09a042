//! The command lines that make cells. A job says what is made, this module with which options of
//! which verb. The order of the options is fixed, so that a manifest's command line is the same
//! each time.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use super::file::{Keep, RunSection};
use super::job::{EvaluationJob, Job, PolicyInput, RecordingJob, TaskInput, TrainingJob};

/// What this program's verbs accept. The binary answers with its own parser.
pub trait CommandLine {
    /// Checks that `trocar` would accept these arguments, without running anything.
    ///
    /// # Errors
    /// The parser's reason.
    fn check(&self, arguments: &[OsString]) -> Result<(), String>;
}

/// What verbs can do that not every version of them can.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Abilities {
    /// `record --resume`.
    pub record_resume: bool,
    /// `eval --keep failures|all DIR`.
    pub eval_keep: bool,
}

impl Abilities {
    /// Asks `line`.
    #[must_use]
    pub fn of(line: &dyn CommandLine) -> Self {
        let accepts = |text: &str| {
            let arguments: Vec<OsString> = text.split(' ').map(OsString::from).collect();
            line.check(&arguments).is_ok()
        };
        Self {
            record_resume: accepts("record --task t --episodes 1 --out d --resume"),
            eval_keep: accepts("eval --task t --policy expert --keep failures d"),
        }
    }
}

/// Where the files of a cell are.
#[derive(Clone, Debug)]
pub struct Places {
    /// The folder of what the cell is: a dataset, a checkpoint, kept trials.
    pub product: PathBuf,
    /// The verb's result as JSON.
    pub result: PathBuf,
    /// The folder of what it needs: a recording's dataset, a training's checkpoint.
    pub input: Option<PathBuf>,
}

/// Arguments of `trocar`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Arguments(Vec<OsString>);

impl Arguments {
    /// They.
    #[must_use]
    pub fn as_slice(&self) -> &[OsString] {
        &self.0
    }

    fn word(mut self, word: impl Into<OsString>) -> Self {
        self.0.push(word.into());
        self
    }

    /// A name and its value, as two words.
    fn option(self, name: &str, value: impl ToString) -> Self {
        self.word(name).word(value.to_string())
    }

    /// A path goes as it is, also if it is no UTF-8.
    fn path(self, name: &str, path: &Path) -> Self {
        self.word(name).word(path)
    }

    /// Without a value the verb's own default holds.
    fn optional(self, name: &str, value: Option<impl ToString>) -> Self {
        match value {
            Some(value) => self.option(name, value),
            None => self,
        }
    }

    fn flag(self, name: &str, given: bool) -> Self {
        if given { self.word(name) } else { self }
    }

    fn more(mut self, options: &[String]) -> Self {
        self.0.extend(options.iter().map(OsString::from));
        self
    }

    fn task(self, task: &TaskInput) -> Self {
        let with_task = self.option("--task", &task.argument);
        match &task.scene {
            Some(scene) => with_task.path("--scene", scene),
            None => with_task,
        }
    }
}

/// How a cell is begun or resumed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begin {
    /// From nothing.
    New,
    /// From what an earlier attempt left.
    Resumed,
}

/// The command line that makes the cell of `job`.
#[must_use]
pub fn command_line(
    job: &Job,
    places: &Places,
    run: &RunSection,
    begin: Begin,
    abilities: Abilities,
) -> Arguments {
    match job {
        Job::Recording(job) => record(job, places, run, begin),
        Job::Training(job) => train(job, places, begin),
        Job::Evaluation(job) => eval(job, places, run, abilities),
    }
}

/// Only the expert's recordings are made by a study.
fn record(job: &RecordingJob, places: &Places, run: &RunSection, begin: Begin) -> Arguments {
    Arguments::default()
        .word("record")
        .task(&job.task)
        .option("--episodes", job.episodes)
        .option("--source", "expert")
        .option("--seed", job.seed)
        .option("--jobs", run.record_jobs)
        .option("--cameras", &job.cameras)
        .flag("--depth", job.depth)
        .more(&job.options)
        .path("--out", &places.product)
        .path("--json", &places.result)
        .flag("--resume", begin == Begin::Resumed)
}

/// The rest of a command line that resumes what was begun at `places`.
fn resume(verb: Arguments, places: &Places) -> Arguments {
    verb.path("--resume", &places.product)
        .path("--json", &places.result)
}

/// One that is resumed has its options in its folder, and takes none but `--json`.
fn train(job: &TrainingJob, places: &Places, begin: Begin) -> Arguments {
    let train = Arguments::default().word("train");
    if begin == Begin::Resumed {
        return resume(train, places);
    }
    let data = places.input.clone().unwrap_or_default();
    train
        .option("--policy", job.policy)
        .path("--data", &data)
        .path("--out", &places.product)
        .option("--episodes", job.demonstrations)
        .optional("--cameras", job.cameras.as_ref())
        .optional("--preset", job.preset.as_ref())
        .optional("--steps", job.steps)
        .optional("--batch", job.batch)
        .flag("--augment", job.augment)
        .flag("--bf16", job.bf16)
        .option("--device", job.device.as_str())
        .option("--threads", job.threads)
        .option("--save-every", job.save_every)
        .option("--seed", job.seed)
        .more(&job.options)
        .path("--json", &places.result)
}

/// Adds the policy of `job`, and of a network where it is computed.
fn with_policy(eval: Arguments, job: &EvaluationJob, places: &Places) -> Arguments {
    match &job.policy {
        PolicyInput::Named(name) => eval.option("--policy", name),
        PolicyInput::Training(_) | PolicyInput::Checkpoint { .. } => eval
            .path("--policy", &places.input.clone().unwrap_or_default())
            .option("--device", job.device.as_str())
            .option("--precision", job.precision.as_str()),
    }
}

/// Without `eval --keep` (`Abilities`) its trials have no logs and no strips in the report.
fn eval(job: &EvaluationJob, places: &Places, run: &RunSection, abilities: Abilities) -> Arguments {
    let eval = Arguments::default().word("eval").task(&job.task);
    let arguments = with_policy(eval, job, places)
        .option("--trials", job.trials)
        .option("--seed", job.first_seed)
        .option("--jobs", run.eval_jobs)
        .optional("--needle", job.needle.as_ref())
        .option("--view", &job.view)
        .optional("--latency-ms", job.execution.latency_ms)
        .optional("--latency-jitter-ms", job.execution.latency_jitter_ms)
        .path("--json", &places.result);
    match run.keep {
        Keep::None => arguments,
        Keep::Failures | Keep::All if !abilities.eval_keep => arguments,
        Keep::Failures => arguments.option("--keep", "failures").word(&places.product),
        Keep::All => arguments.option("--keep", "all").word(&places.product),
    }
}
