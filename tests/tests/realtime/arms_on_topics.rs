//! `run --backend topics`: a controller and the arms that it leads are two processes, each of which
//! may die.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use hal::{ARM_NAMES, ArmCommand};
use tests::{alone, json, repository, scratch, stderr, trocar};
use trocar::session::operator::{Ask, Command as Operator, ask};
use trocar_log::replay::replay;
use trocar_log::{LoggedArm, RunLog, RunMark};
use trocar_topics::{
    ArmFeedback, ArmFeedbackTopic, ArmSetpointTopic, Subscriber, TopicNode, arms_of,
};

use super::{
    CHECKPOINT, MS_NS, checked_log, expect_a_stop, expect_nothing_left, moves, send, sleep_ns,
    until,
};

/// `trocar simulator`, ended with the test.
struct Simulator {
    process: Child,
    topics: String,
    result: PathBuf,
}

impl Simulator {
    fn start(test: &str, task: &str, more: &[&str]) -> Self {
        let topics = format!("test-{}-{test}", std::process::id());
        let result = scratch(test).join("simulator.json");
        let process = trocar()
            .args(["simulator", "--task", task, "--topics", &topics])
            .args(more)
            .arg("--json")
            .arg(&result)
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        Self {
            process,
            topics,
            result,
        }
    }

    /// The controller's process.
    fn run(&self, what: &[&str]) -> Command {
        let mut command = trocar();
        command
            .args(["run", "--backend", "topics", "--topics", &self.topics])
            .args(what)
            .stdout(Stdio::null());
        command
    }

    /// What the arm `name` measures.
    fn feedback(&self, name: &str) -> Watch {
        let node = TopicNode::join(&arms_of(&self.topics)).unwrap();
        let topic = ArmFeedbackTopic::subscriber(&node, name).unwrap();
        Watch { _node: node, topic }
    }

    fn end(mut self) -> serde_json::Value {
        send("-INT", self.process.id());
        assert_eq!(self.process.wait().unwrap().code(), Some(0));
        json(&self.result)
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
    }
}

/// Looks at an arm from outside.
struct Watch {
    _node: TopicNode,
    topic: Subscriber<ArmFeedback>,
}

impl Watch {
    fn next(&self) -> ArmFeedback {
        let mut next = None;
        until("the arm measures", || {
            next = self.topic.newest().unwrap();
            next.is_some()
        });
        next.unwrap()
    }

    /// Waits until no joint moves any more, for a tenth of a second.
    fn rests(&self) {
        let still = |message: &ArmFeedback| message.velocity.iter().all(|rate| rate.abs() < 2e-3);
        let mut quiet = 0;
        until("the arm rests", || {
            quiet = if still(&self.next()) { quiet + 1 } else { 0 };
            sleep_ns(5 * MS_NS);
            quiet > 20
        });
    }
}

/// The task is done by a controller in one process and arms, world and cameras in another; of one
/// arm by the network, which looks through them, of two by the expert.
#[test]
fn tasks_are_done_with_the_simulator_in_another_process() {
    let _turn = alone();
    for (task, policy, cameras) in [
        ("needle-lift", CHECKPOINT, "endoscope"),
        ("needle-handover", "expert", ""),
    ] {
        let mut reasons = Vec::new();
        let done = (4..=6).any(|seed| {
            let Err(reason) = done_elsewhere(task, policy, cameras, seed) else {
                return true;
            };
            assert!(reason.contains("no measurement for"), "{task}: {reason}");
            reasons.push(reason);
            false
        });
        assert!(done, "{task}: {reasons:?}");
    }
}

/// A run with the simulator in another process, or the reason that it gives for its failure: a
/// machine that stands still for longer than measurements may be away ends it.
fn done_elsewhere(task: &str, policy: &str, cameras: &str, seed: u64) -> Result<(), String> {
    let seed = seed.to_string();
    let mut shown = vec!["--seed", &seed];
    if !cameras.is_empty() {
        shown.extend(["--cameras", cameras]);
    }
    let simulator = Simulator::start(&format!("topics-{task}-{seed}"), task, &shown);
    let folder = scratch(&format!("topics-{task}-{seed}-run"));
    let (log, result) = (folder.join("run.mcap"), folder.join("run.json"));
    let mut run = simulator
        .run(&["--task", task, "--policy", policy, "--seed", &seed, "--log"])
        .arg(&log)
        .arg("--json")
        .arg(&result)
        .spawn()
        .unwrap();
    let id = run.id();
    let code = run.wait().unwrap().code();
    let result = json(&result);
    let success = result["success"] == true;
    assert_eq!(code, Some(i32::from(!success)), "{result}");
    let whole = checked_log(&log, &result);
    if success && !cameras.is_empty() {
        assert!(whole.counts.unwrap().frames > 10);
    }
    let ids = [id, simulator.process.id()];
    let summary = simulator.end();
    expect_nothing_left(&ids);
    assert_eq!(summary["success"], success, "{summary}");
    assert!(summary["begun_s"].as_f64().is_some(), "{summary}");
    match success {
        true => Ok(()),
        false => Err(result["reason"].to_string()),
    }
}

