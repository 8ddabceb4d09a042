//! A run that is kept from its core, whose log's disk stands still, or whose policy is for
//! something else.

use super::*;

/// Stopped for so short that the arms' measurements are not missed: overruns are counted, and the
/// run goes on. Stopped for longer, the arms play their tails, and the run ends with a latched
/// fault.
#[test]
fn a_run_kept_from_its_core_goes_on_or_ends_at_rest() {
    let _turn = alone();
    for (stopped_ms, name, fault) in [
        (
            20,
            "stopped-20-ms",
            "all threads kept from their cores for 20 ms (SIGSTOP)",
        ),
        (400, "stopped-400-ms", "the same for 0.4 s"),
    ] {
        let mut run = Run::start("faults-stopped", "random", 0, None);
        let injected = run.tick();
        run.send("-STOP");
        sleep_ns(stopped_ms * MS_NS);
        run.send("-CONT");
        sleep_ns(500 * MS_NS);
        while run.process.try_wait().unwrap().is_none() && run.status().is_none() {
            sleep_ns(2 * MS_NS);
        }
        if run.process.try_wait().unwrap().is_none() {
            run.send("-INT");
        }
        let (code, result) = run.end();
        let result = result.unwrap();
        let reason = result["reason"].as_str().unwrap();
        let missed = reason.starts_with("fault: no measurement for ");
        // A busy machine makes the short one longer.
        assert!(missed || reason == "interrupted", "{reason}");
        assert_eq!(code, Some(1));
        // The signals take effect a moment after they are sent, and the longest period is one that
        // no overrun counts.
        let figure = |name: &str| result["real_time"].pointer(name).unwrap().as_f64().unwrap();
        let (overruns, longest_us) = (figure("/overruns"), figure("/period_us/max"));
        assert!(
            longest_us >= TimeNs(stopped_ms * MS_NS).seconds() * 1e6 - 3e3,
            "{result}"
        );
        assert!(!missed || longest_us >= 50e3, "{result}");
        assert!(overruns >= longest_us / 1e3 - 3.0, "{result}");
        let log = run.checked_log();
        let (taken, then) = if missed {
            (Taken::stops(&log, injected), "the run ends, exit code 1")
        } else {
            let taken = Taken::skips(&log, injected);
            (taken, "its tail is played meanwhile")
        };
        let seen = format!("{overruns} overruns, `{reason}`");
        row(name, fault, &seen, &taken, then);
    }
}

/// Kept from its cores so often that more periods are skipped within a second than are allowed, the
/// run ends at rest and says so.
#[test]
fn too_many_overruns_end_the_run_at_rest() {
    let _turn = alone();
    let limit = ["--set", "realtime.overruns_per_s_max=60"];
    // A machine that is busy enough makes any one run miss the arms' measurements, but not three.
    let named = (1..=3).any(|_| {
        let mut run = Run::start_with("faults-overruns", "random", 0, None, &limit);
        let (injected, mut stops) = (run.tick(), 0);
        while stops < 6 && run.process.try_wait().unwrap().is_none() {
            run.send("-STOP");
            sleep_ns(30 * MS_NS);
            run.send("-CONT");
            sleep_ns(30 * MS_NS);
            stops += 1;
        }
        let (code, result) = run.end();
        let reason = result.unwrap()["reason"].as_str().unwrap().to_owned();
        assert_eq!(code, Some(1), "{reason}");
        let log = run.checked_log();
        let rest = reason.strip_prefix("fault: the control thread skipped ");
        let skipped = rest.and_then(|rest| rest.strip_suffix(" periods within a second"));
        let Some(skipped) = skipped else {
            assert!(reason.starts_with("fault: no measurement for "), "{reason}");
            return false;
        };
        assert!(skipped.parse::<u64>().unwrap() > 60, "{reason}");
        let fault =
            "more overruns than `overruns_per_s_max = 60` (SIGSTOP for 30 ms, again and again)";
        let (seen, taken) = (format!("`{reason}`"), Taken::stops(&log, injected));
        row(
            "overruns",
            fault,
            &seen,
            &taken,
            "the run ends, exit code 1",
        );
        true
    });
    assert!(named);
}

