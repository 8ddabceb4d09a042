//! Bring-up of slow drives, and homing sequences in which an axis moves.

use std::cell::RefCell;
use std::rc::Rc;

use super::*;
use trocar_canopen::master::plan::HomingPlan;

/// To the negative limit switch, which is at -5 units by an encoder that reads 0 wherever it was
/// switched on.
fn to_limit_switch(axis: u8) -> HomingPlan {
    HomingPlan {
        axis,
        method: 17,
        home_position: -4.0,
        switch_speed: 1.0,
        zero_speed: 0.05,
        acceleration: 20.0,
        time_out_ns: 20_000 * MS,
    }
}

fn homing(sequences: &[HomingPlan]) -> ArmPlan {
    let mut plan = plan(1, 2 * MS);
    for (place, sequence) in plan.homing.iter_mut().zip(sequences) {
        *place = Some(*sequence);
    }
    plan
}

fn bring_up(net: Net, plan: &ArmPlan) -> Result<Bench, BringUpError> {
    let scanned = Offline::new(net, plan)?.scan()?;
    let homed = scanned.check_identity()?.map()?.home()?;
    Ok(Bench::of(homed.enable()?, plan))
}

/// Why the arm does not come up; whether it has torque half a second later, and where its motors
/// have come to, units.
fn refused(net: Net, plan: &ArmPlan) -> (String, bool, [f64; TAIL_AXES]) {
    refused_or_cancelled(net, plan, || false)
}

/// The same, of one whose homing is cancelled as soon as `cancelled` says so.
fn refused_or_cancelled(
    net: Net,
    plan: &ArmPlan,
    cancelled: fn() -> bool,
) -> (String, bool, [f64; TAIL_AXES]) {
    let net = Rc::new(RefCell::new(net));
    let offline = Offline::new(Shared(Rc::clone(&net)), plan).unwrap();
    let scanned = offline.cancelled_by(cancelled).scan();
    let mapped = scanned.unwrap().check_identity().unwrap().map().unwrap();
    let error = mapped.home().map(|_| ()).unwrap_err().to_string();
    let mut net = net.borrow_mut();
    let rest = net.now().plus_ns(500 * MS);
    net.advance(rest);
    let torque = |axis| net.node(node(axis)).unwrap().power_state().has_torque();
    let torque = (0..TAIL_AXES).any(torque);
    let motors = core::array::from_fn(|axis| net.motor(node(axis)).unwrap().position_counts);
    let later = rest.plus_ns(500 * MS);
    net.advance(later);
    for (axis, at) in motors.iter().enumerate() {
        let motor = net.motor(node(axis)).unwrap();
        assert!(
            (motor.position_counts - at).abs() < 1e-9,
            "axis {axis} moves"
        );
    }
    (error, torque, motors.map(|counts| counts / COUNTS))
}

/// Buses that a test looks at afterwards.
struct Shared(Rc<RefCell<Net>>);

impl Bus for Shared {
    fn now(&self) -> TimeNs {
        self.0.borrow().now()
    }

    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        self.0.borrow_mut().send(line, frames)
    }

    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        self.0.borrow_mut().receive(line, sink);
    }

    fn flush(&mut self, line: u8) {
        self.0.borrow_mut().flush(line);
    }

    fn wait(&mut self, until: TimeNs) {
        self.0.borrow_mut().advance(until);
    }
}

/// Seven drives that take 200 ms for each answer come up in the time of one, not of seven.
#[test]
fn slow_drives_are_set_up_side_by_side() {
    const ANSWER_NS: u64 = 200 * MS;
    let plan = plan(1, 2 * MS);
    let mut net = network(&plan);
    let answers = Rc::new(RefCell::new([0_u64; TAIL_AXES]));
    let counted = Rc::clone(&answers);
    net.tamper(Box::new(move |_, _, heard| match heard.id.raw() {
        id @ 0x581..=0x587 => {
            counted.borrow_mut()[usize::from(id - 0x581)] += 1;
            Tampering::Delay(ANSWER_NS)
        }
        _ => Tampering::Pass,
    }));
    let began = net.now();
    let mut bench = bring_up(net, &plan).unwrap();
    let took_ns = bench.net().now().since(began);
    let answers = answers.borrow();
    let slowest = *answers.iter().max().unwrap();
    let all: u64 = answers.iter().sum();
    // An answer, and the time until it is looked at and the next question is asked.
    let one_by_one = all * ANSWER_NS;
    assert!(
        took_ns < slowest * (ANSWER_NS + 5 * MS) + 500 * MS,
        "{took_ns}"
    );
    assert!(took_ns * 6 < one_by_one, "{took_ns} of {one_by_one}");
    assert_eq!(bench.torques(), [true; TAIL_AXES]);
}

