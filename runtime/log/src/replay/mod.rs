//! Recomputes every command of a logged run from its recorded inputs and compares bit for bit; and
//! its arms, to be read again by another controller.
//!
//! Compared are, tick by tick and in this order: the controller's state where the log holds it,
//! every number of every command (stamp, enabled, positions, velocities, accelerations, jaw) by its
//! bits, and every byte of every safety report. At the end: the state that ends the file, the hash
//! over the inputs, the hash over the commands that the run reported, and the hash over the log's
//! contents. Host timing, frames and events are compared by the last one alone. The first
//! difference ends the replay, since later ones may follow from it.

mod arm;
mod kept;

use core::fmt;
use std::path::Path;

use hal::config::{ConfigError, Source};
use hal::joints::JOINT_NAMES;
use hal::{ArmCommand, PerArm};
use serde::Serialize;

use crate::safety;
use crate::{LogEnd, LogError, LoggedTick, RunHeader, RunLog, Step, read_steps};
use trocar_control::second_opinion;
use trocar_control::{
    AnyController, CommandHash, ControlConfig, InputHash, QpOutcome, SnapshotError, TickOutput,
    TickReport,
};

pub use arm::RecordedArm;
use kept::Edge;
pub use kept::KeptFrom;

/// What a replay found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReplayResult {
    /// Whether every command and safety report in the log was recomputed bit for bit, nothing that
    /// the controller saw is missing, and the log is what the run wrote.
    pub identical: bool,
    /// Ticks that were recomputed, up to the first difference.
    pub ticks: u64,
    /// Where it begins, if the log's bound left out what came before: with the controller's state
    /// in the log.
    pub kept_from: Option<KeptFrom>,
    /// Whether that state was compared with the one at the end of the file before, which lies
    /// beside it and is of the same run.
    pub edge_checked: bool,
    /// Whether the log's own hash over the inputs could be compared; a cut log has none, so that an
    /// input that no command shows may have changed.
    pub inputs_checked: bool,
    /// Where the replay left the log.
    pub first_difference: Option<Difference>,
    /// What Clarabel says to the filter's answers.
    pub second_opinion: ReferenceComparison,
    /// Why the log ends before its end, if it does; the rest of the result is about what comes
    /// before.
    pub cut: Option<String>,
    /// Whether that is its own bound alone: all that the bound kept was there.
    pub bounded: bool,
}

/// How the filter's answers compare with Clarabel's at a tolerance of 1e-10.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ReferenceComparison {
    /// Problems that were solved again.
    pub problems: u64,
    /// Of these, problems that Clarabel did not solve to that tolerance.
    pub unsolved: u64,
    /// Largest difference of a velocity, in units of the axis's limit.
    pub largest_difference: f64,
}

impl ReferenceComparison {
    fn ask(&mut self, controller: &AnyController) {
        let problem = controller.problem();
        self.problems += 1;
        match second_opinion::compare(problem, controller.solution()) {
            Some(comparison) => {
                self.largest_difference = self.largest_difference.max(comparison.change);
            }
            None => self.unsolved += 1,
        }
    }
}

/// The first thing that the log and its replay disagree on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// The tick.
    pub tick: u64,
    /// What differs: `position.yaw`, `stamp`, `enabled`, `command_hash`; `safety.mode` where a
    /// report does; `inputs` where only their hash shows it; `state` where that of the controller
    /// does, at the end of a file, or `snapshot.state` where the next file does not begin with it;
    /// `contents` where something else in the log is not what the run wrote; `arms` where their
    /// number does; or `log` where the logger lost an input. Where there are two arms, the arm's
    /// name comes first: `psm2.position.yaw`.
    pub what: String,
    /// In the log.
    pub logged: String,
    /// As recomputed.
    pub computed: String,
}

/// [`Difference::what`] where the logger lost an input.
const GAP: &str = "log";

impl Difference {
    /// Whether it is a gap: records that the logger dropped, without which nothing after them can
    /// be recomputed.
    #[must_use]
    pub fn is_gap(&self) -> bool {
        self.what == GAP
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            tick,
            what,
            logged,
            computed,
        } = self;
        write!(
            f,
            "tick {tick}: {what}: logged {logged}, computed {computed}"
        )
    }
}

