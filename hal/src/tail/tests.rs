//! Tests of the safe tail.

use super::{AxisPoint, AxisTail, SafeTail, TAIL_AXES, TailPhase, TailPlayer};
use crate::random::SplitMix64;
use crate::{TICK_NS, TimeNs};

/// Phases of any length and jerk, backwards from rest, so that they are a stop.
fn random_stop(random: &mut SplitMix64) -> AxisTail {
    let phases = [(); 3].map(|()| TailPhase {
        duration_s: random.between(-0.02, 0.12).max(0.0),
        jerk: random.between(-800.0, 800.0),
    });
    let rest = AxisPoint {
        position: random.between(-1.0, 1.0),
        ..AxisPoint::default()
    };
    let start = phases.iter().rev().fold(rest, |knot, phase| {
        knot.after(-phase.duration_s, phase.jerk)
    });
    AxisTail { start, phases }
}

fn random_tail(random: &mut SplitMix64, stamp: TimeNs) -> SafeTail {
    SafeTail {
        stamp,
        axes: [(); TAIL_AXES].map(|()| random_stop(random)),
        enabled: true,
    }
}

fn distance(one: &AxisPoint, other: &AxisPoint) -> [f64; 3] {
    [
        (one.position - other.position).abs(),
        (one.velocity - other.velocity).abs(),
        (one.acceleration - other.acceleration).abs(),
    ]
}

#[test]
fn every_point_is_the_one_found_by_dense_integration() {
    const STEPS: u32 = 10_000;
    let mut random = SplitMix64::new(1);
    for case in 0..50 {
        let tail = random_stop(&mut random);
        let mut state = tail.start;
        let mut begin_s = 0.0;
        for phase in &tail.phases {
            let step_s = phase.duration_s / f64::from(STEPS);
            for step in 0..STEPS {
                let time_s = begin_s + step_s * f64::from(step);
                let off = distance(&tail.at(time_s), &state);
                assert!(
                    off[0] < 1e-8 && off[1] < 1e-9 && off[2] < 1e-9,
                    "case {case} at {time_s}: {off:?}"
                );
                let (v, a) = (state.velocity, state.acceleration);
                state.acceleration += step_s * phase.jerk;
                state.velocity += step_s * f64::midpoint(a, state.acceleration);
                state.position += step_s * f64::midpoint(v, state.velocity);
            }
            begin_s += phase.duration_s;
        }
        let off = distance(&tail.at(1.0), &state);
        assert!(
            off[0] < 1e-8 && off[1] < 1e-9 && off[2] < 1e-9,
            "case {case} at rest: {off:?}"
        );
    }
}

#[test]
fn knots_are_passed_without_a_jump() {
    let mut random = SplitMix64::new(2);
    for case in 0..1_000 {
        let tail = random_stop(&mut random);
        let mut knot_s = 0.0;
        for phase in &tail.phases {
            knot_s += phase.duration_s;
            let before = tail.at((knot_s - 1e-12_f64).max(0.0));
            let after = tail.at(knot_s + 1e-12);
            let off = distance(&before, &after);
            assert!(
                off[0] < 1e-10 && off[1] < 1e-9 && off[2] < 1e-8,
                "case {case} at {knot_s}: {off:?}"
            );
        }
    }
}

#[test]
fn rest_comes_with_the_last_phase_and_stays() {
    let mut random = SplitMix64::new(3);
    for case in 0..1_000 {
        let tail = random_stop(&mut random);
        let end = tail.end();
        assert!(
            end.velocity.abs() < 1e-11 && end.acceleration.abs() < 1e-10,
            "case {case}: {end:?}"
        );
        let duration_s = tail.duration_s();
        let sum = tail.phases.iter().map(|phase| phase.duration_s).sum();
        assert!(duration_s <= sum, "case {case}: {duration_s} {sum}");
        let rest = AxisPoint {
            velocity: 0.0,
            acceleration: 0.0,
            ..end
        };
        for late_s in [0.0, 1e-9, 1e-3, 1e6, f64::INFINITY] {
            assert_eq!(tail.at(duration_s + late_s), rest, "case {case}");
        }
        // Its last phase leads there, unless that is too short to tell.
        if tail.phases[2].duration_s > 1e-3 {
            let before = tail.at(duration_s - 1e-4);
            assert!(before.acceleration.abs() > 0.0, "case {case}: {before:?}");
        }
    }
}

