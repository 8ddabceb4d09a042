//! Policies that die, hang, answer badly, or leave and come back.

use hal::Chunk;
use trocar_control::kinematics::forward;
use trocar_log::LoggedTick;

use super::performer::{CHUNK_TICKS, Manner};
use super::*;

/// How far a target that ends a hold may be from the arm, mm: the gate's own limit.
const RESUME_MM: f64 = 10.0;

/// The log's ticks from the one that ends the run's hold, which began with an arm that came to
/// rest. Nothing is given to the arm that answers an observation from before the hold.
fn after_hold(log: &RunLog) -> Vec<(&LoggedTick, Option<&Chunk>)> {
    let asked = |event: OperatorEvent| {
        let mut ticks = log.ticks();
        ticks.position(|(tick, _)| tick.arms.first.operator == Some(event))
    };
    let held = asked(OperatorEvent::Pause).unwrap();
    let goes_on = asked(OperatorEvent::GoOn).unwrap();
    let (held, _) = log.ticks().nth(held).unwrap();
    let after: Vec<_> = log
        .ticks()
        .skip(goes_on)
        .map(|(tick, chunk)| (tick, chunk.first))
        .collect();
    let rests = after[0].0.arms.first.command;
    assert!(rests.velocity.amax() <= 1e-3, "{rests:?}");
    for chunk in after.iter().filter_map(|(_, chunk)| *chunk) {
        assert!(chunk.observed_at > held.now, "{chunk:?}");
    }
    after
}

/// How far the target of `chunk` that is due is from the tip that is commanded, mm.
fn away_mm(tick: &LoggedTick, chunk: &Chunk) -> f64 {
    let age = TimeNs(tick.now.since(chunk.observed_at));
    let due = usize::try_from(age.0 / chunk.step_ns).unwrap();
    let due = chunk.valid_targets().get(due).unwrap().tip_in_rcm();
    let tip = forward(&tick.arms.first.command.position);
    (due.translation.vector - tip.translation.vector).norm() * 1e3
}

/// How an arm went on after it was held: the distance of the first target that it was given to
/// where it was, mm, which the gate limits.
fn resumed_mm(log: &RunLog) -> f64 {
    let after = after_hold(log);
    let mut given = after
        .iter()
        .filter_map(|(tick, chunk)| Some((tick, (*chunk)?)));
    let (tick, chunk) = given.next().unwrap();
    let away_mm = away_mm(tick, chunk);
    assert!(away_mm <= RESUME_MM, "{away_mm}");
    let fastest = after
        .iter()
        .map(|(tick, _)| tick.arms.first.command.velocity.amax());
    assert!(fastest.fold(0.0, f64::max) > 0.01, "it moves again");
    away_mm
}

/// How far the nearest of the targets was that moved nothing after a hold, mm.
fn refused_mm(log: &RunLog) -> f64 {
    let rests = |tick: &LoggedTick| tick.arms.first.command.velocity.amax() <= 1e-3;
    let after = after_hold(log);
    let at_rest = after.iter().take_while(|(tick, _)| rests(tick));
    let given = at_rest.filter_map(|(tick, chunk)| Some(away_mm(tick, (*chunk)?)));
    let given: Vec<f64> = given.collect();
    // The last one is followed.
    let refused = given.split_last().unwrap().1;
    refused.iter().copied().fold(f64::INFINITY, f64::min)
}

/// A row of a process that was restarted: the arm, which went on from where it was, says when.
pub(crate) fn row_restarted(name: &str, (fault, seen): (&str, &str), log: &RunLog, injected: u64) {
    let taken = Taken::stops(log, injected);
    let (again, away_mm) = (taken.again.unwrap(), resumed_mm(log));
    let then = format!(
        "restarted; the arm goes on {again} ticks after its rest, from a target {away_mm:.1} mm away"
    );
    row(name, fault, &format!("`{}`", seen.trim()), &taken, &then);
}

/// Our own policy process is killed, and hangs: the arm holds until it is there again, and goes on
/// from where it is.
#[test]
fn dead_or_hung_policy_is_restarted_and_the_arm_goes_on() {
    let _turn = alone();
    for (signal, name, fault, seen) in [
        (
            "-KILL",
            "policy-killed",
            "policy process killed, `restarts = 2`",
            "the policy process ended: signal: 9",
        ),
        (
            "-STOP",
            "policy-hangs",
            "policy process hangs (SIGSTOP), `restarts = 2`",
            "the policy process has sent no heartbeat for ",
        ),
    ] {
        let mut run = Run::start("faults-restart", CHECKPOINT, 2, None);
        let injected = run.tick();
        send(signal, run.policy_process());
        run.stops();
        run.hears(seen);
        run.hears("the arms stop and hold; it is started again in 0.2 s (1 of 2)");
        run.until("it goes on", |seen| seen.enabled && seen.moves);
        run.hears("the policy process is ready again");
        let (log, result) = run.interrupted();
        assert_eq!(result["policy"]["restarts"], 1);
        for told in [
            seen,
            "ready again",
            "the policy answers again; its hold of the arms ends",
        ] {
            assert!(
                log.events.iter().any(|event| event.contains(told)),
                "{told}"
            );
        }
        row_restarted(name, (fault, seen), &log, injected);
    }
}

