//! What [`hal::Arm`] promises, tested once and run on every backend: the simulated arm, the arm on
//! CAN buses with emulated drives, and arms that play a log back.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

#[path = "conformance/facts.rs"]
mod facts;
#[path = "conformance/faults.rs"]
mod faults;
#[path = "conformance/on_can.rs"]
mod on_can;
#[path = "conformance/recorded.rs"]
mod recorded;
#[path = "conformance/rig.rs"]
mod rig;
#[path = "conformance/simulated.rs"]
mod simulated;
#[path = "conformance/stops.rs"]
mod stops;

use facts::{FACTS, Fact};
use faults::FAULTS;
use recorded::Shelf;
use rig::Make;
use stops::STOPS;

/// Says what is tested; shown if it fails.
#[expect(clippy::print_stdout, reason = "the test runner keeps it")]
fn begin(name: &str, fact: &str) {
    println!("{name}: {fact}");
}

/// Holds the arm that `make` gives to `facts`; `name` says which it is.
fn conforms<'a>(name: &str, make: Make<'_>, facts: impl IntoIterator<Item = &'a Fact>) {
    for (fact, holds) in facts {
        begin(name, fact);
        holds(make);
    }
}

/// The same of an arm that plays back what `make`'s said to the same driver.
fn plays_back<'a>(name: &str, make: Make<'_>, facts: impl IntoIterator<Item = &'a Fact>) {
    for (fact, holds) in facts {
        begin(&format!("{name}, played back"), fact);
        let shelf = Shelf::default();
        holds(&|| shelf.record(make));
        holds(&|| shelf.play());
        assert_eq!(shelf.len(), 0, "all that was recorded has been played");
    }
}

#[test]
fn the_simulated_arm_conforms() {
    let all = FACTS.iter().chain(&STOPS);
    conforms("simulated", &simulated::make, all);
}

/// The arm on CAN of one of the plans.
fn on_can_conforms(plan: usize) {
    let (name, plan, period_ns) = on_can::plans()[plan];
    let make = || on_can::make(&plan, period_ns);
    let all = FACTS.iter().chain(&STOPS).chain(&FAULTS);
    conforms(name, &make, all);
}

#[test]
fn the_arm_on_one_bus_conforms() {
    on_can_conforms(0);
}

#[test]
fn the_arm_on_one_bus_under_a_faster_controller_conforms() {
    on_can_conforms(1);
}

#[test]
fn the_arm_on_three_buses_conforms() {
    on_can_conforms(2);
}

#[test]
fn the_arm_led_by_its_actuators_conforms() {
    on_can_conforms(3);
}

#[test]
fn an_arm_that_plays_a_simulated_run_back_conforms() {
    let all = FACTS.iter().chain(&STOPS);
    plays_back("simulated", &simulated::make, all);
}

#[test]
fn an_arm_that_plays_a_run_on_can_back_conforms() {
    let (name, plan, period_ns) = on_can::plans()[0];
    let make = || on_can::make(&plan, period_ns);
    let all = FACTS.iter().chain(&STOPS).chain(&FAULTS);
    plays_back(name, &make, all);
}