#[test]
fn first_setpoint_is_the_start_bit_for_bit() {
    let mut random = SplitMix64::new(4);
    for case in 0..200 {
        let mut tail = random_tail(&mut random, TimeNs(7 * TICK_NS));
        for axis in &mut tail.axes {
            // A first phase of no length changes nothing.
            if case % 2 == 0 {
                axis.phases[0].duration_s = 0.0;
            }
            axis.phases[2].duration_s = axis.phases[2].duration_s.max(1e-9);
        }
        for earlier_ns in [0, 1, TICK_NS] {
            let command = tail.command_at(TimeNs(tail.stamp.0 - earlier_ns));
            for joint in 0..6 {
                let start = &tail.axes[joint].start;
                assert_eq!(
                    command.position[joint].to_bits(),
                    start.position.to_bits(),
                    "case {case}"
                );
                assert_eq!(
                    command.velocity[joint].to_bits(),
                    start.velocity.to_bits(),
                    "case {case}"
                );
                assert_eq!(
                    command.acceleration[joint].to_bits(),
                    start.acceleration.to_bits(),
                    "case {case}"
                );
            }
            let jaw = &tail.axes[6].start;
            assert_eq!(command.jaw_position.to_bits(), jaw.position.to_bits());
            assert_eq!(command.jaw_velocity.to_bits(), jaw.velocity.to_bits());
        }
    }
}

#[test]
fn arm_rests_when_its_slowest_axis_does() {
    let mut random = SplitMix64::new(5);
    for _ in 0..200 {
        let stamp = TimeNs(1_000 * TICK_NS);
        let tail = random_tail(&mut random, stamp);
        let longest = tail
            .axes
            .iter()
            .map(AxisTail::duration_s)
            .fold(0.0, f64::max);
        assert_eq!(tail.duration_s().to_bits(), longest.to_bits());
        let rest = tail.command_at(stamp.plus_ns(400 * TICK_NS));
        assert_eq!(rest.velocity.norm().to_bits(), 0.0_f64.to_bits());
        assert_eq!(rest.acceleration.norm().to_bits(), 0.0_f64.to_bits());
        assert_eq!(rest.jaw_velocity.to_bits(), 0.0_f64.to_bits());
        let later = tail.command_at(TimeNs(u64::MAX));
        assert_eq!(
            (later.position, later.jaw_position, later.enabled),
            (rest.position, rest.jaw_position, true)
        );
        let moving = tail.command_at(TimeNs(stamp.0 + 5 * TICK_NS));
        assert!(moving.velocity.norm() > 0.0);
    }
}

#[test]
fn remainder_is_the_same_stop() {
    let mut random = SplitMix64::new(6);
    for case in 0..500 {
        let tail = random_stop(&mut random);
        let played_s = random.between(0.0, 0.4);
        let rest = tail.remainder(played_s);
        let left_s = (tail.duration_s() - played_s).max(0.0);
        assert!((rest.duration_s() - left_s).abs() < 1e-15, "case {case}");
        assert_eq!(rest.start, tail.at(played_s));
        for index in 0..=50 {
            let time_s = 0.4 * f64::from(index) / 50.0;
            let off = distance(&rest.at(time_s), &tail.at(played_s + time_s));
            assert!(
                off[0] < 1e-12 && off[1] < 1e-11 && off[2] < 1e-10,
                "case {case} at {played_s} + {time_s}: {off:?}"
            );
        }
    }
}

