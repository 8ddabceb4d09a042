//! The same seed gives the same bits in every task: twice in one process, in another process, with
//! and without cameras.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::process::Command;

use tch::Device;
use tests::{json, scratch, stderr, trocar};
use trocar::session::episode::{Episode, EpisodeObserver, NoObserver, Timing};
use trocar::session::tasks;
use trocar::session::{PolicyChoice, Setup};
use trocar_tasks::simulation::{Rendering, Simulation};

/// Long enough for every expert to be well on its way.
const TICKS: u64 = 1_200;
/// Long enough for every expert to have taken hold of something.
const WATCHED_TICKS: u64 = 3_600;
/// Images are small, so that there can be as many as there are policy steps.
const SIDE_PIXELS: u32 = 32;
/// Names the task and the seed that a process started by the test below is to run.
const CHILD: &str = "TROCAR_DETERMINISM_CHILD";
/// What its answer begins with.
const ANSWER: &str = "digest ";

/// Looks through all cameras at every policy step.
struct Onlooker(Vec<String>);

impl EpisodeObserver for Onlooker {
    fn cameras(&self) -> Vec<String> {
        self.0.clone()
    }
}

/// Digest of the commands and of the physical state after the expert's first `ticks`.
fn digest(task: &str, seed: u64, ticks: u64, rendering: Rendering) -> String {
    let mut setup = Setup::load(task, None, &PolicyChoice::Expert).unwrap();
    for camera in &mut setup.task.cameras {
        (camera.width, camera.height) = (SIDE_PIXELS, SIDE_PIXELS);
    }
    let mut simulation = Simulation::new(&setup.task, seed, rendering).unwrap();
    let episode = Episode {
        simulation: &mut simulation,
        controller: &mut setup.controller().unwrap(),
        source: &mut setup
            .source(&PolicyChoice::Expert, seed, Device::Cpu)
            .unwrap(),
    };
    let timing = Timing {
        latency: trocar::session::latency::Latency::fixed(0),
        tick_limit: ticks,
    };
    let end = match rendering {
        Rendering::Off => episode.run(&timing, &mut NoObserver),
        Rendering::On => episode.run(&timing, &mut Onlooker(setup.camera_names())),
    };
    let end = end.unwrap();
    assert_eq!(end.tally.ticks(), ticks, "{task} ended early");
    let (commands, state) = (end.tally.command_hash(), simulation.state_hash());
    format!("{commands} {state:016x}")
}

/// The same, worked out by another process.
fn digest_of_another_process(task: &str, seed: u64) -> String {
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "--nocapture", "answer_of_another_process"])
        .env(CHILD, format!("{task} {seed}"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let text = String::from_utf8(output.stdout).unwrap();
    let (_, answer) = text.split_once(ANSWER).unwrap();
    answer.lines().next().unwrap().to_owned()
}

#[test]
#[expect(clippy::print_stdout, reason = "this is how the other process answers")]
fn answer_of_another_process() {
    let Ok(asked) = std::env::var(CHILD) else {
        return;
    };
    let (task, seed) = asked.split_once(' ').unwrap();
    let digest = digest(task, seed.parse().unwrap(), TICKS, Rendering::Off);
    println!("{ANSWER}{digest}");
}

#[test]
fn every_task_is_the_same_twice_in_one_process_and_in_another() {
    for task in tasks::names() {
        let first = digest(task, 3, TICKS, Rendering::Off);
        assert_eq!(first, digest(task, 3, TICKS, Rendering::Off), "{task}");
        assert_eq!(first, digest_of_another_process(task, 3), "{task}");
        assert_ne!(first, digest(task, 4, TICKS, Rendering::Off), "{task}");
    }
}

#[test]
fn every_task_is_the_same_with_and_without_cameras() {
    for task in tasks::names() {
        let seen = digest(task, 3, WATCHED_TICKS, Rendering::On);
        let unseen = digest(task, 3, WATCHED_TICKS, Rendering::Off);
        assert_eq!(seen, unseen, "{task}");
    }
}

#[test]
fn every_task_ends_the_same_in_two_runs_of_the_program() {
    let folder = scratch("determinism");
    for task in tasks::names() {
        let run = |name: &str| {
            let result = folder.join(format!("{task}-{name}.json"));
            let mut command = trocar();
            command.args(["run", "--task", task, "--policy", "expert", "--lockstep"]);
            let output = command
                .args(["--seed", "3", "--json"])
                .arg(&result)
                .output()
                .unwrap();
            // An expert may miss: the hash is what counts here.
            assert!(matches!(output.status.code(), Some(0 | 1)), "{output:?}");
            let result = json(&result);
            (result["command_hash"].clone(), result["ticks"].clone())
        };
        let first = run("first");
        assert!(first.0.is_string(), "{task}");
        assert_eq!(first, run("second"), "{task}");
    }
}
