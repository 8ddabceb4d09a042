//! What a page is told twenty times a second, as JSON. The operator's socket tells the same to
//! `trocar monitor`. Joints, corrections and durations in us are rounded to five places, which
//! keeps a message small; whoever needs all digits reads the log.

use hal::{ARM_NAMES, ArmCommand, ArmState, TimeNs};
use serde::Serialize;
use trocar_control::motion::AXES;
use trocar_control::{GateDecision, QpOutcome};
use trocar_log::{ArmRecord, BusRecord, CriterionRecord, RunNote, TaskRecord};

use super::facts::Facts;
use super::path::Path;
use super::tap::{Buckets, Changed, Counts, Refused, Sample, seconds};
use crate::session::teleop::TeleopStatus;

/// The newest tick.
#[derive(Clone, Debug, Serialize)]
pub(super) struct State {
    kind: &'static str,
    seconds: f64,
    /// For how long the control loop has said nothing new, s.
    silent_s: f64,
    pub(super) arms: Vec<ArmReadout>,
    filter: Filter,
    counts: Counted,
    timing: Timing,
    latency: Histogram,
    speed_percent: u8,
    /// What the task still lacks, in words.
    task: Option<String>,
    /// What has to be so for its success.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    criteria: Vec<CriterionRecord>,
    /// Present if an operator's hands move the arms.
    #[serde(skip_serializing_if = "Option::is_none")]
    teleop: Option<TeleopStatus>,
    /// Present if a person may say how the run went: what they say.
    #[serde(skip_serializing_if = "Option::is_none")]
    said: Option<RunNote>,
    /// The buses of arms on CAN.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    buses: Vec<BusRecord>,
    /// Where the newest chunk leads, arm by arm.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    paths: Vec<Path>,
}

/// One arm, in joint order with the jaw last: rad, m, rad/s, m/s.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ArmReadout {
    name: &'static str,
    state: &'static str,
    homed: bool,
    busy: bool,
    fault: Option<String>,
    /// Why nothing was measured.
    error: Option<String>,
    measured: Option<[f64; AXES]>,
    measured_velocity: Option<[f64; AXES]>,
    commanded: [f64; AXES],
    commanded_velocity: [f64; AXES],
    /// Length of the filter's change, in velocity limits.
    correction: f64,
    qp: &'static str,
    rows_active: u32,
    guard: bool,
    follows: bool,
}

/// What the filter last changed.
#[derive(Clone, Debug, Serialize)]
struct Filter {
    /// How long ago, s.
    ago_s: Option<f64>,
    rows: Vec<String>,
    /// Rows beyond those that are named.
    more: u16,
    /// By how much each axis's velocity was changed, in its limit, arm by arm.
    change: Vec<f64>,
}

/// Ticks and chunks since the run began.
#[derive(Clone, Debug, Serialize)]
struct Counted {
    ticks: u64,
    passed: u64,
    solved: u64,
    failed: u64,
    guard: u64,
    /// How long ago the guard last intervened, s; none if it never did.
    guard_ago_s: Option<f64>,
    chunks: u64,
    refused: u64,
    /// Arm, time and reason of the last chunk that the gate refused.
    last_refused: Option<String>,
}

/// Durations of each tick: computing, lateness of the wake-up, and from one wake-up to the next.
#[derive(Clone, Debug, Serialize)]
struct Timing {
    compute: Histogram,
    wake: Histogram,
    period: Histogram,
    overruns: u64,
}

/// A count for each bucket, whose upper ends `Facts` has, and one for what is beyond all.
#[derive(Clone, Debug, Serialize)]
struct Histogram {
    counts: Vec<u64>,
    newest_us: f64,
    max_us: f64,
}

impl From<&Buckets> for Histogram {
    #[expect(clippy::cast_precision_loss, reason = "a duration is exact in f64")]
    fn from(buckets: &Buckets) -> Self {
        Self {
            counts: buckets.counts.to_vec(),
            newest_us: rounded(buckets.newest_ns as f64 * 1e-3),
            max_us: rounded(buckets.max_ns as f64 * 1e-3),
        }
    }
}

impl State {
    /// What `sample` says, `silent_s` after it came.
    pub(super) fn new(
        sample: &Sample,
        facts: &Facts,
        silent_s: f64,
        task: Option<TaskRecord>,
    ) -> Self {
        let Sample { record, counts } = sample;
        let (missing, criteria) = task.map(|task| (task.missing, task.criteria)).unzip();
        let arms = ARM_NAMES.into_iter().zip(record.arms.iter());
        let arms: Vec<_> = arms.map(|(name, arm)| arm_readout(name, arm)).collect();
        Self {
            kind: "state",
            seconds: seconds(record.tick),
            silent_s,
            filter: filter(counts.last_changed.as_ref(), record.tick, facts, arms.len()),
            counts: counted(counts, record.tick),
            timing: Timing {
                compute: (&counts.compute).into(),
                wake: (&counts.wake).into(),
                period: (&counts.period).into(),
                overruns: counts.skipped,
            },
            latency: (&counts.latency).into(),
            speed_percent: counts.speed_percent,
            task: missing,
            criteria: criteria.unwrap_or_default(),
            teleop: None,
            said: None,
            buses: Vec::new(),
            paths: Vec::new(),
            arms,
        }
    }

