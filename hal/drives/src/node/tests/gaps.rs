//! SYNCs that stay away for a while: what a drive does until they are back, and when it gives up.

use super::*;

/// Position after every half millisecond.
fn watch(bench: &mut Bench, half_ms: u64) -> Vec<f64> {
    (0..half_ms)
        .map(|_| {
            bench.wait_half();
            bench.position()
        })
        .collect()
}

/// Leaves out `count` SYNCs of a drive that moves at 100 counts a millisecond, while its set-points
/// go on. Gives where it was in every half millisecond of the gap, from the last SYNC before it,
/// and the newest target.
fn gap(bench: &mut Bench, count: u64, mut target: i32) -> (Vec<f64>, i32) {
    let mut way = Vec::new();
    target += 100;
    bench.command(0x0F, target);
    bench.frame(0x080, &[]);
    way.extend(watch(bench, 2));
    for _ in 0..count {
        target += 100;
        bench.command(0x0F, target);
        way.extend(watch(bench, 2));
    }
    (way, target)
}

/// A drive bridges three SYNCs that are left out brakes meanwhile and catches up.
#[test]
fn drive_bridges_three_missing_syncs_and_catches_up() {
    // The way of the last half millisecond: a quick stop of 50 counts/ms^2 begins after two periods
    // and takes 2 ms.
    for (count, last_step) in [(1, 50.0), (2, 31.25), (3, 6.25)] {
        let (mut bench, target) = Bench::moving();
        let start = bench.position();
        let (way, mut target) = gap(&mut bench, count, target);
        let steps: Vec<f64> = core::iter::once(start)
            .chain(way.iter().copied())
            .collect::<Vec<_>>()
            .windows(2)
            .map(|w| w[1] - w[0])
            .collect();
        // Two periods as it was, then ever slower.
        assert!(steps[..4].iter().all(|step| (step - 50.0).abs() < 1e-6));
        assert!(steps[4..].windows(2).all(|w| w[1] < w[0]), "{steps:?}");
        let last = steps[steps.len() - 1];
        assert!((last - last_step).abs() < 1e-6, "{count}: {steps:?}");
        assert_eq!(bench.power_state(), PowerState::OperationEnabled);
        assert_eq!(bench.emergencies(), [0_u16; 0], "{count}");
        // Back on its way within two SYNCs, no faster than it may be.
        let mut before = bench.position();
        for _ in 0..2 {
            target += 100;
            bench.cycle(0x0F, target);
            let step = bench.position() - before;
            assert!((0.0..=1000.0).contains(&step), "{step}");
            before = bench.position();
        }
        assert!((before - f64::from(target)).abs() < 1e-6, "{count}");
        assert_eq!(bench.emergencies(), [0_u16; 0], "{count}");
        assert_eq!(bench.power_state(), PowerState::OperationEnabled);
    }
}

/// A gap that is longer than the drive waits stops it and it says why.
#[test]
fn longer_sync_gap_stops_the_drive_with_an_emergency() {
    // 2000h: periods without a SYNC after which it stops; three left out are a gap of four periods.
    for (limit, left_out, stops) in [(3, 3, true), (4, 3, false), (10, 9, false), (10, 10, true)] {
        let (mut bench, target) = Bench::moving();
        bench.write(index::SYNC_LOSS, &[limit]).unwrap();
        let (way, target) = gap(&mut bench, left_out, target);
        assert!(way.windows(2).all(|w| w[1] >= w[0]), "no way back");
        let told = if stops { vec![0x8700] } else { Vec::new() };
        assert_eq!(bench.emergencies(), told, "{limit} {left_out}");
        let at = bench.position();
        for _ in 0..5 {
            bench.cycle(0x0F, target);
        }
        let enabled = bench.power_state() == PowerState::OperationEnabled;
        assert_eq!(enabled, !stops, "{limit} {left_out}");
        let resumed = (bench.position() - f64::from(target)).abs() < 1e-6;
        assert_eq!(resumed, !stops);
        // A quick stop from 100 counts/ms, at most.
        assert!(resumed || bench.position() - at <= 100.0 + 1e-6);
    }
}
