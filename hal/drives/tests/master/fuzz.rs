//! Arbitrary frames on the bus of an arm: no panic, and the arm stays where it may be and as fast
//! as it may be.

use super::*;
use trocar_canopen::arbitrary::Random;

/// Throws frames at an arm that is moving; gives how many cycles it lived without a fault.
fn throw(seed: u64, cycles: u32) -> u32 {
    let mut random = Random::new(seed);
    let mut bench = Bench::new();
    let mut lived = 0;
    let mut before = bench.motors();
    for n in 0..cycles {
        for _ in 0..random.below(4) {
            let frame = random.frame();
            bench.net().intrude(0, frame);
        }
        let _ = bench.cycle(0.0008);
        lived += u32::from(bench.arm.fault().is_none());
        let now = bench.motors();
        for (a, b) in before.iter().zip(&now) {
            assert!((b - a).abs() <= 4.0 * 0.002 + 1e-9, "{seed} {n}");
            assert!(b.abs() <= 5.0);
        }
        before = now;
    }
    lived
}

/// Arbitrary frames on the bus never panic nor move the arm outside its limits.
#[test]
fn arbitrary_frames_keep_the_arm_within_its_limits() {
    let lived: u32 = (0..6).map(|seed| throw(seed, 150)).sum();
    // Most end with a fault sooner or later, since many identifiers are the master's own; some do
    // not at once.
    assert!(lived > 30, "{lived}");
}
