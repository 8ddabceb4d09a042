//! Recomputes every command of a logged run from its recorded inputs and compares bit for bit.

use core::fmt;

use hal::ArmCommand;
use hal::config::{ConfigError, Source};
use hal::joints::JOINT_NAMES;
use serde::Serialize;

use crate::control::second_opinion;
use crate::control::{CommandHash, ControlConfig, Controller, InputHash, QpOutcome, TickInput};
use crate::log::{Loss, RunLog};

/// What a replay found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReplayResult {
    /// Whether every command in the log was recomputed bit for bit, and nothing that the controller saw is missing.
    pub identical: bool,
    /// Ticks that were recomputed, up to the first difference.
    pub ticks: u64,
    /// Whether the log's own hash over the inputs could be compared; a cut log has none, so that an input that no command
    /// shows may have changed.
    pub inputs_checked: bool,
    /// Where the replay left the log.
    pub first_difference: Option<Difference>,
    /// What Clarabel says to the filter's answers.
    pub second_opinion: SecondOpinion,
    /// Why the log ends before its end, if it does; the rest of the result is about what comes before.
    pub cut: Option<String>,
}

/// How the filter's answers compare with Clarabel's at a tolerance of 1e-10.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SecondOpinion {
    /// Problems that were solved again.
    pub problems: u64,
    /// Of these, problems that Clarabel did not solve to that tolerance.
    pub unsolved: u64,
    /// Largest difference of a velocity, in units of the axis's limit.
    pub largest_difference: f64,
}

impl SecondOpinion {
    fn ask(&mut self, controller: &Controller) {
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
    /// What differs: `position.yaw`, `stamp`, `enabled`, `command_hash`; `inputs` where only their hash shows it; or `log` where the logger lost an input.
    pub what: String,
    /// In the log.
    pub logged: String,
    /// As recomputed.
    pub computed: String,
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
    /// There is nothing to compare.
    #[error("the log holds no tick")]
    Empty,
}

impl From<ConfigError> for ReplayError {
    fn from(error: ConfigError) -> Self {
        Self::Configuration(error)
    }
}

/// Recomputes every command of `log` from its inputs.
///
/// # Errors
/// [`ReplayError`] when the log does not say how the controller was configured or holds no tick.
pub fn replay(log: &RunLog) -> Result<ReplayResult, ReplayError> {
    let config = ControlConfig::load(&text(log, "control.toml")?, &text(log, "safety.toml")?)?;
    let mut controller =
        Controller::new(&config).map_err(|error| ReplayError::Controller(error.to_string()))?;
    if log.tick_count() == 0 {
        return Err(ReplayError::Empty);
    }
    let cut = log.cut().map(str::to_owned);
    let inputs_checked = log.input_hash.is_some();
    let mut hash = CommandHash::new();
    let mut inputs = InputHash::new();
    let mut second_opinion = SecondOpinion::default();
    let mut ticks = 0;
    let mut last = 0;
    for (position, (logged, chunk)) in log.ticks().enumerate() {
        let inputs_lost = lost_before(log, position, logged.tick);
        let input = TickInput {
            now: logged.now,
            measured: logged.measured,
            chunk,
            operator: logged.operator,
        };
        if let Some(chunk) = chunk {
            inputs.chunk(chunk);
        }
        inputs.tick(logged.now, &logged.measured, logged.operator);
        let difference = inputs_lost.or_else(|| {
            let output = controller.tick(&input);
            if matches!(output.report.qp, QpOutcome::Solved { .. }) {
                second_opinion.ask(&controller);
            }
            hash.add(&output.command);
            difference(logged.tick, &logged.command, &output.command)
        });
        if difference.is_some() {
            return Ok(ReplayResult {
                identical: false,
                ticks,
                inputs_checked: false,
                first_difference: difference,
                second_opinion,
                cut,
            });
        }
        ticks += 1;
        last = logged.tick;
    }
    let first_difference = lost_before(log, log.tick_count(), last)
        .or_else(|| other_inputs(log, last, inputs))
        .or_else(|| other_hash(log, last, hash));
    Ok(ReplayResult {
        identical: first_difference.is_none(),
        ticks,
        inputs_checked,
        first_difference,
        second_opinion,
        cut,
    })
}

fn text(log: &RunLog, file: &'static str) -> Result<Source, ReplayError> {
    let text = log
        .text(file)
        .ok_or(ReplayError::NoConfiguration { file })?;
    Ok(Source::embedded(file, text))
}

/// What the logger lost just before the tick at `position`, or of it.
fn lost_before(log: &RunLog, position: usize, tick: u64) -> Option<Difference> {
    let logged = log.losses.iter().find_map(|loss| match *loss {
        Loss::Ticks {
            position: at,
            count,
        } if at == position => Some(format!("{count} ticks dropped by the logger")),
        Loss::Chunk { tick: of } if of == tick && position < log.tick_count() => {
            Some("the chunk dropped by the logger".to_owned())
        }
        Loss::Ticks { .. } | Loss::Chunk { .. } => None,
    })?;
    Some(Difference {
        tick,
        what: "log".to_owned(),
        logged,
        computed: "nothing, for want of it".to_owned(),
    })
}

/// Compares the hash over the inputs that was taken while the controller ran: a bit may change in an input without
/// changing any command.
fn other_inputs(log: &RunLog, tick: u64, hash: InputHash) -> Option<Difference> {
    let logged = log.input_hash?;
    let computed = hash.value();
    (logged != computed).then(|| Difference {
        tick,
        what: "inputs".to_owned(),
        logged: format!("{logged:016x}"),
        computed: format!("{computed:016x}"),
    })
}

/// Compares the hash that the run reported, which the log's own ticks must add up to.
fn other_hash(log: &RunLog, tick: u64, hash: CommandHash) -> Option<Difference> {
    let logged = &log.outcome.as_ref()?.command_hash;
    let computed = format!("{:016x}", hash.value());
    (*logged != computed).then(|| Difference {
        tick,
        what: "command_hash".to_owned(),
        logged: logged.clone(),
        computed,
    })
}

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
        return found(
            "stamp".to_owned(),
            logged.stamp.0.to_string(),
            computed.stamp.0.to_string(),
        );
    }
    if logged.enabled != computed.enabled {
        return found(
            "enabled".to_owned(),
            logged.enabled.to_string(),
            computed.enabled.to_string(),
        );
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
