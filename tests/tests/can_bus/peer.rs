//! Other programs on the bus, ended with the test that started them.

use std::fs::{self, File};
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Output, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tests::{repository, trocar};
use trocar::rt::sleep_ns;

/// A bus carries everybody's frames: one test at a time.
///
/// # Panics
/// Without a CAN interface: where there is no bus no test of it may pass.
pub(crate) fn alone() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    let interfaces = fs::read_to_string("/proc/self/net/dev").unwrap();
    for name in ["vcan0", "vcan1", "vcan2"] {
        assert!(
            interfaces.contains(&format!("{name}:")),
            "there is no CAN interface {name} here: run `make test-can`, or this under .ci/with-vcan, which makes one"
        );
    }
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Everything that a finished command printed.
pub(crate) fn said(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

/// Sockets that hear everything on the first bus.
fn receivers() -> usize {
    fs::read_to_string("/proc/net/can/rcvlist_all")
        .unwrap()
        .lines()
        .filter(|line| line.split_whitespace().next() == Some("vcan0"))
        .count()
}

/// Waits until there are more of them than `before`.
fn await_receiver(before: usize) {
    let opened = (0..6000).any(|_hundredth| {
        let more = receivers() > before;
        if !more {
            sleep_ns(10_000_000);
        }
        more
    });
    assert!(opened, "the program opened no socket");
}

/// A program on the bus.
pub(crate) struct Peer {
    process: Child,
    /// What it says beside its results, if that is listened to.
    aside: Option<BufReader<ChildStderr>>,
}

/// Where [`Peer::trocar`] keeps logs that nobody asked for.
pub(crate) fn state_folder() -> PathBuf {
    std::env::temp_dir().join("trocar-peer-state")
}

impl Peer {
    /// A program that prints what it hears, and has its socket open when this returns.
    pub(crate) fn listening(program: &str, arguments: &[&str]) -> Self {
        let before = receivers();
        let process = Command::new(program)
            .args(arguments)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        await_receiver(before);
        Self {
            process,
            aside: None,
        }
    }

    /// `candump` on the first bus, writing its log to `file`.
    pub(crate) fn logging(file: &Path) -> Self {
        let before = receivers();
        let process = Command::new("candump")
            .args(["-L", "vcan0"])
            .stdout(File::create(file).unwrap())
            .spawn()
            .unwrap();
        await_receiver(before);
        Self {
            process,
            aside: None,
        }
    }

    /// Drives with these node ids, in their initial state, when this returns.
    pub(crate) fn drives(nodes: &str) -> Self {
        let mut process = Command::new("python3")
            .arg(repository().join("tests/can/peer_drive.py"))
            .arg("--eds")
            .arg(repository().join("tests/can/peer_drive.eds"))
            .args(["--nodes", nodes])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.as_mut().unwrap())
            .read_line(&mut line)
            .unwrap();
        assert_eq!(line, "ready\n", "the drives can be spoken to");
        Self {
            process,
            aside: None,
        }
    }

    /// `trocar` with these arguments, `slow` times slower than real time, when it has said a line
    /// that has `ready` in it.
    pub(crate) fn trocar(slow: u64, arguments: &[&str], ready: &str) -> Self {
        let mut process = trocar()
            .env("TROCAR_SLOW_MOTION", slow.to_string())
            .env("XDG_STATE_HOME", state_folder())
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let aside = process.stderr.take().map(BufReader::new);
        let mut peer = Self { process, aside };
        peer.await_word(ready);
        peer
    }

    /// Waits until it says a line that has `word` in it.
    pub(crate) fn await_word(&mut self, word: &str) {
        let mut said = String::new();
        let aside = self.aside.as_mut().unwrap();
        while !said.contains(word) {
            let more = aside.read_line(&mut said).unwrap();
            assert!(more > 0, "it ended before it said {word:?}: {said}");
        }
    }

    /// Asks it to end as a person at the terminal would, and gives what it then printed.
    pub(crate) fn interrupt(self) -> String {
        let id = self.process.id().to_string();
        let sent = Command::new("kill").args(["-INT", &id]).status().unwrap();
        assert!(sent.success());
        self.end().1
    }

    /// Waits until it has ended by itself, and gives what it printed.
    pub(crate) fn finish(self) -> String {
        let (success, printed) = self.end();
        assert!(success, "{printed}");
        printed
    }

    /// Waits for its end: whether it was content, and what it printed.
    fn end(mut self) -> (bool, String) {
        let mut printed = String::new();
        let mut output = self.process.stdout.take().unwrap();
        output.read_to_string(&mut printed).unwrap();
        (self.process.wait().unwrap().success(), printed)
    }

    /// Ends it.
    pub(crate) fn stop(self) {}
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ended = self.process.kill();
        let _reaped = self.process.wait();
    }
}
