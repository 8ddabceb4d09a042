//! The controller's aggregation by due time against ACT's published ensembling by count of steps:
//! on answers that come every step, on time, they are the same.

use hal::random::SplitMix64;
use hal::{Chunk, TimeNs, TipTarget};
use trocar_control::aggregate::{Aggregation, Aggregator};
use trocar_nets::ensemble::TemporalEnsemble;

const ROWS: usize = 12;
const STEP_NS: u64 = 40_000_000;

/// A chunk of positions within a metre, all with the same rotation.
#[expect(
    clippy::cast_possible_truncation,
    reason = "networks answer in single precision"
)]
fn rows(random: &mut SplitMix64) -> Vec<f32> {
    (0..3 * ROWS).map(|_| random.signed_unit() as f32).collect()
}

fn chunk(observed_at: TimeNs, sequence: u64, rows: &[f32]) -> Chunk {
    let target = |row: &[f32]| TipTarget {
        position_m: core::array::from_fn(|axis| f64::from(row[axis])),
        rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
        jaw: 0.0,
    };
    let targets: Vec<TipTarget> = rows.chunks_exact(3).map(target).collect();
    Chunk::new(observed_at, sequence, STEP_NS, &targets)
}

#[test]
fn aggregation_by_due_time_is_the_published_ensembling() {
    for decay in [0.01, 0.0, -0.05, 0.3] {
        let mut published = TemporalEnsemble::new(decay, ROWS, 3);
        let mut ours = Aggregator::new(Aggregation::Ensemble { decay });
        let random = &mut SplitMix64::new(17);
        for step in 0..40 {
            let rows = rows(random);
            let now = TimeNs(step * STEP_NS);
            ours.push(&chunk(now, step + 1, &rows), now);
            let (target, _) = ours.targets(now, now).unwrap();
            let expected = published.next(&rows).unwrap();
            for (ours, published) in target.position_m.iter().zip(expected) {
                let apart = (ours - f64::from(published)).abs();
                assert!(apart < 1e-6, "decay {decay}, step {step}: {apart:e} apart");
            }
        }
    }
}
