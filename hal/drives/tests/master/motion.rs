use super::*;
use hal::tail::{AxisPoint, AxisTail, TailPhase};
use trocar_canopen::bus_load::bits::duration_ns;
use trocar_canopen::cia402::PowerState;

#[test]
fn the_arm_follows_and_the_measurement_is_a_cycle_old() {
    for plan in [plan(1, 2 * MS), plan(3, MS)] {
        let mut bench = Bench::on(&plan);
        let step = 0.4 * trocar_canopen::number::seconds(plan.cycle_ns);
        let state = bench.cycles(200, step).unwrap();
        assert_eq!(bench.now.since(state.stamp), plan.cycle_ns);
        for axis in 0..6 {
            // Commanded in the cycle before the last, in effect from the SYNC on, reached a cycle
            // later.
            let behind = (bench.position[axis] - state.position[axis]) / step;
            assert!((2.0..4.0).contains(&behind), "{axis}: {behind}");
            // A SYNC may have to wait for a frame that is on the wire: 135 us of a cycle.
            assert!((state.velocity[axis] - 0.4).abs() < 0.06, "{axis}");
        }
        assert!(bench.arm.fault().is_none());
        let health = bench.arm.cycle().axis_health();
        assert!(
            health
                .iter()
                .all(|h| h.age_cycles == 0 && h.late == 0 && h.rejected == 0)
        );
    }
}

#[test]
fn the_bus_is_as_busy_as_the_plan_says() {
    let plan = plan(1, 2 * MS);
    let mut bench = Bench::on(&plan);
    let before = bench.net().wire(0).busy().0;
    let _ = bench.cycles(1000, 0.0005);
    let busy_ns = bench.net().wire(0).busy().0 - before;
    let load = plan.traffic(0).load();
    let bound = |bits: u64| duration_ns(u32::try_from(bits).unwrap(), plan.bit_rate) * 1000;
    assert!(
        busy_ns > bound(load.least),
        "{busy_ns} of at least {}",
        bound(load.least)
    );
    assert!(
        busy_ns < bound(load.most),
        "{busy_ns} of at most {}",
        bound(load.most)
    );
}

#[test]
fn in_actuator_space_the_arm_moves_its_joints() {
    let mut plan = plan(1, 2 * MS);
    plan.space = Space::Actuator;
    let mut bench = Bench::on(&plan);
    let start = bench.read().unwrap();
    bench.position[..6].copy_from_slice(start.position.as_slice());
    bench.position[6] = start.jaw_position;
    let state = bench.cycles(100, 0.0002).unwrap();
    for axis in 3..6 {
        assert!(
            (state.position[axis] - start.position[axis] - 0.02).abs() < 1e-3,
            "{axis}"
        );
    }
    let wanted = plan.space.from_joints(&bench.position);
    let _ = bench.cycles(5, 0.0);
    for (motor, wanted) in bench.motors().iter().zip(wanted) {
        assert!((motor - wanted).abs() < 1e-4);
    }
}

/// A stop of 20 ms from 0.4 units/s.
fn braking(command: &ArmCommand) -> SafeTail {
    let mut tail = SafeTail::hold(command);
    for (axis, place) in tail.axes.iter_mut().enumerate() {
        let position = if axis < 6 {
            command.position[axis]
        } else {
            command.jaw_position
        };
        // Deceleration grows for 10 ms and fades for 10 ms.
        *place = AxisTail {
            start: AxisPoint {
                position,
                velocity: 0.4,
                acceleration: 0.0,
            },
            phases: [(0.01, -4000.0), (0.01, 4000.0), (0.0, 0.0)]
                .map(|(duration_s, jerk)| TailPhase { duration_s, jerk }),
        };
    }
    tail
}

#[test]
fn a_controller_that_falls_silent_leaves_its_tail_to_be_played() {
    let mut bench = Bench::new();
    let mut command = bench.command();
    for _ in 0..100 {
        let _ = bench.cycle(0.0008);
        command = bench.command();
        bench.arm.write(&command, &braking(&command)).unwrap();
        bench.send();
    }
    let end = braking(&command).axes[0].end().position;
    // The bus goes on, the controller does not.
    for _ in 0..50 {
        assert!(bench.read().is_ok());
    }
    assert!(
        (bench.motors()[0] - end).abs() < 2e-5,
        "{} {end}",
        bench.motors()[0]
    );
    assert_eq!(bench.torques(), [true; TAIL_AXES]);
}

