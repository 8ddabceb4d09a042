//! What is done when a process of the run dies or hangs, be it the policy's or the cameras'.
//!
//! Without restarts (`[policy]` in `control.toml`) it is lost for good. With some, the arms come to
//! a smooth stop and hold, if they need it, while our own process is started again, or another's is
//! waited for.

use hal::TimeNs;
use trocar_control::Supervision;
use trocar_log::Level;
use trocar_topics::Events;

use super::remote_arms::{PATIENCE_NS, PrintLine};
use super::signals::{HoldCause, Signals};
use crate::rt::{self, MonotonicClock};
use crate::session::SessionError;
use crate::session::external::LOOK_NS;

/// The longest time before a restart, ns.
const BACKOFF_NS_MAX: u64 = 60_000_000_000;

/// Another process of the run.
pub(super) trait Remote {
    /// What it is called in messages.
    fn who(&self) -> String;

    /// Whether it was started here. Of others an end can't be seen while they are away: they come
    /// back as other processes.
    fn is_own(&self) -> bool;

    /// Begins anew with one that has died or hangs. Nothing that was said before counts.
    fn call_again(&mut self) -> Result<(), SessionError>;

    /// Whether it was called again and is not started yet, since what it is started with is looked
    /// at first.
    fn is_preparing(&self) -> bool {
        false
    }

    /// Whether it is ready.
    fn is_ready(&mut self) -> Result<bool, SessionError>;

    /// Whether it is ready again, at `now` by the run's clock.
    fn is_back(&mut self, now: TimeNs) -> Result<bool, SessionError>;

    /// Why its process says no more, if so.
    fn ended(&mut self) -> Result<Option<String>, SessionError>;

    /// Why nothing more is to be expected of it, if so: it ended, or it hangs.
    fn lost(&mut self) -> Option<String>;
}

/// Waits until `remote` is ready for the first time; `clock` was made when it was started, and
/// `events` are of its topics.
pub(super) fn await_ready(
    remote: &mut impl Remote,
    (clock, within_ns): (MonotonicClock, u64),
    events: &Events,
    say: PrintLine<'_>,
) -> Result<(), SessionError> {
    let (mut said, within_s) = (false, within_ns / 1_000_000_000);
    while clock.now().0 < within_ns {
        if remote.is_ready()? {
            return Ok(());
        }
        if let Some(reason) = remote.ended()? {
            return Err(SessionError::RealTime(format!("{reason}, while loading")));
        }
        if rt::interrupted() {
            return Err(SessionError::RealTime(
                "interrupted before the run began".to_owned(),
            ));
        }
        if !said && clock.now().0 > PATIENCE_NS {
            said = true;
            say(&format!(
                "waiting for {} to be ready, for {within_s} s at most; no arm is enabled",
                remote.who()
            ));
        }
        rt::wait(events, LOOK_NS);
    }
    Err(SessionError::RealTime(format!(
        "{} did not become ready in {within_s} s",
        remote.who()
    )))
}

/// Where the process is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ProcessState {
    /// It answers.
    Running,
    /// It is started again at this time.
    Backoff(TimeNs),
    /// It was called again, and has until this time to be started; then it has as long to be ready.
    Starting(TimeNs),
}

/// Looks after one process.
pub(super) struct Supervisor {
    /// What the arms lack while it is away, if they need it.
    lacking: Option<HoldCause>,
    /// The run's.
    clock: MonotonicClock,
    rules: Supervision,
    /// Says on the terminal what happens.
    warn: fn(&str),
    presence: ProcessState,
    restarts: u32,
}

impl Supervisor {
    /// By the run's `clock`; while the process is away the arms hold for what is `lacking`, if
    /// anything.
    pub(super) const fn new(
        lacking: Option<HoldCause>,
        clock: MonotonicClock,
        (rules, warn): (Supervision, fn(&str)),
    ) -> Self {
        Self {
            lacking,
            clock,
            rules,
            warn,
            presence: ProcessState::Running,
            restarts: 0,
        }
    }

    /// How often it was started again, or had to be waited for.
    pub(super) const fn restarts(&self) -> u32 {
        self.restarts
    }

    /// Whether it is not away.
    pub(super) fn is_here(&self) -> bool {
        self.presence == ProcessState::Running
    }

