//! Tests of what the simulated arm does when nobody commands it.

use core::f64::consts::TAU;

use hal::tail::{AxisPoint, AxisTail, TAIL_AXES, TailPhase};
use hal::{Arm, ArmCommand, ArmState, JOINT_COUNT, JointVector, SafeTail, TimeNs};

use super::{Rendering, Simulation};
use crate::task::TaskConfig;

/// How far each axis goes, rad (insertion m), jaw last.
const WAY: [f64; TAIL_AXES] = [0.1, -0.1, -0.02, 0.4, 0.3, -0.3, 0.3];
/// How long that takes, s.
const WAY_S: f64 = 0.5;
/// Time to bring the acceleration to zero, and then half the time to bring the velocity to zero, s.
const EASE_S: f64 = 0.02;
const HALF_BRAKE_S: f64 = 0.06;
/// Both together, ticks.
const STOP_TICKS: u64 = 140;
/// What the drives get to settle once the setpoint rests, ticks: the shipped gains bring yaw in
/// with 50 ms.
const SETTLE_TICKS: u64 = 200;

/// A driver that knows where it wants to go and how to stop on the way.
struct Driver {
    simulation: Simulation,
    start: [f64; TAIL_AXES],
    tick: u64,
}

impl Driver {
    fn new() -> Self {
        let task = TaskConfig::shipped("needle-lift");
        let mut simulation = Simulation::new(&task, 0, Rendering::Off).unwrap();
        let found = simulation.read(TimeNs(0)).unwrap();
        Self {
            simulation,
            start: axes(&found.position, found.jaw_position),
            tick: 0,
        }
    }

    /// The stop from where the motion is at `tick`, whose first point is the command.
    fn tail(&self, tick: u64) -> SafeTail {
        let stamp = TimeNs::from_tick(tick);
        let share = stamp.seconds() / WAY_S;
        SafeTail {
            stamp,
            axes: core::array::from_fn(|axis| {
                let way = WAY[axis];
                stop(AxisPoint {
                    position: self.start[axis] + way * (share - (TAU * share).sin() / TAU),
                    velocity: way / WAY_S * (1.0 - (TAU * share).cos()),
                    acceleration: way / (WAY_S * WAY_S) * TAU * (TAU * share).sin(),
                })
            }),
            enabled: true,
        }
    }

    /// Goes along for `ticks`; gives the last tail.
    fn go(&mut self, ticks: u64) -> SafeTail {
        for tick in self.tick..self.tick + ticks {
            let tail = self.tail(tick);
            self.simulation
                .write(&tail.command_at(tail.stamp), &tail)
                .unwrap();
            self.simulation.step();
        }
        self.tick += ticks;
        self.tail(self.tick - 1)
    }

    /// Steps without a word, and reads.
    fn silent(&mut self) -> ArmState {
        self.simulation.step();
        self.tick += 1;
        self.simulation.read(TimeNs::from_tick(self.tick)).unwrap()
    }
}

/// First the acceleration goes, then the velocity.
fn stop(start: AxisPoint) -> AxisTail {
    let coasting = start.velocity + start.acceleration * EASE_S / 2.0;
    let jerk = coasting / (HALF_BRAKE_S * HALF_BRAKE_S);
    let phase = |duration_s, jerk| TailPhase { duration_s, jerk };
    AxisTail {
        start,
        phases: [
            phase(EASE_S, -start.acceleration / EASE_S),
            phase(HALF_BRAKE_S, -jerk),
            phase(HALF_BRAKE_S, jerk),
        ],
    }
}

fn axes(joints: &JointVector, jaw: f64) -> [f64; TAIL_AXES] {
    core::array::from_fn(|axis| {
        if axis < JOINT_COUNT {
            joints[axis]
        } else {
            jaw
        }
    })
}

fn positions(state: &ArmState) -> [f64; TAIL_AXES] {
    axes(&state.position, state.jaw_position)
}

fn velocities(state: &ArmState) -> [f64; TAIL_AXES] {
    axes(&state.velocity, state.jaw_velocity)
}

/// Whether the drives have what `command` says.
fn follows(simulation: &Simulation, command: &ArmCommand) -> bool {
    let (position, velocity, enabled) = simulation.world.setpoint(0);
    let wanted = axes(&command.position, command.jaw_position);
    let wanted_velocity = axes(&command.velocity, command.jaw_velocity);
    let near = |got: &[f64], wanted: &[f64]| {
        got.iter()
            .zip(wanted)
            .all(|(got, wanted)| (got - wanted).abs() < 1e-12)
    };
    near(&position, &wanted) && near(&velocity, &wanted_velocity) && enabled == command.enabled
}

/// Highest speed of an axis on its way.
fn peak_speed(axis: usize) -> f64 {
    2.0 * WAY[axis].abs() / WAY_S
}

/// Highest acceleration of an axis on its stop: that of a knot.
fn peak_acceleration(tail: &AxisTail) -> f64 {
    [0.0, EASE_S, EASE_S + HALF_BRAKE_S]
        .map(|knot_s| tail.at(knot_s).acceleration.abs())
        .into_iter()
        .fold(0.0, f64::max)
}