/// With `fault.ends_run = false` the arm holds with its fault until the operator clears it, and
/// moves again once it is enabled.
#[test]
fn a_fault_can_be_cleared_and_the_run_goes_on() {
    let _turn = alone();
    let holds = ["--set", "control.fault.ends_run=false"];
    let mut run = Run::start_with("faults-cleared", "random", 0, None, &holds);
    let injected = run.tick();
    run.send("-STOP");
    sleep_ns(400 * MS_NS);
    run.send("-CONT");
    run.until("it holds with a fault", |seen| seen.faulty && !seen.moves);
    let of = Ask {
        run: Some(run.process.id().to_string()),
        json: false,
    };
    let does = |event| ask(Operator::Event(event), &of).unwrap();
    let (refused, done) = does(OperatorEvent::Enable);
    assert!(
        !done && refused.contains("enable does not apply in FAULT"),
        "{refused}"
    );
    assert!(does(OperatorEvent::Clear).1);
    assert!(does(OperatorEvent::Enable).1);
    run.until("it moves again", |seen| seen.enabled && seen.moves);
    let (log, _) = run.interrupted();
    for told in [
        "psm1: fault: no measurement for ",
        "psm1: FAULT to DISABLED",
        "psm1: operator: clear",
    ] {
        assert!(
            log.events.iter().any(|event| event.contains(told)),
            "{told}"
        );
    }
    row(
        "fault-cleared",
        "a fault with `ends_run = false` (SIGSTOP for 0.4 s)",
        "`fault: no measurement for ...`",
        &Taken::stops(&log, injected),
        "holds in FAULT; moves again after `trocar clear` and `enable`",
    );
}

/// A file system of its own that can be made to wait, unmounted with the test.
struct StandingDisk(PathBuf);

impl StandingDisk {
    /// None where this user, who is not root, may not mount one.
    fn mount() -> Option<Self> {
        let folder = scratch("faults-disk-stands");
        let (image, mounted) = (folder.join("disk.img"), folder.join("mounted"));
        fs::create_dir(&mounted).unwrap();
        fs::File::create(&image).unwrap().set_len(96 << 20).unwrap();
        let (image, place) = (image.to_str()?, mounted.to_str()?);
        let made = granted("mkfs.ext4", &["-q", "-F", image]);
        (made && granted("mount", &["-o", "loop", image, place])).then_some(Self(mounted))
    }

    /// Makes all that is written to it wait until what this gives is dropped.
    fn freeze(&self) -> Frozen<'_> {
        let frozen = Command::new("fsfreeze").arg("-f").arg(&self.0).status();
        assert!(frozen.unwrap().success());
        Frozen(self)
    }
}

/// A disk that stands still. It is dropped before the run that writes to it, which could not end.
struct Frozen<'a>(&'a StandingDisk);

impl Drop for Frozen<'_> {
    fn drop(&mut self) {
        let freed = Command::new("fsfreeze").arg("-u").arg(&self.0.0).status();
        assert!(freed.is_ok_and(|status| status.success()) || std::thread::panicking());
    }
}

