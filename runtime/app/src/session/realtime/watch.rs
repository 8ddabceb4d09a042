//! The run as its first thread sees it: chunks from the policy process to the control thread, and
//! reasons to end.

use super::signals::{EndRunOnDrop, Signals};
use super::supervised::Supervised;
use super::wall_log::WallLog;
use crate::histogram::Histogram;
use crate::rt;
use crate::session::SessionError;
use crate::session::run::{INTERRUPTED, STOPPED};

/// Polling period for the signals, where no policy process wakes this thread, ns.
const IDLE_NS: u64 = 10_000_000;

/// What was seen.
pub(super) struct Watched {
    /// Why the run was ended from here, if it was.
    pub(super) ended_by: Option<String>,
    /// How long the policy process took for its chunks.
    pub(super) inference: Histogram,
    /// How often it was started again, or came back.
    pub(super) restarts: u32,
}

/// Looks after the run until the control thread has stopped.
///
/// # Errors
/// If a topic fails; that ends the run as well.
pub(super) fn watch(
    mut policy: Option<Supervised<'_>>,
    signals: &Signals,
    mut wall: WallLog,
) -> Result<Watched, SessionError> {
    let _ends = EndRunOnDrop(signals);
    let mut watched = Watched {
        ended_by: None,
        inference: Histogram::new(),
        restarts: 0,
    };
    while !signals.stopped() {
        wall.look(signals);
        if let Some(policy) = &mut policy {
            policy.hand_on(signals, &mut watched.inference)?;
            watched.restarts = policy.restarts();
        }
        if !signals.done() {
            watched.ended_by = if rt::interrupted() {
                Some(INTERRUPTED.to_owned())
            } else if signals.stop_asked() {
                Some(STOPPED.to_owned())
            } else {
                match &mut policy {
                    Some(policy) => policy.look_after(signals)?,
                    None => None,
                }
            };
            if watched.ended_by.is_some() {
                signals.end_run();
            }
        }
        match &policy {
            Some(policy) => policy.wait(),
            None => rt::sleep_ns(IDLE_NS),
        }
    }
    if let Some(policy) = &policy {
        policy.tell_to_go();
    }
    watched.ended_by = watched.ended_by.or_else(|| signals.overruns());
    Ok(watched)
}
