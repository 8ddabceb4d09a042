//! What holds for every arm: stops that it finishes alone, nonsense that it refuses, torque that it
//! gives up.

use hal::tail::{AxisTail, TAIL_AXES, TailPhase};
use hal::{ArmCommand, SafeTail, TimeNs};

use crate::facts::Fact;
use crate::rig::{Driver, Make, STOP_NS, WAY, assert_near, positions};

/// All of them.
pub(crate) const STOPS: [Fact; 8] = [
    ("silence", silence_leaves_the_stop_to_be_played_and_held),
    (
        "after silence",
        a_command_after_silence_goes_on_from_the_stop,
    ),
    ("no numbers", what_is_no_number_moves_nothing),
    (
        "no numbers, moving",
        what_is_no_number_is_a_period_of_the_stop,
    ),
    (
        "disabled",
        a_disabled_arm_goes_nowhere_until_a_command_enables_it,
    ),
    ("a disabled tail", a_tail_that_is_disabled_lets_go),
    ("a tail of a disabled arm", a_disabled_tail_never_enables),
    (
        "the same again",
        the_same_commands_give_the_same_measurements,
    ),
];

/// Where `tail` comes to rest.
fn rest(tail: &SafeTail) -> [f64; TAIL_AXES] {
    tail.axes.map(|axis| axis.end().position)
}

/// After a stop that ends at `wanted`: it is there, and stays.
fn assert_rests(driver: &mut Driver, wanted: &[f64; TAIL_AXES], when: &str) {
    let settled = driver.silent(driver.periods(driver.nature.settle_ns));
    assert_near(&positions(&settled), wanted, 0.02, when);
    for _ in 0..driver.periods(500_000_000) {
        let state = driver.silent(1);
        assert_near(&positions(&state), &positions(&settled), 0.005, when);
    }
}

fn silence_leaves_the_stop_to_be_played_and_held(make: Make<'_>) {
    // While it speeds up, at its fastest, and while it slows down.
    for ms in [126, 250, 300] {
        let when = format!("silent after {ms} ms");
        let mut driver = Driver::new(make);
        let (before, tail) = driver.go(ms * 1_000_000);
        let mut before = positions(&before);
        let begun = before;
        for _ in 0..driver.periods(STOP_NS) {
            let now = positions(&driver.silent(1));
            for axis in 0..TAIL_AXES {
                // On it goes, never back, but for what a drive overshoots.
                let forward = (now[axis] - before[axis]) * WAY[axis].signum();
                assert!(forward > -0.002 * WAY[axis].abs(), "{when}: axis {axis}");
            }
            before = now;
        }
        assert_rests(&mut driver, &rest(&tail), &when);
        for axis in 0..TAIL_AXES {
            let stopping_way = (rest(&tail)[axis] - begun[axis]) / WAY[axis];
            assert!(
                stopping_way > 0.05,
                "{when}: it is no test without a way to go"
            );
        }
    }
}

fn a_command_after_silence_goes_on_from_the_stop(make: Make<'_>) {
    for silence_ms in [2, 10, 50, 500] {
        let mut driver = Driver::new(make);
        let (_, tail) = driver.go(250_000_000);
        let count = driver.periods(silence_ms * 1_000_000);
        let _ = driver.silent(count);
        for _ in 0..driver.periods(STOP_NS) {
            let now = driver.rig.now();
            let since_s = TimeNs(now.since(tail.stamp)).seconds();
            let rest_of_it = SafeTail {
                stamp: now,
                axes: tail.axes.map(|axis| axis.remainder(since_s)),
                enabled: true,
            };
            let command = rest_of_it.command_at(now);
            driver.period(Some((command, rest_of_it))).unwrap();
        }
        let when = format!("after {silence_ms} ms of silence");
        assert_rests(&mut driver, &rest(&tail), &when);
        // And from there it takes commands as before.
        driver.depart_from(rest(&tail), WAY);
        let wanted = core::array::from_fn(|axis| rest(&tail)[axis] + WAY[axis]);
        assert_near(&positions(&driver.arrive()), &wanted, 0.02, &when);
    }
}

/// Ways to put `value` into a command or its tail.
const NONSENSE: [fn(&mut ArmCommand, &mut SafeTail, f64); 12] = [
    |command, _, value| command.position[0] = value,
    |command, _, value| command.position[5] = value,
    |command, _, value| command.velocity[2] = value,
    |command, _, value| command.acceleration[4] = value,
    |command, _, value| command.jaw_position = value,
    |command, _, value| command.jaw_velocity = value,
    |_, tail, value| tail.axes[0].start.position = value,
    |_, tail, value| tail.axes[3].start.velocity = value,
    |_, tail, value| tail.axes[6].start.acceleration = value,
    |_, tail, value| tail.axes[1].phases[0].duration_s = value,
    |_, tail, value| tail.axes[2].phases[2].jerk = value,
    |command, tail, value| {
        command.position.fill(value);
        command.velocity.fill(value);
        tail.axes[5] = AxisTail::at_rest(value);
    },
];

