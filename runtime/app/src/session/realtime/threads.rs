//! The threads of a run: one controls, one observes the arms or simulates them, and the first looks
//! after the policy process.

use std::thread::{self, ScopedJoinHandle};

use hal::{Chunk, PerArm};
use rtrb::Producer;

use super::channels::Local;
use super::child::PolicyChild;
use super::control_thread::ControlEnd;
use super::signals::Signals;
use super::supervised::Supervised;
use super::wall_log::WallLog;
use super::watch::{Watched, watch};
use crate::rt::MonotonicClock;
use crate::session::operator::Listener;
use crate::session::plan::Arms;
use crate::session::source::ChunkSource;
use crate::session::{Plan, SessionError};

/// What the threads give back; `T` is that of the observing one.
pub(super) struct Ends<R, T> {
    /// An error is one from before the loop, or a panic: the loop itself returns none.
    pub(super) control: Result<ControlEnd<R>, SessionError>,
    /// Of the first thread.
    pub(super) watched: Result<Watched, SessionError>,
    pub(super) seen: Result<T, SessionError>,
}

/// Gives the queue for chunks to whoever answers: a source of this process, or the policy process,
/// which is supervised as `plan` says by the run's `clock`.
pub(super) fn wired<'a, S: Arms>(
    plan: &Plan<S>,
    source: Option<ChunkSource>,
    child: Option<&'a mut PolicyChild>,
    chunk_in: Producer<PerArm<Chunk>>,
    clock: MonotonicClock,
) -> (Local, Option<Supervised<'a>>) {
    match child {
        Some(child) => {
            child.follow(clock);
            let rules = plan.setup.robot().control.supervision;
            let supervised = Supervised::new(child, chunk_in, clock, (rules, plan.warn));
            (None, Some(supervised))
        }
        None => (source.map(|source| (source, chunk_in)), None),
    }
}

/// Runs all threads, by the run's `clock`, until the one that controls has stopped.
///
/// Spawns listener, control and observer in a scope and watches on the calling thread; all are
/// joined when it returns. Each thread holds a guard that ends the others, so that none waits for
/// one that is gone.
pub(super) fn run<R: Send, T: Send>(
    remote: Option<Supervised<'_>>,
    (signals, listener, clock): (&Signals, Option<&Listener>, MonotonicClock),
    control: impl FnOnce() -> Result<ControlEnd<R>, SessionError> + Send,
    observe: impl FnOnce() -> Result<T, SessionError> + Send,
) -> Ends<R, T> {
    thread::scope(|scope| {
        if let Some(listener) = listener {
            scope.spawn(move || listener.serve(scope, signals));
        }
        let control = scope.spawn(control);
        let seen = scope.spawn(observe);
        let watched = watch(remote, signals, WallLog::new(clock));
        Ends {
            control: joined(control).and_then(|end| end),
            seen: joined(seen).and_then(|end| end),
            watched,
        }
    })
}

/// What a thread gave back.
///
/// A panic becomes an error.
pub(super) fn joined<T>(handle: ScopedJoinHandle<'_, T>) -> Result<T, SessionError> {
    handle
        .join()
        .map_err(|_| SessionError::RealTime("a thread of the run has panicked".to_owned()))
}