    /// The same with what the operator's hands do.
    pub(super) fn by_hand(mut self, teleop: Option<TeleopStatus>) -> Self {
        self.teleop = teleop;
        self
    }

    /// The same with what a person says of the run.
    pub(super) fn of_which(mut self, said: Option<RunNote>) -> Self {
        self.said = said;
        self
    }

    /// The same with the load of these buses.
    pub(super) fn on_buses(mut self, buses: Vec<BusRecord>) -> Self {
        self.buses = buses;
        self
    }

    /// The same with where the newest chunk leads.
    pub(super) fn towards(mut self, paths: Vec<Path>) -> Self {
        self.paths = paths;
        self
    }

    pub(super) fn json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }
}

fn arm_readout(name: &'static str, arm: &ArmRecord) -> ArmReadout {
    let report = &arm.report;
    let measured = arm.measured.as_ref().ok();
    let (commanded, commanded_velocity) = commanded(&arm.command);
    ArmReadout {
        name,
        state: report.mode.state.name(),
        homed: report.mode.homed,
        busy: report.mode.busy,
        fault: report.fault.map(|fault| fault.to_string()),
        error: arm.measured.err().map(|error| error.to_string()),
        measured: measured.map(position),
        measured_velocity: measured.map(velocity),
        commanded,
        commanded_velocity,
        correction: rounded(report.correction),
        qp: match report.qp {
            QpOutcome::NotNeeded => "passed",
            QpOutcome::Solved { .. } => "solved",
            QpOutcome::Failed => "failed",
        },
        rows_active: report.rows_active,
        guard: report.guard_intervened,
        follows: report.target.is_some(),
    }
}

fn position(state: &ArmState) -> [f64; AXES] {
    axes(state.position.as_slice(), state.jaw_position)
}

fn velocity(state: &ArmState) -> [f64; AXES] {
    axes(state.velocity.as_slice(), state.jaw_velocity)
}

fn commanded(command: &ArmCommand) -> ([f64; AXES], [f64; AXES]) {
    (
        axes(command.position.as_slice(), command.jaw_position),
        axes(command.velocity.as_slice(), command.jaw_velocity),
    )
}

/// Joints with the jaw behind them, to five places: what a page draws.
fn axes(joints: &[f64], jaw: f64) -> [f64; AXES] {
    std::array::from_fn(|axis| rounded(joints.get(axis).copied().unwrap_or(jaw)))
}

/// To five places. NaN and infinite stay, which JSON writes as null.
fn rounded(value: f64) -> f64 {
    (value * 1e5).round() * 1e-5
}

/// What the filter last changed, with the names of its first rows. `tick` is now.
fn filter(changed: Option<&Changed>, tick: u64, facts: &Facts, arms: usize) -> Filter {
    let rows = changed.map_or(&[][..], |changed| {
        let named = usize::from(changed.count).min(changed.rows.len());
        &changed.rows[..named]
    });
    let named = rows
        .iter()
        .filter_map(|row| facts.rows.get(usize::from(*row)));
    let change = changed
        .iter()
        .flat_map(|changed| changed.change)
        .take(AXES * arms);
    Filter {
        ago_s: changed.map(|changed| seconds(tick.saturating_sub(changed.tick))),
        rows: named.cloned().collect(),
        more: changed.map_or(0, |changed| changed.count) - u16::try_from(rows.len()).unwrap_or(0),
        change: change.map(rounded).collect(),
    }
}

fn counted(counts: &Counts, tick: u64) -> Counted {
    let refused = |refused: &Refused| {
        let name = ARM_NAMES.get(refused.arm).copied().unwrap_or_default();
        let at = seconds(refused.tick);
        format!("{name} at {at:.2} s: {}", refusal(refused.reason))
    };
    Counted {
        ticks: counts.ticks,
        passed: counts.passed,
        solved: counts.solved,
        failed: counts.failed,
        guard: counts.guard_interventions,
        guard_ago_s: counts.guard_tick.map(|at| seconds(tick.saturating_sub(at))),
        chunks: counts.chunks,
        refused: counts.refused,
        last_refused: counts.last_refused.as_ref().map(refused),
    }
}

/// Why the gate refused a chunk, in words.
pub(super) fn refusal(reason: GateDecision) -> String {
    match reason {
        GateDecision::Accepted => "accepted".to_owned(),
        GateDecision::WrongLength { len } => format!("its length is {len}"),
        GateDecision::WrongStep { step_ns } => format!("its step is {step_ns} ns"),
        GateDecision::FromTheFuture => "its observation lies ahead".to_owned(),
        GateDecision::Stale { age_ns } => {
            format!(
                "stale, observed {:.0} ms before",
                TimeNs(age_ns).seconds() * 1e3
            )
        }
        GateDecision::OutOfOrder => "out of order".to_owned(),
        GateDecision::NotFinite { index } => format!("target {index} is not finite"),
        GateDecision::NotUnit { index } => format!("target {index} has no unit quaternion"),
        GateDecision::StepTooLong { index } => {
            format!("target {index} is too far from the one before")
        }
        GateDecision::Jump => "its target is too far from the tip".to_owned(),
        GateDecision::Elsewhere => "it does not start where the arm was held".to_owned(),
    }
}
