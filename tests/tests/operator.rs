//! The operator: verbs that steer a run in real time over its socket, and what they may not do.
#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs::{self, Permissions};
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use tests::{json, scratch, stderr, trocar};
use trocar::rt::{MonotonicClock, sleep_ns};
use trocar_log::RunLog;
use trocar_log::replay::replay;
use trocar_log::verify::verify;

/// Anything takes less time than this, ns.
const PATIENCE_NS: u64 = 120_000_000_000;

/// A run in real time whose folder of sockets is its own. Sockets have short paths.
struct Run {
    process: Child,
    sockets: PathBuf,
    folder: PathBuf,
}

impl Run {
    fn start(test: &str) -> Self {
        let folder = scratch(test);
        let sockets = std::env::temp_dir().join(format!("op-{test}-{}", std::process::id()));
        fs::create_dir_all(&sockets).unwrap();
        let process = trocar()
            .env("XDG_RUNTIME_DIR", &sockets)
            .args([
                "run",
                "--task",
                "needle-lift",
                "--policy",
                "random",
                "--seed",
                "7",
            ])
            .args(["--set", "scene.episode.time_limit_s=600"])
            .arg("--log")
            .arg(folder.join("run.mcap"))
            .arg("--json")
            .arg(folder.join("run.json"))
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let mut run = Self {
            process,
            sockets,
            folder,
        };
        run.wait_for("ENABLED");
        run
    }

    fn command(&self, verb: &[&str]) -> (i32, String, String) {
        let output = operator(&self.sockets, verb);
        let text = String::from_utf8(output.stdout.clone()).unwrap();
        (output.status.code().unwrap(), text, stderr(&output))
    }

    fn wait_for(&mut self, wanted: &str) {
        let clock = MonotonicClock::new();
        loop {
            assert_eq!(self.process.try_wait().unwrap(), None, "ended too early");
            let (_, answer, _) = self.command(&["status"]);
            if answer.contains(wanted) {
                return;
            }
            assert!(clock.now().0 < PATIENCE_NS, "no {wanted} but {answer}");
            sleep_ns(20_000_000);
        }
    }

    fn socket(&self) -> PathBuf {
        let mut folder = fs::read_dir(&self.sockets).unwrap();
        let own = folder.next().unwrap().unwrap().path();
        own.join(format!("run-{}.sock", self.process.id()))
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
        let _removed = fs::remove_dir_all(&self.sockets);
    }
}

fn operator(sockets: &Path, verb: &[&str]) -> std::process::Output {
    let mut command: Command = trocar();
    command.env("XDG_RUNTIME_DIR", sockets).args(verb);
    command.output().unwrap()
}

#[test]
fn verbs_pause_resume_slow_down_and_stop_a_run() {
    let _turn = tests::alone();
    let mut run = Run::start("operator-verbs");
    let ok = |verb: &[&str], wanted: &str| {
        let (code, answer, _) = run.command(verb);
        assert_eq!(code, 0, "{verb:?}: {answer}");
        assert!(answer.contains(wanted), "{verb:?}: {answer}");
    };
    ok(&["pause"], "psm1 PAUSED homed");
    ok(&["home"], "psm1 PAUSED");
    let refused = run.command(&["enable"]);
    assert_eq!(refused.0, 1);
    assert!(
        refused
            .1
            .starts_with("error: enable does not apply in PAUSED")
    );
    ok(&["speed", "30"], "psm1 PAUSED");
    ok(&["resume"], "psm1 ENABLED");
    ok(&["disable"], "psm1 DISABLED");
    ok(&["enable"], "psm1 ENABLED");
    let (code, answer, _) = run.command(&["status", "--json"]);
    let status: serde_json::Value = serde_json::from_str(&answer).unwrap();
    assert_eq!((code, &status["ok"]), (0, &true.into()));
    assert_eq!(status["arms"][0]["state"], "ENABLED");
    assert!(status["arms"][0]["fault"].is_null());
    let (code, answer, _) = run.command(&["clear"]);
    assert_eq!(code, 1, "{answer}");
    let (code, answer, _) = run.command(&["mark", "success", "--label", "third try"]);
    assert_eq!(code, 1, "{answer}");
    let judged = "error: this run takes no mark: it has a task that judges it";
    assert!(answer.starts_with(judged), "{answer}");

    let socket = run.socket();
    assert_eq!(fs::metadata(&socket).unwrap().mode() & 0o777, 0o600);
    ok(&["stop"], "ok");
    assert_eq!(run.process.wait().unwrap().code(), Some(1));
    assert!(!socket.exists());
    let result = json(&run.folder.join("run.json"));
    assert_eq!(result["reason"], "stopped by the operator");
    let log = RunLog::open(&run.folder.join("run.mcap")).unwrap();
    let replayed = replay(&log).unwrap();
    assert!(replayed.identical, "{replayed:?}");
    let verified = verify(&log).unwrap();
    assert!(verified.ok, "{:?}", verified.violations);
    let (code, _, error) = run.command(&["status"]);
    assert_eq!(code, 2);
    assert!(
        error.contains("no run in real time of this user listens"),
        "{error}"
    );
}

#[test]
fn lines_that_are_no_commands_move_nothing() {
    let _turn = tests::alone();
    let run = Run::start("operator-lines");
    let mut stream = UnixStream::connect(run.socket()).unwrap();
    let mut answers = BufReader::new(stream.try_clone().unwrap()).lines();
    // One after another in one piece, a piece of a line first.
    stream.write_all(b"sta").unwrap();
    sleep_ns(200_000_000);
    stream
        .write_all(b"tus\nspeed 0\nPAUSE\nmark good\n\xff\xfe\nstatus json\n")
        .unwrap();
    let mut next = || answers.next().unwrap().unwrap();
    assert!(next().starts_with("ok; "));
    for _ in 0..4 {
        let answer = next();
        assert!(answer.contains("is no command: status, enable"), "{answer}");
    }
    assert!(next().starts_with("{\"ok\":true"));
    // A line without an end is not kept.
    let _gone = stream.write_all(&vec![b'x'; 100_000]);
    let answer = next();
    assert!(answer.contains("at most 1000 bytes"), "{answer}");
    // Whoever says nothing holds up nobody.
    let _silent: Vec<_> = (0..4).map(|_| UnixStream::connect(run.socket())).collect();
    assert!(run.command(&["status"]).1.contains("psm1 ENABLED"));
}

#[test]
fn a_folder_that_others_may_enter_is_refused() {
    let base = std::env::temp_dir().join(format!("op-open-{}", std::process::id()));
    let own = base.join(format!(
        "trocar-{}",
        fs::metadata("/proc/self").unwrap().uid()
    ));
    fs::create_dir_all(&own).unwrap();
    fs::set_permissions(&own, Permissions::from_mode(0o755)).unwrap();
    let output = operator(&base, &["status"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("mode 0700"), "{}", stderr(&output));
    fs::remove_dir_all(&base).unwrap();
}
