//! `trocar drives` and `trocar run --backend can`, two processes on a bus.

use tests::scratch;
use trocar_log::RunLog;
use trocar_log::replay::replay;
use trocar_log::verify::verify;

use super::pair::{Pair, Process};
use super::peer::alone;

/// Why each drive stopped, by node.
fn causes(drives: &serde_json::Value) -> Vec<(u64, String)> {
    let stops = drives["stops"].as_array().unwrap();
    let mut causes: Vec<(u64, String)> = stops
        .iter()
        .map(|stop| {
            let cause = stop["cause"].as_str().unwrap().to_owned();
            (stop["node"].as_u64().unwrap(), cause)
        })
        .collect();
    causes.sort();
    causes
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn the_needle_is_lifted_over_can() {
    let _turn = alone();
    let pair = Pair::start("can_lift", &[], &[]);
    let (code, run) = pair.run("expert").end();
    assert_eq!(code, Some(0), "{run}");
    assert_eq!(run["success"], true, "{run}");
    assert!(run["can"]["arms"][0]["fault"].is_null(), "{run}");
    let log = RunLog::open(&pair.log()).unwrap();
    let verified = verify(&log).unwrap();
    assert!(verified.ok, "{:?}", verified.violations.first());
    assert!(replay(&log).unwrap().identical);
    assert!(
        log.text("can.toml")
            .is_some_and(|text| text.contains("nodes"))
    );
    let drives = pair.end();
    assert_eq!(drives["success"], true, "{drives}");
    let ends = causes(&drives);
    assert!(
        ends.iter()
            .all(|(_, why)| why == "its master switched it off"),
        "{ends:?}"
    );
}

/// What the drives report when their run has been killed in mid-motion.
fn killed() -> serde_json::Value {
    let mut pair = Pair::start("can_killed", &[], &[]);
    let run = pair.run("expert");
    pair.drives.await_word("the episode begins");
    pair.pass_ms(1500);
    run.signal("-KILL");
    pair.drives.await_word("at rest");
    drop(run);
    pair.end()
}

/// Every drive of `drives` stopped by itself for the loss of its master, and rested within 50 ms of
/// its last SYNC; tells whether no time was left out of these 50 ms.
fn rested_in_time(drives: &serde_json::Value) -> bool {
    let stops = drives["stops"].as_array().unwrap();
    assert_eq!(stops.len(), 7, "{drives}");
    let number = |stop: &serde_json::Value, key: &str| stop[key].as_f64().unwrap();
    let moved = |stop| number(stop, "rest_after_sync_ms") > 0.0;
    assert!(stops.iter().any(moved), "it was in mid-motion: {drives}");
    let stalled_ms = 1e3 * drives["stalled_s"].as_f64().unwrap();
    for stop in stops {
        let code = stop["code"].as_u64();
        // No SYNC, or no set-point: both are missing since then.
        assert!(matches!(code, Some(0x8700 | 0x8250)), "{stop}");
        assert!(number(stop, "stop_after_sync_ms") <= 25.0, "{stop}");
        assert!(number(stop, "rest_after_sync_ms") <= 50.0, "{stop}");
        assert!(number(stop, "stalled_ms") <= stalled_ms, "{drives}");
    }
    stops.iter().all(|stop| number(stop, "stalled_ms") <= 0.0)
}

/// When the run is killed in mid motion the drives rest within 50 ms and say why.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn drives_rest_within_50_ms_of_a_killed_run() {
    let _turn = alone();
    // Time that a busy machine keeps from the drives does not pass for them, so one kill must do
    // without.
    let whole = (0..8).any(|_| rested_in_time(&killed()));
    assert!(whole, "the drives' process stood still at every kill");
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn a_pulled_node_stops_the_others_and_log_and_result_name_it() {
    let _turn = alone();
    let pair = Pair::start("can_pulled", &[], &["kind=pull,node=3,at=1s"]);
    let (code, run) = pair.run("expert").end();
    assert_eq!(code, Some(1), "{run}");
    assert_eq!(run["success"], false);
    assert_eq!(run["can"]["arms"][0]["fault_node"], 3, "{run}");
    let reason = run["reason"].as_str().unwrap();
    assert!(
        reason.starts_with("fault: psm1: node 3 (axis 2, bus 0): "),
        "{reason}"
    );
    let event = reason.trim_start_matches("fault: ");
    let log = RunLog::open(&pair.log()).unwrap();
    assert!(
        log.events.iter().any(|told| told == event),
        "{:?}",
        log.events
    );
    let drives = pair.end();
    for (node, cause) in causes(&drives) {
        let expected = if node == 3 {
            "it lost its power"
        } else {
            "quick stop commanded by its master"
        };
        assert_eq!(cause, expected, "node {node}");
    }
    assert_eq!(causes(&drives).len(), 7);
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn bus_off_stops_the_arm_at_once_and_its_drives_by_themselves() {
    let _turn = alone();
    let pair = Pair::start("can_bus_off", &[], &["kind=bus-off,node=1,at=1s"]);
    let (code, run) = pair.run("expert").end();
    assert_eq!(code, Some(1), "{run}");
    assert_eq!(
        run["reason"], "fault: psm1: bus 0: our controller is bus-off",
        "{run}"
    );
    let log = RunLog::open(&pair.log()).unwrap();
    let bus_off = "psm1: bus 0: our controller is bus-off";
    assert!(
        log.events.iter().any(|told| told == bus_off),
        "{:?}",
        log.events
    );
    // The master says nothing more, so the drives notice that it is gone.
    let drives = pair.end();
    let stops = drives["stops"].as_array().unwrap();
    assert_eq!(stops.len(), 7, "{drives}");
    for stop in stops {
        assert!(
            matches!(stop["code"].as_u64(), Some(0x8700 | 0x8250)),
            "{stop}"
        );
    }
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn a_wrong_drive_an_absent_one_and_a_missing_world_are_named() {
    let _turn = alone();
    let pair = Pair::start("can_wrong", &[], &["kind=wrong-identity,node=5"]);
    let mut run = pair.run("expert");
    run.await_word("psm1 on vcan0: node 5 (axis 4, bus 0): 1018:02 is ");
    drop(run);
    let folder = scratch("can_absent");
    let on = |topics: &str, seed: &str| {
        let world = ["--backend", "can", "--topics", topics, "--seed", seed];
        let run = ["run", "--task", "needle-lift", "--policy", "noop"];
        Process::start(&folder, "run", &[&run[..], &world].concat())
    };
    let mut alone = on("nowhere", "0");
    alone.await_word("no publisher of a scene on topics \"nowhere\"");
    let mut other = on("can_wrong", "9");
    other.await_word("is needle-lift, seed 0; this run is needle-lift, seed 9");
    drop(pair);
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn one_khz_on_three_buses_runs() {
    let _turn = alone();
    let changes = [
        ("cycle_us = 2000", "cycle_us = 1000"),
        (
            "interfaces = [\"vcan0\"]\nsync_id = 0x080",
            "interfaces = [\"vcan0\", \"vcan1\", \"vcan2\"]\nsync_id = 0x080",
        ),
        (
            "nodes = [1, 2, 3, 4, 5, 6, 7]\nlines = [0, 0, 0, 0, 0, 0, 0]",
            "nodes = [1, 2, 3, 4, 5, 6, 7]\nlines = [0, 0, 0, 1, 1, 2, 2]",
        ),
    ];
    let mut pair = Pair::fast("can_three", &changes);
    let run = pair.run("expert");
    pair.drives.await_word("the episode begins");
    pair.pass_ms(2000);
    run.signal("-INT");
    let (_, run) = run.end();
    assert!(run["can"]["arms"][0]["fault"].is_null(), "{run}");
    assert_eq!(run["can"]["cycle_us"], 1000);
    assert_eq!(run["reason"], "interrupted", "{run}");
    let drives = pair.end();
    assert_eq!(drives["buses"].as_array().map(Vec::len), Some(3));
}