#[test]
fn silent_driver_leaves_a_smooth_stop() {
    // While it speeds up, at its fastest, and while it slows down.
    for ticks in [125, 200, 250, 300] {
        let mut driver = Driver::new();
        let tail = driver.go(ticks);
        let mut before = driver.simulation.read(tail.stamp).unwrap();
        let moving = velocities(&before);
        let rest = tail.command_at(TimeNs(u64::MAX));
        let rest = axes(&rest.position, rest.jaw_position);
        for silent in 1..=STOP_TICKS + SETTLE_TICKS {
            let state = driver.silent();
            let expected = tail.command_at(TimeNs::from_tick(ticks - 1 + silent));
            assert!(
                follows(&driver.simulation, &expected),
                "{silent} after {ticks}"
            );
            for (axis, &before) in velocities(&before).iter().enumerate() {
                let acceleration = (velocities(&state)[axis] - before) / 1e-3;
                // The drives lag behind and stick; a fifth is what that adds.
                let bound = 1.2 * peak_acceleration(&tail.axes[axis]);
                assert!(
                    acceleration.abs() <= bound,
                    "axis {axis}, {silent} after {ticks}: {acceleration} of {bound}"
                );
            }
            before = state;
        }
        for axis in 0..TAIL_AXES {
            let slow = 0.005 * peak_speed(axis);
            assert!(moving[axis].abs() > 50.0 * slow, "axis {axis} at {ticks}");
            let (position, velocity) = (positions(&before)[axis], velocities(&before)[axis]);
            assert!(velocity.abs() < slow, "axis {axis} at {ticks}: {velocity}");
            let off = (position - rest[axis]).abs();
            assert!(
                off < 0.01 * WAY[axis].abs(),
                "axis {axis} at {ticks}: {off}"
            );
        }
    }
}

#[test]
fn stopped_arm_holds_for_good() {
    let mut driver = Driver::new();
    let tail = driver.go(250);
    for _ in 0..STOP_TICKS + SETTLE_TICKS {
        driver.silent();
    }
    let stopped = positions(&driver.silent());
    let rest = tail.command_at(TimeNs(u64::MAX));
    for tick in 0..2_000 {
        let state = driver.silent();
        assert!(follows(&driver.simulation, &rest), "tick {tick}");
        for axis in 0..TAIL_AXES {
            let off = (positions(&state)[axis] - stopped[axis]).abs();
            assert!(
                off < 0.005 * WAY[axis].abs(),
                "axis {axis}, tick {tick}: {off}"
            );
        }
    }
}

#[test]
fn next_command_takes_over_wherever_the_stop_is() {
    for silence in [1, 3, 50, 500] {
        let mut driver = Driver::new();
        let tail = driver.go(250);
        for _ in 0..silence {
            driver.silent();
        }
        let stamp = TimeNs::from_tick(driver.tick);
        let next = SafeTail {
            stamp,
            ..SafeTail::hold(&tail.command_at(stamp))
        };
        let command = next.command_at(stamp);
        driver.simulation.write(&command, &next).unwrap();
        driver.silent();
        assert!(follows(&driver.simulation, &command));
        driver.silent();
        assert!(follows(&driver.simulation, &command));
    }
}

#[test]
fn unheard_arm_holds_what_it_was_found_at() {
    let mut driver = Driver::new();
    let found = driver.simulation.world.setpoint(0);
    for _ in 0..300 {
        let state = driver.silent();
        assert_eq!(driver.simulation.world.setpoint(0), found);
        for (axis, position) in positions(&state).iter().enumerate() {
            assert!((position - driver.start[axis]).abs() < 1e-3 * WAY[axis].abs());
        }
    }
}

#[test]
fn arm_without_torque_stays_without_it() {
    let mut driver = Driver::new();
    driver.go(500);
    for _ in 0..SETTLE_TICKS {
        driver.silent();
    }
    let limp = positions(&driver.silent());
    // Away from where it is: drives that were on would go there.
    let tail = SafeTail::at_rest(TimeNs::from_tick(driver.tick), &driver.start, false);
    let command = tail.command_at(tail.stamp);
    driver.simulation.write(&command, &tail).unwrap();
    for tick in 0..1_000 {
        let state = driver.silent();
        assert!(follows(&driver.simulation, &command), "tick {tick}");
        assert_eq!((state.effort.norm(), state.jaw_effort), (0.0, 0.0));
        for axis in 0..TAIL_AXES {
            let off = (positions(&state)[axis] - limp[axis]).abs();
            assert!(off < 0.005 * WAY[axis].abs(), "axis {axis}: {off}");
        }
    }
}

#[test]
fn tail_changes_nothing_while_every_step_has_its_command() {
    let drive = |enabled| {
        let mut driver = Driver::new();
        for tick in 0..300 {
            let stop = driver.tail(tick);
            let command = stop.command_at(stop.stamp);
            let other = SafeTail::at_rest(stop.stamp, &[0.3; TAIL_AXES], false);
            let tail = if enabled { stop } else { other };
            driver.simulation.write(&command, &tail).unwrap();
            driver.simulation.step();
        }
        let commanded = driver.simulation.state_hash();
        driver.simulation.step();
        (commanded, driver.simulation.state_hash())
    };
    let (stop, other) = (drive(true), drive(false));
    assert_eq!(stop.0, other.0);
    assert_ne!(stop.1, other.1);
}