    /// Starts `remote` again when it is time to; why it is lost for good, if so.
    pub(super) fn look_after(
        &mut self,
        remote: &mut impl Remote,
        signals: &Signals,
    ) -> Result<Option<String>, SessionError> {
        let now = self.clock.now();
        match self.presence {
            ProcessState::Running => {
                let reason = remote.lost();
                Ok(reason.and_then(|reason| self.lose(reason, remote.is_own(), signals)))
            }
            ProcessState::Backoff(again_at) => {
                if now >= again_at {
                    // What it is to be started with is gone or another; it would be again.
                    if let Err(error) = remote.call_again() {
                        return Ok(Some(error.to_string()));
                    }
                    self.presence = ProcessState::Starting(now.plus_ns(self.rules.return_ns));
                }
                Ok(None)
            }
            ProcessState::Starting(until) => self.expect(remote, now, until, signals),
        }
    }

    /// Looks whether it is ready again, or will not be.
    fn expect(
        &mut self,
        remote: &mut impl Remote,
        now: TimeNs,
        until: TimeNs,
        signals: &Signals,
    ) -> Result<Option<String>, SessionError> {
        let was_preparing = remote.is_preparing();
        match remote.is_back(now) {
            Ok(false) if was_preparing && !remote.is_preparing() => {
                self.presence = ProcessState::Starting(now.plus_ns(self.rules.return_ns));
                return Ok(None);
            }
            Ok(false) => {}
            Ok(true) => {
                self.presence = ProcessState::Running;
                if self.lacking == Some(HoldCause::Frames) {
                    // What the policy answers to frames of before does not count.
                    signals.hold_for_answers(now);
                    signals.go_on(HoldCause::Frames);
                }
                let text = format!("{} is ready again", remote.who());
                self.tell(signals, Level::Info, &text);
                return Ok(None);
            }
            // It wants to be shown something else; it would again.
            Err(error) => return Ok(Some(error.to_string())),
        }
        // Another's process that has left is another process when it comes back.
        let failed = if remote.is_own() {
            remote.ended()?
        } else {
            None
        };
        let within_s = TimeNs(self.rules.return_ns).seconds();
        let late = (now > until).then(|| {
            format!(
                "{} was not ready again within {within_s:.1} s",
                remote.who()
            )
        });
        let reason = failed.or(late);
        Ok(reason.and_then(|reason| self.lose(reason, remote.is_own(), signals)))
    }

    /// Makes the arms hold and says when it is started again; gives back `reason` if it is not.
    fn lose(&mut self, reason: String, own: bool, signals: &Signals) -> Option<String> {
        if self.restarts >= self.rules.restarts {
            return Some(reason);
        }
        let hold = match self.lacking {
            Some(lacking) => {
                signals.hold(lacking);
                "the arms stop and hold; "
            }
            None => "",
        };
        let doubled = 1_u64.checked_shl(self.restarts).unwrap_or(u64::MAX);
        let backoff_ns = self.rules.backoff_ns.saturating_mul(doubled);
        let backoff_ns = backoff_ns.min(BACKOFF_NS_MAX);
        self.restarts += 1;
        let (time, of) = (self.restarts, self.rules.restarts);
        let next = if own {
            self.presence = ProcessState::Backoff(self.clock.now().plus_ns(backoff_ns));
            let seconds = TimeNs(backoff_ns).seconds();
            format!("it is started again in {seconds:.1} s")
        } else {
            self.presence = ProcessState::Backoff(self.clock.now());
            let seconds = TimeNs(self.rules.return_ns).seconds();
            format!("it may come back within {seconds:.1} s")
        };
        let text = format!("{reason}; {hold}{next} ({time} of {of})");
        self.tell(signals, Level::Warning, &text);
        None
    }

