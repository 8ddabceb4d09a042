//! What `trocar drives` and `trocar run --backend can` refuse before they touch a bus; these need
//! none.
#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use tests::{repository, scratch, trocar};

/// The shipped nodes and buses with some text replaced.
fn config(test: &str, changes: &[(&str, &str)]) -> PathBuf {
    let mut text = fs::read_to_string(repository().join("config/can.toml")).unwrap();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    let file = scratch(test).join("can.toml");
    fs::write(&file, text).unwrap();
    file
}

fn run(arguments: &[&str]) -> Output {
    trocar().args(arguments).output().unwrap()
}

/// The exit code and what the program complained of.
fn refused(output: &Output) -> (Option<i32>, String) {
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.code(), told)
}

const ON_CAN: [&str; 7] = [
    "run",
    "--task",
    "needle-lift",
    "--policy",
    "expert",
    "--backend",
    "can",
];

/// One kHz for seven axes on one bus is refused with the arithmetic.
#[test]
fn seven_axes_at_1_khz_are_refused_on_one_bus() {
    let file = config(
        "can_refusals_1khz",
        &[("cycle_us = 2000", "cycle_us = 1000")],
    );
    let mut arguments = ON_CAN.to_vec();
    arguments.extend(["--can-config", file.to_str().unwrap()]);
    let (code, told) = refused(&run(&arguments));
    assert_eq!(code, Some(2), "{told}");
    assert!(
        told.contains(
            "bus 0: 1 SYNC x 55 + 7 set-points x 115 + 7 answers x 135 + heartbeats of 8 nodes = 1811 bits with stuffing, \
             but a cycle of 1000 us at 1 Mbit/s has 1000: 181.1 % of the bus"
        ),
        "{told}"
    );
}

/// Two arms on one bus at 500 Hz are refused and at 250 Hz only lack the bus.
#[test]
fn two_arms_on_one_bus_need_250_hz() {
    let arguments = [
        "run",
        "--task",
        "needle-handover",
        "--policy",
        "expert",
        "--backend",
        "can",
    ];
    let (code, told) = refused(&run(&arguments));
    assert_eq!(code, Some(2), "{told}");
    assert!(
        told.contains("of which at most 95 % may be planned"),
        "{told}"
    );
    let file = config(
        "can_refusals_two_arms",
        &[
            ("cycle_us = 2000", "cycle_us = 4000"),
            ("\"vcan0\"", "\"nocan7\""),
        ],
    );
    let mut slower = arguments.to_vec();
    slower.extend(["--can-config", file.to_str().unwrap()]);
    let (code, told) = refused(&run(&slower));
    assert_eq!(code, Some(1), "{told}");
    assert!(lacks_the_bus(&told), "{told}");
}

/// A cycle that is no whole number of control periods is refused.
#[test]
fn cycle_of_fractional_control_periods_is_refused() {
    let file = config(
        "can_refusals_cycle",
        &[("cycle_us = 2000", "cycle_us = 2500")],
    );
    let mut arguments = ON_CAN.to_vec();
    arguments.extend(["--can-config", file.to_str().unwrap()]);
    let (code, told) = refused(&run(&arguments));
    assert_eq!(code, Some(2), "{told}");
    assert!(told.contains("cycle_us = 2500"), "{told}");
}

#[test]
fn options_that_do_not_go_together_are_refused() {
    let mut lockstep = ON_CAN.to_vec();
    lockstep.push("--lockstep");
    let (code, told) = refused(&run(&lockstep));
    assert_eq!(code, Some(2), "{told}");
    assert!(told.contains("--lockstep needs --backend sim"), "{told}");
    let mut simulated = ON_CAN[..5].to_vec();
    simulated.extend(["--can-config", "config/can.toml"]);
    let (code, told) = refused(&run(&simulated));
    assert_eq!(code, Some(2), "{told}");
    assert!(told.contains("--can-config needs --backend can"), "{told}");
}