#[test]
fn axes_find_their_home_at_a_limit_switch() {
    for (method, home, end) in [(17, -4.0, -5.0), (18, 4.5, 5.0)] {
        let sequence = HomingPlan {
            method,
            home_position: home,
            ..to_limit_switch(2)
        };
        let plan = homing(&[sequence]);
        let mut bench = bring_up(network(&plan), &plan).unwrap();
        // Just off the switch, and called what the plan calls it.
        let motors = bench.motors();
        assert!((motors[2] - end).abs() < 0.005, "{motors:?}");
        for axis in [0, 1, 3, 4, 5, 6] {
            assert!(
                (motors[axis] - bench.position[axis]).abs() < 1e-4,
                "{motors:?}"
            );
        }
        bench.position[2] = home;
        let state = bench.cycles(5, 0.0).unwrap();
        assert!(
            (state.position[2] - home).abs() < 0.005,
            "{}",
            state.position[2]
        );
        assert_eq!(bench.torques(), [true; TAIL_AXES]);
    }
}

/// The order of the plan, not of the axes: an instrument has to be out before its arm turns.
#[test]
fn axes_move_one_after_the_other_in_the_order_of_the_plan() {
    let plan = homing(&[to_limit_switch(4), to_limit_switch(1)]);
    let mut net = network(&plan);
    let seen = Rc::new(RefCell::new(Vec::new()));
    let noted = Rc::clone(&seen);
    net.tamper(Box::new(move |_, _, heard| {
        // A control word with bit 4: homing begins.
        let starts = matches!(heard.data(), [control, ..] if control & 0x10 != 0);
        if matches!(heard.id.raw(), 0x202 | 0x205) && starts {
            let mut noted = noted.borrow_mut();
            if noted.last() != Some(&heard.id.raw()) {
                noted.push(heard.id.raw());
            }
        }
        Tampering::Pass
    }));
    bring_up(net, &plan).unwrap();
    assert_eq!(*seen.borrow(), [0x205, 0x202]);
}

#[test]
fn homing_error_is_named_and_the_axis_stops() {
    let plan = homing(&[to_limit_switch(2)]);
    let mut net = network(&plan);
    let mut moving = 0;
    net.tamper(Box::new(move |_, _, heard| {
        match (heard.id.raw(), heard.data()) {
            // While it moves, its status word says that it can't.
            (0x583, [0x4B, 0x41, 0x60, 0, low, high, ..]) if *low == 0x37 && high & 0x10 == 0 => {
                moving += 1;
                if moving < 50 {
                    return Tampering::Pass;
                }
                let data = [0x4B, 0x41, 0x60, 0, *low, high | 0x20, 0, 0];
                Tampering::Replace(frame(0x583, &data))
            }
            _ => Tampering::Pass,
        }
    }));
    let (error, torque, motors) = refused(net, &plan);
    let named = "node 3 (axis 2, bus 0): homing error, status word 0x2";
    assert!(error.starts_with(named) && !torque, "{error}");
    // On its way, and not at its end.
    assert!(-4.9 < motors[2] && motors[2] < 0.25, "{motors:?}");
}

#[test]
fn homing_that_takes_too_long_is_stopped() {
    let plan = homing(&[HomingPlan {
        switch_speed: 0.2,
        time_out_ns: 1500 * MS,
        ..to_limit_switch(2)
    }]);
    let (error, torque, motors) = refused(network(&plan), &plan);
    let named = "node 3 (axis 2, bus 0): homing not complete after 1.5 s, status word 0x";
    assert!(error.starts_with(named) && !torque, "{error}");
    // 0.2 units/s for 1.5 s and what it takes to notice.
    assert!((-0.1..0.02).contains(&motors[2]), "{motors:?}");
}

#[test]
fn homing_method_that_a_drive_lacks_is_refused_before_it_moves() {
    let plan = homing(&[HomingPlan {
        method: 23,
        ..to_limit_switch(2)
    }]);
    let (error, torque, motors) = refused(network(&plan), &plan);
    let named = "node 3 (axis 2, bus 0): does not offer homing method 23";
    assert!(error == named && !torque, "{error}");
    assert!((motors[2] - 0.3).abs() < 1e-4, "{motors:?}");
}

/// A motor that is blocked on the way is a following error of its drive, which bring-up names.
#[test]
fn blocked_axis_ends_its_homing_with_the_drives_fault() {
    let plan = homing(&[to_limit_switch(2)]);
    let mut net = network(&plan);
    net.motor(node(2)).unwrap().stuck = true;
    let (error, torque, _) = refused(net, &plan);
    // Its emergency comes first.
    assert!(
        error.contains("node 3 (axis 2, bus 0): emergency 8611h"),
        "{error}"
    );
    assert!(error.ends_with("while axis 2 moved for its homing") && !torque);
}

#[test]
fn cancelled_homing_stops_the_axis() {
    let sequence = to_limit_switch(2);
    let plan = homing(&[sequence]);
    let (error, torque, motors) = refused_or_cancelled(network(&plan), &plan, || true);
    assert!(error.contains("homing was cancelled"), "{error}");
    assert!(!torque && motors[2] > -4.9, "{motors:?}");
}
