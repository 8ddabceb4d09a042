//! Facts about how chunks become a target.

use super::{Aggregation, Aggregator, between};
use hal::{Chunk, Pose, TimeNs, TipTarget};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

const STEP_NS: u64 = 40_000_000;

fn target(aggregator: &Aggregator, at: u64) -> Option<TipTarget> {
    aggregator
        .targets(TimeNs(at), TimeNs(at))
        .map(|(target, _)| target)
}

fn at(x: f64, jaw: f64) -> TipTarget {
    TipTarget::new(&Pose::translation(x, 0.0, -0.1), jaw)
}

fn constant(observed_at: u64, sequence: u64, x: f64, len: usize) -> Chunk {
    Chunk::new(TimeNs(observed_at), sequence, STEP_NS, &vec![at(x, x); len])
}

#[test]
fn oldest_chunk_weighs_most_and_newest_moves_the_jaw() {
    let mut aggregator = Aggregator::new(Aggregation::Ensemble { decay: 0.5 });
    aggregator.push(&constant(0, 1, 0.0, 10), TimeNs(0));
    aggregator.push(&constant(STEP_NS, 2, 1.0, 10), TimeNs(STEP_NS));
    let blended = target(&aggregator, STEP_NS).unwrap();
    let weight = (-0.5_f64).exp();
    assert!((blended.position_m[0] - weight / (1.0 + weight)).abs() < 1e-15);
    assert!((blended.jaw - 1.0).abs() < 1e-15);
    // Once the first has ended the second is the oldest.
    let blended = target(&aggregator, 10 * STEP_NS).unwrap();
    assert!((blended.position_m[0] - 1.0).abs() < 1e-15);
}

/// Hundred chunks cover one instant and older ones are forgotten.
#[test]
fn oldest_of_a_hundred_chunks_are_dropped() {
    let mut aggregator = Aggregator::new(Aggregation::Ensemble { decay: 0.01 });
    for index in 0..300_u32 {
        let observed_at = u64::from(index) * STEP_NS;
        aggregator.push(
            &constant(observed_at, u64::from(index) + 1, f64::from(index), 100),
            TimeNs(observed_at),
        );
    }
    let blended = target(&aggregator, 299 * STEP_NS).unwrap();
    let (mut sum, mut weight) = (0.0, 0.0);
    for i in 0..100_u32 {
        let w = (-0.01 * f64::from(i)).exp();
        sum += w * f64::from(200 + i);
        weight += w;
    }
    assert!(
        (blended.position_m[0] - sum / weight).abs() < 1e-9,
        "{}",
        blended.position_m[0]
    );
}

#[test]
fn whole_chunk_is_played_to_its_end() {
    let mut aggregator = Aggregator::new(Aggregation::WholeChunk);
    aggregator.push(&constant(0, 1, 0.0, 5), TimeNs(0));
    aggregator.push(&constant(STEP_NS, 2, 1.0, 5), TimeNs(STEP_NS));
    aggregator.push(&constant(2 * STEP_NS, 3, 2.0, 5), TimeNs(2 * STEP_NS));
    aggregator.advance(TimeNs(4 * STEP_NS));
    assert!(target(&aggregator, 4 * STEP_NS).unwrap().position_m[0].abs() < 1e-15);
    aggregator.advance(TimeNs(4 * STEP_NS + 1));
    assert!((target(&aggregator, 4 * STEP_NS + 1).unwrap().position_m[0] - 2.0).abs() < 1e-15);
}

#[test]
fn looking_ahead_asks_the_same_chunks() {
    let mut aggregator = Aggregator::new(Aggregation::Ensemble { decay: 0.0 });
    aggregator.push(&constant(0, 1, 0.0, 3), TimeNs(0));
    aggregator.push(&constant(STEP_NS, 2, 1.0, 5), TimeNs(STEP_NS));
    let (here, ahead) = aggregator
        .targets(TimeNs(2 * STEP_NS), TimeNs(3 * STEP_NS))
        .unwrap();
    assert!((here.position_m[0] - 0.5).abs() < 1e-15 && (ahead.position_m[0] - 0.5).abs() < 1e-15);
    assert!((target(&aggregator, 3 * STEP_NS).unwrap().position_m[0] - 1.0).abs() < 1e-15);
}

#[test]
fn past_every_horizon_there_is_no_target() {
    for mode in [
        Aggregation::Ensemble { decay: 0.01 },
        Aggregation::WholeChunk,
        Aggregation::Newest,
    ] {
        let mut aggregator = Aggregator::new(mode);
        assert_eq!(target(&aggregator, 0), None);
        aggregator.push(&constant(0, 1, 0.0, 5), TimeNs(0));
        assert!(target(&aggregator, 4 * STEP_NS).is_some());
        assert_eq!(target(&aggregator, 4 * STEP_NS + 1), None);
    }
}

#[test]
fn between_two_targets_the_tip_turns_evenly() {
    for angle in [0.01, 0.1, 1.0, 3.0] {
        let axis = Vector3::new(1.0, 2.0, -0.5).normalize();
        let turned = UnitQuaternion::new(axis * angle);
        let from = at(0.0, 0.0);
        let mut to = TipTarget::new(
            &Pose::from_parts(Translation3::new(1.0, 0.0, -0.1), turned),
            1.0,
        );
        to.rotation_xyzw = to.rotation_xyzw.map(|x| -x);
        let middle = between(&from, &to, 0.25).tip_in_rcm();
        let expected = UnitQuaternion::new(axis * angle * 0.25);
        assert!(
            middle.rotation.angle_to(&expected) < 1e-6,
            "{angle}: {}",
            middle.rotation.angle()
        );
        assert!((middle.translation.x - 0.25).abs() < 1e-15);
    }
}
