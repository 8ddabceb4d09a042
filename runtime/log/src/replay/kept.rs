//! Where a replay begins in a log whose bound left out what came before, and what it says to the
//! controller's state in a log.

use std::path::Path;

use serde::Serialize;

use super::{Difference, Recomputed, ReplayError};
use crate::bound::earlier;
use crate::{LogError, LoggedSnapshot, RunHeader, Step, read_steps};

/// The first tick of a log that does not begin with its run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct KeptFrom {
    /// Ticks of the run before it.
    pub left_out: u64,
    /// When it was, s since the run began.
    pub at_s: f64,
}

impl Recomputed {
    /// Takes over the state that the log holds before its first tick, `left_out` ticks after the
    /// run's.
    pub(super) fn go_on(
        &mut self,
        left_out: u64,
        first: &Step<'_>,
    ) -> Result<KeptFrom, ReplayError> {
        let snapshot = first
            .snapshot
            .filter(|snapshot| snapshot.record == left_out)
            .ok_or(ReplayError::LeftOut { ticks: left_out })?;
        snapshot.restore(&mut self.controller)?;
        self.inputs = snapshot.inputs;
        self.hash = snapshot.commands;
        Ok(KeptFrom {
            left_out,
            at_s: first.tick.now.seconds(),
        })
    }

    /// Compares the state that the log holds, at the tick `tick`, with the controller's.
    pub(super) fn other_state(&self, tick: u64, logged: &LoggedSnapshot) -> Option<Difference> {
        let own = LoggedSnapshot::of(&self.controller, logged.record, (self.inputs, self.hash));
        let (what, [logged, computed]) = logged.difference(&own)?;
        Some(Difference {
            tick,
            what: what.to_owned(),
            logged,
            computed,
        })
    }
}

/// The state with which a file ends that another follows.
pub(super) struct Edge {
    /// The file's name.
    file: String,
    state: LoggedSnapshot,
}

impl Edge {
    /// Of the file before the one at `path`, whose header is `header`, if that file lies beside it,
    /// can be read, and ends where this one begins.
    pub(super) fn before(path: &Path, header: &RunHeader) -> Option<Self> {
        if header.left_out == 0 {
            return None;
        }
        let before = earlier(path);
        let (run, end) = read_steps::<LogError>(&before, |_, _| Ok(())).ok()?;
        let of_run = RunHeader {
            left_out: header.left_out,
            ..run
        };
        let state = end.snapshot.filter(|_| of_run == *header)?;
        (state.record == header.left_out).then(|| Self {
            file: before
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            state,
        })
    }

    /// Compares it with the state before the log's first tick, `first`.
    pub(super) fn other(&self, first: &Step<'_>) -> Option<Difference> {
        let (what, [logged, before]) = first.snapshot?.difference(&self.state)?;
        Some(Difference {
            tick: first.tick.tick,
            what: format!("snapshot.{what}"),
            logged,
            computed: format!("{before} where {} ends", self.file),
        })
    }
}
