//! A `trocar` with a console, and requests to it.

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use tests::{scratch, trocar};

/// Nothing takes longer than this, also of what has only the processor time that others leave.
pub(crate) const PATIENCE: Duration = Duration::from_secs(300);

/// How many times slower than the machine's the clocks of a run are that nobody moves by hand: a
/// machine that is busy with tests beside it may keep it from its cores for so many times 50 ms
/// until it lacks a measurement and ends.
pub(crate) const SLOW_MOTION: u64 = 4;

/// The same of what no clock paces, such as a log that is looked through: a page of which a console
/// hears nothing for 10 s of its clock is disconnected, and a test may wait for a processor longer.
pub(crate) const UNPACED: u64 = 20;

/// Setting for pictures whose colours do not matter, as they are drawn sooner.
pub(crate) const PLAIN: &str = "scene.rendering.shading=plain";

/// What has `trocar WORDS` draw the cameras of its own scene sooner, if it has any.
fn plainly(words: &[&str]) -> &'static [&'static str] {
    let is = |word| words.contains(&word);
    let draws = (is("run") || is("record")) && is("--task") && !is("--backend");
    if draws { &["--set", PLAIN] } else { &[] }
}

/// A process that serves a console. Its folder of operators' sockets is its own; they have short
/// paths.
pub(crate) struct Served {
    pub(crate) process: Child,
    pub(crate) port: u16,
    pub(crate) token: String,
    /// What opens the console.
    url: String,
    /// SHA-256 of the certificate, if it has one.
    pub(crate) fingerprint: Option<String>,
    /// What opens it in Foxglove, if it can be.
    pub(crate) viewer: Option<String>,
    pub(crate) folder: PathBuf,
    sockets: PathBuf,
}

/// How many mutated messages a test sends: `least`, or as many as `TROCAR_MUTATED_MESSAGES` says if
/// that is more.
pub(crate) fn mutated_messages(least: usize) -> usize {
    let asked = std::env::var("TROCAR_MUTATED_MESSAGES").ok();
    asked.map_or(least, |count| count.parse::<usize>().unwrap().max(least))
}

/// By how much a process may grow while it is sent nonsense, MB.
pub(crate) const GROWTH_MB: u64 = 48;

/// The log of an expert's episode of `task`, in the scratch folder of `test`.
pub(crate) fn made_log(test: &str, task: &str) -> PathBuf {
    let log = scratch(test).join("run.mcap");
    let mut command = trocar();
    command.args(["run", "--task", task, "--policy", "expert"]);
    command.args(["--set", PLAIN, "--lockstep", "--seed", "7", "--log"]);
    assert!(command.arg(&log).status().unwrap().success());
    log
}

/// Verifies a log: no limit was broken.
pub(crate) fn verified(log: &Path) {
    let output = trocar().arg("verify").arg(log).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said} {}", tests::stderr(&output));
}

impl Served {
    /// A run in real time of needle lift, paced by `policy`, that goes on for minutes.
    pub(crate) fn run(test: &str, policy: &str) -> Self {
        let words = [
            "run",
            "--task",
            "needle-lift",
            "--policy",
            policy,
            "--seed",
            "7",
        ];
        let words = words
            .into_iter()
            .chain(["--set", "scene.episode.time_limit_s=300"]);
        Self::start_slow(test, &words.collect::<Vec<_>>(), SLOW_MOTION)
    }

    /// `trocar WORDS --console` at a free port; no clock paces it.
    pub(crate) fn start(test: &str, words: &[&str]) -> Self {
        Self::start_slow(test, words, UNPACED)
    }

    /// The same, whose clocks are so many times slower than the machine's.
    pub(crate) fn start_slow(test: &str, words: &[&str], slow_motion: u64) -> Self {
        let words: Vec<&str> = words
            .iter()
            .copied()
            .chain(["--console", "127.0.0.1:0"])
            .collect();
        Self::start_at(&scratch(test), &words, slow_motion)
    }

    /// `trocar WORDS`, which say where its console is, whose files are in `folder`.
    pub(crate) fn start_at(folder: &Path, words: &[&str], slow_motion: u64) -> Self {
        let name = folder.file_name().unwrap().to_str().unwrap();
        let sockets = std::env::temp_dir().join(format!("co-{name}-{}", std::process::id()));
        fs::create_dir_all(&sockets).unwrap();
        let mut command: Command = trocar();
        command
            .env("XDG_RUNTIME_DIR", &sockets)
            .env("XDG_STATE_HOME", folder)
            .env("TROCAR_SLOW_MOTION", slow_motion.to_string())
            .args(words)
            .args(plainly(words))
            .arg("--json")
            .arg(folder.join("result.json"))
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let mut process = command.spawn().unwrap();
        let mut said = BufReader::new(process.stderr.take().unwrap());
        let (mut line, mut fingerprint, mut viewer) = (String::new(), None, None);
        while !line.contains("console: http") {
            line.clear();
            assert!(said.read_line(&mut line).unwrap() > 0, "no console");
            let found = line.trim().split("certificate: SHA-256 ").nth(1);
            fingerprint = found.map(str::to_owned).or(fingerprint);
            let found = line.trim().split("foxglove: ").nth(1);
            viewer = found.map(str::to_owned).or(viewer);
        }
        // Whatever else it says must not fill the pipe.
        std::thread::spawn(move || std::io::copy(&mut said, &mut std::io::sink()));
        let url = line.trim().split("console: ").nth(1).unwrap().to_owned();
        let (address, token) = url.split_once("/?token=").unwrap();
        let (_, port) = address.rsplit_once(':').unwrap();
        Self {
            process,
            port: port.parse().unwrap(),
            token: token.to_owned(),
            url: url.clone(),
            fingerprint,
            viewer,
            folder: folder.to_owned(),
            sockets,
        }
    }

    pub(crate) fn url(&self) -> String {
        self.url.clone()
    }

    pub(crate) fn host(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    pub(crate) fn cookie(&self) -> String {
        format!("trocar_console_{}={}", self.port, self.token)
    }

    pub(crate) fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream
    }

    /// The answer to `GET path` with these headers, head and body.
    pub(crate) fn get(&self, path: &str, headers: &[(&str, &str)]) -> String {
        self.try_get(path, headers).unwrap()
    }

    /// The same; none if the connection is closed before there is a whole answer.
    pub(crate) fn try_get(&self, path: &str, headers: &[(&str, &str)]) -> Option<String> {
        let mut request = format!("GET {path} HTTP/1.1\r\nConnection: close\r\n");
        for (name, value) in headers {
            request += &format!("{name}: {value}\r\n");
        }
        let mut stream = self.connect();
        stream.write_all((request + "\r\n").as_bytes()).ok()?;
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).ok()?;
        Some(String::from_utf8_lossy(&answer).into_owned())
    }

    /// Its resident memory, MB.
    pub(crate) fn resident_mb(&self) -> u64 {
        let path = format!("/proc/{}/status", self.process.id());
        let status = fs::read_to_string(path).unwrap();
        let line = status.lines().find(|line| line.starts_with("VmRSS:"));
        let kb = line.unwrap().split_whitespace().nth(1).unwrap();
        kb.parse::<u64>().unwrap() / 1024
    }

    /// The exit code, once it has ended.
    pub(crate) fn code(&mut self) -> i32 {
        self.process.wait().unwrap().code().unwrap()
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
        let _removed = fs::remove_dir_all(&self.sockets);
    }
}
