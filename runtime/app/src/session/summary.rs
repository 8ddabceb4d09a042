//! What a run and an evaluation report, in the form that scripts rely on.

use core::fmt;

use hal::TimeNs;
use serde::Serialize;
use trocar_control::MeasuredClearance;
use trocar_log::RunNote;
use trocar_tasks::task::{Outcome, PatientPlacement, Variation};
use trocar_world::tissue::TissueExtremes;

use super::Plan;
use super::episode::EpisodeEnd;
use super::score::Score;
use super::teleop::TeleopSummary;
use crate::rt::{RtReport, ThreadFaults};

/// Percentiles of a duration.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct PercentilesUs {
    /// Median, µs.
    pub p50: f64,
    /// 99th percentile, µs.
    pub p99: f64,
    /// Largest, µs.
    pub max: f64,
}

/// Durations in buckets, in ascending order; those that hold none are left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct BucketsUs {
    /// The longest duration that each bucket counts, µs; it begins at most 3.2 % below.
    pub ends_us: Vec<f64>,
    /// How many each holds.
    pub counts: Vec<u64>,
}

/// All durations of a loop in real time.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LoopHistograms {
    /// Compute time of the controller a tick.
    pub tick: BucketsUs,
    /// How late the control thread woke.
    pub wake: BucketsUs,
    /// From one wake-up to the next.
    pub period: BucketsUs,
}

/// Median and 99th percentile, ms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LatencyMs {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
}

/// How often the safety QP had something to do.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct QpCounts {
    /// Ticks in which a row was violated and the QP gave the answer.
    pub solved: u64,
    /// Ticks in which the nominal motion passed unchanged.
    pub passed: u64,
    /// Ticks in which the QP gave no usable answer and the arm braked.
    pub failed: u64,
}

/// The policy's part of a run.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PolicyCounts {
    /// `expert`, `noop`, `random` or the checkpoint's directory.
    pub name: String,
    /// The task of the demonstrations that a checkpoint was trained on, if it tells.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trained_on: Option<String>,
    /// SHA-256 of a checkpoint's `model.safetensors`, hexadecimal: its folder may hold other
    /// weights later.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights_sha256: Option<String>,
    /// Observations that were answered.
    pub queries: u64,
    /// Chunks that the input gate refused.
    pub refused: u64,
    /// How often its process was started again, or had to be waited for, after it died or hung;
    /// absent if it never did.
    #[serde(skip_serializing_if = "is_zero")]
    pub restarts: u32,
    /// Time from an observation to the delivery of its chunk.
    pub latency_ms: LatencyMs,
    /// Time that the policy itself took to answer.
    pub inference_ms: LatencyMs,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde wants it so")]
const fn is_zero(count: &u32) -> bool {
    *count == 0
}

/// The loop's timing in a real-time run.
#[derive(Clone, Debug, Serialize)]
pub struct RealTimeCounts {
    /// Whole periods skipped.
    pub overruns: u64,
    /// How late the control thread woke.
    pub wake_us: PercentilesUs,
    /// From one wake-up to the next.
    pub period_us: PercentilesUs,
    /// Of these and of the ticks' compute time, every duration.
    pub histograms: LoopHistograms,
    /// What befell the control thread, and what it was granted.
    pub thread: ThreadCounts,
    /// Log records dropped.
    pub log_dropped: u64,
    /// How many times slower than the system's the run's clocks went; 1 is real time. See
    /// [`crate::rt::slow_motion`].
    pub slow_motion: u64,
}

/// The control thread in its loop.
#[derive(Clone, Debug, Serialize)]
pub struct ThreadCounts {
    /// How often it asked for memory; 0 where the program does not count, see
    /// [`crate::rt::CountingAllocator`].
    pub allocations: u64,
    /// Its page faults and context switches; each period ends with one voluntary switch.
    pub faults: ThreadFaults,
    /// What it asked of the system, and what it got.
    pub granted: RtReport,
}