/// A restart that fails as often as is allowed ends the run with the arm at rest.
#[test]
fn the_last_restart_ends_the_run_at_rest() {
    let _turn = alone();
    let mut run = Run::start("faults-last", CHECKPOINT, 1, None);
    send("-KILL", run.policy_process());
    run.stops();
    run.until("it goes on", |seen| seen.enabled && seen.moves);
    let injected = run.tick();
    send("-KILL", run.policy_process());
    let (code, result) = run.end();
    let result = result.unwrap();
    let reason = result["reason"].as_str().unwrap();
    assert!(
        reason.starts_with("the policy process ended: signal: 9"),
        "{reason}"
    );
    assert_eq!((code, &result["policy"]["restarts"]), (Some(1), &1.into()));
    row(
        "policy-killed-last",
        "policy process killed, no restart left",
        "`the policy process ended: signal: 9`",
        &Taken::stops(&run.checked_log(), injected),
        "the run ends, exit code 1",
    );
}

/// What an external policy says wrong has no effect: the arm rests when its last good chunk ends,
/// and goes on with the next good one.
#[test]
fn bad_answers_bring_the_arm_to_rest_until_a_good_one_comes() {
    let _turn = alone();
    for (manner, name, fault) in [
        (Manner::NotFinite, "chunks-nan", "chunks with NaN"),
        (
            Manner::Replays,
            "chunks-old",
            "an old chunk again and again",
        ),
        (Manner::Slow, "chunks-late", "chunks 2.5 s late"),
    ] {
        let topics = format!("faults-{}-{manner:?}", std::process::id());
        let performer = Performer::appear(&topics);
        let mut run = Run::start("faults-bad", &format!("external:{topics}"), 0, None);
        // Some answers have been judged before.
        sleep_ns(1500 * MS_NS);
        let injected = run.tick();
        performer.behave(manner);
        run.until("it rests", |seen| !seen.moves);
        // None of them moves the arm, which is not paused.
        sleep_ns(3000 * MS_NS);
        run.until("it is seen", |seen| {
            assert!(seen.enabled && !seen.moves, "{manner:?}");
            true
        });
        performer.behave(Manner::Good);
        run.until("it goes on", |seen| seen.moves);
        let (log, result) = run.interrupted();
        assert!(
            result["policy"]["refused"].as_u64().unwrap() > 0,
            "{result}"
        );
        let taken = Taken::refuses(&log, injected, CHUNK_TICKS);
        let then = "the arm, which is not paused, goes on with the next good chunk";
        row(name, fault, "refused by the gate", &taken, then);
    }
}

/// A policy that comes back and asks for what is 30 mm away is refused by name and moves nothing,
/// until it begins where the arm is.
#[test]
fn a_policy_that_comes_back_elsewhere_is_refused() {
    let _turn = alone();
    let topics = format!("faults-{}-elsewhere", std::process::id());
    let performer = Performer::appear(&topics);
    let mut run = Run::start("faults-elsewhere", &format!("external:{topics}"), 1, None);
    let injected = run.tick();
    drop(performer);
    run.stops();
    let performer = Performer::appear(&topics);
    performer.behave(Manner::Elsewhere);
    run.until("it is no longer held", |seen| seen.enabled);
    sleep_ns(1500 * MS_NS);
    run.until("it is seen", |seen| {
        assert!(seen.enabled && !seen.moves);
        true
    });
    performer.behave(Manner::Good);
    run.until("it goes on", |seen| seen.enabled && seen.moves);
    let (log, result) = run.interrupted();
    assert!(result["policy"]["refused"].as_u64().unwrap() > 0);
    let named = "psm1: chunks are refused: they do not start where the arm was held";
    let told = log.events.iter().filter(|event| event.contains(named));
    assert_eq!(told.count(), 1, "{:?}", log.events);
    let nearest_mm = refused_mm(&log);
    assert!(nearest_mm > 1.5 * RESUME_MM, "{nearest_mm}");
    row(
        "policy-elsewhere",
        "external policy leaves, comes back and asks for what is 30 mm away, `restarts = 1`",
        "`they do not start where the arm was held`",
        &Taken::stops(&log, injected),
        "nothing moves until a chunk starts where the arm is, which is followed",
    );
}

/// An external policy that leaves may come back, and the arm goes on from where it is; without
/// restarts the run ends.
#[test]
fn an_external_policy_may_leave_and_come_back() {
    let _turn = alone();
    let topics = format!("faults-{}-leaves", std::process::id());
    for restarts in [1, 0] {
        let performer = Performer::appear(&topics);
        let mut run = Run::start(
            "faults-leaves",
            &format!("external:{topics}"),
            restarts,
            None,
        );
        let injected = run.tick();
        drop(performer);
        if restarts == 0 {
            let (code, result) = run.end();
            let result = result.unwrap();
            let reason = result["reason"].as_str().unwrap();
            assert!(
                reason.contains("ended") && reason.contains("swings"),
                "{reason}"
            );
            assert_eq!(code, Some(1));
            run.checked_log();
            continue;
        }
        run.stops();
        run.hears("it may come back within 30.0 s (1 of 1)");
        let performer = Performer::appear(&topics);
        run.until("it goes on", |seen| seen.enabled && seen.moves);
        let (log, result) = run.interrupted();
        drop(performer);
        assert_eq!(result["policy"]["restarts"], 1);
        assert_eq!(result["policy"]["refused"], 0, "{result}");
        let (taken, away_mm) = (Taken::stops(&log, injected), resumed_mm(&log));
        let again = taken.again.unwrap();
        let then = format!(
            "it comes back as another process; the arm goes on {again} ticks after its rest, from a target {away_mm:.1} mm away"
        );
        let fault = "external policy leaves, `restarts = 1`";
        row("policy-leaves", fault, "`ended`", &taken, &then);
    }
}