/// A command of no number is refused and the tail played instead.
#[test]
fn non_finite_command_plays_the_tail() {
    let mut bench = Bench::new();
    let _ = bench.cycles(10, 0.0);
    let before = bench.motors();
    for _ in 0..50 {
        let _ = bench.read();
        let mut command = bench.command();
        command.position[3] = f64::NAN;
        command.position[0] = 1.0;
        let _ = bench.arm.write(&command, &SafeTail::hold(&command));
        bench.send();
    }
    assert_eq!(bench.arm.refused(), 50);
    assert!(same(&bench.motors(), &before));
    assert!(bench.arm.fault().is_none());
}

#[test]
fn a_command_that_leaps_is_refused_and_the_tail_played_instead() {
    let mut bench = Bench::new();
    let _ = bench.cycles(10, 0.0);
    let before = bench.motors();
    bench.position[5] += 0.02;
    for refused in 1..=3 {
        // Twice the greatest speed for a cycle of 2 ms are 0.008.
        let _ = bench.cycle(0.0);
        assert_eq!(bench.arm.refused(), refused);
    }
    let _ = bench.read();
    assert!(same(&bench.motors(), &before));
    bench.position[5] -= 0.015;
    let _ = bench.cycles(5, 0.0);
    assert_eq!(bench.arm.refused(), 3);
    assert!((bench.motors()[5] - before[5] - 0.005).abs() < 1e-5);
    assert!(bench.arm.fault().is_none());
}

#[test]
fn periods_that_were_missed_are_periods_of_the_tail() {
    let mut bench = Bench::new();
    let mut command = bench.command();
    for _ in 0..20 {
        let _ = bench.cycle(0.0008);
        command = bench.command();
        bench.arm.write(&command, &braking(&command)).unwrap();
        bench.send();
    }
    // Four cycles late: the drives have gone on for one and slowed down.
    bench.dead_for(8 * MS);
    let _ = bench.read();
    let wanted = braking(&command).axes[0].at(0.008).position;
    let set_point = bench.arm.cycle().targets()[0];
    assert!((f64::from(set_point) / COUNTS - wanted).abs() < 1e-5);
}

#[test]
fn disabling_lets_go_and_only_the_controller_enables_again() {
    let mut bench = Bench::new();
    bench.enabled = false;
    let _ = bench.cycles(50, 0.0);
    assert_eq!(bench.torques(), [false; TAIL_AXES]);
    assert!(bench.cycle(0.0).is_ok());
    bench.enabled = true;
    let _ = bench.cycles(50, 0.0);
    let state = [Some(PowerState::OperationEnabled); TAIL_AXES];
    assert_eq!(bench.arm.cycle().states(), state);
}

/// When the process dies every drive rests within 50 ms of the last SYNC.
#[test]
fn drives_rest_within_50_ms_of_a_dead_process() {
    let mut bench = Bench::new();
    let _ = bench.cycles(200, 0.002);
    let moving = bench.motors();
    bench.dead_for(48 * MS);
    let rest = bench.motors();
    bench.dead_for(200 * MS);
    assert!(same(&bench.motors(), &rest));
    for (a, b) in moving.iter().zip(&rest) {
        assert!(b - a > 0.001 && b - a < 0.05, "{a} {b}");
    }
}

#[test]
fn a_sync_may_count_and_may_have_another_identifier() {
    for (id, counter) in [(0x80, 10), (0x100, 0), (0x100, 240)] {
        let mut plan = plan(1, 2 * MS);
        plan.sync_id = CanId::new(id).unwrap();
        plan.sync_counter = counter;
        let mut bench = Bench::on(&plan);
        let state = bench.cycles(300, 0.0004).unwrap();
        assert!((state.position[0] - 0.1 - 300.0 * 0.0004).abs() < 0.002);
        assert!(bench.arm.fault().is_none());
        // A SYNC that is not this arm's is nobody's business.
        let other = if id == 0x80 { 0x100 } else { 0x080 };
        bench.net().intrude(0, frame(other, &[]));
        assert!(bench.cycles(20, 0.0).is_ok());
    }
}

/// A controller twice as fast as the bus sends its newest command.
#[test]
fn faster_controller_sends_its_newest_command() {
    let mut bench = Bench::new();
    let _ = bench.cycles(5, 0.0);
    bench.cycle_ns = MS;
    let before = bench.net().wire(0).busy().1;
    let state = bench.cycles(1000, 0.0004).unwrap();
    let frames = bench.net().wire(0).busy().1 - before;
    // 500 SYNCs with fourteen frames each, and heartbeats.
    assert!((7500..7600).contains(&frames), "{frames}");
    let behind = (bench.position[0] - state.position[0]) / 0.0004;
    assert!((2.0..7.0).contains(&behind), "{behind}");
    let target = f64::from(bench.arm.cycle().targets()[0]) / COUNTS;
    assert!((target - bench.position[0]).abs() < 1e-4);
    assert!(bench.arm.fault().is_none());
    assert_eq!(bench.arm.cycle().axis_health()[0].missed, 0);
}

