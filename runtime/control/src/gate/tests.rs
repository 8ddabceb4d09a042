//! What passes the gate and what does not.

use super::{Gate, GateDecision, GateLimits};
use hal::{Chunk, Pose, TimeNs, TipTarget};

const LIMITS: GateLimits = GateLimits {
    age_ns_max: 2_000_000_000,
    step_m_max: 0.01,
    step_rad_max: 0.5,
    jump_m_max: 0.05,
    jump_rad_max: 1.0,
    resume_m_max: 0.01,
    resume_rad_max: 0.2,
};
const STEP_NS: u64 = 40_000_000;
const NOW: TimeNs = TimeNs(1_000_000_000);

fn good(sequence: u64) -> Chunk {
    let targets = [TipTarget::new(&Pose::translation(0.0, 0.0, -0.11), 0.2); 50];
    Chunk::new(TimeNs(900_000_000), sequence, STEP_NS, &targets)
}

fn decision_after(spoil: impl Fn(&mut Chunk)) -> GateDecision {
    let mut gate = Gate::new(LIMITS);
    let mut chunk = good(5);
    spoil(&mut chunk);
    gate.judge(&chunk, NOW, &Pose::translation(0.0, 0.0, -0.11))
        .unwrap()
}

#[test]
fn a_good_chunk_is_accepted_once() {
    let mut gate = Gate::new(LIMITS);
    let tip = Pose::translation(0.0, 0.0, -0.11);
    assert_eq!(
        gate.judge(&good(5), NOW, &tip),
        Some(GateDecision::Accepted)
    );
    assert_eq!(gate.judge(&good(5), NOW, &tip), None);
    assert_eq!(
        gate.judge(&good(4), NOW, &tip),
        Some(GateDecision::OutOfOrder)
    );
    assert_eq!((gate.accepted_count(), gate.refused_count()), (1, 1));
    gate.forget();
    assert_eq!(
        gate.judge(&good(1), NOW, &tip),
        Some(GateDecision::Accepted)
    );
}

#[test]
fn a_refused_sequence_does_not_block_the_next_one() {
    let mut gate = Gate::new(LIMITS);
    let tip = Pose::translation(0.0, 0.0, -0.11);
    let mut bad = good(u64::MAX);
    bad.targets[3].jaw = f64::NAN;
    assert_eq!(
        gate.judge(&bad, NOW, &tip),
        Some(GateDecision::NotFinite { index: 3 })
    );
    assert_eq!(
        gate.judge(&good(6), NOW, &tip),
        Some(GateDecision::Accepted)
    );
}

#[test]
fn every_kind_of_nonsense_has_its_verdict() {
    assert_eq!(
        decision_after(|c| c.len = 0),
        GateDecision::WrongLength { len: 0 }
    );
    assert_eq!(
        decision_after(|c| c.len = 129),
        GateDecision::WrongLength { len: 129 }
    );
    assert_eq!(
        decision_after(|c| c.step_ns = 0),
        GateDecision::WrongStep { step_ns: 0 }
    );
    assert_eq!(
        decision_after(|c| c.step_ns = u64::MAX),
        GateDecision::WrongStep { step_ns: u64::MAX }
    );
    assert_eq!(
        decision_after(|c| c.observed_at = TimeNs(u64::MAX)),
        GateDecision::FromTheFuture
    );
    assert_eq!(
        decision_after(|c| c.len = 2),
        GateDecision::Stale {
            age_ns: 100_000_000
        }
    );
    assert_eq!(
        decision_after(|c| c.targets[7].position_m[1] = f64::INFINITY),
        GateDecision::NotFinite { index: 7 }
    );
    assert_eq!(
        decision_after(|c| c.targets[7].rotation_xyzw = [0.0; 4]),
        GateDecision::NotUnit { index: 7 }
    );
    assert_eq!(
        decision_after(|c| c.targets[7].position_m[1] = 0.02),
        GateDecision::StepTooLong { index: 7 }
    );
    let turned = [1.0, 0.0, 0.0, 0.0];
    assert_eq!(
        decision_after(|c| c.targets[9].rotation_xyzw = turned),
        GateDecision::StepTooLong { index: 9 }
    );
    assert_eq!(
        decision_after(|c| c.targets.iter_mut().for_each(|t| t.position_m[0] = 0.06)),
        GateDecision::Jump
    );
    assert_eq!(
        decision_after(|c| c.targets[100].jaw = f64::NAN),
        GateDecision::Accepted
    );
}

#[test]
fn an_old_observation_is_stale() {
    let mut gate = Gate::new(LIMITS);
    let decision = gate.judge(
        &good(1),
        TimeNs(2_900_000_001),
        &Pose::translation(0.0, 0.0, -0.11),
    );
    assert_eq!(
        decision,
        Some(GateDecision::Stale {
            age_ns: 2_000_000_001
        })
    );
}

/// After a hold of the run's own only a chunk that starts where the arm is ends the wait for one;
/// order and age count as before.
#[test]
fn an_arm_goes_on_from_where_it_is() {
    let mut gate = Gate::new(LIMITS);
    let tip = Pose::translation(0.0, 0.0, -0.11);
    let aside = |sequence, m: f64| {
        let mut chunk = good(sequence);
        chunk.targets.iter_mut().for_each(|t| t.position_m[0] = m);
        chunk
    };
    let turned = |sequence, rad: f64| {
        let mut chunk = good(sequence);
        let (sine, cosine) = (rad / 2.0).sin_cos();
        let rotation = [sine, 0.0, 0.0, cosine];
        chunk
            .targets
            .iter_mut()
            .for_each(|t| t.rotation_xyzw = rotation);
        chunk
    };
    let judge = |gate: &mut Gate, chunk: &Chunk| gate.judge(chunk, NOW, &tip).unwrap();
    assert_eq!(judge(&mut gate, &aside(1, 0.03)), GateDecision::Accepted);
    gate.go_on();
    let elsewhere = GateDecision::Elsewhere;
    assert_eq!(judge(&mut gate, &aside(2, 0.03)), elsewhere);
    assert_eq!(judge(&mut gate, &aside(3, 0.011)), elsewhere);
    assert_eq!(judge(&mut gate, &turned(4, 0.21)), elsewhere);
    assert_eq!(judge(&mut gate, &aside(5, 0.06)), GateDecision::Jump);
    assert_eq!(judge(&mut gate, &aside(1, 0.0)), GateDecision::OutOfOrder);
    assert_eq!(judge(&mut gate, &aside(6, 0.009)), GateDecision::Accepted);
    assert_eq!(judge(&mut gate, &aside(7, 0.03)), GateDecision::Accepted);
    // Whoever enables the arm, takes it or hands it back begins anew.
    gate.go_on();
    gate.forget();
    assert_eq!(judge(&mut gate, &turned(1, 0.5)), GateDecision::Accepted);
}
