//! Studies in a scratch folder, run by the program.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use tests::{repository, stderr, trocar};

/// `trocar study study.toml` in `folder`.
pub(crate) fn study(folder: &Path, options: &[&str]) -> Command {
    let mut command = trocar();
    command
        .current_dir(folder)
        .args(["study", "study.toml"])
        .args(options);
    command
}

/// `trocar report` in `folder`.
pub(crate) fn report(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = trocar();
    command.current_dir(folder).arg("report").args(arguments);
    command
}

/// Runs `command` with the command line of `of`, which must succeed.
pub(crate) fn run(of: &Command) -> Output {
    let output = again(of).output().unwrap();
    assert!(
        output.status.success(),
        "{of:?}: {}{}",
        stdout(&output),
        stderr(&output)
    );
    output
}

/// Runs it, expects exit code 2, and gives the message.
pub(crate) fn refused(of: &Command) -> String {
    let output = again(of).output().unwrap();
    assert_eq!(
        output.status.code(),
        Some(2),
        "{of:?}: {}{}",
        stdout(&output),
        stderr(&output)
    );
    stderr(&output)
}

/// The same command once more.
fn again(of: &Command) -> Command {
    let mut command = Command::new(of.get_program());
    command.args(of.get_args());
    if let Some(folder) = of.get_current_dir() {
        command.current_dir(folder);
    }
    command
}

/// What it wrote to standard output.
pub(crate) fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The folders of a study's cells of one kind.
pub(crate) fn cell_folders(results: &Path, kind: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(results.join(kind)).unwrap();
    let mut folders: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    folders.sort();
    folders
}

/// The committed tiny study with small pictures and with no more time than the experts need, as
/// `study.toml` in `folder`.
pub(crate) fn tiny(folder: &Path) -> PathBuf {
    let config = repository().join("config");
    let mut text = fs::read_to_string(config.join("studies/tiny.toml")).unwrap();
    for (task, shipped, enough) in [
        ("needle-lift", "time_limit_s = 12.0", "time_limit_s = 7.0"),
        (
            "block-transfer",
            "time_limit_s = 25.0",
            "time_limit_s = 16.0",
        ),
    ] {
        let scene = fs::read_to_string(config.join(format!("tasks/{task}/scene.toml"))).unwrap();
        assert!(scene.contains("width = 512") && scene.contains("height = 512"));
        assert!(scene.contains(shipped));
        let scene = scene.replace("= 512", "= 64").replace(shipped, enough);
        let file = format!("{task}.scene.toml");
        fs::write(folder.join(&file), scene).unwrap();
        let table = format!("[task.{task}]\n");
        assert!(text.contains(&table));
        text = text.replace(&table, &format!("{table}scene = \"{file}\"\n"));
    }
    let path = folder.join("study.toml");
    fs::write(&path, text).unwrap();
    path
}
