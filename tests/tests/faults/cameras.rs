//! The cameras' process of a simulated run dies or hangs.

use super::*;

/// The policy looks through them: the arm holds until they are there again and the policy has
/// answered a new frame, and goes on from where it is.
#[test]
fn dead_or_hung_cameras_are_restarted_and_the_arm_goes_on() {
    let _turn = alone();
    for (signal, name, fault, seen) in [
        (
            "-KILL",
            "cameras-killed",
            "the cameras' process of a simulated run killed, `restarts = 2`",
            "the cameras' process ended: signal: 9",
        ),
        (
            "-STOP",
            "cameras-hang",
            "it hangs (SIGSTOP), `restarts = 2`",
            "the cameras' process has sent no heartbeat for ",
        ),
    ] {
        let mut run = Run::start("faults-cameras", CHECKPOINT, 2, None);
        let (policy, cameras) = (run.policy_process(), run.cameras_process());
        let injected = run.tick();
        send(signal, cameras);
        run.stops();
        run.hears(seen);
        run.hears("the arms stop and hold; it is started again in 0.2 s (1 of 2)");
        run.until("it goes on", |seen| seen.enabled && seen.moves);
        run.hears("the cameras' process is ready again");
        let now = (run.policy_process(), run.cameras_process());
        assert_eq!(now.0, policy, "the policy was none the worse");
        assert_ne!(now.1, cameras);
        let (log, result) = run.interrupted();
        assert!(result["policy"].get("restarts").is_none(), "{result}");
        assert!(log.counts.unwrap().frames > 1);
        for told in [
            seen,
            "the cameras' process is ready again",
            "the policy answers again; its hold of the arms ends",
        ] {
            assert!(
                log.events.iter().any(|event| event.contains(told)),
                "{told}: {:?}",
                log.events
            );
        }
        row_restarted(name, (fault, seen), &log, injected);
    }
}

#[test]
fn the_policys_cameras_without_a_restart_end_the_run_at_rest() {
    let _turn = alone();
    let mut run = Run::start("faults-cameras-last", CHECKPOINT, 0, None);
    let injected = run.tick();
    send("-KILL", run.cameras_process());
    let (code, result) = run.end();
    let reason = result.unwrap()["reason"].as_str().unwrap().to_owned();
    assert_eq!(
        (code, reason.as_str()),
        (Some(1), "the cameras' process ended: signal: 9 (SIGKILL)")
    );
    row(
        "cameras-killed-last",
        "the cameras' process killed, no restart left",
        "`the cameras' process ended: signal: 9`",
        &Taken::stops(&run.checked_log(), injected),
        "the run ends, exit code 1",
    );
}

/// Nothing but the log sees them: the arm never stops, and the log says from when on it has no
/// frames.
#[test]
fn an_arm_whose_log_alone_loses_its_cameras_goes_on() {
    let _turn = alone();
    let mut run = Run::start("faults-cameras-log", "random", 0, None);
    let injected = run.tick();
    send("-KILL", run.cameras_process());
    let said =
        "the cameras' process ended: signal: 9 (SIGKILL); the run goes on without its frames";
    run.hears(said);
    let detected = run.tick() - injected;
    run.until("it moves on", |seen| seen.enabled && seen.moves);
    let (log, _) = run.interrupted();
    assert!(log.events.iter().any(|event| event.contains(said)));
    let asked = log.ticks().filter_map(|(tick, _)| tick.arms.first.operator);
    let asked: Vec<OperatorEvent> = asked.collect();
    // At the end the arm comes to rest and loses torque.
    assert_eq!(
        asked,
        [
            OperatorEvent::Enable,
            OperatorEvent::Pause,
            OperatorEvent::Disable
        ]
    );
    row(
        "cameras-killed-log",
        "the cameras' process killed, only the log sees its frames",
        "`the run goes on without its frames`",
        &Taken::goes_on(&log, Some(detected)),
        "the log has no more frames",
    );
}