    /// Says it in the log and, on the terminal, at once.
    pub(super) fn tell(&self, signals: &Signals, level: Level, text: &str) {
        signals.tell(self.clock.now(), level, text);
        (self.warn)(text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A process that is there until it is killed, and comes back as often as it is called.
    struct Fake {
        gone: bool,
        calls: u32,
        /// Whether there is another in its place.
        another: bool,
    }

    impl Remote for Fake {
        fn who(&self) -> String {
            "the process".to_owned()
        }

        fn is_own(&self) -> bool {
            true
        }

        fn call_again(&mut self) -> Result<(), SessionError> {
            (self.gone, self.calls) = (false, self.calls + 1);
            match self.another {
                true => Err(SessionError::RealTime("it is another".to_owned())),
                false => Ok(()),
            }
        }

        fn is_ready(&mut self) -> Result<bool, SessionError> {
            Ok(!self.gone)
        }

        fn is_back(&mut self, _now: TimeNs) -> Result<bool, SessionError> {
            self.is_ready()
        }

        fn ended(&mut self) -> Result<Option<String>, SessionError> {
            Ok(self.gone.then(|| "the process ended".to_owned()))
        }

        fn lost(&mut self) -> Option<String> {
            self.gone.then(|| "the process ended".to_owned())
        }
    }

    fn supervised(lacking: Option<HoldCause>, restarts: u32) -> Supervisor {
        let rules = Supervision {
            restarts,
            backoff_ns: 0,
            return_ns: 1_000_000_000,
            frozen_ns: None,
        };
        Supervisor::new(lacking, MonotonicClock::new(), (rules, |_| ()))
    }

    /// Arms that need frames hold until the policy has answered new ones; then it may be lost no
    /// more often than is allowed.
    #[test]
    fn arms_hold_for_frames_and_then_for_an_answer() {
        let (signals, mut supervisor) =
            (Signals::default(), supervised(Some(HoldCause::Frames), 1));
        let mut fake = Fake {
            gone: false,
            calls: 0,
            another: false,
        };
        let mut look = |fake: &mut Fake| supervisor.look_after(fake, &signals).unwrap();
        assert_eq!(look(&mut fake), None);
        assert!(!signals.held());
        fake.gone = true;
        assert_eq!(look(&mut fake), None);
        assert!(signals.lacks(HoldCause::Frames));
        assert_eq!((look(&mut fake), fake.calls), (None, 1));
        assert_eq!(look(&mut fake), None);
        assert!(!signals.lacks(HoldCause::Frames) && signals.lacks(HoldCause::Answers));
        assert!(signals.answers_from() > TimeNs(0));
        fake.gone = true;
        assert_eq!(look(&mut fake), Some("the process ended".to_owned()));
    }

    /// One in whose place another would be started is lost for good, however many restarts are
    /// left.
    #[test]
    fn another_process_is_not_started_in_its_place() {
        let (signals, mut supervisor) =
            (Signals::default(), supervised(Some(HoldCause::Answers), 5));
        let mut fake = Fake {
            gone: true,
            calls: 0,
            another: true,
        };
        let mut look = || supervisor.look_after(&mut fake, &signals).unwrap();
        assert_eq!(look(), None);
        assert!(look().is_some_and(|reason| reason.contains("it is another")));
    }

    /// A process whose files are compared before it is started, and that is ready at the next look.
    struct Checked {
        gone: bool,
        looks: u32,
    }

    impl Remote for Checked {
        fn who(&self) -> String {
            "the process".to_owned()
        }

        fn is_own(&self) -> bool {
            true
        }

        fn call_again(&mut self) -> Result<(), SessionError> {
            self.gone = false;
            Ok(())
        }

        fn is_preparing(&self) -> bool {
            self.looks == 0
        }

        fn is_ready(&mut self) -> Result<bool, SessionError> {
            Ok(self.looks > 0)
        }

        fn is_back(&mut self, _now: TimeNs) -> Result<bool, SessionError> {
            let ready = self.is_ready();
            self.looks += 1;
            ready
        }

        fn ended(&mut self) -> Result<Option<String>, SessionError> {
            Ok(None)
        }

        fn lost(&mut self) -> Option<String> {
            self.gone.then(|| "the process ended".to_owned())
        }
    }

    /// What was looked at before the process was started takes nothing of its time to be ready.
    #[test]
    fn the_time_to_be_ready_begins_with_the_process() {
        let (signals, mut supervisor) =
            (Signals::default(), supervised(Some(HoldCause::Answers), 1));
        supervisor.rules.return_ns = 0;
        let mut checked = Checked {
            gone: true,
            looks: 0,
        };
        for _ in 0..4 {
            assert_eq!(supervisor.look_after(&mut checked, &signals).unwrap(), None);
        }
        assert!(supervisor.is_here());
        assert_eq!((supervisor.restarts(), checked.looks), (1, 2));
    }

    /// What no arm needs holds none.
    #[test]
    fn arms_that_lack_nothing_go_on() {
        let (signals, mut supervisor) = (Signals::default(), supervised(None, 1));
        let mut fake = Fake {
            gone: true,
            calls: 0,
            another: false,
        };
        for _ in 0..3 {
            assert_eq!(supervisor.look_after(&mut fake, &signals).unwrap(), None);
            assert!(!signals.held());
        }
        assert_eq!((supervisor.restarts(), fake.calls), (1, 1));
        assert!(supervisor.is_here());
    }
}
