//! What a recording says of how it came about: in the dataset's metadata and in the result.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;
use trocar_data::dataset::VideoCodec;
use trocar_tasks::disturbance::Disturbance;
use trocar_tasks::task::{Drawn, PatientPlacement, Variation};

use super::{Attempt, RecordOptions};
use crate::digest::hash_text;
use crate::session::policy_choice::OPERATOR;
use crate::session::source::ChunkSource;
use crate::session::teleop::{OperatorFigures, TeleopSummary};
use crate::session::{Plan, PolicyChoice, SessionError};

/// By how much longer a disturbed demonstration may take than the task allows.
pub const DISTURBED_TIME_FACTOR: u32 = 2;

/// Everything that decides what a recording's episodes are: one that goes on must have it all
/// alike, but for the version.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct OptionsNote<'a> {
    trocar: &'static str,
    task: &'a str,
    instruction: Option<&'a str>,
    seed: u64,
    cameras: Vec<String>,
    depth: bool,
    video: Option<&'static str>,
    view: &'static str,
    needle: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    patient: Option<&'a PatientPlacement>,
    varied: &'a [Variation],
    disturb: Option<f64>,
    /// `teleop` if a person did them, `intervention` if one took over from a policy,
    /// `simulated-operator`, `policy` if it was the caller's; none of the expert's.
    source: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    operator_delay_ms: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    operator_tremor_mm: Option<f64>,
    /// The policy of an intervention, or the caller's.
    #[serde(skip_serializing_if = "Option::is_none")]
    policy: Option<String>,
    /// SHA-256 of its weights, which another training in the same folder changes.
    #[serde(skip_serializing_if = "Option::is_none")]
    policy_sha256: Option<String>,
    /// SHA-256 of the configuration files as they were in effect.
    files: BTreeMap<String, String>,
}

/// How a recording was made, if it was disturbed or varied, or is of failures.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct RecordingNote<'a> {
    trocar: &'static str,
    task: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    scene: Option<&'a str>,
    view: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    needle: Option<&'a str>,
    seed: u64,
    varied: &'a [Variation],
    /// Whether these are the attempts that failed.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    failures: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    disturb: Option<DisturbNote>,
    #[serde(skip_serializing_if = "Option::is_none")]
    source: Option<&'static str>,
    /// What the simulated operator is like.
    #[serde(skip_serializing_if = "Option::is_none")]
    operator: Option<OperatorFigures>,
    /// The policy from which a person took over, or the caller's.
    #[serde(skip_serializing_if = "Option::is_none")]
    policy: Option<String>,
    /// SHA-256 of its weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    policy_sha256: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct DisturbNote {
    share: f64,
    time_limit_s: f64,
}

/// How one demonstration came about.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct EpisodeNote {
    pub(super) seed: u64,
    /// Grasps that the expert tried.
    pub(super) grasps: u32,
    #[serde(flatten)]
    pub(super) drawn: Drawn,
    /// None at all if it was not to be disturbed.
    pub(super) disturbances: Option<Vec<Disturbance>>,
    /// Of one that a person did by hand, or a simulated operator.
    #[serde(flatten)]
    pub(super) by_hand: Option<ByHandNote>,
}

/// How hands did a demonstration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct ByHandNote {
    pub(super) source: &'static str,
    /// Who says that it is a success: the task's judge or the person.
    pub(super) ended_by: &'static str,
    /// What the person calls it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) label: Option<String>,
    pub(super) teleop: TeleopSummary,
}

/// What became of the demonstrations that were disturbed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct DisturbedCounts {
    /// How many there were.
    pub attempts: usize,
    /// How many succeeded, and so were kept.
    pub kept: usize,
    /// In how many of those the expert tried more than one grasp.
    pub retried: usize,
}

impl DisturbedCounts {
    pub(super) const fn add(&mut self, attempt: &Attempt) {
        if attempt.disturbances == 0 {
            return;
        }
        self.attempts += 1;
        if attempt.kept {
            self.kept += 1;
            if attempt.grasps > 1 {
                self.retried += 1;
            }
        }
    }
}

