//! Arbitrary frames: no panic, a bounded answer, and a motor that stays where it may be.

use super::*;
use crate::can::random::Random;

/// Identifiers that mean something to node 5, so that more than one frame in 2048 is heard.
const HEARD: [u16; 10] = [
    0x000, 0x080, 0x205, 0x305, 0x405, 0x505, 0x605, 0x605, 0x701, 0x705,
];

/// Objects that change most.
const TOUCHED: [u16; 16] = [
    0x1005, 0x1016, 0x1017, 0x1019, 0x1029, 0x1400, 0x1600, 0x1800, 0x1A00, 0x6007, 0x6040, 0x605A,
    0x6060, 0x607A, 0x607C, 0x60C2,
];

/// Control words on the way to enabled.
const CONTROLS: [u8; 8] = [0x00, 0x02, 0x06, 0x07, 0x0F, 0x0F, 0x1F, 0x80];

/// What a master would say, most of the time, so that the axis moves.
fn frame(random: &mut Random) -> Frame {
    match random.below(16) {
        0..=5 => Frame::new(CanId::new(0x080).unwrap(), Payload::EMPTY),
        6..=11 => {
            let [_, _, a, b, c, d, ..] = random.next().to_le_bytes();
            // Often within the range, sometimes anywhere.
            let wide = random.below(4) == 0;
            let high = if wide { [c, d] } else { [c % 8, 0] };
            let data = [0x0F, 0, a, b, high[0], high[1]];
            Frame::new(CanId::new(0x205).unwrap(), Payload::truncated(&data))
        }
        _ => nonsense(random),
    }
}

fn nonsense(random: &mut Random) -> Frame {
    if random.below(4) == 0 {
        return random.frame();
    }
    let id = CanId::new(random.pick(&HEARD)).unwrap();
    let payload = random.payload();
    match id.raw() {
        // Otherwise hardly any NMT command means something.
        0x000 => {
            let command = random.pick(&[0x01, 0x01, 0x01, 0x02, 0x80, 0x81, 0x82]);
            let node = random.pick(&[0, 5, 5, 9]);
            Frame::new(id, Payload::truncated(&[command, node]))
        }
        0x080 if random.below(8) > 0 => Frame::new(id, Payload::EMPTY),
        0x205..=0x505 if random.below(2) == 0 => {
            let [_, _, rest @ ..] = random.next().to_le_bytes();
            let mut data = [random.pick(&CONTROLS), 0, 0, 0, 0, 0, 0, 0];
            data[2..].copy_from_slice(&rest);
            Frame::new(id, Payload::truncated(&data[..6]))
        }
        0x605 if random.below(4) > 0 => {
            let [low, high] = random.pick(&TOUCHED).to_le_bytes();
            let command = random.pick(&[0x40, 0x2F, 0x2B, 0x23, 0x60, 0x70, 0x21]);
            let sub = random.pick(&[0, 0, 1, 2, 3]);
            let [a, b, c, d, ..] = random.next().to_le_bytes();
            let first = random.pick(&[a, 0, 1, 6, 8, 0x0F]);
            Frame::new(id, Payload::full([command, low, high, sub, first, b, c, d]))
        }
        _ => Frame::new(id, payload),
    }
}

/// Throws `count` frames at nodes that are on their way; gives how often the motor was enabled and how far it went.
fn throw(seed: u64, count: u32) -> (u32, f64) {
    let mut random = Random::new(seed);
    let (mut enabled, mut travelled) = (0, 0.0);
    let mut bench = Bench::enabled();
    let config = AxisConfig::default();
    let mut before = bench.node.demand(bench.now);
    for n in 0..count {
        if n % 500 == 0 {
            bench = Bench::enabled();
            before = bench.node.demand(bench.now);
        }
        let frame = frame(&mut random);
        bench.node.on_frame(bench.now, &frame, &mut bench.out);
        let step_ns = random.below(1_000_000);
        bench.now = bench.now.plus_ns(step_ns);
        bench.node.on_time(bench.now, &mut bench.out);
        assert!(
            bench.out.frames().len() <= 16 && bench.out.lost() == 0,
            "{seed} {n}"
        );
        bench.out.clear();
        let demand = bench.node.demand(bench.now);
        let (low, high) = (f64::from(config.range.0), f64::from(config.range.1));
        let position = demand.position_counts;
        assert!((low..=high).contains(&position), "{seed} {n}: {position}");
        let step = (position - before.position_counts).abs();
        let reach = f64::from(config.speed_max) * crate::can::number::seconds(step_ns);
        assert!(
            step <= reach + 1e-3,
            "{seed} {n} {frame}: {step} of {reach}"
        );
        if demand.torque {
            enabled += 1;
            travelled += step;
        }
        before = demand;
        bench.node.feedback(Feedback {
            position_counts: position,
            velocity_counts_s: demand.velocity_counts_s,
            torque_per_mille: 0.0,
        });
    }
    (enabled, travelled)
}

#[test]
fn arbitrary_frames_never_panic_nor_move_the_axis_outside_its_limits() {
    let (enabled, travelled) = throw(1, 100_000);
    // It is no test if the axis never moves.
    assert!(enabled > 10_000 && travelled > 1e6, "{enabled} {travelled}");
}

#[test]
#[ignore = "ten million frames: a minute in a release build"]
fn ten_million_arbitrary_frames_never_move_the_axis_outside_its_limits() {
    for seed in 100..200 {
        throw(seed, 100_000);
    }
}
