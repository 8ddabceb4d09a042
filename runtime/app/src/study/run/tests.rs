//! Runs of a study whose verbs are a script, so that they end when the test says so.

use std::cell::RefCell;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use hal::config::Source;

use super::super::commands::Abilities;
use super::super::file::StudyFile;
use super::super::materials::Materials;
use super::super::store::{State, Store};
use super::super::{expand, work::Workshop};
use super::*;
use crate::session::scratch::Scratch;

/// A training with the recording that it reads and the evaluation that needs it.
const STUDY: &str = "title = \"One training\"\n\
    [training]\ndevice = \"cpu\"\nthreads = 1\n\
    [evaluation]\ndevice = \"cpu\"\n\
    [task.needle-lift]\n\
    [network.act]\npolicy = \"act-pc\"\npreset = \"small\"\ncameras = \"single\"\nsteps = 10\n\
    [recording.plain]\nseed = 0\n\
    [[grid]]\nname = \"success\"\ntitle = \"Success\"\ntasks = [\"needle-lift\"]\nnetworks = [\"act\"]\n\
    recordings = [\"plain\"]\ndemonstrations = [1]\ntraining_seeds = [1]\ntrials = 1\nfirst_seed = 1000\n\
    columns = \"network\"\n";

/// What a study sees of its verbs. A training writes a line into its state each time that it is
/// begun or resumed; where the file `hold` lies beside the script it then waits for SIGINT,
/// otherwise the state becomes its weights.
const VERBS: &str = r#"#!/bin/sh
verb=$1
while [ $# -gt 0 ]; do
    case $1 in
    --out | --resume) out=$2 ;;
    --policy) policy=$2 ;;
    --json) json=$2 ;;
    esac
    shift
done
case $verb in
record)
    mkdir -p "$out" && echo demonstration >"$out/data"
    echo '{"episodes": 1}' >"$json"
    ;;
train)
    trap 'exit 1' INT
    mkdir -p "$out" && echo begun >>"$out/training_state.safetensors"
    while [ -e "$(dirname "$0")/hold" ]; do sleep 0.02; done
    mv "$out/training_state.safetensors" "$out/model.safetensors"
    echo '{"steps": 10}' >"$json"
    ;;
eval)
    [ -f "$policy/model.safetensors" ] || exit 1
    echo '{"trials": 1, "successes": 1, "episodes": [{"seed": 1000}], "weights_sha256": "ab12"}' >"$json"
    ;;
esac
"#;

/// A folder for the test `name`, with the script in it.
fn folder(name: &str) -> Scratch {
    let folder = Scratch::folder(&format!("run-{name}"));
    let (text, verbs) = (folder.join("verbs.txt"), folder.join("verbs"));
    fs::write(&text, VERBS).unwrap();
    // Written by another process: a file that this one has open for writing, in any thread's child,
    // can't be executed.
    let mut install = Command::new("install");
    let installed = install
        .args(["-m", "755"])
        .args([&text, &verbs])
        .status()
        .unwrap();
    assert!(installed.success());
    folder
}

/// The study, of which every cell is run.
struct Whole {
    file: StudyFile,
    plan: Plan,
    store: Store,
    executable: PathBuf,
    machine: Machine,
}

impl Whole {
    fn new(folder: &Path) -> Self {
        let source = Source::embedded("study.toml", STUDY);
        let file: StudyFile = source.parse().unwrap();
        file.check(&source).unwrap();
        let path = Path::new("study.toml");
        let materials = Materials::gather(&file, path, "code".to_owned()).unwrap();
        let plan = expand(&file, STUDY, &materials).unwrap();
        assert_eq!(plan.cells.len(), 3);
        Self {
            file,
            plan,
            store: Store::new(folder.join("results")),
            executable: folder.join("verbs"),
            machine: Machine {
                cores: 1,
                gpus: Vec::new(),
            },
        }
    }

    /// Calls `with` with a runner of it, and gives what was said.
    fn with(&self, with: impl FnOnce(&mut Runner<'_>)) -> String {
        let workshop = Workshop {
            store: &self.store,
            file: &self.file,
            executable: self.executable.clone(),
            executable_sha256: String::new(),
            host: String::new(),
            abilities: Abilities::default(),
        };
        let said = RefCell::new(String::new());
        let mut say = |line: &str| *said.borrow_mut() += &format!("{line}\n");
        let part = self.plan.part(None);
        with(&mut Runner::new(
            &self.plan,
            &part,
            &workshop,
            &self.machine,
            &mut say,
        ));
        said.into_inner()
    }

    /// Runs it to its end, in which `made` cells are made and none fails.
    fn ends(&self, made: usize) -> String {
        self.with(|runner| {
            runner.run().unwrap();
            let (found, failed) = (3 - made, &runner.outcome.failed);
            assert_eq!((runner.outcome.made, runner.outcome.found), (made, found));
            assert!(failed.is_empty(), "{failed:?}");
        })
    }

    fn address(&self, kind: Kind) -> Address {
        let mut cells = self.plan.cells.iter();
        let cell = cells.find(|cell| cell.job.kind() == kind).unwrap();
        cell.address.clone()
    }
}

/// Turns `runner` until `is_so`.
fn turn_until(runner: &mut Runner<'_>, is_so: impl Fn(&Runner<'_>) -> bool) {
    for _look in 0..3000 {
        runner.poll().unwrap();
        if !runner.outcome.interrupted {
            runner.start().unwrap();
        }
        if is_so(runner) {
            return;
        }
        rt::sleep_ns(10_000_000);
    }
    panic!("it never is");
}

