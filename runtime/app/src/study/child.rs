//! A verb of this program as a child process: what it says goes to the cell's log, and it ends when
//! its parent does.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};

use super::commands::Arguments;
use crate::rt;

/// Tells a child the process that started it.
pub const PARENT_VARIABLE: &str = "TROCAR_STUDY_PARENT";

/// Lines of its log that a failure is reported with.
const OUTCOME_LINES: usize = 3;

/// A running verb.
#[derive(Debug)]
pub struct Running {
    child: Child,
    log: PathBuf,
    memory_bytes: u64,
}

/// How a verb ended.
#[derive(Clone, Debug)]
pub struct Ended {
    /// Whether it exited with code 0.
    pub success: bool,
    /// Its exit code, unless a signal ended it.
    pub code: Option<i32>,
    /// How, and its last lines.
    pub outcome: String,
    /// Its greatest memory, bytes, as far as it was seen.
    pub memory_bytes: Option<u64>,
}

impl Running {
    /// Starts `executable` with `arguments`.
    ///
    /// It holds `lock`, its standard input, so that the cell stays locked until it has ended, even
    /// if this process is killed.
    ///
    /// # Errors
    /// The system's.
    pub fn start(
        executable: &Path,
        arguments: &Arguments,
        gpu: Option<&str>,
        lock: &File,
        log: &Path,
    ) -> io::Result<Self> {
        let mut command = Command::new(executable);
        command
            .args(arguments.as_slice())
            .env(PARENT_VARIABLE, std::process::id().to_string())
            .stdin(Stdio::from(lock.try_clone()?));
        append_output(&mut command, log)?;
        // Signals from the terminal come here first and are handed on.
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        if let Some(gpu) = gpu {
            command.env("CUDA_VISIBLE_DEVICES", gpu);
        }
        Ok(Self {
            child: command.spawn()?,
            log: log.to_owned(),
            memory_bytes: 0,
        })
    }

    /// Its process.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// How it ended, if it has.
    ///
    /// # Errors
    /// The system's.
    pub fn poll(&mut self) -> io::Result<Option<Ended>> {
        let memory = rt::peak_memory(self.child.id()).unwrap_or(0);
        self.memory_bytes = self.memory_bytes.max(memory);
        let status = self.child.try_wait()?;
        Ok(status.map(|status| Ended {
            success: status.success(),
            code: status.code(),
            outcome: self.outcome(status),
            memory_bytes: (self.memory_bytes > 0).then_some(self.memory_bytes),
        }))
    }

    /// Asks it to end: a training keeps its state, a recording its episodes.
    pub fn interrupt(&self) {
        // It may just have ended.
        let _gone = rt::interrupt_process(self.child.id());
    }

    fn outcome(&self, status: ExitStatus) -> String {
        let said = fs::read(&self.log).unwrap_or_default();
        let said = String::from_utf8_lossy(&said);
        let lines: Vec<&str> = said
            .lines()
            .filter(|line| !line.trim().is_empty())
            .collect();
        let last = lines[lines.len().saturating_sub(OUTCOME_LINES)..].join(" | ");
        format!("{status}: {last}")
    }
}

/// Appends what `command` writes to its standard outputs to `log`.
fn append_output(command: &mut Command, log: &Path) -> io::Result<()> {
    let output = OpenOptions::new().create(true).append(true).open(log)?;
    command
        .stdout(Stdio::from(output.try_clone()?))
        .stderr(Stdio::from(output));
    Ok(())
}

/// In a child: ends with SIGINT when the study that started it ends, however that happens.
///
/// # Errors
/// The system's; or if the parent is gone already.
pub fn end_with_parent() -> io::Result<()> {
    match std::env::var(PARENT_VARIABLE).map(|parent| parent.parse()) {
        Ok(Ok(parent)) => rt::end_with_parent(parent),
        Ok(Err(error)) => Err(io::Error::other(format!("{PARENT_VARIABLE}: {error}"))),
        Err(_) => Ok(()),
    }
}
