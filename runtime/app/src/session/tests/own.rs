//! Recordings of a policy of the caller's.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use hal::{Observation, Policy, PolicyError};
use trocar_data::dataset::Notes;

use super::disturbed::{options, small_lift};
use super::*;
use crate::session::SessionError;
use crate::session::record::{Attempt, record_with};
use crate::session::source::{ChunkSource, MakeSource, STEP_NS};

/// What the policies were reset with, added up.
static SEEDS: AtomicU64 = AtomicU64::new(0);

/// Holds each arm where it is.
#[derive(Default)]
struct Holds {
    chunks: u64,
}

impl Policy for Holds {
    fn reset(&mut self, seed: u64) {
        self.chunks = 0;
        SEEDS.fetch_add(seed, Ordering::Relaxed);
    }

    fn infer(&mut self, observation: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError> {
        self.chunks += 1;
        let sequence = self.chunks;
        let arms = observation.arms.iter();
        let chunks = arms
            .map(|arm| Chunk::new(arm.state.stamp, sequence, STEP_NS, &[arm.here(); 2]))
            .collect();
        Ok(chunks)
    }
}

/// The policy, asked every so many steps.
fn holds(every: u64) -> ChunkSource {
    ChunkSource::policy(Box::<Holds>::default(), Vec::new(), every)
}

/// A short lift by that policy.
fn lift() -> Plan {
    let mut plan = small_lift(&[]);
    plan.policy = PolicyChoice::Own("holds".to_owned());
    plan.setup.task.time_limit_s = 0.4;
    plan
}

/// The action is what the policy wants of the arm as it is seen, and the dataset names the policy.
/// It holds, and so fails.
#[test]
fn an_own_policy_is_recorded() {
    let folder = Scratch::new("session-own");
    let path = |name: &str| folder.0.join(name);
    let options = RecordOptions {
        failures: Some(path("failed")),
        jobs: 1,
        ..options(&path("kept"), None)
    };
    let done = AtomicUsize::new(0);
    let stop = || done.load(Ordering::Acquire) >= 2;
    let mut on_attempt = |_: &Attempt| {
        done.fetch_add(1, Ordering::Release);
    };
    let make: MakeSource<'_> = &|| Ok(holds(1));
    let summary = record_with(&lift(), &options, make, &stop, &mut on_attempt).unwrap();
    let seeds: Vec<u64> = summary.attempts.iter().map(|it| it.seed).collect();
    assert_eq!((seeds, summary.episodes), (vec![40, 41], 0));
    assert!(SEEDS.load(Ordering::Relaxed) >= 81);

    let failed = Dataset::open(&path("failed")).unwrap();
    let steps: usize = summary.attempts.iter().map(|it| it.steps).sum();
    assert!(steps > 10, "{steps}");
    assert_eq!(failed.len(), steps);
    for frame in 0..steps {
        let (tip, action) = (failed.tip_pose(frame, 0), failed.action(frame, 0));
        // Actions are in single precision.
        let same = tip
            .iter()
            .zip(&action)
            .all(|(seen, wanted)| (seen - wanted).abs() < 1e-6);
        assert!(same, "{tip:?} {action:?}");
    }
    let recording = Notes::read(&path("failed")).unwrap().recording.unwrap();
    let said = (&recording["source"], &recording["policy"]);
    assert_eq!(said, (&"policy".into(), &"holds".into()));
}

/// Before anything is written.
#[test]
fn an_own_policy_that_cannot_demonstrate_is_refused() {
    let folder = Scratch::new("session-own-refused");
    let refused = |plan: &Plan, every: u64, disturb: Option<f64>| {
        let options = options(&folder.0.join("out"), disturb);
        let make: MakeSource<'_> = &|| Ok(holds(every));
        let error = record_with(plan, &options, make, &|| false, &mut |_| {}).unwrap_err();
        assert!(matches!(error, SessionError::BadArgument(_)), "{error:?}");
        assert!(!folder.0.join("out").exists());
        error.to_string()
    };
    assert!(refused(&lift(), 5, None).contains("asked every 5 policy steps"));
    assert!(refused(&lift(), 1, Some(0.5)).contains("only demonstrations of the expert"));
    assert!(refused(&small_lift(&[]), 1, None).contains("PolicyChoice::Own"));
}
