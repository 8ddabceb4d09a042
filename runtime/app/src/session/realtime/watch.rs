//! The run as its first thread sees it: chunks from the policy process to the control thread, and reasons to end.

use hal::Chunk;
use rtrb::Producer;

use super::child::PolicyChild;
use super::signals::{EndsRun, Signals};
use crate::histogram::Histogram;
use crate::rt;
use crate::session::SessionError;
use crate::session::run::{INTERRUPTED, STOPPED};
use hal::PerArm;

/// Time between two looks, ns: at a policy process, and at the signals alone.
const POLL_NS: u64 = 1_000_000;
const IDLE_NS: u64 = 10_000_000;

/// What was seen.
pub(super) struct Watched {
    /// Why the run was ended from here, if it was.
    pub(super) ended_by: Option<String>,
    /// How long the policy process took for its chunks.
    pub(super) inference: Histogram,
}

/// Looks after the run until the control thread has stopped.
///
/// # Errors
/// If a topic fails; that ends the run as well.
pub(super) fn watch(
    mut policy: Option<(&mut PolicyChild, Producer<PerArm<Chunk>>)>,
    signals: &Signals,
) -> Result<Watched, SessionError> {
    let _ends = EndsRun(signals);
    let mut watched = Watched {
        ended_by: None,
        inference: Histogram::new(),
    };
    while !signals.stopped() {
        if let Some((child, chunks)) = &mut policy {
            if let Some(answer) = child.newest_chunks()? {
                // Full means that the control thread takes none: it will hold the arms and say so.
                let _full = chunks.push(answer);
            }
            if let Some(infer_ns) = child.newest_inference_ns()? {
                watched.inference.record(infer_ns);
            }
        }
        if !signals.done() {
            watched.ended_by = if rt::interrupted() {
                Some(INTERRUPTED.to_owned())
            } else if signals.stop_asked() {
                Some(STOPPED.to_owned())
            } else {
                policy.as_mut().and_then(|(child, _)| child.end())
            };
            if watched.ended_by.is_some() {
                signals.end_run();
            }
        }
        rt::sleep_ns(if policy.is_some() { POLL_NS } else { IDLE_NS });
    }
    Ok(watched)
}
