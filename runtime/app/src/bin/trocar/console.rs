//! What a person at the terminal reads: results on standard output, messages and progress on
//! standard error.
use std::error::Error;
use std::io::{ErrorKind, Write as _};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};

/// Whether standard output is for JSON alone.
static JSON_ON_STDOUT: AtomicBool = AtomicBool::new(false);

/// Whether standard output could not be written.
static STDOUT_FAILED: AtomicBool = AtomicBool::new(false);

/// From now on lines of result go to standard error: standard output is for JSON.
pub(crate) fn leave_stdout_to_json() {
    JSON_ON_STDOUT.store(true, Ordering::Relaxed);
}

/// A line of result.
pub(crate) fn result(line: &str) {
    if JSON_ON_STDOUT.load(Ordering::Relaxed) {
        note(line);
    } else {
        text(&format!("{line}\n"));
    }
}

/// A text that is the result itself, as it is.
pub(crate) fn text(text: &str) {
    let mut out = std::io::stdout().lock();
    let written = out.write_all(text.as_bytes()).and_then(|()| out.flush());
    // Whoever closes it does not want to read on; a full disk is told, and ends nothing that is
    // still to be done.
    if written.is_err_and(|error| error.kind() != ErrorKind::BrokenPipe)
        && !STDOUT_FAILED.swap(true, Ordering::Relaxed)
    {
        warning("standard output can't be written");
    }
}

/// Whether something that was printed was lost.
pub(crate) fn stdout_failed() -> bool {
    STDOUT_FAILED.load(Ordering::Relaxed)
}

/// A line of information.
pub(crate) fn note(line: &str) {
    tell(&format!("{line}\n"));
}

/// What is told on standard error; if that is closed, nobody is there to be told.
fn tell(text: &str) {
    let _told = std::io::stderr().write_all(text.as_bytes());
}

/// A line about what is allowed but may not be meant.
pub(crate) fn warning(line: &str) {
    tell(&format!("trocar: warning: {line}\n"));
}

/// The error and everything behind it.
pub(crate) fn error(error: &dyn Error) {
    let mut text = format!("trocar: error: {error}");
    let mut source = error.source();
    while let Some(cause) = source {
        text += &format!(": {cause}");
        source = cause.source();
    }
    tell(&(text + "\n"));
}

/// What the command line is answered with in place of a verb, help or an error; the program's exit
/// code.
pub(crate) fn usage(answer: &clap::Error) -> u8 {
    let written = answer.print().and_then(|()| std::io::stdout().flush());
    let full = written.is_err_and(|error| error.kind() != ErrorKind::BrokenPipe);
    match answer.exit_code() {
        0 => u8::from(full),
        _ => 2,
    }
}

/// A duration in two units.
pub(crate) fn duration(seconds: f64) -> String {
    let duration = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX);
    HumanDuration(Duration::from_secs(duration.as_secs())).to_string()
}

/// A progress bar that tells the time that is left itself, as `{msg}` of its steps tells other
/// things; hidden when standard error is no terminal.
pub(crate) fn bar(what: &'static str) -> ProgressBar {
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} {msg}") {
        bar.set_style(style);
    }
    bar.set_message(what);
    bar
}

/// What `work` gives, with a bar of the episodes that it says are done, of how many.
pub(crate) fn with_episodes<T>(work: impl FnOnce(&mut dyn FnMut(usize, usize)) -> T) -> T {
    let bar = progress(0, "episodes");
    let done = work(&mut |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    done
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
