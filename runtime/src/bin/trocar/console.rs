//! What a person at the terminal reads: results on standard output, messages and progress on standard error.
#![expect(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "this is the program's console"
)]

use std::error::Error;

use indicatif::{ProgressBar, ProgressStyle};

/// A line of result.
pub(crate) fn result(line: &str) {
    println!("{line}");
}

/// A line of information.
pub(crate) fn note(line: &str) {
    eprintln!("{line}");
}

/// A line about what is allowed but may not be meant.
pub(crate) fn warning(line: &str) {
    eprintln!("trocar: warning: {line}");
}

/// The error and everything behind it.
pub(crate) fn error(error: &dyn Error) {
    eprint!("trocar: error: {error}");
    let mut source = error.source();
    while let Some(cause) = source {
        eprint!(": {cause}");
        source = cause.source();
    }
    eprintln!();
}

/// A progress bar over `total` steps of `what`; hidden when standard error is no terminal.
pub(crate) fn progress(total: u64, what: &'static str) -> ProgressBar {
    let bar = ProgressBar::new(total);
    if let Ok(style) = ProgressStyle::with_template("{msg} {bar:40} {pos}/{len}, {eta} left") {
        bar.set_style(style);
    }
    bar.set_message(what);
    bar
}