/// One bus of an arm.
#[derive(Clone, Debug, Serialize)]
pub struct CanBusSummary {
    /// Its interface.
    pub interface: String,
    /// Share that this arm may take of it at worst-case stuffing, per mille.
    pub planned_per_mille: u64,
    /// Frames that the system lost before they came to us.
    pub frames_lost: u64,
    /// How often our controller became error passive on it.
    pub error_passive: u64,
    /// Frames on it that no CANopen device sends.
    pub frames_foreign: u64,
}

impl CanBusSummary {
    /// What a person should look into, if there is something.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        let times = self.error_passive;
        (times > 0).then(|| {
            format!(
                "{}: our controller became error passive {times} times, as it counted many errors; the arm went on, but \
                 look at cable, termination and bit rate",
                self.interface
            )
        })
    }
}

/// One arm on CAN.
#[derive(Clone, Debug, Serialize)]
pub struct CanArmSummary {
    /// `psm1` or `psm2`.
    pub arm: &'static str,
    /// Its buses.
    pub buses: Vec<CanBusSummary>,
    /// Answers of drives that did not come in their cycle, over all axes.
    pub answers_missed: u64,
    /// Answers that came in a later cycle.
    pub answers_late: u64,
    /// Answers that could not be believed.
    pub answers_rejected: u64,
    /// SYNCs that were left out to find out which ones answers belong to.
    pub syncs_left_out: u64,
    /// Commands that were not finite or out of range.
    pub commands_refused: u64,
    /// Whether each of its drives said at the end that it has no torque any more, before its node
    /// was stopped.
    pub confirmed_down: bool,
    /// What stopped the arm, if something did.
    pub fault: Option<String>,
    /// The node that it was, if it was one.
    pub fault_node: Option<u8>,
}

impl CanArmSummary {
    /// What a person should know before going near the arm, if there is something.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        (!self.confirmed_down).then(|| {
            format!(
                "{}: its drives have not confirmed that they are down, and their nodes were stopped; take the arm to have torque until \
                 its power is off",
                self.arm
            )
        })
    }
}

/// Arms on CAN.
#[derive(Clone, Debug, Serialize)]
pub struct CanSummary {
    /// Time between two SYNCs, us.
    pub cycle_us: u64,
    /// Bits a second.
    pub bit_rate_bit_s: u32,
    /// Whether the drives' positions are those of actuators; otherwise of joints.
    pub actuator_space: bool,
    /// The arms.
    pub arms: Vec<CanArmSummary>,
}

/// What a soft tissue went through: the largest values of a run.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct TissueSummary {
    /// Force between an instrument as a whole and the tissue after a low pass at 50 Hz, N; a pinch
    /// is not in it.
    pub force_n_max: f64,
    /// Normal force of one finger on the tissue after the same low pass, N.
    pub squeeze_n_max: f64,
    /// Stretch; 0.1 is a tenth longer than at rest.
    pub stretch_max: f64,
    /// How far the mark rose above where it lay at rest, m.
    pub mark_rise_m_max: f64,
}

impl From<TissueExtremes> for TissueSummary {
    fn from(extremes: TissueExtremes) -> Self {
        Self {
            force_n_max: extremes.force_n,
            squeeze_n_max: extremes.squeeze_n,
            stretch_max: extremes.stretch,
            mark_rise_m_max: extremes.mark_rise_m,
        }
    }
}

impl fmt::Display for TissueSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "tissue: pulled with at most {:.3} N, squeezed with {:.2} N, stretched by {:.1} %, mark {:.1} mm up",
            self.force_n_max,
            self.squeeze_n_max,
            self.stretch_max * 100.0,
            self.mark_rise_m_max * 1e3
        )
    }
}

