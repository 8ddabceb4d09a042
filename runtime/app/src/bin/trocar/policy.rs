//! `trocar policy`: a checkpoint that answers sessions of other processes; and how such a session
//! calls for one.

use clap::Args;
use clap::builder::{NonEmptyStringValueParser, RangedU64ValueParser};

use trocar::rt;
use trocar::session::external::{
    ByHand, DEFAULT_NAME, DEFAULT_WITHIN_S, ExternalChoice, serve_by_hand,
};
use trocar::session::teleop::{DELAYS_MS, TREMORS_MM};
use trocar::session::{PolicyChoice, SessionError};

use crate::args::{ComputeArgs, within};
use crate::commands::{Done, compute};
use crate::console;

/// How an external policy is awaited, and what it is told.
#[derive(Args, Clone, Debug)]
pub(crate) struct ExternalArgs {
    /// How long an external policy may take to appear, to reset and to answer, s, up to 86400.
    #[arg(long, value_name = "S", default_value_t = DEFAULT_WITHIN_S, value_parser = within())]
    pub(crate) policy_timeout: u64,
    /// Language instruction of the task, passed to an external policy; the task's name if not
    /// given.
    #[arg(long, value_name = "TEXT", value_parser = NonEmptyStringValueParser::new())]
    pub(crate) instruction: Option<String>,
    /// What a simulated operator is like.
    #[command(flatten)]
    pub(crate) operator: SimulatedArgs,
}

/// What a simulated operator is like, where the user chooses it.
#[derive(Args, Clone, Copy, Debug)]
pub(crate) struct SimulatedArgs {
    /// How old what a simulated operator sees is, ms, up to 500; 80 if not given.
    #[arg(long, value_name = "MS", value_parser = sight_delay())]
    pub(crate) operator_delay_ms: Option<u64>,
    /// Tremor of a simulated operator's hands, 8 to 12 Hz, mm rms, up to 2; 0.1 if not given.
    #[arg(long, value_name = "MM", value_parser = tremor)]
    pub(crate) operator_tremor_mm: Option<f64>,
}

impl SimulatedArgs {
    /// The same policy with what was typed.
    pub(crate) fn operated(&self, policy: PolicyChoice) -> Result<PolicyChoice, SessionError> {
        policy.operated(self.operator_delay_ms, self.operator_tremor_mm)
    }
}

fn sight_delay() -> RangedU64ValueParser<u64> {
    RangedU64ValueParser::new().range(DELAYS_MS)
}

fn tremor(text: &str) -> Result<f64, String> {
    let tremor: Option<f64> = text.parse().ok();
    let (low, high) = (TREMORS_MM.start(), TREMORS_MM.end());
    tremor
        .filter(|tremor| TREMORS_MM.contains(tremor))
        .ok_or_else(|| format!("expected a number in [{low}, {high}]"))
}

impl ExternalArgs {
    /// The policy `text`, awaited and told as it was typed.
    pub(crate) fn policy(&self, text: &str) -> Result<PolicyChoice, SessionError> {
        let policy = PolicyChoice::parse(text).within_s(self.policy_timeout);
        let policy = policy.instructed(self.instruction.as_deref())?;
        let policy = self.operator.operated(policy)?;
        policy.check_exists()?;
        Ok(policy)
    }
}

/// Options of `policy`.
#[derive(Args, Debug)]
pub(crate) struct PolicyArgs {
    /// A checkpoint's directory, or a committed policy's name such as `needle-lift/act-compact`.
    #[arg(long)]
    pub(crate) policy: String,
    /// The name of its topics, which sessions call it by.
    #[arg(long, default_value = DEFAULT_NAME)]
    pub(crate) name: String,
    /// End after so many sessions; if not given, only a signal ends it.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) sessions: Option<u64>,
    /// Where and how the network computes.
    #[command(flatten)]
    pub(crate) compute: ComputeArgs,
}

pub(crate) fn policy(args: &PolicyArgs) -> Done {
    let choice = PolicyChoice::parse(&args.policy);
    choice.check_exists()?;
    let PolicyChoice::Checkpoint(folder) = choice else {
        return Err(SessionError::BadArgument(format!(
            "--policy {}: a checkpoint's folder is wanted; others answer in the session's own process",
            args.policy
        )));
    };
    ExternalChoice::new(Some(&args.name)).check()?;
    let options = ByHand {
        name: args.name.clone(),
        policy: folder,
        compute: compute(&args.compute)?,
        sessions: args.sessions,
    };
    rt::catch_interrupts().map_err(SessionError::signals)?;
    let served = serve_by_hand(&options, &mut |said| {
        console::note(&format!("trocar: {said}"));
    })?;
    let plural = if served == 1 { "" } else { "s" };
    console::note(&format!("trocar: {served} session{plural} served"));
    Ok(true)
}
