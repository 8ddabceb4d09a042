//! `trocar monitor` in a pseudo-terminal: it shows a run that has no console, and its keys steer
//! it; what the run refuses is on the screen.

use std::io::{Read as _, Write as _};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};

use tests::{json, stderr, trocar};
use trocar::rt::sleep_ns;

use crate::run::{PATIENCE, SLOW_MOTION};

/// Ended with its test.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _reaped = self.0.wait();
    }
}

/// What a terminal was sent so far.
#[derive(Clone, Default)]
struct Sent(Arc<Mutex<String>>);

impl Sent {
    fn wait_for(&self, text: &str) {
        for _ in 0..PATIENCE.as_millis() / 20 {
            if self.0.lock().unwrap().contains(text) {
                return;
            }
            sleep_ns(20_000_000);
        }
        panic!("{text} never came: {}", self.0.lock().unwrap());
    }
}

#[test]
fn the_monitor_shows_a_run_and_its_keys_steer_it() {
    let sockets = std::env::temp_dir().join(format!("co-monitor-{}", std::process::id()));
    std::fs::create_dir_all(&sockets).unwrap();
    let at = |mut command: Command| {
        command.env("XDG_RUNTIME_DIR", &sockets);
        command.env("TROCAR_SLOW_MOTION", SLOW_MOTION.to_string());
        command
    };
    let mut run = at(trocar());
    run.args(["run", "--task", "needle-lift", "--policy", "noop"]);
    run.args(["--set", "scene.episode.time_limit_s=300", "--json"]);
    let result = sockets.join("run.json");
    run.arg(&result);
    let mut run = Ended(
        run.stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    );
    let status = || at(trocar()).arg("status").output().unwrap();
    while !String::from_utf8_lossy(&status().stdout).contains("ENABLED") {
        assert!(run.0.try_wait().unwrap().is_none(), "the run has ended");
    }
    let no_terminal = at(trocar())
        .arg("monitor")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert_eq!(no_terminal.status.code(), Some(2));
    assert!(stderr(&no_terminal).contains("monitor needs a terminal"));
    let program = trocar().get_program().to_owned();
    let program = program.to_str().unwrap();
    let process = run.0.id();
    let mut monitor = at(Command::new("script"));
    monitor.env("TERM", "xterm-256color").args(["-qec"]);
    monitor.arg(format!(
        "stty cols 100 rows 30; exec {program} monitor --run {process}"
    ));
    monitor
        .arg("/dev/null")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped());
    let mut monitor = Ended(monitor.spawn().unwrap());
    let sent = Sent::default();
    let mut from = monitor.0.stdout.take().unwrap();
    let to = sent.clone();
    let reader = std::thread::spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(count @ 1..) = from.read(&mut bytes) {
            let text = String::from_utf8_lossy(&bytes[..count]);
            to.0.lock().unwrap().push_str(&text);
        }
    });
    sent.wait_for("ENABLED");
    sent.wait_for("insertion");
    let mut keys = monitor.0.stdin.take().unwrap();
    // A task judges this run.
    keys.write_all(b"y").unwrap();
    sent.wait_for("judges");
    keys.write_all(b"p").unwrap();
    sent.wait_for("PAUSED");
    keys.write_all(b"s").unwrap();
    // The run ends, and the monitor with it.
    let _code = run.0.wait().unwrap();
    assert_eq!(json(&result)["reason"], "stopped by the operator");
    assert!(monitor.0.wait().unwrap().success());
    reader.join().unwrap();
    let _removed = std::fs::remove_dir_all(&sockets);
}
