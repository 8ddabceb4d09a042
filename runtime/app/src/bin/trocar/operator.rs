//! The operator's verbs: one command to a run in real time, and its answer.

use clap::Args;

use trocar::monitor::monitor;
use trocar::session::operator::{Ask, Command, ask};

use crate::commands::Done;
use crate::console;

/// Options of the operator's verbs.
#[derive(Args, Debug)]
pub(crate) struct OperatorArgs {
    /// The run, by its process number; needed only if more than one of this user's runs is in real time.
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
    /// The run, by its process number; needed only if more than one of this user's runs is in real time.
    #[arg(long, value_name = "PROCESS")]
    run: Option<String>,
}

/// Shows a run in the terminal until it ends or the person leaves.
pub(crate) fn watch(args: &MonitorArgs) -> Done {
    monitor(args.run.as_deref())?;
    Ok(true)
}