/// An arm whose controller is killed stops as its last set-point said and holds there; another run
/// is told that its episode is used up.
#[test]
fn arms_whose_controller_dies_stop_and_hold() {
    let _turn = alone();
    let simulator = Simulator::start("topics-killed", "needle-lift", &["--seed", "1"]);
    let watch = simulator.feedback(ARM_NAMES[0]);
    let log = scratch("topics-killed-run").join("run.mcap");
    let task = ["--task", "needle-lift", "--policy", "random", "--seed", "1"];
    let mut run = simulator.run(&task).arg("--log").arg(&log).spawn().unwrap();
    until("the run is under way", || {
        assert_eq!(run.try_wait().unwrap(), None, "ended too early");
        moves(&log)
    });
    run.kill().unwrap();
    run.wait().unwrap();
    watch.rests();
    let held = watch.next();
    sleep_ns(300 * MS_NS);
    let later = watch.next();
    assert!(later.sequence > held.sequence, "the simulator goes on");
    let drift = held.position.iter().zip(&later.position);
    let drift = drift.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(drift < 2e-3, "it holds: {drift}");
    let again = simulator
        .run(&task)
        .stderr(Stdio::piped())
        .output()
        .unwrap();
    let said = stderr(&again);
    assert!(said.contains("has begun already"), "{said}");
    assert!(said.contains("start `trocar simulator` anew"), "{said}");
}

/// A simulator that dies is a lost measurement: the run ends with that fault, and its log is whole.
#[test]
fn a_run_whose_arms_die_ends_with_a_fault() {
    let _turn = alone();
    let mut simulator = Simulator::start("topics-dies", "needle-lift", &["--seed", "1"]);
    let folder = scratch("topics-dies-run");
    let (log, result) = (folder.join("run.mcap"), folder.join("run.json"));
    let mut run = simulator
        .run(&[
            "--task",
            "needle-lift",
            "--policy",
            "random",
            "--seed",
            "1",
            "--log",
        ])
        .arg(&log)
        .arg("--json")
        .arg(&result)
        .spawn()
        .unwrap();
    until("the run is under way", || {
        assert_eq!(run.try_wait().unwrap(), None, "ended too early");
        moves(&log)
    });
    simulator.process.kill().unwrap();
    simulator.process.wait().unwrap();
    assert_eq!(run.wait().unwrap().code(), Some(1));
    let result = json(&result);
    let reason = result["reason"].as_str().unwrap();
    assert!(reason.contains("no measurement for 0.0"), "{reason}");
    let whole = RunLog::open(&log).unwrap();
    assert_eq!(whole.cut(), None);
    assert!(replay(&whole).unwrap().identical);
}

/// A robot without a task: limits, a policy, and arms that answer. A signal brings it to rest, and
/// its arm loses torque.
#[test]
fn a_robot_on_topics_rests_without_torque_after_a_signal() {
    let _turn = alone();
    let simulator = Simulator::start("topics-robot", "needle-lift", &[]);
    let node = TopicNode::join(&arms_of(&simulator.topics)).unwrap();
    let told = ArmSetpointTopic::subscriber(&node, ARM_NAMES[0]).unwrap();
    let watch = simulator.feedback(ARM_NAMES[0]);
    let folder = scratch("topics-robot-run");
    let (log, result) = (folder.join("run.mcap"), folder.join("run.json"));
    let safety = repository().join("config/tasks/needle-lift/safety.toml");
    let mut run = simulator
        .run(&[
            "--policy",
            "random",
            "--safety",
            safety.to_str().unwrap(),
            "--log",
        ])
        .arg(&log)
        .arg("--json")
        .arg(&result)
        .spawn()
        .unwrap();
    let mut last: Option<ArmCommand> = None;
    let mut look = || {
        while let Some(setpoint) = told.next_unread().unwrap() {
            last = Some(setpoint.command());
        }
    };
    until("the run is under way", || {
        assert_eq!(run.try_wait().unwrap(), None, "ended too early");
        look();
        moves(&log)
    });
    send("-INT", run.id());
    until("the run ends", || {
        look();
        run.try_wait().unwrap().is_some()
    });
    let result = json(&result);
    assert_eq!(result["reason"], "interrupted", "{result}");
    assert!(result["success"].is_null(), "{result}");
    let last = last.unwrap();
    assert!(!last.enabled && last.velocity.amax() <= 0.0, "{last:?}");
    watch.rests();
    let whole = checked_log(&log, &result);
    expect_a_stop(&whole);
    let of_log: &LoggedArm = &whole.ticks().last().unwrap().0.arms.first;
    assert_eq!(
        of_log.command.position, last.position,
        "as the arm was told"
    );
}

