//! The limits of position that drives have and bring-up writes, against the mechanical stops of the
//! shipped arms.

use super::*;
use core::f64::consts::TAU;
use hal::config::Source;
use hal::psm::{ACTUATORS, COUPLING, JAW_MIN, STOP_MAX, STOP_MIN};
use trocar_canopen::cia301::Address;
use trocar_canopen::index;
use trocar_canopen::master::client::read;

/// What an axis reaches, from its least position to its greatest, rad (m).
type Reach = (f64, f64);

const POSITION_RANGE: [Address; 2] = [index::RANGE_MIN, index::RANGE_MAX];
const SOFTWARE_LIMIT: [Address; 2] = [index::LIMIT_MIN, index::LIMIT_MAX];

/// `factor` times what is reached.
fn times((low, high): Reach, factor: f64) -> Reach {
    let (a, b) = (low * factor, high * factor);
    (a.min(b), a.max(b))
}

fn plus((low, high): Reach, other: Reach) -> Reach {
    (low + other.0, high + other.1)
}

/// What the axes reach between the stops of their joints, jaw (actuators: two discs that move it)
/// last.
fn reach(space: Space, joints: [Reach; TAIL_AXES]) -> [Reach; TAIL_AXES] {
    let [yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw, jaw] = joints;
    if space == Space::Joint {
        return joints;
    }
    // The rows of the coupling, solved for the discs one after the other. Wrist yaw is half the sum
    // of two discs, and a share of the wrist's pitch; the jaw is their difference.
    let disc_1 = times(roll, 1.0 / COUPLING[0][0]);
    let disc_2 = times(wrist_pitch, 1.0 / COUPLING[1][1]);
    let sum = times(
        plus(wrist_yaw, times(disc_2, -COUPLING[2][1])),
        0.5 / COUPLING[2][2],
    );
    let disc_3 = plus(sum, times(jaw, 0.5 / COUPLING[3][2]));
    let disc_4 = plus(sum, times(jaw, 0.5 / COUPLING[3][3]));
    [yaw, pitch, insertion, disc_1, disc_2, disc_3, disc_4]
}

/// The arms of `config/can.toml`, whose drives count in `space`.
fn shipped(space: Space) -> Vec<ArmPlan> {
    let text = CanConfig::shipped().text().to_owned();
    let text = match space {
        Space::Joint => text,
        Space::Actuator => text.replacen("space = \"joint\"", "space = \"actuator\"", 1),
    };
    let config = CanConfig::load(&Source::embedded("can.toml", &text)).unwrap();
    assert!(config.arms.iter().all(|arm| arm.plan.space == space));
    config.arms.iter().map(|arm| arm.plan).collect()
}

/// The drives of `plan` as `trocar drives` emulates them: as they are built, or after bring-up.
fn drives(plan: &ArmPlan, brought_up: bool) -> Net {
    let network = || {
        let mut net = Network::new(plan.lines, plan.bit_rate, 64);
        for (axis, serial) in plan.axes.iter().zip(1..) {
            let node = Node::new(axis.node, &AxisConfig::of(axis, serial));
            net.add(axis.line, node, IdealMotor::default());
        }
        net
    };
    if !brought_up {
        let mut net = network();
        net.wait(TimeNs(100 * MS));
        return net;
    }
    let identified = Offline::new(network(), plan)
        .and_then(Offline::scan)
        .and_then(|arm| arm.check_identity());
    let mut homed = identified.unwrap().map().unwrap().home().unwrap();
    core::mem::replace(homed.bus_mut(), network())
}

/// The two ends of a range as the drive of `axis` answers them, rad (m).
fn ends(net: &mut Net, plan: &ArmPlan, axis: usize, objects: [Address; 2]) -> Reach {
    let motor = &ACTUATORS[axis];
    let who = plan.axes[axis];
    let [low, high] = objects.map(|object| {
        let data = read(net, who.line, who.node, object).unwrap();
        let counts = i32::from_le_bytes(data.as_slice().try_into().unwrap());
        f64::from(counts) * TAU / (motor.encoder_counts_per_turn * motor.gear_ratio)
    });
    (low, high)
}

/// 607Bh and 607Dh of every axis of both arms, in joint and in actuator space, before bring-up and
/// after it, lie within the mechanical stops and end less than a count before them. Only the jaw's
/// begin further down, by what presses closed fingers together.
#[test]
fn position_limits_lie_within_the_mechanical_stops() {
    let stops: [Reach; TAIL_AXES] = core::array::from_fn(|n| (STOP_MIN[n], STOP_MAX[n]));
    let mut pressed = stops;
    pressed[6].0 = JAW_MIN;
    for space in [Space::Joint, Space::Actuator] {
        let (stops, pressed) = (reach(space, stops), reach(space, pressed));
        let is_beyond = |&n: &usize| pressed[n].0 < stops[n].0 || pressed[n].1 > stops[n].1;
        let beyond: Vec<usize> = (0..TAIL_AXES).filter(is_beyond).collect();
        match space {
            Space::Joint => assert_eq!(beyond, [6]),
            // Both discs that move the jaw.
            Space::Actuator => assert_eq!(beyond, [5, 6]),
        }
        for plan in shipped(space) {
            for brought_up in [false, true] {
                let mut net = drives(&plan, brought_up);
                for (axis, (low, high)) in pressed.into_iter().enumerate() {
                    let motor = &ACTUATORS[axis];
                    let count = TAU / (motor.encoder_counts_per_turn * motor.gear_ratio);
                    for objects in [POSITION_RANGE, SOFTWARE_LIMIT] {
                        let (least, most) = ends(&mut net, &plan, axis, objects);
                        let spare = [least - low, high - most].map(|spare| spare / count);
                        assert!(
                            spare.iter().all(|spare| (-1e-6..1.0).contains(spare)),
                            "{space:?} {} node {}: {least} to {most}, stops at {low} and {high}",
                            objects[0],
                            plan.axes[axis].node
                        );
                    }
                }
            }
        }
    }
}
