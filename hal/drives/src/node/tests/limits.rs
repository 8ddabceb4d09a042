//! How far and how fast an axis goes, whatever its target.

use super::*;

#[test]
fn targets_beyond_range_and_speed_are_held_back_and_shown() {
    let mut bench = Bench::enabled();
    let mut before = bench.position();
    for _ in 0..1200 {
        bench.cycle(0x0F, i32::MAX);
        assert!(bench.position() - before < 1000.1);
        before = bench.position();
    }
    assert!((before - 1_000_000.0).abs() < 1e-6);
    assert_ne!(bench.node.dictionary().get(index::STATUS) & 0x0800, 0);
}

/// A target that the greatest speed cannot reach is a limit and no following error.
#[test]
fn unreachable_target_is_an_internal_limit_not_an_error() {
    let mut bench = Bench::enabled();
    bench
        .write(index::FOLLOWING_WINDOW, &500_u32.to_le_bytes())
        .unwrap();
    for _ in 0..60 {
        bench.cycle(0x0F, 100_000);
        let get = |address| bench.node.dictionary().get(address);
        let deviation = get(index::POSITION_DEMAND) - get(index::POSITION);
        assert_eq!(get(index::FOLLOWING_ERROR), deviation);
        assert!(deviation.abs() <= 500, "{deviation}");
        assert_ne!(get(index::STATUS) & 0x0800, 0);
    }
    assert!(bench.emergencies().is_empty());
    assert_eq!(bench.node.power_state(), PowerState::OperationEnabled);
}

/// The lower one of two greatest speeds holds each in its own unit.
#[test]
fn lower_of_607f_and_6080_limits_the_speed() {
    // A motor of 10 000 counts a turn: 600 turns a minute are 100 counts a millisecond.
    for (counts_s, turns_min, counts_ms) in [
        (1_000_000_u32, 600_u32, 100.0),
        (50_000, 600, 50.0),
        (50_000, 6000, 50.0),
        (1_000_000, 6, 1.0),
    ] {
        let mut bench = Bench::enabled();
        bench
            .write(index::SPEED_MAX, &counts_s.to_le_bytes())
            .unwrap();
        bench
            .write(index::MOTOR_SPEED_MAX, &turns_min.to_le_bytes())
            .unwrap();
        bench.cycle(0x0F, 500_000);
        for _ in 0..20 {
            let before = bench.position();
            bench.cycle(0x0F, 500_000);
            let way = bench.position() - before;
            assert!((way - counts_ms).abs() < 1e-6, "{turns_min}: {way}");
        }
    }
}
