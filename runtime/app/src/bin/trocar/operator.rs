//! The operator's verbs: one command to a run in real time, and its answer.

use clap::{Args, ValueEnum};

use trocar::monitor::monitor;
use trocar::session::operator::{Ask, Command, ask};
use trocar_log::RunMark;

use crate::commands::Done;
use crate::console;

/// Options of the operator's verbs.
#[derive(Args, Debug)]
pub(crate) struct OperatorArgs {
    /// The run, by its process number; needed only if more than one of this user's runs is in real
    /// time.
    #[arg(long, value_name = "PROCESS")]
    run: Option<String>,
    /// Print the answer as JSON.
    #[arg(long)]
    json: bool,
}

/// Options of `speed`.
#[derive(Args, Debug)]
pub(crate) struct SpeedArgs {
    /// The share, percent, 1 to 100.
    #[arg(value_parser = clap::value_parser!(u8).range(1..=100))]
    pub(crate) percent: u8,
    /// Which run, and in which form it answers.
    #[command(flatten)]
    pub(crate) of: OperatorArgs,
}

/// How a run went.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Mark {
    /// What was to be done is done.
    Success,
    /// It is not done.
    Failure,
    /// It is neither: the run is of no use.
    Discard,
    /// Take the mark back.
    #[value(name = "none")]
    Unmarked,
}

/// Options of `mark`.
#[derive(Args, Debug)]
pub(crate) struct MarkArgs {
    /// How the run went.
    #[arg(value_enum)]
    mark: Mark,
    /// What the run is called, a line of up to 64 characters; an empty one takes the label back. It
    /// stays as it is if not given.
    #[arg(long, value_name = "TEXT")]
    label: Option<String>,
    /// Which run, and in which form it answers.
    #[command(flatten)]
    of: OperatorArgs,
}

/// Marks a run and prints what it answers.
pub(crate) fn mark(args: &MarkArgs) -> Done {
    let mark = match args.mark {
        Mark::Success => Some(RunMark::Success),
        Mark::Failure => Some(RunMark::Failure),
        Mark::Discard => Some(RunMark::Discard),
        Mark::Unmarked => None,
    };
    let label = args.label.clone();
    operate(Command::Mark { mark, label }, &args.of)
}

/// Gives `command` to a run and prints what it answers.
pub(crate) fn operate(command: Command, args: &OperatorArgs) -> Done {
    let (answer, yes) = ask(
        command,
        &Ask {
            run: args.run.clone(),
            json: args.json,
        },
    )?;
    console::result(&answer);
    Ok(yes)
}

/// Options of `monitor`.
#[derive(Args, Debug)]
pub(crate) struct MonitorArgs {
    /// The run, by its process number; needed only if more than one of this user's runs is in real
    /// time.
    #[arg(long, value_name = "PROCESS")]
    run: Option<String>,
}

/// Shows a run in the terminal until it ends or the person leaves.
pub(crate) fn watch(args: &MonitorArgs) -> Done {
    monitor(args.run.as_deref())?;
    Ok(true)
}
