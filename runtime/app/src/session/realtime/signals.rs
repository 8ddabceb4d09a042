//! Flags between the threads of a run, and the promise that no thread's end leaves the others
//! waiting.

use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use hal::TimeNs;
use trocar_log::{Level, SideLog};

use crate::console::Console;
use crate::rt;
use crate::session::operator::Served;

/// Why arms hold; each cause is a bit of the flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum HoldCause {
    /// A policy that answers.
    Answers = 1,
    /// A camera that the policy looks through.
    Frames = 2,
}

/// The flags.
#[derive(Debug, Default)]
pub(super) struct Signals {
    /// Come to rest: the task has its verdict, or something ended the run.
    done: AtomicBool,
    /// The control thread has ended: everybody else may.
    stopped: AtomicBool,
    /// The operator has asked for the end.
    stop_asked: AtomicBool,
    /// Whoever the drives move is there: they may have torque.
    torque_allowed: AtomicBool,
    /// What is lacking for now, while the arms hold.
    lacking: AtomicU8,
    /// The first instant whose observation ends the hold for want of an answer, ns.
    answers_from: AtomicU64,
    /// Periods that were skipped within a second, if these were too many; 0 if not.
    overruns: AtomicU64,
    /// Where viewers hear what the log is to say.
    console: Option<Console>,
    /// What the log is to say of it; of no interest to the control thread.
    told: Mutex<Vec<(TimeNs, Level, String)>>,
}

impl Signals {
    /// Those of a run that `console` shows, if there is one.
    pub(super) fn of(console: Option<&Console>) -> Self {
        Self {
            console: console.cloned(),
            ..Self::default()
        }
    }

    /// Whether the arm should come to rest.
    pub(super) fn done(&self) -> bool {
        self.done.load(Ordering::Acquire)
    }

    /// Asks for rest and then the end.
    pub(super) fn end_run(&self) {
        self.done.store(true, Ordering::Release);
    }

    /// Asks for it since so many periods were skipped within a second, if nobody has before.
    pub(super) fn overran(&self, skipped: u64) {
        if !self.done() {
            self.overruns.store(skipped, Ordering::Release);
            self.end_run();
        }
    }

    /// Why the run ended, if it was by overruns.
    pub(super) fn overruns(&self) -> Option<String> {
        let skipped = self.overruns.load(Ordering::Acquire);
        (skipped > 0)
            .then(|| format!("fault: the control thread skipped {skipped} periods within a second"))
    }

    /// Lets the drives have torque.
    pub(super) fn allow_torque(&self) {
        self.torque_allowed.store(true, Ordering::Release);
    }

    /// Whether the drives may have torque.
    pub(super) fn torque_allowed(&self) -> bool {
        self.torque_allowed.load(Ordering::Acquire)
    }

    /// Whether the operator wants the run to end.
    pub(super) fn stop_asked(&self) -> bool {
        self.stop_asked.load(Ordering::Acquire)
    }

    /// Whether the arms are to hold, since something is lacking.
    pub(super) fn held(&self) -> bool {
        self.lacking.load(Ordering::Acquire) != 0
    }

    /// Whether that is lacking.
    pub(super) fn lacks(&self, what: HoldCause) -> bool {
        self.lacking.load(Ordering::Acquire) & what as u8 != 0
    }

    /// Makes the arms hold, since that is lacking.
    pub(super) fn hold(&self, what: HoldCause) {
        self.lacking.fetch_or(what as u8, Ordering::AcqRel);
    }

    /// Makes the arms hold until there is an answer to an observation of `from` or later.
    pub(super) fn hold_for_answers(&self, from: TimeNs) {
        self.answers_from.store(from.0, Ordering::Release);
        self.hold(HoldCause::Answers);
    }

    /// From when on an answer's observation must be to end a hold.
    pub(super) fn answers_from(&self) -> TimeNs {
        TimeNs(self.answers_from.load(Ordering::Acquire))
    }

    /// Lets the arms go on, unless something else is lacking.
    pub(super) fn go_on(&self, what: HoldCause) {
        self.lacking.fetch_and(!(what as u8), Ordering::AcqRel);
    }

    /// Has the log say something, which viewers hear at once; whoever has the log takes it from
    /// here.
    pub(super) fn tell(&self, at: TimeNs, level: Level, text: &str) {
        if let Some(console) = &self.console {
            console.happened(at, level, text);
        }
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        told.push((at, level, text.to_owned()));
    }

    /// Writes into the log what it is to say.
    pub(super) fn write_told(&self, log: Option<&mut SideLog>) {
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        let told = told.drain(..);
        if let Some(log) = log {
            for (at, level, text) in told {
                log.event(at, level, &text);
            }
        }
    }

    /// Whether the control thread has ended.
    pub(super) fn stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire)
    }
}

impl Served for Signals {
    fn stop(&self) {
        self.stop_asked.store(true, Ordering::Release);
    }

    fn ending(&self) -> bool {
        self.done()
    }

    fn stopped(&self) -> bool {
        self.stopped()
    }
}

/// Held by every thread but the control thread: when the thread ends for whatever reason, a panic
/// included, so does the run.
pub(super) struct EndRunOnDrop<'a>(pub(super) &'a Signals);

impl Drop for EndRunOnDrop<'_> {
    fn drop(&mut self) {
        self.0.end_run();
    }
}

/// Held by the control thread: when it ends for whatever reason, everybody else may.
pub(super) struct StopsAll<'a>(pub(super) &'a Signals);

impl Drop for StopsAll<'_> {
    fn drop(&mut self) {
        self.0.end_run();
        self.0.stopped.store(true, Ordering::Release);
    }
}

/// Held as long as arms may move: when it goes, for whatever reason, the next signal may end the
/// process at once.
pub(super) struct Moving;

impl Drop for Moving {
    fn drop(&mut self) {
        rt::arms_rest();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A thread that panics ends the run and the control thread stops all.
    #[test]
    fn panicking_thread_ends_the_run() {
        let signals = Signals::default();
        std::thread::scope(|scope| {
            let panicked = scope.spawn(|| {
                let _ends = EndRunOnDrop(&signals);
                std::panic::resume_unwind(Box::new("a bug"));
            });
            assert!(panicked.join().is_err());
        });
        assert!(signals.done() && !signals.stopped());
        drop(StopsAll(&signals));
        assert!(signals.stopped());
    }
}
