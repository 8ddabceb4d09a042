//! What a network may compute with: refused before anything moves if this machine has it not.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use tests::{stderr, trocar};

/// Runs the committed policy with `arguments`, expects exit code 2, and gives the message.
fn refused(arguments: &[&str]) -> String {
    let policy = "config/policies/needle-lift/act-compact";
    let output = trocar()
        .args(["run", "--task", "needle-lift", "--lockstep"])
        .args(["--policy", policy])
        .args(arguments)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    stderr(&output)
}

#[test]
fn a_core_is_left_to_the_control() {
    let message = refused(&["--threads", "1024"]);
    assert!(message.contains("--threads 1024"), "{message}");
    assert!(message.contains("cores"), "{message}");
    assert!(refused(&["--threads", "0"]).contains("--threads"));
}

#[test]
fn half_precision_on_a_cpu_is_refused() {
    let message = refused(&["--precision", "bf16"]);
    assert!(message.contains("precision = bf16"), "{message}");
    assert!(message.contains("act-compact"), "{message}");
}
