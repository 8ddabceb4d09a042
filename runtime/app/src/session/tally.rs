//! Counts and percentiles of one run, from its tick records.

use hal::ARM_NAMES;

use super::Plan;
use super::ended::Ended;
use super::plan::Arms;
use super::summary::{
    BucketsUs, LatencyMs, PercentilesUs, PolicyCounts, QpCounts, RealTimeCounts, RunSummary,
};
use crate::histogram::Histogram;
use hal::PerArm;
use trocar_control::{AnyController, CommandHash, Fault, MeasuredClearance, QpOutcome, TickReport};
use trocar_log::{RunNote, TickRecord};

/// What a run adds up to.
#[derive(Debug, Default)]
pub struct Tally {
    ticks: u64,
    hash: CommandHash,
    compute: Histogram,
    latency: Histogram,
    inference: Histogram,
    qp: QpCounts,
    guard_interventions: u64,
    queries: u64,
    refused: u64,
    restarts: u32,
    /// Each arm's fault in the first tick that had any.
    faults: Option<PerArm<Option<Fault>>>,
    /// How near the measured arms came to their boundaries.
    measured: Vec<MeasuredClearance>,
    following_errors_m: Vec<f64>,
}

impl Tally {
    /// Counts one control period.
    pub fn tick(&mut self, record: &TickRecord) {
        self.ticks += 1;
        self.compute.record(record.timing.compute_ns);
        for arm in record.arms.iter() {
            self.hash.add(&arm.command);
            let gate = arm.report.gate;
            self.refused += u64::from(gate.is_some_and(|verdict| !verdict.is_accepted()));
        }
        if !record.has_fault() {
            // A fault lasts until the operator clears it; one that was did not end the run.
            self.faults = None;
        } else if self.faults.is_none() {
            self.faults = Some(record.arms.map(|arm| arm.report.fault));
        }
        // One problem for all arms; one that follows nothing has no part in it.
        let any = |what: fn(&TickReport) -> bool| record.arms.iter().any(|arm| what(&arm.report));
        if any(|report| report.qp == QpOutcome::Failed) {
            self.qp.failed += 1;
        } else if any(|report| matches!(report.qp, QpOutcome::Solved { .. })) {
            self.qp.solved += 1;
        } else {
            self.qp.passed += 1;
        }
        self.guard_interventions += u64::from(any(|report| report.guard_intervened));
    }

    /// Counts one answered observation: how long the policy took, and how long until its chunk was
    /// there.
    pub fn query(&mut self, inference_ns: u64, latency_ns: u64) {
        self.queries += 1;
        self.inference.record(inference_ns);
        self.latency.record(latency_ns);
    }

    /// Counts one chunk that came from another process, so long after its observation.
    pub fn delivery(&mut self, latency_ns: u64) {
        self.queries += 1;
        self.latency.record(latency_ns);
    }

    /// Adds what another thread or process measured of the policy's own computing.
    pub fn inferences(&mut self, inference: &Histogram) {
        self.inference.merge(inference);
    }

    /// Takes note of how often the policy process was started again.
    pub(super) const fn restarts(&mut self, restarts: u32) {
        self.restarts = restarts;
    }

    /// Takes over from `controller` how near the measured arms came to their boundaries, and how
    /// far from their commands they were.
    pub fn measured(&mut self, controller: &AnyController) {
        self.measured = controller.measured_clearances();
        self.following_errors_m = controller.following_errors_m();
    }

    /// Control periods so far.
    #[must_use]
    pub const fn ticks(&self) -> u64 {
        self.ticks
    }

    /// What was wrong when something first was, in words; of two arms, also whose fault it was.
    #[must_use]
    pub fn faults(&self) -> Option<String> {
        let faults = self.faults.as_ref()?;
        let alone = faults.count() == 1;
        let described = faults.iter().zip(ARM_NAMES).filter_map(|(fault, name)| {
            let fault = fault.as_ref()?;
            Some(if alone {
                format!("fault: {fault}")
            } else {
                format!("fault of {name}: {fault}")
            })
        });
        Some(described.collect::<Vec<_>>().join("; "))
    }

    /// The hash of all commands so far, hexadecimal.
    #[must_use]
    pub fn command_hash(&self) -> String {
        format!("{:016x}", self.hash.value())
    }

    /// What the policy did.
    pub(super) fn policy(&self) -> PolicyCounts {
        PolicyCounts {
            queries: self.queries,
            refused: self.refused,
            restarts: self.restarts,
            latency_ms: milliseconds(&self.latency),
            inference_ms: milliseconds(&self.inference),
            ..PolicyCounts::default()
        }
    }