/// Why a log cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// A configuration text is missing.
    #[error("the log does not hold {file}, without which there is no controller")]
    NoConfiguration {
        /// Its name.
        file: &'static str,
    },
    /// A configuration text is wrong.
    #[error("in the log: {0}")]
    Configuration(ConfigError),
    /// The controller cannot be built.
    #[error("the logged configuration makes no controller: {0}")]
    Controller(String),
    /// The run's beginning is missing, and the controller's state where the log begins is too.
    #[error(
        "the log's bound left out the first {ticks} ticks: there is nothing to replay the others from"
    )]
    LeftOut {
        /// How many.
        ticks: u64,
    },
    /// The controller can't go on from the state in the log.
    #[error(
        "the log's bound left out its beginning, and the controller can't go on from its state in the log"
    )]
    State(#[from] SnapshotError),
    /// There is nothing to compare.
    #[error("the log holds no tick")]
    Empty,
    /// There is no such arm in it.
    #[error("the log has no arm {index}, counted from 0")]
    NoArm {
        /// The requested one.
        index: usize,
    },
}

impl From<ConfigError> for ReplayError {
    fn from(error: ConfigError) -> Self {
        Self::Configuration(error)
    }
}

/// Recomputes every command and every safety report of `log` from its inputs, up to the first gap:
/// see [`Difference::is_gap`].
///
/// # Errors
/// [`ReplayError`] when the log does not say how the controller was configured or holds no tick.
pub fn replay(log: &RunLog) -> Result<ReplayResult, ReplayError> {
    let mut replay = Replay::new(&log.header)?;
    log.steps().try_for_each(|step| replay.step(&step))?;
    replay.finish(&log.end())
}

/// Replays the log at `path` as [`replay`] does, without ever holding more than a tick of it. The
/// state that it begins with is compared with the end of the file before, if that one lies beside
/// it.
///
/// # Errors
/// [`LogError`] when it is no log or was damaged, [`ReplayError`] as [`replay`].
pub fn replay_file<E: From<LogError> + From<ReplayError>>(path: &Path) -> Result<ReplayResult, E> {
    let mut replay = None;
    let (header, end) = read_steps(path, |header, step| -> Result<(), E> {
        let replay = match &mut replay {
            Some(replay) => replay,
            None => replay.insert(Replay {
                edge: Edge::before(path, header),
                ..Replay::new(header)?
            }),
        };
        Ok(replay.step(step)?)
    })?;
    let replay = match replay {
        Some(replay) => replay,
        None => Replay::new(&header)?,
    };
    Ok(replay.finish(&end)?)
}

/// A replay under way.
struct Replay {
    run: Recomputed,
    ticks: u64,
    /// Ticks that the log's bound left out.
    left_out: u64,
    kept_from: Option<KeptFrom>,
    /// The end of the file before, if it is known.
    edge: Option<Edge>,
    /// The newest tick, if there was any.
    last: Option<u64>,
    found: Option<Difference>,
}

impl Replay {
    /// # Errors
    /// [`ReplayError::NoConfiguration`], [`ReplayError::Configuration`] and
    /// [`ReplayError::Controller`].
    fn new(header: &RunHeader) -> Result<Self, ReplayError> {
        let control = text(header, "control.toml")?;
        let config = ControlConfig::load(&control, &text(header, "safety.toml")?)?;
        Ok(Self {
            run: Recomputed::new(&config)?,
            ticks: 0,
            left_out: header.left_out,
            kept_from: None,
            edge: None,
            last: None,
            found: None,
        })
    }

    /// Recomputes a tick; nothing after the first difference.
    fn step(&mut self, step: &Step<'_>) -> Result<(), ReplayError> {
        if self.found.is_some() {
            return Ok(());
        }
        let tick = step.tick.tick;
        let goes_on = match self.last.replace(tick) {
            None if self.left_out > 0 => {
                self.kept_from = Some(self.run.go_on(self.left_out, step)?);
                self.edge.as_ref().and_then(|edge| edge.other(step))
            }
            None | Some(_) => step
                .snapshot
                .and_then(|snapshot| self.run.other_state(tick, snapshot)),
        };
        self.found = goes_on
            .or_else(|| lost(step))
            .or_else(|| self.run.tick(step));
        self.ticks += u64::from(self.found.is_none());
        Ok(())
    }

