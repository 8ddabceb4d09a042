//! Processes that were configured otherwise than the run that they take part in, from the beginning
//! or when they join it later.

use iceoryx2::prelude::ZeroCopySend;
use tests::repository;
use trocar_topics::{Message, PolicyHello, Topic, TopicNode};

use super::*;

/// What the scene of [`Run`] is set to, which whoever draws it must be told too.
const SCENE: [&str; 4] = [
    "--set",
    "scene.episode.time_limit_s=300",
    "--set",
    "scene.success.hold_s=10",
];

/// A process of this program beside a run, ended with the test.
struct Beside(Child);

impl Beside {
    fn start(verb: &[&str], more: &[&str]) -> Self {
        let mut command = trocar();
        command.args(verb).args(more);
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        Self(command.spawn().unwrap())
    }

    /// `trocar cameras` of the scene of [`Run`].
    fn cameras(topics: &str, more: &[&str]) -> Self {
        let verb = ["cameras", "--task", "needle-lift", "--topics", topics];
        Self::start(&verb, &[&SCENE[..], more].concat())
    }

    /// Its exit code and what it said, once it ends by itself.
    fn ends(mut self) -> (Option<i32>, String) {
        let lines = BufReader::new(self.0.stderr.take().unwrap()).lines();
        let said: Vec<String> = lines.map_while(Result::ok).collect();
        (self.0.wait().unwrap().code(), said.join("\n"))
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _reaped = self.0.wait();
    }
}

fn topics(test: &str) -> String {
    format!("faults-{}-{test}", std::process::id())
}

/// Runs that are not of the world that `trocar simulator` is: each is refused by what differs
/// before an arm has torque, and none uses up the world's episode.
#[test]
fn another_world_than_the_runs_is_refused_by_what_differs() {
    let _turn = alone();
    let (name, folder) = (topics("world"), scratch("faults-world"));
    let result = folder.join("simulator.json");
    let world = ["--task", "needle-lift", "--seed", "3", "--topics", &name];
    let json_to = ["--json", result.to_str().unwrap()];
    let simulator = Beside::start(&["simulator"], &[&world[..], &json_to].concat());
    for (row_name, fault, options, seen) in [
        (
            "world-another",
            "`trocar simulator` of another task than the run's",
            &["--task", "tissue-retraction", "--seed", "3"][..],
            "is needle-lift, seed 3; this run is tissue-retraction, seed 3",
        ),
        (
            "world-seed",
            "of another seed",
            &["--task", "needle-lift", "--seed", "4"],
            "is needle-lift, seed 3; this run is needle-lift, seed 4",
        ),
        (
            "world-scene",
            "of another scene",
            &["--task", "needle-lift", "--seed", "3", "--needle", "N3"],
            "has another scene than this run",
        ),
    ] {
        let clock = MonotonicClock::new();
        let said = loop {
            let on = ["run", "--backend", "topics", "--topics", &name];
            let output = trocar()
                .args(on)
                .args(["--policy", "noop"])
                .args(options)
                .output()
                .unwrap();
            let said = tests::stderr(&output);
            // The simulator may not be there yet.
            if said.contains("start `trocar simulator` first") && clock.now().0 < PATIENCE_NS {
                continue;
            }
            assert_eq!(output.status.code(), Some(2), "{said}");
            break said;
        };
        assert!(said.contains(seen), "{said}");
        row_at_rest(row_name, fault, &format!("`{seen}`"), "exit code 2");
    }
    send("-INT", simulator.0.id());
    let (code, said) = simulator.ends();
    assert_eq!(code, Some(0), "{said}");
    let begun = &json(&result)["begun_s"];
    assert!(begun.is_null(), "no arm was enabled: {begun}");
}