#[test]
fn points_ahead_are_the_setpoints_of_the_coming_periods() {
    let mut random = SplitMix64::new(7);
    let stamp = TimeNs(3 * TICK_NS);
    let tail = random_tail(&mut random, stamp);
    let now = stamp.plus_ns(TICK_NS);
    let points: Vec<_> = tail.points(now, 2 * TICK_NS, 5).collect();
    let expected: Vec<_> = [6, 8, 10, 12, 14]
        .map(|tick| tail.command_at(TimeNs::from_tick(tick)))
        .to_vec();
    assert_eq!(points, expected);
    let far = tail.points(TimeNs(u64::MAX - 1), TICK_NS, 2);
    assert!(far.into_iter().all(|point| point.stamp == TimeNs(u64::MAX)));
}

/// Resting arm stays as it is and a disabled one stays disabled.
#[test]
fn tail_of_a_resting_arm_holds_it() {
    let positions = [0.1, -0.2, 0.12, 0.3, -0.4, 0.5, 0.6];
    for enabled in [false, true] {
        let tail = SafeTail::at_rest(TimeNs(5), &positions, enabled);
        assert!(tail.duration_s() <= 0.0);
        for now in [TimeNs(0), TimeNs(5), TimeNs(1 << 40)] {
            let command = tail.command_at(now);
            assert_eq!(command.stamp, now);
            assert_eq!(command.position.as_slice(), &positions[..6]);
            assert_eq!(command.jaw_position.to_bits(), positions[6].to_bits());
            assert_eq!(command.velocity.norm().to_bits(), 0.0_f64.to_bits());
            assert_eq!(command.enabled, enabled);
            assert_eq!(SafeTail::hold(&command).axes, tail.axes);
            assert_eq!(SafeTail::hold(&command).enabled, enabled);
        }
    }
}

#[test]
fn before_the_start_is_the_start() {
    let tail = random_stop(&mut SplitMix64::new(9));
    for time_s in [-0.0, -1e-9, -1.0, f64::NEG_INFINITY, f64::NAN] {
        assert_eq!(tail.at(time_s), tail.start, "{time_s}");
        assert_eq!(tail.remainder(time_s), tail, "{time_s}");
    }
}

#[test]
fn senseless_durations_end_at_once() {
    let start = AxisPoint {
        position: 0.25,
        velocity: 0.1,
        acceleration: 1.0,
    };
    for duration_s in [-1.0, f64::NEG_INFINITY, f64::NAN] {
        let phase = TailPhase {
            duration_s,
            jerk: 100.0,
        };
        let tail = AxisTail {
            start,
            phases: [phase; 3],
        };
        assert!(tail.duration_s() <= 0.0);
        assert_eq!(tail.at(0.1), AxisTail::at_rest(0.25).start);
    }
}

#[test]
fn any_number_that_is_not_finite_is_found() {
    let good = SafeTail::at_rest(TimeNs(0), &[0.0; TAIL_AXES], true);
    assert!(good.is_finite());
    let spoils: [fn(&mut AxisTail, f64); 5] = [
        |axis, bad| axis.start.position = bad,
        |axis, bad| axis.start.velocity = bad,
        |axis, bad| axis.start.acceleration = bad,
        |axis, bad| axis.phases[0].duration_s = bad,
        |axis, bad| axis.phases[2].jerk = bad,
    ];
    for axis in 0..TAIL_AXES {
        for (index, spoil) in spoils.iter().enumerate() {
            for bad in [f64::NAN, f64::INFINITY] {
                let mut tail = good;
                spoil(&mut tail.axes[axis], bad);
                assert!(!tail.is_finite(), "number {index} of axis {axis}");
            }
        }
    }
}

#[test]
fn player_goes_on_by_a_period_for_every_period_of_silence() {
    let mut random = SplitMix64::new(8);
    let mut player = TailPlayer::new(TICK_NS);
    assert_eq!(player.next_period(), None);
    for tick in [10, 20] {
        let command = random_tail(&mut random, TimeNs(0)).command_at(TimeNs::from_tick(tick));
        // A stop that is on the way already began before the command.
        let tail = random_tail(&mut random, TimeNs::from_tick(tick - 3));
        player.write(&command, &tail);
        assert_eq!(player.next_period(), None);
        for silent in 1..=600 {
            let expected = tail.command_at(TimeNs::from_tick(tick + silent));
            assert_eq!(player.next_period(), Some(expected));
        }
    }
}
