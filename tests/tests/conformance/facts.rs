//! What holds for every arm: measurements, units, motion.

use std::collections::BTreeSet;

use hal::ArmState;
use hal::tail::TAIL_AXES;

use crate::rig::{Axes, Driver, Make, WAY, WAY_S, assert_near, positions, velocities};

/// A test of one behaviour.
pub(crate) type Fact = (&'static str, fn(Make<'_>));

/// All of them.
pub(crate) const FACTS: [Fact; 5] = [
    ("holds where it was found", holds_where_it_was_found),
    ("stamps", stamps_never_run_ahead_nor_back),
    (
        "a second read",
        a_second_read_gives_the_same_and_changes_nothing,
    ),
    (
        "axes and units",
        each_axis_goes_where_it_is_told_in_its_own_unit,
    ),
    ("velocities", velocity_is_the_rate_of_the_position),
];

fn holds_where_it_was_found(make: Make<'_>) {
    let mut driver = Driver::new(make);
    for _ in 0..driver.periods(300_000_000) {
        let state = driver.silent(1);
        assert_near(&positions(&state), &driver.found, 0.005, "unheard");
        assert!(state.is_finite() && state.impossible().is_none());
    }
}

fn stamps_never_run_ahead_nor_back(make: Make<'_>) {
    let mut driver = Driver::new(make);
    let mut before: Option<ArmState> = None;
    let mut stamps = BTreeSet::new();
    for _ in 0..driver.periods(500_000_000) {
        let now = driver.rig.now();
        let (state, _) = driver.go(1);
        assert!(state.stamp <= now, "{:?} at {now:?}", state.stamp);
        let age_ns = now.since(state.stamp);
        assert!(age_ns <= driver.nature.age_max_ns, "{age_ns} ns old");
        if let Some(before) = before {
            assert!(state.stamp >= before.stamp);
        }
        stamps.insert(state.stamp);
        before = Some(state);
    }
    // A measurement for every so many periods.
    let every = driver.nature.age_max_ns.max(driver.nature.period_ns);
    let count = u64::try_from(stamps.len()).unwrap();
    assert!(count * every >= 490_000_000, "{count} measurements");
}

fn a_second_read_gives_the_same_and_changes_nothing(make: Make<'_>) {
    let (mut once, mut twice) = (Driver::new(make), Driver::new(make));
    for n in 0..once.periods(700_000_000) {
        // In some periods nothing is said.
        let speaks = n % 5 != 3;
        let now = twice.rig.now();
        let early = twice.rig.arm().read(now);
        let [first, second] = [&mut once, &mut twice].map(|driver| {
            let said = driver.set_point();
            driver.period(speaks.then_some(said))
        });
        assert_eq!((early, first), (second, second), "period {n}");
    }
}

fn each_axis_goes_where_it_is_told_in_its_own_unit(make: Make<'_>) {
    let mut driver = Driver::new(make);
    let mut wanted = driver.found;
    for axis in 0..TAIL_AXES {
        let mut way: Axes = [0.0; TAIL_AXES];
        way[axis] = WAY[axis];
        driver.depart_from(wanted, way);
        wanted[axis] += WAY[axis];
        let state = driver.arrive();
        let when = format!("after axis {axis}");
        assert_near(&positions(&state), &wanted, 0.02, &when);
        assert!(state.is_finite() && state.impossible().is_none());
    }
}

fn velocity_is_the_rate_of_the_position(make: Make<'_>) {
    let mut driver = Driver::new(make);
    let _ = driver.go(200_000_000);
    // Around the middle, where all axes are fastest.
    let mut states = Vec::new();
    for _ in 0..driver.periods(100_000_000) {
        states.push(driver.go(1).0);
    }
    let (first, last) = (states.first().unwrap(), states.last().unwrap());
    let seconds = hal::TimeNs(last.stamp.since(first.stamp)).seconds();
    let count = f64::from(u32::try_from(states.len()).unwrap());
    for (axis, way) in WAY.iter().enumerate() {
        let rate = (positions(last)[axis] - positions(first)[axis]) / seconds;
        let mean = states
            .iter()
            .map(|state| velocities(state)[axis])
            .sum::<f64>()
            / count;
        let fastest = 2.0 * way / WAY_S;
        assert!(
            (mean - rate).abs() < 0.03 * fastest.abs(),
            "axis {axis}: {mean} but the position changes by {rate}"
        );
        assert!(
            (0.8..1.05).contains(&(mean / fastest)),
            "axis {axis}: {mean} of {fastest}"
        );
    }
}