/// Cameras of another scene end as soon as they see the run's, and show nothing: a run that waits
/// for them ends, one under way holds its arm until the right ones are there.
#[test]
fn cameras_of_another_scene_show_nothing() {
    let _turn = alone();
    let (name, plain) = (
        topics("cameras"),
        ["--set", "scene.rendering.shading=plain"],
    );
    let asks = Asks {
        camera: Some("endoscope"),
        ..Asks::usual()
    };
    let _policy = Performer::asking(&name, asks);
    let policy = format!("external:{name}");
    let refused = "has another scene than these cameras";
    let others = Beside::cameras(&name, &[&plain[..], &["--needle", "N3"]].concat());
    let output = trocar()
        .args([
            "run",
            "--task",
            "needle-lift",
            "--no-log",
            "--policy",
            &policy,
        ])
        .args(["--topics", &name])
        .args(SCENE)
        .args(plain)
        .output()
        .unwrap();
    let said = tests::stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    let awaited = "camera endoscope has published no frame on topics";
    assert!(said.contains(awaited), "{said}");
    let (code, said) = others.ends();
    assert!(code == Some(2) && said.contains(refused), "{said}");
    row_at_rest(
        "cameras-scene",
        "`trocar cameras` of another scene than the run's",
        &format!("`{refused}`, `{awaited}`"),
        "both end, exit codes 2 and 1",
    );

    let first = Beside::cameras(&name, &plain);
    let more = [&plain[..], &["--topics", &name]].concat();
    let mut run = Run::start_with("faults-scene", &policy, 1, None, &more);
    let injected = run.tick();
    drop(first);
    run.stops();
    let others = Beside::cameras(&name, &[&plain[..], &["--needle", "N3"]].concat());
    let (code, said) = others.ends();
    assert!(code == Some(2) && said.contains(refused), "{said}");
    run.until("it is held", |seen| {
        assert!(!seen.enabled && !seen.moves);
        true
    });
    let _right = Beside::cameras(&name, &plain);
    run.until("it goes on", |seen| seen.enabled && seen.moves);
    let (log, _) = run.interrupted();
    let taken = Taken::stops(&log, injected);
    let again = taken.again.unwrap();
    row(
        "cameras-scene-later",
        "`trocar cameras` is killed, and others come that draw another scene, `restarts = 1`",
        &format!("`has published no frame for 2 s`, `{refused}`"),
        &taken,
        &format!(
            "the others end, exit code 2; with the right ones the arm goes on {again} ticks after its rest"
        ),
    );
}

/// What a policy of a later version of this program says first.
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/policy_hello/2")]
struct LaterHello(PolicyHello);

impl Message for LaterHello {
    const TOPIC: &'static str = PolicyHello::TOPIC;
}

/// A policy of another version of the program is refused by the name of the topic, before an arm
/// has torque.
#[test]
fn a_policy_of_another_version_is_refused_by_its_topic() {
    let _turn = alone();
    let name = topics("version");
    let node = TopicNode::join(&name).unwrap();
    let later = Topic::<LaterHello>::publisher(&node, "psm1").unwrap();
    later.publish(&LaterHello(PolicyHello::default())).unwrap();
    let output = trocar()
        .args(["run", "--task", "needle-lift", "--no-log", "--policy"])
        .arg(format!("external:{name}"))
        .output()
        .unwrap();
    let said = tests::stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    let seen = format!("'trocar/{name}/psm1/policy_hello' carries another type");
    assert!(said.contains(&seen), "{said}");
    row_at_rest(
        "policy-version",
        "an external policy of another version of the messages",
        "`psm1/policy_hello' carries another type`",
        "exit code 1",
    );
}

/// A policy process that is killed is not started again with what has come into its checkpoint's
/// folder meanwhile, however many restarts are left.
#[test]
fn a_checkpoint_that_has_changed_is_not_started_again() {
    let _turn = alone();
    let folder = scratch("faults-checkpoint");
    for entry in fs::read_dir(repository().join(CHECKPOINT)).unwrap() {
        let from = entry.unwrap().path();
        fs::copy(&from, folder.join(from.file_name().unwrap())).unwrap();
    }
    let mut run = Run::start("faults-checkpoint-run", folder.to_str().unwrap(), 2, None);
    // As training does that writes a newer one: all loads as before, but for the last weight.
    let (weights, newer) = (
        folder.join("model.safetensors"),
        folder.join("model.safetensors.part"),
    );
    let mut bytes = fs::read(&weights).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&newer, bytes).unwrap();
    fs::rename(newer, weights).unwrap();
    let injected = run.tick();
    send("-KILL", run.policy_process());
    run.hears("it is started again in 0.2 s (1 of 2)");
    let (code, result) = run.end();
    let result = result.unwrap();
    let reason = result["reason"].as_str().unwrap();
    let seen = "model.safetensors has changed since the run began with it";
    assert!(reason.contains(seen) && code == Some(1), "{reason}");
    row(
        "policy-changed",
        "policy process killed, other weights in its checkpoint's folder by then, `restarts = 2`",
        &format!("`{seen}`"),
        &Taken::stops(&run.checked_log(), injected),
        "the run ends, exit code 1",
    );
}