/// One run.
#[derive(Clone, Debug, Serialize)]
pub struct RunSummary {
    /// Task name; absent in a run of a robot without one.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub task: String,
    /// From where the cameras looked: `train`, `view1` or `view2`; absent without a task.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub view: String,
    /// The needle, in a task that has a choice.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub needle: Option<String>,
    /// The scene file, if it was not the built-in one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// How the patient lies whose organ is the ground, if it is one's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patient: Option<PatientPlacement>,
    /// The policy and what it did.
    pub policy: PolicyCounts,
    /// The seed that everything random depends on.
    pub seed: u64,
    /// Whether the task was done; absent without a task.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub success: Option<bool>,
    /// Why the run ended.
    pub reason: String,
    /// What a person said of it; absent if nothing.
    #[serde(skip_serializing_if = "RunNote::is_empty")]
    pub said: RunNote,
    /// Simulated or real time that passed, s.
    pub seconds: f64,
    /// Control periods.
    pub ticks: u64,
    /// FNV-1a over the bits of every command, hexadecimal.
    pub command_hash: String,
    /// Compute time of the controller a tick.
    pub tick_us: PercentilesUs,
    /// The filter's work.
    pub qp: QpCounts,
    /// Ticks in which the guard replaced the candidate by its last verified stop.
    pub guard_interventions: u64,
    /// How near the measured arms came to each boundary while they held torque: commands keep their
    /// distance, an arm lags behind them.
    pub measured_clearance: Vec<MeasuredClearance>,
    /// Of each arm the largest distance of a measured part of its instrument from where it was
    /// commanded to be, m.
    pub following_error_m: Vec<f64>,
    /// Present in real-time runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub real_time: Option<RealTimeCounts>,
    /// Present in runs over CAN.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub can: Option<CanSummary>,
    /// Present in tasks with a soft tissue.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tissue: Option<TissueSummary>,
    /// Present if an operator's hands were the policy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub teleop: Option<TeleopSummary>,
}

/// One trial of an evaluation.
#[derive(Clone, Debug, Serialize)]
pub struct TrialSummary {
    /// Its seed.
    pub seed: u64,
    /// Whether the task was done.
    pub success: bool,
    /// Whether the simulation was at fault: the trial says nothing of the policy.
    pub invalid: bool,
    /// Why it ended.
    pub reason: String,
    /// Simulated time, s.
    pub seconds: f64,
    /// Hash of its commands.
    pub command_hash: String,
    /// Present in tasks with a soft tissue.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tissue: Option<TissueSummary>,
    /// Its log, if that was kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log: Option<String>,
    /// Its animation, if that was kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pictures: Option<String>,
}

impl TrialSummary {
    /// Of the trial `seed`, of which nothing was kept.
    pub(super) fn new(seed: u64, end: &EpisodeEnd) -> Self {
        Self {
            seed,
            success: matches!(end.outcome, Outcome::Success),
            invalid: matches!(end.outcome, Outcome::Invalid(_)),
            reason: end.reason(),
            seconds: TimeNs::from_tick(end.tally.ticks()).seconds(),
            command_hash: end.tally.command_hash(),
            tissue: end.tissue,
            log: None,
            pictures: None,
        }
    }
}

/// An evaluation over many trials.
#[derive(Clone, Debug, Serialize)]
pub struct EvalSummary {
    /// Task name.
    pub task: String,
    /// From where the cameras looked: `train`, `view1` or `view2`.
    pub view: String,
    /// The needle, in a task that has a choice, unless each trial has its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub needle: Option<String>,
    /// What was drawn anew for each trial.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub varied: Vec<Variation>,
    /// The scene file, if it was not the built-in one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// How the patient lies whose organ is the ground, if it is one's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patient: Option<PatientPlacement>,
    /// The policy.
    pub policy: String,
    /// The task of the demonstrations that a checkpoint was trained on, if it tells.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trained_on: Option<String>,
    /// SHA-256 of a checkpoint's `model.safetensors`, hexadecimal: its folder may hold other
    /// weights later.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights_sha256: Option<String>,
    /// How many trials were asked for.
    pub trials_asked: usize,
    /// Whether a signal ended the evaluation before all of them were done.
    pub interrupted: bool,
    /// How many were done.
    pub trials: usize,
    /// How many of them succeeded.
    pub successes: usize,
    /// In how many the simulation was at fault: they count neither way.
    pub invalid: usize,
    /// `successes / (trials - invalid)`.
    pub rate: f64,
    /// Wilson's 95 % interval of the rate.
    pub wilson95: [f64; 2],
    /// The trials in order of their seeds.
    pub episodes: Vec<TrialSummary>,
}