    /// # Errors
    /// [`ReplayError::Empty`] without a tick.
    fn finish(self, end: &LogEnd) -> Result<ReplayResult, ReplayError> {
        let last = self.last.ok_or(ReplayError::Empty)?;
        let went_through = self.found.is_none();
        let first_difference = self
            .found
            .or_else(|| {
                let count = Some(end.dropped_at_end).filter(|count| *count > 0)?;
                Some(dropped(last, format!("{count} ticks")))
            })
            .or_else(|| self.run.other_state(last, end.snapshot.as_ref()?))
            .or_else(|| other_inputs(end, last, self.run.inputs))
            .or_else(|| other_hash(end, last, self.run.hash))
            .or_else(|| other_contents(end, last));
        Ok(ReplayResult {
            identical: first_difference.is_none(),
            ticks: self.ticks,
            kept_from: self.kept_from,
            edge_checked: self.kept_from.is_some() && self.edge.is_some(),
            inputs_checked: went_through && (end.input_hash.is_some() || end.snapshot.is_some()),
            first_difference,
            second_opinion: self.run.second_opinion,
            cut: end.cut.clone(),
            bounded: end.bounded,
        })
    }
}

/// The run as it is computed again.
///
/// Built from the two configuration texts in the log, not from files on the disk.
struct Recomputed {
    controller: AnyController,
    /// What stands before the names of each arm's numbers.
    prefixes: Vec<String>,
    hash: CommandHash,
    /// From the log's inputs, in the order in which the recorder took them.
    inputs: InputHash,
    second_opinion: ReferenceComparison,
}

impl Recomputed {
    fn new(config: &ControlConfig) -> Result<Self, ReplayError> {
        let controller = AnyController::new(config)
            .map_err(|error| ReplayError::Controller(error.to_string()))?;
        let alone = controller.arm_count() == 1;
        let prefix = |name: &str| {
            if alone {
                String::new()
            } else {
                format!("{name}.")
            }
        };
        Ok(Self {
            prefixes: config.arms.iter().map(|arm| prefix(&arm.name)).collect(),
            controller,
            hash: CommandHash::new(),
            inputs: InputHash::new(),
            second_opinion: ReferenceComparison::default(),
        })
    }

    /// Adds what the controller was given in one tick to the hash of the inputs.
    fn hash_inputs(&mut self, step: &Step<'_>) {
        for (index, chunk) in step.chunks.iter().enumerate() {
            if let Some(chunk) = chunk {
                self.inputs.chunk(index, chunk);
            }
        }
        for arm in step.tick.arms.iter() {
            let now = step.tick.now;
            self.inputs.tick(now, &arm.measured, arm.operator);
        }
    }

    /// The log's tick has another number of arms than the controller.
    fn other_arms(&self, logged: &LoggedTick) -> Difference {
        Difference {
            tick: logged.tick,
            what: "arms".to_owned(),
            logged: logged.arms.count().to_string(),
            computed: self.controller.arm_count().to_string(),
        }
    }

    /// Recomputes one tick of all arms and compares.
    fn tick(&mut self, step: &Step<'_>) -> Option<Difference> {
        let logged = step.tick;
        self.hash_inputs(step);
        let inputs = step.inputs();
        if inputs.count() != self.controller.arm_count() {
            return Some(self.other_arms(logged));
        }
        let outputs = self.controller.tick(&inputs);
        let solved = |output: &TickOutput| matches!(output.report.qp, QpOutcome::Solved { .. });
        if outputs.iter().any(solved) {
            self.second_opinion.ask(&self.controller);
        }
        for output in outputs.iter() {
            self.hash.add(&output.command);
        }
        self.difference(step, &outputs)
    }

    /// What the outputs of a tick and the log disagree on: a command before a report.
    fn difference(&self, step: &Step<'_>, outputs: &PerArm<TickOutput>) -> Option<Difference> {
        let named = |index: usize, found: Difference| {
            let prefix = &self.prefixes[index];
            Difference {
                what: format!("{prefix}{}", found.what),
                ..found
            }
        };
        let tick = step.tick.tick;
        let arms = step.tick.arms.iter().zip(outputs.iter()).enumerate();
        let mut commands = arms.filter_map(|(index, (arm, output))| {
            let found = difference(tick, &arm.command, &output.command)?;
            Some(named(index, found))
        });
        let reports = step.reports.iter().zip(outputs.iter()).enumerate();
        let mut reports = reports.filter_map(|(index, (logged, output))| {
            let found = other_report(tick, *logged, &output.report)?;
            Some(named(index, found))
        });
        commands.next().or_else(|| reports.next())
    }
}