/// A robot needs limits a bus and a policy that sees no simulator.
#[test]
fn robot_needs_limits_a_bus_and_a_policy() {
    let safety = repository().join("config/tasks/needle-lift/safety.toml");
    let safety = safety.to_str().unwrap();
    let on_can = ["run", "--backend", "can", "--safety"];
    for (arguments, reason) in [
        (vec!["run", "--policy", "noop"], "--task"),
        (
            vec!["run", "--policy", "noop", "--safety", safety],
            "--safety needs --backend can or topics: the simulator runs tasks",
        ),
        (
            [&on_can[..], &[safety, "--policy", "expert"]].concat(),
            "--policy expert: it sees the simulator's scene and needs a --task",
        ),
        (
            [&on_can[..], &["nolimits.toml", "--policy", "noop"]].concat(),
            "nolimits.toml",
        ),
        (
            [&on_can[..], &[safety, "--policy", "noop", "--seconds", "0"]].concat(),
            "expected a number in [0.1, 86400]",
        ),
        (
            [
                &on_can[..],
                &[safety, "--policy", "noop", "--task", "needle-lift"],
            ]
            .concat(),
            "cannot be used with",
        ),
        (
            vec![
                "run",
                "--task",
                "needle-lift",
                "--policy",
                "noop",
                "--seconds",
                "3",
            ],
            "cannot be used with",
        ),
        (
            vec!["drives", "--no-world", "--task", "needle-lift"],
            "cannot be used with",
        ),
        (vec!["drives", "--no-world", "3"], "3"),
    ] {
        let (code, told) = refused(&run(&arguments));
        assert_eq!(code, Some(2), "{arguments:?}: {told}");
        assert!(told.contains(reason), "{arguments:?}: {told}");
    }
}

/// Whether what is told is that there is no interface nocan7, and what would help: on a kernel
/// without CAN that is another thing.
fn lacks_the_bus(told: &str) -> bool {
    let absent = "nocan7: cannot be opened as a CAN interface: ";
    let no_can = "nocan7: there are no CAN sockets: ";
    told.contains(absent) && told.contains("`ip link add dev nocan7 type vcan")
        || told.contains(no_can) && told.contains("load the modules can, can_raw and vcan")
}

#[test]
fn an_interface_that_is_not_there_is_named_with_what_to_do() {
    let file = config("can_refusals_interface", &[("\"vcan0\"", "\"nocan7\"")]);
    let file = file.to_str().unwrap();
    let mut arguments = ON_CAN.to_vec();
    arguments.extend(["--can-config", file]);
    for output in [run(&arguments), run(&["drives", "--config", file])] {
        let (code, told) = refused(&output);
        assert_eq!(code, Some(1), "{told}");
        assert!(lacks_the_bus(&told), "{told}");
    }
}

#[test]
fn faults_that_cannot_be_are_refused() {
    for (fault, expected) in [
        ("kind=fire,node=3", "kind=fire: there are pull, reboot, "),
        ("kind=pull,node=3,at=soon", "at=soon: a time is 0 to 3600 s"),
        (
            "kind=pull,node=99",
            "there is no such node; there are 1 2 3",
        ),
    ] {
        let (code, told) = refused(&run(&["drives", "--fault", fault]));
        assert_eq!(code, Some(2), "{told}");
        assert!(told.contains(expected), "{told}");
    }
}

#[test]
fn one_node_for_two_axes_is_refused() {
    let nodes = (
        "[11, 12, 13, 14, 15, 16, 17]",
        "[11, 12, 3, 14, 15, 16, 17]",
    );
    let apart = (
        "[\"vcan0\"]\nsync_id = 0x080",
        "[\"vcan1\"]\nsync_id = 0x080",
    );
    let cases = [
        // On one interface no master could tell them apart; on two it is only the drives' process
        // that could not.
        (
            &[nodes][..],
            "arm.1.nodes.2 = 3 is outside one that the first arm",
        ),
        (&[nodes, apart], "node 3 is of two arms"),
    ];
    for (changes, expected) in cases {
        let file = config("can_refusals_nodes", changes);
        let file = file.to_str().unwrap();
        let (code, told) = refused(&run(&[
            "drives",
            "--task",
            "needle-handover",
            "--config",
            file,
        ]));
        assert_eq!(code, Some(2), "{told}");
        assert!(told.contains(expected), "{told}");
    }
}