/// A robot's run without a page is marked over the operator's socket, and its log has the last
/// mark.
#[test]
fn a_robot_on_topics_is_marked_without_a_page() {
    let _turn = alone();
    let simulator = Simulator::start("topics-marked", "needle-lift", &[]);
    let folder = scratch("topics-marked-run");
    let (log, result) = (folder.join("run.mcap"), folder.join("run.json"));
    let safety = repository().join("config/tasks/needle-lift/safety.toml");
    let safety = safety.to_str().unwrap();
    let mut run = simulator
        .run(&["--policy", "random", "--safety", safety, "--log"])
        .arg(&log)
        .arg("--json")
        .arg(&result)
        .spawn()
        .unwrap();
    until("the run is under way", || {
        assert_eq!(run.try_wait().unwrap(), None, "ended too early");
        moves(&log)
    });
    marks(run.id(), &log);
    ask(Operator::Stop, &of(run.id(), false)).unwrap();
    run.wait().unwrap();
    let said = &json(&result)["said"];
    assert_eq!(
        said,
        &serde_json::json!({ "mark": "discard", "label": "camera fell" })
    );
    assert!(is_told(&log, "the operator marks the run: discard"));
    let outcome = RunLog::open(&log).unwrap().outcome.unwrap();
    let said = outcome.said.to_string();
    assert_eq!(said, "marked discard, label \"camera fell\"");
}

/// Whether `log` says so among what happened.
fn is_told(log: &Path, text: &str) -> bool {
    RunLog::open(log).is_ok_and(|log| log.events.iter().any(|event| event == text))
}

fn of(run: u32, json: bool) -> Ask {
    let run = Some(run.to_string());
    Ask { run, json }
}

/// A person says how the run goes, and otherwise a moment later; a label that is none changes
/// nothing.
fn marks(run: u32, log: &Path) {
    let says = |mark, label: Option<&str>| {
        let label = label.map(str::to_owned);
        ask(Operator::Mark { mark, label }, &of(run, false)).unwrap()
    };
    let (answer, yes) = says(Some(RunMark::Success), None);
    assert!(yes && answer.ends_with("; marked success"), "{answer}");
    until("the mark is told", || {
        is_told(log, "the operator marks the run: success")
    });
    let (answer, yes) = says(None, Some("camera fell"));
    let unmarked = "; not marked, label \"camera fell\"";
    assert!(yes && answer.ends_with(unmarked), "{answer}");
    until("it is told that there is none", || {
        is_told(log, "the operator takes the mark of the run back")
    });
    let (answer, yes) = says(Some(RunMark::Failure), Some("two\u{2028}lines"));
    assert!(!yes && answer.starts_with("error: a label is"), "{answer}");
    let (_, yes) = says(Some(RunMark::Discard), None);
    assert!(yes);
    let (status, _) = ask(Operator::Status, &of(run, true)).unwrap();
    let status: serde_json::Value = serde_json::from_str(&status).unwrap();
    let said = serde_json::json!({ "mark": "discard", "label": "camera fell" });
    assert_eq!(status["said"], said, "{status}");
}

/// What is not there, or led by another, is named.
#[test]
fn arms_that_are_not_there_are_named() {
    let topics = format!("test-{}-nobody", std::process::id());
    let safety = repository().join("config/tasks/needle-lift/safety.toml");
    let run = |more: &[&str]| {
        let mut command = trocar();
        command.args([
            "run",
            "--backend",
            "topics",
            "--topics",
            &topics,
            "--policy",
            "noop",
        ]);
        command.args(more).output().unwrap()
    };
    let robot = run(&["--safety", safety.to_str().unwrap(), "--seconds", "1"]);
    let said = stderr(&robot);
    assert_eq!(robot.status.code(), Some(1), "{said}");
    assert!(said.contains("no feedback of psm1 on topics"), "{said}");
    let task = run(&["--task", "needle-lift"]);
    let said = stderr(&task);
    assert!(said.contains("start `trocar simulator` first"), "{said}");
    let lockstep = run(&["--task", "needle-lift", "--lockstep"]);
    assert_eq!(lockstep.status.code(), Some(2), "{}", stderr(&lockstep));
}
