//! A policy process under supervision: its chunks to the control thread, and what is done when it dies or hangs.
//!
//! Without restarts (`[policy]` in `control.toml`) the run ends with it. With some, the arms come to a smooth stop and hold, while our
//! own process is started again, or an external one is waited for. They go on with the first chunk that answers an observation from
//! after it was ready again, if the gate lets it through.

use hal::{Chunk, PerArm, TimeNs};
use rtrb::Producer;
use trocar_control::Supervision;
use trocar_log::Level;

use super::child::PolicyChild;
use super::signals::{Lacking, Signals};
use crate::histogram::Histogram;
use crate::rt::MonotonicClock;
use crate::session::SessionError;

/// The longest time before a restart, ns.
const BACKOFF_NS_MAX: u64 = 60_000_000_000;

/// Where the process is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Presence {
    /// It answers.
    Here,
    /// It is started again at this time.
    Away(TimeNs),
    /// It was started again, and has until this time to be ready.
    Coming(TimeNs),
}

/// The process, where its chunks go, and how it is supervised.
pub(super) struct Supervised<'a> {
    child: &'a mut PolicyChild,
    chunks: Producer<PerArm<Chunk>>,
    /// The run's.
    clock: MonotonicClock,
    rules: Supervision,
    /// Says on the terminal what happens.
    warn: fn(&str),
    presence: Presence,
    restarts: u32,
}

impl<'a> Supervised<'a> {
    pub(super) const fn new(
        child: &'a mut PolicyChild,
        chunks: Producer<PerArm<Chunk>>,
        clock: MonotonicClock,
        (rules, warn): (Supervision, fn(&str)),
    ) -> Self {
        Self {
            child,
            chunks,
            clock,
            rules,
            warn,
            presence: Presence::Here,
            restarts: 0,
        }
    }

    /// How often it was started again, or had to be waited for.
    pub(super) const fn restarts(&self) -> u32 {
        self.restarts
    }

    /// Waits until it may have said something, or a little.
    pub(super) fn wait(&self) {
        self.child.wait();
    }

    /// Hands its newest answer to the control thread.
    pub(super) fn hand_on(
        &mut self,
        signals: &Signals,
        inference: &mut Histogram,
    ) -> Result<(), SessionError> {
        if self.presence != Presence::Here {
            return Ok(());
        }
        if let Some(answer) = self.child.newest_chunks()? {
            if signals.lacks(Lacking::Answers) {
                if answer.first.observed_at < signals.answers_from() {
                    return Ok(());
                }
                // Before the chunk: arms that are paused would ignore it.
                signals.go_on(Lacking::Answers);
                self.tell(
                    signals,
                    Level::Info,
                    "the policy answers again; its hold of the arms ends",
                );
            }
            // Full means that the control thread takes none: it will hold the arms and say so.
            let _full = self.chunks.push(answer);
        }
        if let Some(infer_ns) = self.child.newest_inference_ns()? {
            inference.record(infer_ns);
        }
        Ok(())
    }

    /// Starts it again when it is time to; why the run ends with it, if so.
    pub(super) fn look_after(&mut self, signals: &Signals) -> Result<Option<String>, SessionError> {
        let now = self.clock.now();
        if signals.lacks(Lacking::Frames) {
            self.child.excuse();
        }
        match self.presence {
            Presence::Here => Ok(self
                .child
                .end()
                .and_then(|reason| self.lost(reason, signals))),
            Presence::Away(again_at) => {
                if now >= again_at {
                    self.child.call_again()?;
                    self.presence = Presence::Coming(now.plus_ns(self.rules.return_ns));
                }
                Ok(None)
            }
            Presence::Coming(until) => self.expect(now, until, signals),
        }
    }

    /// Looks whether it is ready again, or will not be.
    fn expect(
        &mut self,
        now: TimeNs,
        until: TimeNs,
        signals: &Signals,
    ) -> Result<Option<String>, SessionError> {
        match self.child.is_back(now) {
            Ok(false) => {}
            Ok(true) => {
                self.presence = Presence::Here;
                self.tell(signals, Level::Info, "the policy process is ready again");
                return Ok(None);
            }
            // It wants to be shown something else; it would again.
            Err(error) => return Ok(Some(error.to_string())),
        }
        // An external policy that has left is another process when it comes back.
        let failed = if self.child.is_own() {
            self.child.ended()?
        } else {
            None
        };
        let within_s = TimeNs(self.rules.return_ns).seconds();
        let late = (now > until).then(|| {
            let who = self.child.who();
            format!("{who} was not ready again within {within_s:.1} s")
        });
        Ok(failed
            .or(late)
            .and_then(|reason| self.lost(reason, signals)))
    }

    /// Makes the arms hold and says when it is started again; gives back `reason` if it is not.
    fn lost(&mut self, reason: String, signals: &Signals) -> Option<String> {
        if self.restarts >= self.rules.restarts {
            return Some(reason);
        }
        signals.hold(Lacking::Answers);
        let doubled = 1_u64.checked_shl(self.restarts).unwrap_or(u64::MAX);
        let backoff_ns = self.rules.backoff_ns.saturating_mul(doubled);
        let backoff_ns = backoff_ns.min(BACKOFF_NS_MAX);
        self.restarts += 1;
        let (time, of) = (self.restarts, self.rules.restarts);
        let next = if self.child.is_own() {
            self.presence = Presence::Away(self.clock.now().plus_ns(backoff_ns));
            let seconds = TimeNs(backoff_ns).seconds();
            format!("it is started again in {seconds:.1} s")
        } else {
            self.presence = Presence::Away(self.clock.now());
            let seconds = TimeNs(self.rules.return_ns).seconds();
            format!("it may come back within {seconds:.1} s")
        };
        let text = format!("{reason}; the arms stop and hold; {next} ({time} of {of})");
        self.tell(signals, Level::Warning, &text);
        None
    }

    fn tell(&self, signals: &Signals, level: Level, text: &str) {
        signals.tell(self.clock.now(), level, text);
        (self.warn)(text);
    }
}
