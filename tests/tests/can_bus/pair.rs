//! `trocar drives` and a run beside them, as processes that end with the test.

use std::env;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use tests::{json, repository, scratch, trocar};
use trocar::rt::{MonotonicClock, sleep_ns};

const MS_NS: u64 = 1_000_000;

/// Anything takes less time than this, ns.
const PATIENCE_NS: u64 = 240_000 * MS_NS;

/// How much slower these processes live, so that a kernel inside a kernel on a busy machine keeps
/// up with their buses.
const SLOW_MOTION: u64 = 15;

/// The same of processes that only ask and answer, without a SYNC.
const SLOW_TALK: u64 = 5;

/// Lets so many milliseconds of the time of [`Process::start`]'s processes pass.
pub(crate) fn pass_ms(ms: u64) {
    sleep_ns(ms * MS_NS * SLOW_MOTION);
}

pub(crate) fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let clock = MonotonicClock::new();
    while !holds() {
        assert!(clock.now().0 < PATIENCE_NS, "waited in vain until {what}");
        sleep_ns(20 * MS_NS);
    }
}

/// Names the run's topics to a test that plays one of its processes; unset in an ordinary test run.
pub(crate) const TOPICS: &str = "TROCAR_TEST_TOPICS";

/// A `trocar` process with files for what it says and what comes of it.
pub(crate) struct Process {
    child: Child,
    said: PathBuf,
    result: PathBuf,
}

impl Process {
    pub(crate) fn start(folder: &Path, name: &str, arguments: &[&str]) -> Self {
        Self::slowed(SLOW_MOTION, folder, name, arguments)
    }

    /// This test executable once more, for the test `role`, which plays a process of the run on
    /// `topics`.
    pub(crate) fn playing(folder: &Path, role: &str, topics: &str) -> Self {
        let mut command = Command::new(env::current_exe().unwrap());
        command.args(["--exact", role, "--nocapture"]);
        command.env(TOPICS, topics);
        Self::spawned(
            SLOW_MOTION,
            folder,
            &format!("{role}.out").replace("::", "-"),
            command,
        )
    }

    fn slowed(times: u64, folder: &Path, name: &str, arguments: &[&str]) -> Self {
        let mut command = trocar();
        command.args(arguments).arg("--json");
        command.arg(folder.join(format!("{name}.json")));
        Self::spawned(times, folder, name, command)
    }

    fn spawned(times: u64, folder: &Path, name: &str, mut command: Command) -> Self {
        let said = folder.join(format!("{name}.txt"));
        let result = folder.join(format!("{name}.json"));
        let child = command
            .env("TROCAR_SLOW_MOTION", times.to_string())
            .env("XDG_STATE_HOME", folder)
            .stdout(Stdio::null())
            .stderr(File::create(&said).unwrap())
            .spawn()
            .unwrap();
        Self {
            child,
            said,
            result,
        }
    }

    fn said(&self) -> String {
        fs::read_to_string(&self.said).unwrap()
    }

    /// Waits until it has said `text`.
    pub(crate) fn await_word(&mut self, text: &str) {
        let said = self.said.clone();
        self.until(&format!("it says {text:?}"), || {
            fs::read_to_string(&said).unwrap().contains(text)
        });
    }

    /// Waits until `holds`, which must come before its end.
    pub(crate) fn until(&mut self, what: &str, mut holds: impl FnMut() -> bool) {
        let clock = MonotonicClock::new();
        loop {
            let ended = self.child.try_wait().unwrap();
            if holds() {
                return;
            }
            let said = || self.said();
            assert!(ended.is_none(), "it ended before {what}: {}", said());
            assert!(
                clock.now().0 < PATIENCE_NS,
                "waited in vain until {what}: {}",
                said()
            );
            sleep_ns(20 * MS_NS);
        }
    }

    pub(crate) fn signal(&self, signal: &str) {
        let id = self.child.id().to_string();
        let sent = Command::new("kill").args([signal, &id]).status().unwrap();
        assert!(sent.success());
    }

    fn code(&mut self) -> Option<i32> {
        let mut code = None;
        until("a process ends", || {
            code = self.child.try_wait().unwrap();
            code.is_some()
        });
        code.and_then(|status| status.code())
    }

    /// Waits for its end: the exit code and what it said.
    pub(crate) fn wait(mut self) -> (Option<i32>, String) {
        (self.code(), self.said())
    }

    /// Waits for its end: the exit code and the result.
    pub(crate) fn end(mut self) -> (Option<i32>, serde_json::Value) {
        let code = self.code();
        let said = self.said();
        assert!(self.result.exists(), "no result: {said}");
        (code, json(&self.result))
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _gone = self.child.kill();
        let _reaped = self.child.wait();
    }
}

/// Drives and, beside them, a run of the expert.
pub(crate) struct Pair {
    folder: PathBuf,
    config: String,
    slow_motion: u64,
    pub(crate) drives: Process,
}

impl Pair {
    /// Drives whose nodes and buses are the shipped ones after `changes`.
    pub(crate) fn start(test: &str, changes: &[(&str, &str)], faults: &[&str]) -> Self {
        Self::slowed(SLOW_MOTION, test, changes, faults)
    }

    /// [`Self::start`] for a cycle of 1 ms, in which a pause of 4 ms is a fault: slower still.
    pub(crate) fn fast(test: &str, changes: &[(&str, &str)]) -> Self {
        Self::slowed(2 * SLOW_MOTION, test, changes, &[])
    }

    /// The shipped drives, for runs that end before there is a SYNC.
    pub(crate) fn talking(test: &str) -> Self {
        Self::slowed(SLOW_TALK, test, &[], &[])
    }

    fn slowed(slow_motion: u64, test: &str, changes: &[(&str, &str)], faults: &[&str]) -> Self {
        let folder = scratch(test);
        let mut text = fs::read_to_string(repository().join("config/can.toml")).unwrap();
        for (from, to) in changes {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, to);
        }
        let file = folder.join("can.toml");
        fs::write(&file, text).unwrap();
        let config = file.to_str().unwrap().to_owned();
        let mut arguments = vec!["drives", "--config", &config, "--topics", test];
        for fault in faults {
            arguments.extend(["--fault", fault]);
        }
        let mut drives = Process::slowed(slow_motion, &folder, "drives", &arguments);
        drives.await_word("psm1 is nodes 1 2 3 4 5 6 7");
        Self {
            folder,
            config,
            slow_motion,
            drives,
        }
    }

    /// The expert's run on these drives.
    pub(crate) fn run(&self, policy: &str) -> Process {
        let log = self.log();
        let topics = self.folder.file_name().unwrap().to_str().unwrap();
        let arguments = [
            "run",
            "--task",
            "needle-lift",
            "--policy",
            policy,
            "--backend",
            "can",
            "--can-config",
            &self.config,
            "--topics",
            topics,
            "--log",
            log.to_str().unwrap(),
        ];
        Process::slowed(self.slow_motion, &self.folder, "run", &arguments)
    }

    /// Lets so many milliseconds of their time pass.
    pub(crate) fn pass_ms(&self, ms: u64) {
        sleep_ns(ms * MS_NS * self.slow_motion);
    }

    pub(crate) fn log(&self) -> PathBuf {
        self.folder.join("run.mcap")
    }

    /// Ends the drives: what they report.
    pub(crate) fn end(self) -> serde_json::Value {
        self.drives.signal("-INT");
        let (code, result) = self.drives.end();
        assert_eq!(code, Some(0));
        result
    }
}
