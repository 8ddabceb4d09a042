//! What a run says of itself, as far as the monitor shows it: the same JSON that pages of the
//! console get. Keys that it does not know are passed over, so that it may be of another version
//! than the run. The types stand for those in `console/facts` and `console/state`, which can only
//! be written.

use serde::Deserialize;
use trocar_log::RunNote;

/// What does not change.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Facts {
    /// The task, or what the limits of a robot's run are for.
    pub(super) title: String,
    pub(super) policy: String,
    pub(super) seed: u64,
    pub(super) axes: Vec<Axis>,
    /// Upper ends of the histograms' buckets, us.
    pub(super) buckets_us: Vec<u64>,
    /// None of a run without a task.
    pub(super) time_limit_s: Option<f64>,
}

/// The limits of a joint or the jaw: rad, or m.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Axis {
    pub(super) name: String,
    pub(super) unit: String,
    pub(super) low: f64,
    pub(super) high: f64,
    /// The greatest, rad/s or m/s.
    pub(super) velocity: f64,
}

/// The newest tick.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct State {
    pub(super) seconds: f64,
    /// For how long the control loop has said nothing new, s.
    pub(super) silent_s: f64,
    /// In the order of the configuration; one or two.
    pub(super) arms: Vec<Arm>,
    pub(super) filter: Filter,
    pub(super) counts: Counts,
    pub(super) timing: Timing,
    /// From the observation to the chunk that came of it.
    pub(super) latency: Histogram,
    /// Share of the speed limits that the operator allows.
    pub(super) speed_percent: u8,
    /// What the task still lacks, where it is known.
    pub(super) task: Option<String>,
    /// What a person says of a run that no task judges; none of a run that takes no mark.
    pub(super) said: Option<RunNote>,
}

/// One arm, in joint order with the jaw last.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Arm {
    pub(super) name: String,
    pub(super) state: String,
    pub(super) homed: bool,
    pub(super) busy: bool,
    pub(super) fault: Option<String>,
    pub(super) error: Option<String>,
    /// None where nothing was measured in the tick; `error` says why.
    pub(super) measured: Option<Vec<f64>>,
    /// rad, of insertion m, as all of an arm's numbers.
    pub(super) commanded: Vec<f64>,
    pub(super) commanded_velocity: Vec<f64>,
    pub(super) follows: bool,
}

/// What the filter last changed.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Filter {
    /// None if it has changed nothing since the run began.
    pub(super) ago_s: Option<f64>,
    pub(super) rows: Vec<String>,
    /// Rows beyond those that are named.
    pub(super) more: u16,
    /// By how much each axis's velocity was changed, in its limit, arm by arm.
    pub(super) change: Vec<f64>,
}

/// Ticks and chunks since the run began: what the filter passed, solved and failed, in how many the
/// guard intervened, and how many chunks came and were refused.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Counts {
    pub(super) ticks: u64,
    pub(super) passed: u64,
    pub(super) solved: u64,
    pub(super) failed: u64,
    pub(super) guard: u64,
    pub(super) guard_ago_s: Option<f64>,
    pub(super) chunks: u64,
    pub(super) refused: u64,
    pub(super) last_refused: Option<String>,
}

/// Of each tick: how long it computed, and how late its thread woke.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Timing {
    pub(super) compute: Histogram,
    pub(super) wake: Histogram,
    /// Whole periods that were skipped.
    pub(super) overruns: u64,
}

/// Durations counted in buckets; their upper ends are `Facts::buckets_us`.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Histogram {
    /// One longer than there are ends: the last counts what is beyond all.
    pub(super) counts: Vec<u64>,
    pub(super) max_us: f64,
}

impl Histogram {
    /// The upper end of the bucket that has the median, us; none if it is empty or beyond the last
    /// bucket.
    pub(super) fn median_us(&self, ends_us: &[u64]) -> Option<u64> {
        let total: u64 = self.counts.iter().sum();
        let mut below = 0;
        let bucket = self.counts.iter().position(|count| {
            below += count;
            total > 0 && 2 * below >= total
        })?;
        ends_us.get(bucket).copied()
    }
}
