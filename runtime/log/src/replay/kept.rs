//! Where a replay begins in a log whose bound left out what came before, and what it says to the controller's state in a log.

use hal::Chunk;
use serde::Serialize;

use super::{Difference, Recomputed, ReplayError};
use crate::{LoggedSnapshot, Step};
use trocar_control::{InputHash, Snapshot};

/// The first tick of a log that does not begin with its run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct KeptFrom {
    /// Ticks of the run before it.
    pub left_out: u64,
    /// When it was, s since the run began.
    pub at_s: f64,
}

impl Recomputed {
    /// Takes over the state that the log holds before its first tick, `left_out` ticks after the run's.
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
        let hex = |word: u64| format!("{word:016x}");
        let found = |what: &str, logged: String, computed: String| Difference {
            tick,
            what: what.to_owned(),
            logged,
            computed,
        };
        let hashes = [
            ("inputs", logged.inputs.value(), self.inputs.value()),
            ("command_hash", logged.commands.value(), self.hash.value()),
        ];
        for (what, logged, computed) in hashes {
            if logged != computed {
                return Some(found(what, hex(logged), hex(computed)));
            }
        }
        let mut own = Snapshot::new();
        self.controller.save(&mut own);
        let words = logged.snapshot.state().iter().zip(own.state()).enumerate();
        let mut words = words.filter(|(_, (logged, computed))| logged != computed);
        if let Some((place, (logged, computed))) = words.next() {
            let name = |word: u64| format!("{} as its word {place}", hex(word));
            return Some(found("state", name(*logged), name(*computed)));
        }
        let same_chunk = |(index, chunk): (usize, &Chunk)| {
            let held = own.held().get(index);
            let own = held.and_then(|held| self.controller.held(held));
            own.is_some_and(|own| hash(own) == hash(chunk))
        };
        let same = logged.snapshot == own && logged.chunks.iter().enumerate().all(same_chunk);
        let other = || found("state", "other chunks".to_owned(), "its own".to_owned());
        (!same).then(other)
    }
}

/// A hash over what counts of a chunk.
fn hash(chunk: &Chunk) -> u64 {
    let mut hash = InputHash::new();
    hash.chunk(0, chunk);
    hash.value()
}