const NO_NUMBERS: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];

fn what_is_no_number_moves_nothing(make: Make<'_>) {
    let mut driver = Driver::new(make);
    let stands = positions(&driver.arrive());
    for (n, nonsense) in NONSENSE.iter().enumerate() {
        for value in NO_NUMBERS {
            for _ in 0..3 {
                let state = driver.say(|command, tail| nonsense(command, tail, value));
                assert!(state.is_finite(), "{value} in {n}");
                assert_near(&positions(&state), &stands, 0.005, "nonsense");
            }
        }
    }
    // It still obeys.
    driver.depart(WAY);
    let wanted = core::array::from_fn(|axis| driver.found[axis] + 2.0 * WAY[axis]);
    assert_near(
        &positions(&driver.arrive()),
        &wanted,
        0.02,
        "after nonsense",
    );
}

fn what_is_no_number_is_a_period_of_the_stop(make: Make<'_>) {
    let mut driver = Driver::new(make);
    let (_, tail) = driver.go(250_000_000);
    for n in 0..driver.periods(STOP_NS + 50_000_000) {
        let n = usize::try_from(n).unwrap();
        let nonsense = NONSENSE[n % NONSENSE.len()];
        let value = NO_NUMBERS[n % NO_NUMBERS.len()];
        let _ = driver.say(|command, tail| nonsense(command, tail, value));
    }
    assert_rests(&mut driver, &rest(&tail), "nonsense while moving");
}

/// A tail that begins where `command` is and runs away as fast as it may, a tenth of the way in 100
/// ms.
fn runaway(command: &ArmCommand, enabled: bool) -> SafeTail {
    let mut tail = SafeTail::hold(command);
    tail.enabled = enabled;
    for (axis, way) in tail.axes.iter_mut().zip(WAY) {
        let jerk = 600.0 * way;
        axis.phases = [(0.1, jerk), (0.0, 0.0), (0.0, 0.0)]
            .map(|(duration_s, jerk)| TailPhase { duration_s, jerk });
    }
    tail
}

fn a_disabled_arm_goes_nowhere_until_a_command_enables_it(make: Make<'_>) {
    let mut driver = Driver::new(make);
    let limp = positions(&driver.arrive());
    // Away from where it is: drives that were on would go there.
    let elsewhere = driver.found;
    for _ in 0..driver.periods(200_000_000) {
        let tail = SafeTail::at_rest(driver.rig.now(), &elsewhere, false);
        let state = driver
            .period(Some((tail.command_at(tail.stamp), tail)))
            .unwrap();
        assert_near(&positions(&state), &limp, 0.01, "disabled");
    }
    for _ in 0..driver.periods(200_000_000) {
        let state = driver.silent(1);
        assert_near(&positions(&state), &limp, 0.01, "disabled and silent");
    }
    let stands = positions(&driver.silent(1));
    driver.depart_from(stands, [0.0; TAIL_AXES]);
    let _ = driver.go(200_000_000);
    driver.depart_from(stands, WAY);
    let wanted = core::array::from_fn(|axis| stands[axis] + WAY[axis]);
    assert_near(&positions(&driver.arrive()), &wanted, 0.02, "enabled again");
}

fn a_tail_that_is_disabled_lets_go(make: Make<'_>) {
    let mut driver = Driver::new(make);
    let stands = positions(&driver.arrive());
    let (command, _) = driver.set_point();
    let tail = runaway(&command, false);
    let _ = driver.period(Some((command, tail)));
    for _ in 0..driver.periods(300_000_000) {
        let state = driver.silent(1);
        assert_near(&positions(&state), &stands, 0.02, "let go");
    }
}

fn a_disabled_tail_never_enables(make: Make<'_>) {
    let mut driver = Driver::new(make);
    let stands = positions(&driver.arrive());
    for _ in 0..driver.periods(50_000_000) {
        let (mut command, _) = driver.set_point();
        command.enabled = false;
        let tail = runaway(&command, false);
        let _ = driver.period(Some((command, tail)));
    }
    for _ in 0..driver.periods(300_000_000) {
        let state = driver.silent(1);
        assert_near(&positions(&state), &stands, 0.01, "disabled");
    }
}

fn the_same_commands_give_the_same_measurements(make: Make<'_>) {
    let run = || {
        let mut driver = Driver::new(make);
        let mut states = Vec::new();
        for n in 0..driver.periods(700_000_000) {
            let said = driver.set_point();
            states.push(driver.period((n % 50 != 7).then_some(said)));
        }
        states
    };
    assert_eq!(run(), run());
}
