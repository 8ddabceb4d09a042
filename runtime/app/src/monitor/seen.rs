//! What a run says of itself, as far as the monitor shows it: the same JSON that pages of the
//! console get.

use serde::Deserialize;
use trocar_log::RunNote;

/// What does not change.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Facts {
    pub(super) title: String,
    pub(super) policy: String,
    pub(super) seed: u64,
    pub(super) axes: Vec<Axis>,
    /// Upper ends of the histograms' buckets, us.
    pub(super) buckets_us: Vec<u64>,
    pub(super) time_limit_s: Option<f64>,
}

/// The limits of a joint or the jaw: rad, or m.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Axis {
    pub(super) name: String,
    pub(super) unit: String,
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) velocity: f64,
}

/// The newest tick.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct State {
    pub(super) seconds: f64,
    /// For how long the control loop has said nothing new, s.
    pub(super) silent_s: f64,
    pub(super) arms: Vec<Arm>,
    pub(super) filter: Filter,
    pub(super) counts: Counts,
    pub(super) timing: Timing,
    pub(super) latency: Histogram,
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
    pub(super) measured: Option<Vec<f64>>,
    pub(super) commanded: Vec<f64>,
    pub(super) commanded_velocity: Vec<f64>,
    pub(super) follows: bool,
}

/// What the filter last changed.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Filter {
    pub(super) ago_s: Option<f64>,
    pub(super) rows: Vec<String>,
    pub(super) more: u16,
    /// By how much each axis's velocity was changed, in its limit, arm by arm.
    pub(super) change: Vec<f64>,
}

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

#[derive(Clone, Debug, Deserialize)]
pub(super) struct Timing {
    pub(super) compute: Histogram,
    pub(super) wake: Histogram,
    pub(super) overruns: u64,
}

#[derive(Clone, Debug, Deserialize)]
pub(super) struct Histogram {
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