/// The configuration file of that name as the run had it.
fn text(header: &RunHeader, file: &'static str) -> Result<Source, ReplayError> {
    let text = header
        .text(file)
        .ok_or(ReplayError::NoConfiguration { file })?;
    Ok(Source::embedded(file, text))
}

/// What the logger lost just before a tick, or of it.
fn lost(step: &Step<'_>) -> Option<Difference> {
    let what = match (step.dropped_before, step.chunk_dropped) {
        (0, false) => return None,
        (0, true) => "the chunk".to_owned(),
        (count, _) => format!("{count} ticks"),
    };
    Some(dropped(step.tick.tick, what))
}

/// Something that the logger dropped, so that the replay ends here.
fn dropped(tick: u64, what: String) -> Difference {
    Difference {
        tick,
        what: GAP.to_owned(),
        logged: format!("{what} dropped by the logger"),
        computed: "nothing, for want of it".to_owned(),
    }
}

/// Compares what the controller said of a tick.
fn other_report(tick: u64, logged: Option<&[u8]>, report: &TickReport) -> Option<Difference> {
    let (what, logged, computed) = safety::difference(tick, logged, report)?;
    Some(Difference {
        tick,
        what,
        logged,
        computed,
    })
}

/// Whether the log is what the run wrote: also what a replay does not recompute, such as frames,
/// events and the outcome.
fn other_contents(end: &LogEnd, tick: u64) -> Option<Difference> {
    end.altered.then(|| Difference {
        tick,
        what: "contents".to_owned(),
        logged: "the hash of what the run wrote".to_owned(),
        computed: "another".to_owned(),
    })
}

/// Compares the hash over the inputs that was taken while the controller ran: a bit may change in
/// an input without changing any command.
fn other_inputs(end: &LogEnd, tick: u64, hash: InputHash) -> Option<Difference> {
    let logged = end.input_hash?;
    let computed = hash.value();
    (logged != computed).then(|| Difference {
        tick,
        what: "inputs".to_owned(),
        logged: format!("{logged:016x}"),
        computed: format!("{computed:016x}"),
    })
}

/// Compares the hash that the run reported, which the log's own ticks must add up to.
fn other_hash(end: &LogEnd, tick: u64, hash: CommandHash) -> Option<Difference> {
    let logged = &end.outcome.as_ref()?.command_hash;
    let computed = format!("{:016x}", hash.value());
    (*logged != computed).then(|| Difference {
        tick,
        what: "command_hash".to_owned(),
        logged: logged.clone(),
        computed,
    })
}

/// The first number of two commands that differs in any bit.
fn difference(tick: u64, logged: &ArmCommand, computed: &ArmCommand) -> Option<Difference> {
    let found = |what: String, logged: String, computed: String| {
        Some(Difference {
            tick,
            what,
            logged,
            computed,
        })
    };
    if logged.stamp != computed.stamp {
        let [logged, computed] = [logged, computed].map(|command| command.stamp.0.to_string());
        return found("stamp".to_owned(), logged, computed);
    }
    if logged.enabled != computed.enabled {
        let [logged, computed] = [logged, computed].map(|command| command.enabled.to_string());
        return found("enabled".to_owned(), logged, computed);
    }
    let (what, logged, computed) =
        numbers(logged)
            .zip(numbers(computed))
            .find_map(|((what, logged), (_, computed))| {
                (logged.to_bits() != computed.to_bits()).then_some((what, logged, computed))
            })?;
    found(what, format!("{logged:?}"), format!("{computed:?}"))
}

/// Every number of a command and its name.
fn numbers(command: &ArmCommand) -> impl Iterator<Item = (String, f64)> {
    let vectors = [
        ("position", command.position),
        ("velocity", command.velocity),
        ("acceleration", command.acceleration),
    ];
    let joints = vectors.into_iter().flat_map(|(what, vector)| {
        JOINT_NAMES
            .into_iter()
            .enumerate()
            .map(move |(index, joint)| (format!("{what}.{joint}"), vector[index]))
    });
    joints.chain([
        ("position.jaw".to_owned(), command.jaw_position),
        ("velocity.jaw".to_owned(), command.jaw_velocity),
    ])
}

#[cfg(test)]
mod tests;