    /// The summary of a run of `plan` that ended so.
    pub(super) fn summary<S: Arms>(
        &self,
        plan: &Plan<S>,
        ended: &Ended,
        mut real_time: Option<RealTimeCounts>,
    ) -> RunSummary {
        let (robot, task) = (plan.setup.robot(), plan.setup.task());
        if let Some(counts) = &mut real_time {
            counts.histograms.tick = BucketsUs::of(&self.compute);
        }
        let skipped = real_time.as_ref().map_or(0, |counts| counts.overruns);
        RunSummary {
            task: task.map_or_else(String::new, |setup| setup.task_name.clone()),
            view: task.map_or_else(String::new, |setup| setup.task.view.name().to_owned()),
            needle: task.and_then(|setup| setup.task.needle().map(str::to_owned)),
            scene: task.and_then(|setup| setup.scene_file.clone()),
            patient: task.and_then(|setup| setup.task.patient().cloned()),
            policy: PolicyCounts {
                name: plan.policy.name(),
                trained_on: robot.trained_on.clone(),
                weights_sha256: robot.weights_sha256.clone(),
                ..self.policy()
            },
            seed: plan.seed,
            success: ended.success,
            reason: ended.reason.clone(),
            said: RunNote::default(),
            seconds: scaled((self.ticks + skipped) * hal::TICK_NS, 1e-9),
            ticks: self.ticks,
            command_hash: self.command_hash(),
            tick_us: PercentilesUs::of(&self.compute),
            qp: self.qp,
            guard_interventions: self.guard_interventions,
            measured_clearance: self.measured.clone(),
            following_error_m: self.following_errors_m.clone(),
            real_time,
            can: None,
            tissue: ended.tissue,
            teleop: plan.by_hand(),
        }
    }
}

impl PercentilesUs {
    /// The percentiles of `histogram`, which holds ns.
    pub(super) fn of(histogram: &Histogram) -> Self {
        Self {
            p50: scaled(histogram.percentile(0.50), 1e-3),
            p99: scaled(histogram.percentile(0.99), 1e-3),
            max: scaled(histogram.max(), 1e-3),
        }
    }
}

impl BucketsUs {
    /// The buckets of `histogram`, which holds ns.
    pub(super) fn of(histogram: &Histogram) -> Self {
        let buckets = histogram.buckets();
        let (ends_us, counts) = buckets
            .map(|(end_ns, count)| (scaled(end_ns, 1e-3), count))
            .unzip();
        Self { ends_us, counts }
    }
}

fn milliseconds(histogram: &Histogram) -> LatencyMs {
    LatencyMs {
        p50: scaled(histogram.percentile(0.50), 1e-6),
        p99: scaled(histogram.percentile(0.99), 1e-6),
    }
}

#[expect(
    clippy::cast_precision_loss,
    reason = "durations of a run are exact in f64"
)]
fn scaled(ns: u64, unit: f64) -> f64 {
    ns as f64 * unit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::{PolicyChoice, Setup};
    use hal::{ArmState, JointVector, TimeNs};
    use trocar_control::TickInput;
    use trocar_log::TickTiming;

    /// A tick of two arms that are not enabled.
    fn two_arms() -> TickRecord {
        let setup = Setup::load("needle-handover", None, &PolicyChoice::Noop).unwrap();
        let mut controller = setup.controller().unwrap();
        let home = JointVector::new(0.0, 0.0, hal::psm::HOME_INSERTION_M, 0.0, 0.0, 0.0);
        let input = || TickInput {
            now: TimeNs(0),
            measured: Ok(ArmState::at_rest(TimeNs(0), home, 0.4)),
            chunk: None,
            operator: None,
        };
        let inputs = PerArm::two(input(), input());
        let outputs = controller.tick(&inputs);
        TickRecord::new(0, inputs, outputs, TickTiming::default())
    }

    #[test]
    fn a_fault_is_told_in_words_and_of_two_arms_with_its_arm() {
        let untroubled = two_arms();
        let fault = Fault::TrackingError {
            tip_m: 0.25,
            turn_rad: 0.5,
        };
        let described = |faults: [Option<Fault>; 2], arms: usize| {
            let [first, second] = faults;
            let mut record = untroubled;
            record.arms.first.report.fault = first;
            record.arms.second = record.arms.second.filter(|_| arms == 2);
            if let Some(arm) = &mut record.arms.second {
                arm.report.fault = second;
            }
            let mut tally = Tally::default();
            tally.tick(&untroubled);
            tally.tick(&record);
            // What comes after the first is not its cause.
            record.arms.first.report.fault = Some(Fault::MeasurementNotFinite);
            if first.or(second).is_some() {
                tally.tick(&record);
            }
            tally.faults()
        };
        let words = "the tip is 250.0 mm and 0.500 rad away from its command";
        assert_eq!(described([None, None], 2), None);
        assert_eq!(
            described([Some(fault), None], 1),
            Some(format!("fault: {words}"))
        );
        for (faults, expected) in [
            ([Some(fault), None], format!("fault of psm1: {words}")),
            ([None, Some(fault)], format!("fault of psm2: {words}")),
            (
                [Some(fault); 2],
                format!("fault of psm1: {words}; fault of psm2: {words}"),
            ),
        ] {
            assert_eq!(described(faults, 2), Some(expected));
        }
    }
}