/// A controller that is faster than its bus does not make the bus faster.
#[test]
fn faster_controller_leaves_the_bus_cycle_as_it_is() {
    for cycle_ms in [1, 2, 4, 8] {
        let mut bench = Bench::on(&plan(3, cycle_ms * MS));
        bench.cycle_ns = MS;
        let (mut syncs, mut newest) = (0, bench.arm.cycle().sync());
        for _ in 0..80 {
            bench.cycle(0.0).unwrap();
            let sync = bench.arm.cycle().sync();
            syncs += u64::from(sync != newest);
            newest = sync;
        }
        assert_eq!(syncs, 80 / cycle_ms, "cycle of {cycle_ms} ms");
    }
}

/// What node 3 says on its way down, a state a line, and how long each lasted, ms.
fn taken_down(plan: &ArmPlan) -> (Vec<PowerState>, Vec<u64>) {
    let mut bench = Bench::on(plan);
    let _ = bench.cycles(100, 0.001);
    let _ = bench.cycles(50, 0.0);
    let end = bench.now.plus_ns(bench.arm.take_down_ns());
    let (mut states, mut lasted) = (Vec::new(), Vec::new());
    let mut down = false;
    while !down {
        assert!(bench.now < end, "{states:?}");
        bench.now = bench.now.plus_ns(MS);
        let now = bench.now;
        bench.arm.bus_mut().wait(now);
        down = bench.arm.take_down(now);
        let state = bench.net().node(node(2)).unwrap().power_state();
        if states.last() == Some(&state) {
            *lasted.last_mut().unwrap() += 1;
        } else {
            states.push(state);
            lasted.push(1);
        }
    }
    assert_eq!(bench.arm.fault(), None);
    assert_eq!(bench.torques(), [false; TAIL_AXES]);
    (states, lasted)
}

/// At the end each drive is taken down state by state and waits for its brake.
#[test]
fn take_down_passes_each_state_and_waits_for_the_brake() {
    let down = [
        PowerState::OperationEnabled,
        PowerState::SwitchedOn,
        PowerState::ReadyToSwitchOn,
        PowerState::SwitchOnDisabled,
    ];
    for brake_ms in [0, 150] {
        for mut plan in [plan(1, 2 * MS), plan(3, MS)] {
            plan.brake_ns = brake_ms * MS;
            let (states, lasted) = taken_down(&plan);
            assert_eq!(states, down);
            assert!(
                (brake_ms..brake_ms + 20).contains(&lasted[1]),
                "{brake_ms} ms: {lasted:?}"
            );
        }
    }
}

/// A controller that disables its arm in the middle of a run gives brakes their time too, though
/// set-points leave before the SYNC.
#[test]
fn a_disabled_arm_waits_for_its_brakes() {
    let mut plan = plan(1, 2 * MS);
    plan.brake_ns = 150 * MS;
    let mut bench = Bench::on(&plan);
    let _ = bench.cycles(50, 0.001);
    bench.enabled = false;
    let mut states: Vec<(PowerState, u64)> = Vec::new();
    for _ in 0..150 {
        let _ = bench.cycle(0.0);
        let state = bench.net().node(node(2)).unwrap().power_state();
        match states.last_mut() {
            Some((last, cycles)) if *last == state => *cycles += 1,
            _ => states.push((state, 1)),
        }
    }
    let order: Vec<PowerState> = states.iter().map(|(state, _)| *state).collect();
    let down = [
        PowerState::OperationEnabled,
        PowerState::SwitchedOn,
        PowerState::ReadyToSwitchOn,
        PowerState::SwitchOnDisabled,
    ];
    assert_eq!(order, down, "{states:?}");
    assert!((75..85).contains(&states[1].1), "{states:?}");
}

/// A node that fell silent is not waited for and the others go down.
#[test]
fn take_down_does_not_wait_for_a_silent_node() {
    let mut bench = Bench::new();
    let _ = bench.cycles(50, 0.0005);
    bench.net().power(node(4), false);
    let _ = bench.cycles(300, 0.0);
    assert!(bench.arm.fault().is_some());
    let end = bench.now.plus_ns(bench.arm.take_down_ns());
    loop {
        bench.now = bench.now.plus_ns(2 * MS);
        let now = bench.now;
        assert!(now < end);
        bench.arm.bus_mut().wait(now);
        if bench.arm.take_down(now) {
            break;
        }
    }
    // Nobody knows of the one that has no power.
    let torques = bench.torques();
    assert!((0..TAIL_AXES).all(|axis| axis == 4 || !torques[axis]));
}