impl EvalSummary {
    /// Sums up `episodes`, of `asked` that there were to be, of `plan`.
    pub(super) fn new(plan: &Plan, asked: usize, episodes: Vec<TrialSummary>) -> Self {
        let Plan { setup, policy, .. } = plan;
        let score = Score::of(&episodes);
        Self {
            task: setup.task_name.clone(),
            view: setup.task.view.name().to_owned(),
            needle: setup.needle().map(str::to_owned),
            varied: setup.task.varied.clone(),
            scene: setup.scene_file.clone(),
            patient: setup.task.patient().cloned(),
            policy: policy.name(),
            trained_on: setup.robot.trained_on.clone(),
            weights_sha256: setup.robot.weights_sha256.clone(),
            trials_asked: asked,
            interrupted: episodes.len() < asked,
            trials: episodes.len(),
            successes: score.successes,
            invalid: score.invalid,
            rate: score.rate(),
            wilson95: score.wilson95(),
            episodes,
        }
    }

    /// The trials counted.
    #[must_use]
    pub fn score(&self) -> Score {
        Score::of(&self.episodes)
    }
}

/// The success rate and Wilson's 95 % score interval around it.
#[expect(clippy::cast_precision_loss, reason = "trial counts are small")]
#[must_use]
pub fn wilson_interval(successes: usize, trials: usize) -> (f64, [f64; 2]) {
    const Z: f64 = 1.959_963_984_540_054;
    if trials == 0 {
        return (0.0, [0.0, 1.0]);
    }
    let n = trials as f64;
    let rate = successes as f64 / n;
    let centre = rate + Z * Z / (2.0 * n);
    let spread = Z * (rate * (1.0 - rate) / n + Z * Z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + Z * Z / n;
    (
        rate,
        [
            ((centre - spread) / scale).max(0.0),
            ((centre + spread) / scale).min(1.0),
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_interval_matches_published_values() {
        // 34 of 50, the paper's ACT with one camera.
        let (rate, [low, high]) = wilson_interval(34, 50);
        assert!((rate - 0.68).abs() < 1e-12);
        assert!(
            (low - 0.5419).abs() < 1e-3 && (high - 0.7924).abs() < 1e-3,
            "{low} {high}"
        );
        let (_, [low, high]) = wilson_interval(0, 0);
        assert!(
            low.abs() < 1e-12 && (high - 1.0).abs() < 1e-12,
            "{low} {high}"
        );
    }

    #[test]
    fn an_arm_whose_drives_are_not_known_to_be_down_is_named() {
        let arm = |confirmed_down, fault: Option<&str>| CanArmSummary {
            arm: "psm2",
            buses: Vec::new(),
            answers_missed: 0,
            answers_late: 0,
            answers_rejected: 0,
            syncs_left_out: 0,
            commands_refused: 0,
            confirmed_down,
            fault: fault.map(str::to_owned),
            fault_node: None,
        };
        assert_eq!(arm(true, None).warning(), None);
        for fault in [None, Some("bus 0: our controller is bus-off")] {
            let warning = arm(false, fault).warning().unwrap_or_default();
            assert!(
                warning.starts_with("psm2: its drives have not confirmed that they are down"),
                "{warning}"
            );
        }
    }

    /// A bus on which our controller became error passive is named with what to look at.
    #[test]
    fn error_passive_bus_is_named_with_advice() {
        let bus = |error_passive| CanBusSummary {
            interface: "vcan1".to_owned(),
            planned_per_mille: 900,
            frames_lost: 0,
            error_passive,
            frames_foreign: 0,
        };
        assert_eq!(bus(0).warning(), None);
        let warning = bus(2).warning().unwrap_or_default();
        assert!(
            warning.starts_with("vcan1: our controller became error passive 2 times"),
            "{warning}"
        );
    }
}
