//! What the closed-loop tests share: the built binaries, scratch folders, and JSON results.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The repository's root.
#[must_use]
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .map_or_else(PathBuf::new, Path::to_path_buf)
}

/// The `trocar` binary, to be run in the repository's root: `TROCAR_CHECKED`, which `make test`
/// sets, else what `cargo build` made.
///
/// # Panics
/// If it was not built.
#[must_use]
pub fn trocar() -> Command {
    let built = || target().join("debug/trocar");
    let binary = std::env::var_os("TROCAR_CHECKED").map_or_else(built, PathBuf::from);
    program(binary, "cargo build -p trocar")
}

/// The `trocar` binary that users get, to be run in the repository's root.
///
/// # Panics
/// If it was not built.
#[must_use]
pub fn trocar_release() -> Command {
    program(target().join("release/trocar"), "make build")
}

fn target() -> PathBuf {
    let told = std::env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into());
    repository().join(told)
}

fn program(binary: PathBuf, made_by: &str) -> Command {
    assert!(
        binary.exists(),
        "{} is missing: `{made_by}` builds it",
        binary.display()
    );
    let mut command = Command::new(binary);
    command.current_dir(repository());
    // What it keeps for its user is no business of a test's.
    command.env("XDG_STATE_HOME", repository().join("target/scratch/state"));
    command
}

/// An empty folder for one test.
///
/// # Panics
/// If it can't be made.
#[must_use]
#[expect(clippy::expect_used, reason = "a test can't go on without it")]
pub fn scratch(test: &str) -> PathBuf {
    let folder = repository().join("target/scratch").join(test);
    let _absent = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a scratch folder can be made");
    folder
}

/// What a finished command wrote to standard error.
#[must_use]
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Waits for the machine to be free of other real-time runs of this test program, and keeps it as
/// long as the guard lives.
pub fn alone() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The process that `parent` started for `verb`, as soon as there is one; none while it is still a
/// copy of its parent.
#[must_use]
pub fn child_of(parent: u32, verb: &str) -> Option<u32> {
    let threads = fs::read_dir(format!("/proc/{parent}/task")).ok()?.flatten();
    let lists =
        threads.filter_map(|thread| fs::read_to_string(thread.path().join("children")).ok());
    let children: Vec<u32> = lists
        .flat_map(|list| {
            let ids = list.split_whitespace().map(str::parse);
            ids.filter_map(Result::ok).collect::<Vec<_>>()
        })
        .collect();
    let is_verb = |child: &u32| {
        let command = fs::read_to_string(format!("/proc/{child}/cmdline")).unwrap_or_default();
        command.split('\0').nth(1) == Some(verb)
    };
    children.into_iter().find(is_verb)
}

/// Reads a JSON result.
///
/// # Panics
/// If there is none.
#[must_use]
#[expect(clippy::expect_used, reason = "a test can't go on without it")]
pub fn json(path: &Path) -> serde_json::Value {
    let text = fs::read_to_string(path).expect("the result was written");
    serde_json::from_str(&text).expect("the result is JSON")
}