impl Drop for StandingDisk {
    fn drop(&mut self) {
        let _gone = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

/// Longer than the log's queue holds ticks, ns.
const STANDS_NS: u64 = 8_000 * MS_NS;

/// A replay of the log at `path` is identical up to the first record that the logger dropped, ends
/// there, and says where and what.
fn ends_at_the_gap(path: &Path, log: &RunLog) {
    let mut steps = log.steps().enumerate();
    let gap = steps.find(|(_, step)| step.dropped_before > 0 || step.chunk_dropped);
    let (whole, step) = gap.unwrap();
    let (tick, count) = (step.tick.tick, step.dropped_before);
    let replayed = replay(log).unwrap();
    let found = replayed.first_difference.unwrap();
    assert!(!replayed.identical && found.is_gap(), "{found}");
    assert_eq!((replayed.ticks, found.tick), (whole as u64, tick));
    let output = trocar().arg("replay").arg(path).output().unwrap();
    let told = String::from_utf8(output.stdout).unwrap();
    let lost = match count {
        0 => "the chunk".to_owned(),
        count => format!("{count} ticks"),
    };
    let expected = format!(
        "ends at a gap: tick {tick}: {lost} dropped by the logger; {whole} ticks before it are identical"
    );
    assert_eq!(
        (told.trim_end(), output.status.code()),
        (expected.as_str(), Some(1))
    );
}

/// The disk of the log stands still for longer than the queue reaches: the loop does not wait, and
/// the log says what it lacks.
#[test]
fn a_standing_disk_costs_records_and_not_the_loop() {
    let _turn = alone();
    let Some(disk) = StandingDisk::mount() else {
        println!("skipped: only root may mount a file system of its own");
        return;
    };
    let log = disk.0.join("run.mcap");
    let mut run = Run::start("faults-stands", "random", 0, Some(&log));
    let injected = run.tick();
    let frozen = disk.freeze();
    sleep_ns(STANDS_NS);
    run.until("it moves all the while", |seen| seen.enabled && seen.moves);
    drop(frozen);
    run.send("-INT");
    let (code, result) = run.end();
    let real_time = &result.unwrap()["real_time"];
    let dropped = real_time["log_dropped"].as_u64().unwrap();
    assert!(dropped > 0 && code == Some(1), "{real_time}");
    assert_eq!(real_time["thread"]["allocations"], 0);
    let log = RunLog::open(&run.log).unwrap();
    assert_eq!(log.cut(), None);
    let verified = verify(&log).unwrap();
    let found: Vec<_> = verified
        .violations
        .iter()
        .map(|it| it.limit.as_str())
        .collect();
    assert!(found.contains(&"missing_ticks"), "{found:?}");
    assert!(
        found.iter().all(|limit| *limit == "missing_ticks"),
        "{found:?}"
    );
    ends_at_the_gap(&run.log, &log);
    row(
        "disk-stands",
        "the log's disk stands still for 8 s (`fsfreeze`)",
        &format!("{dropped} log records dropped, `missing_ticks`"),
        &Taken::drops(&log, injected),
        "the log goes on too, with a gap that `verify` and `replay` name; `replay` ends there",
    );
}

/// A policy for other arms or a camera that there is not is refused before anything moves; one that
/// comes back as another ends the run.
#[test]
fn a_policy_for_something_else_is_refused_by_name() {
    let _turn = alone();
    for (asks, name, expected) in [
        (
            Asks {
                arms: 2,
                ..Asks::usual()
            },
            "policy-other-arms",
            "commands 2 arms, there are 1",
        ),
        (
            Asks {
                camera: Some("ear"),
                ..Asks::usual()
            },
            "policy-other-camera",
            "ear",
        ),
        (
            Asks {
                every_steps: 0,
                ..Asks::usual()
            },
            "policy-malformed",
            "says a query interval of 0 steps",
        ),
    ] {
        let topics = format!("faults-{}-other", std::process::id());
        let _performer = Performer::asking(&topics, asks);
        let output = trocar()
            .args(["run", "--task", "needle-lift", "--policy"])
            .arg(format!("external:{topics}"))
            .output()
            .unwrap();
        let said = tests::stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(expected), "{said}");
        let asks = (asks.arms, asks.every_steps, asks.camera.unwrap_or("none"));
        let (arms, every, camera) = asks;
        let fault = format!("a policy for {arms} arm(s), every {every} steps, camera {camera}");
        row_at_rest(name, &fault, &format!("`{expected}`"), "exit code 2");
    }
    let topics = format!("faults-{}-changed", std::process::id());
    let performer = Performer::appear(&topics);
    let mut run = Run::start("faults-changed", &format!("external:{topics}"), 1, None);
    let injected = run.tick();
    drop(performer);
    run.stops();
    let _other = Performer::asking(
        &topics,
        Asks {
            every_steps: 7,
            ..Asks::usual()
        },
    );
    let (code, result) = run.end();
    let reason = result.unwrap()["reason"].as_str().unwrap().to_owned();
    let expected = "has come back as another";
    assert!(reason.contains(expected) && code == Some(1), "{reason}");
    row(
        "policy-another",
        "external policy leaves, comes back and asks for other observations, `restarts = 1`",
        &format!("`{expected}`"),
        &Taken::stops(&run.checked_log(), injected),
        "the run ends, exit code 1",
    );
}