/// A training made anew that is interrupted keeps its earlier result and goes on.
#[test]
fn interrupted_retraining_keeps_the_earlier_result() {
    let folder = folder("anew");
    let whole = Whole::new(&folder);
    whole.ends(3);
    let training = whole.address(Kind::Training);
    let cell = whole.store.cell(Kind::Training, &training);
    let state = || whole.store.state(Kind::Training, &training);
    let checkpoint = whole.store.product(Kind::Training, &training);
    let names = ["cell.json", "result.json"];
    let earlier = names.map(|name| fs::read(cell.join(name)).unwrap());

    // Its weights are gone, and an evaluation needs them.
    fs::remove_dir_all(&checkpoint).unwrap();
    let evaluation = whole.address(Kind::Evaluation);
    fs::remove_dir_all(whole.store.cell(Kind::Evaluation, &evaluation)).unwrap();
    assert!(matches!(state(), State::Bare(_)), "{:?}", state());
    fs::write(folder.join("hold"), "").unwrap();
    let kept = checkpoint.join("training_state.safetensors");
    let said = whole.with(|runner| {
        turn_until(runner, |_| kept.is_file());
        runner.outcome.interrupted = true;
        runner.running[0].running.interrupt();
        turn_until(runner, |runner| runner.running.is_empty());
        assert!(runner.outcome.failed.is_empty());
    });
    assert!(said.ends_with(": interrupted\n"), "{said}");
    assert_eq!(state(), State::Begun);
    assert_eq!(fs::read_to_string(&kept).unwrap(), "begun\n");
    let aside = names.map(|name| fs::read(cell.join(format!("{name}.old"))).unwrap());
    assert!(aside == earlier, "the earlier result lies aside");

    fs::remove_file(folder.join("hold")).unwrap();
    let said = whole.ends(2);
    assert!(said.contains(": goes on\n"), "{said}");
    let weights = fs::read_to_string(checkpoint.join("model.safetensors"));
    assert_eq!(
        weights.unwrap(),
        "begun\nbegun\n",
        "one training in two attempts"
    );
    assert!(matches!(state(), State::Done(_)), "{:?}", state());
    let evaluated = whole.store.state(Kind::Evaluation, &evaluation);
    let State::Done(evaluated) = evaluated else {
        panic!("{evaluated:?}");
    };
    assert_eq!(evaluated.weights_sha256.as_deref(), Some("ab12"));
    assert!(!cell.join("cell.json.old").exists() && !cell.join("result.json.old").exists());
}

/// A training made anew that is interrupted before it kept anything is done as before.
#[test]
fn retraining_interrupted_at_once_starts_again() {
    let folder = folder("bare");
    let whole = Whole::new(&folder);
    whole.ends(3);
    let training = whole.address(Kind::Training);
    let result = whole.store.result(Kind::Training, &training);
    let earlier = fs::read(&result).unwrap();
    fs::remove_dir_all(whole.store.product(Kind::Training, &training)).unwrap();
    let lock = whole.store.lock(Kind::Training, &training).unwrap();
    whole.store.set_aside(Kind::Training, &training).unwrap();
    assert_eq!(whole.store.state(Kind::Training, &training), State::Begun);
    drop(lock);
    // Nothing needs its weights, so it is only looked at.
    whole.store.put_back(Kind::Training, &training).unwrap();
    let state = whole.store.state(Kind::Training, &training);
    assert!(matches!(state, State::Bare(_)), "{state:?}");
    assert_eq!(fs::read(&result).unwrap(), earlier);
    whole.ends(0);
}

/// A study that keeps no recordings removes one's data when its last training is done, is done
/// then, and makes it anew where a training lost its weights.
#[test]
fn recordings_go_when_nothing_needs_them() {
    let folder = folder("dropped");
    let mut whole = Whole::new(&folder);
    whole.file.run.keep_recordings = false;
    let said = whole.ends(3);
    assert!(said.contains("its data is removed"), "{said}");
    let recording = whole.address(Kind::Recording);
    let data = whole.store.product(Kind::Recording, &recording);
    assert!(!data.exists());
    assert_eq!(whole.ends(0), "");
    let training = whole.address(Kind::Training);
    fs::remove_dir_all(
        whole
            .store
            .cell(Kind::Evaluation, &whole.address(Kind::Evaluation)),
    )
    .unwrap();
    fs::remove_dir_all(whole.store.product(Kind::Training, &training)).unwrap();
    whole.ends(3);
    assert!(!data.exists());
    whole.file.run.keep_recordings = true;
    fs::remove_dir_all(whole.store.cell(Kind::Training, &training)).unwrap();
    whole.ends(2);
    assert!(data.exists());
}
