//! The folder of libtorch, as every package with a binary has it, and the commit that a release
//! build is of.

#[path = "../../policy/build.rs"]
mod libtorch;

use std::env;
use std::process::Command;

fn main() {
    libtorch::main();
    println!("cargo:rerun-if-env-changed=TROCAR_COMMIT");
    println!("cargo:rustc-env=TROCAR_COMMIT={}", commit());
}

/// What logs say of the commit. A debug build is not made anew for each commit, so that it does not
/// say.
fn commit() -> String {
    if let Ok(told) = env::var("TROCAR_COMMIT") {
        return told;
    }
    if env::var("PROFILE").as_deref() != Ok("release") {
        return "of a debug build".to_owned();
    }
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo:rerun-if-changed={log}");
    }
    git(&["rev-parse", "--short=12", "HEAD"]).unwrap_or_else(|| "unknown".to_owned())
}

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