/// Who demonstrates, if it is not the expert alone.
pub(super) fn source(plan: &Plan) -> Option<&'static str> {
    if operator(plan).is_some() {
        return Some(OPERATOR);
    }
    if is_own(plan) {
        return Some("policy");
    }
    let by_hand = plan.policy == PolicyChoice::Teleop;
    plan.demonstrates
        .then_some(if by_hand { "teleop" } else { "intervention" })
}

/// How the hands of `source`, if it has some, did the demonstration that it has just ended.
pub(super) fn by_hand_note(plan: &Plan, hands: &ChunkSource) -> Option<ByHandNote> {
    let both = hands.by_hand().zip(source(plan));
    both.map(|(teleop, source)| ByHandNote {
        source,
        ended_by: "judge",
        label: None,
        teleop,
    })
}

/// The simulated operator, if it is one who demonstrates.
fn operator(plan: &Plan) -> Option<OperatorFigures> {
    if let PolicyChoice::Operator(figures) = plan.policy {
        Some(figures)
    } else {
        None
    }
}

/// Whether a policy of the caller's demonstrates by itself.
const fn is_own(plan: &Plan) -> bool {
    matches!(plan.policy, PolicyChoice::Own(_)) && !plan.demonstrates
}

/// The policy from which a person may take over, or that of the caller's.
fn policy(plan: &Plan) -> Option<String> {
    let policy = Some(&plan.policy).filter(|policy| **policy != PolicyChoice::Teleop);
    let policy = policy.filter(|_| plan.demonstrates || is_own(plan));
    policy.map(PolicyChoice::name)
}

/// What is said of the recording as a whole, the task's name among it; nothing if it is of the
/// plain kind.
pub(super) fn recording_note(
    plan: &Plan,
    options: &RecordOptions,
) -> Result<Option<Value>, SessionError> {
    let plain = options.disturb.is_none() && options.instruction.is_none();
    if plain && source(plan).is_none() && plan.setup.task.varied.is_empty() {
        return Ok(None);
    }
    described(plan, options, false).map(Some)
}

/// What is said of the dataset of the attempts that failed.
pub(super) fn failures_note(plan: &Plan, options: &RecordOptions) -> Result<Value, SessionError> {
    described(plan, options, true)
}

fn described(plan: &Plan, options: &RecordOptions, failures: bool) -> Result<Value, SessionError> {
    let setup = &plan.setup;
    let note = RecordingNote {
        trocar: env!("CARGO_PKG_VERSION"),
        task: &setup.task_name,
        scene: setup.scene_file.as_deref(),
        view: setup.task.view.name(),
        needle: setup.needle(),
        seed: plan.seed,
        varied: &setup.task.varied,
        failures,
        source: source(plan),
        operator: operator(plan),
        policy: policy(plan),
        policy_sha256: plan.policy.weights_sha256()?,
        disturb: options.disturb.map(|share| DisturbNote {
            share,
            time_limit_s: setup.task.time_limit_s * f64::from(DISTURBED_TIME_FACTOR),
        }),
    };
    value(options, &note)
}

/// The options of a recording, of whatever kind it is.
pub(super) fn options_note(plan: &Plan, options: &RecordOptions) -> Result<Value, SessionError> {
    let setup = &plan.setup;
    let texts = setup.robot.texts.by_name().into_iter();
    let operator = operator(plan);
    let note = OptionsNote {
        trocar: env!("CARGO_PKG_VERSION"),
        task: &setup.task_name,
        instruction: options.instruction.as_deref(),
        seed: plan.seed,
        cameras: setup.cameras_with(Vec::new()),
        depth: options.depth,
        video: options.video.map(VideoCodec::name),
        view: setup.task.view.name(),
        needle: setup.needle(),
        patient: setup.task.patient(),
        varied: &setup.task.varied,
        disturb: options.disturb,
        source: source(plan),
        operator_delay_ms: operator.map(|it| it.delay_ms),
        operator_tremor_mm: operator.map(|it| it.tremor_mm),
        policy: policy(plan),
        policy_sha256: plan.policy.weights_sha256()?,
        files: texts.map(|(name, text)| (name, hash_text(&text))).collect(),
    };
    value(options, &note)
}

/// `note` as the dataset takes it.
pub(super) fn value(options: &RecordOptions, note: &impl Serialize) -> Result<Value, SessionError> {
    serde_json::to_value(note).map_err(|error| SessionError::output(&options.out, error))
}
