//! Runs a study: starts every cell whose inputs are done, as many at a time as the machine has room
//! for.
//!
//! One thread polls everything. `start` begins what can be begun, nearest to a result first;
//! `run/end` takes care of what has ended, `run/tell` says so. What other processes work on is
//! looked at again later; a cell that fails makes those that need it skipped, and no others.

mod begin;
mod end;
mod tell;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;

use hal::TimeNs;

use super::StudyError;
use super::address::Address;
use super::child::Running;
use super::commands::Begin;
use super::estimate::Durations;
use super::gpu::{self, MemoryWatch};
use super::job::Kind;
use super::plan::{Cell, Plan};
use super::schedule::{Allocation, Machine, Pool};
use super::store::Attempts;
use super::work::Workshop;
use crate::rt::{self, MonotonicClock};

/// Polling period for the children.
const LOOK_NS: u64 = 50_000_000;

/// Time after which a cell that another process works on is looked at again.
const ELSEWHERE_NS: u64 = 1_000_000_000;

/// What became of a study, or of a shard of it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Cells that were done before.
    pub found: usize,
    /// Cells that this run made.
    pub made: usize,
    /// Cells that failed, with the reason.
    pub failed: Vec<(String, String)>,
    /// Cells that are not what was written, with the reason.
    pub damaged: Vec<(String, String)>,
    /// Cells that need one of those.
    pub skipped: usize,
    /// Whether it was interrupted.
    pub interrupted: bool,
}

/// How a cell of a run stands. `Done`, `Failed`, `Skipped` are final for this run.
#[derive(Clone, Debug, PartialEq)]
enum Status {
    Waiting,
    /// Another process works on it, or on what it needs; to be looked at again.
    Elsewhere(TimeNs),
    Running,
    Done,
    Failed,
    Skipped,
}

impl Status {
    /// Whether a cell is to be begun, as far as itself is concerned.
    fn is_due(&self, now: TimeNs) -> bool {
        match self {
            Self::Waiting => true,
            Self::Elsewhere(until) => now >= *until,
            Self::Running | Self::Done | Self::Failed | Self::Skipped => false,
        }
    }
}

/// A cell that a child is making, with what it holds until the end: resources and locks.
struct Work {
    /// Its place in `Runner::cells`.
    cell: usize,
    running: Running,
    grant: Allocation,
    lock: File,
    /// A shared lock on the recording that a training reads.
    input: Option<File>,
    begun: TimeNs,
    before: Attempts,
    command: Vec<String>,
    begin: Begin,
}

/// Runs the cells of `part`.
///
/// # Errors
/// [`StudyError::Io`] if the study's folder can't be used.
pub fn run(
    plan: &Plan,
    part: &BTreeSet<Address>,
    workshop: &Workshop<'_>,
    machine: &Machine,
    say: &mut dyn FnMut(&str),
) -> Result<Outcome, StudyError> {
    let mut runner = Runner::new(plan, part, workshop, machine, say);
    runner.run()?;
    Ok(runner.outcome)
}

/// A part of a study while it is made. Cells are known by their places in `cells`.
struct Runner<'a> {
    cells: Vec<&'a Cell>,
    /// Those of the whole study, other shards' too.
    all: Vec<&'a Cell>,
    /// Places among them in the order in which they are begun if they can be: what is nearest to a
    /// result is first.
    order: Vec<usize>,
    /// Where in `cells` an address is; inputs that are of another part are not there and count as
    /// done.
    places: BTreeMap<&'a Address, usize>,
    status: Vec<Status>,
    workshop: &'a Workshop<'a>,
    machine: &'a Machine,
    pool: Pool,
    gpu_names: BTreeMap<String, String>,
    memory: MemoryWatch,
    running: Vec<Work>,
    durations: Durations,
    /// Times of this run alone; durations of earlier attempts are in the store.
    clock: MonotonicClock,
    outcome: Outcome,
    say: &'a mut dyn FnMut(&str),
}

impl<'a> Runner<'a> {
    fn new(
        plan: &'a Plan,
        part: &BTreeSet<Address>,
        workshop: &'a Workshop<'a>,
        machine: &'a Machine,
        say: &'a mut dyn FnMut(&str),
    ) -> Self {
        let cells: Vec<&Cell> = plan
            .cells
            .iter()
            .filter(|cell| part.contains(&cell.address))
            .collect();
        let needs_gpu = cells.iter().any(|cell| cell.job.on_gpu());
        Self {
            places: cells
                .iter()
                .enumerate()
                .map(|(index, cell)| (&cell.address, index))
                .collect(),
            order: begin_order(&cells),
            status: vec![Status::Waiting; cells.len()],
            cells,
            all: plan.cells.iter().collect(),
            workshop,
            machine,
            pool: Pool::new(machine),
            gpu_names: if needs_gpu {
                gpu::names()
            } else {
                BTreeMap::new()
            },
            memory: MemoryWatch::default(),
            running: Vec::new(),
            durations: Durations::default(),
            clock: MonotonicClock::new(),
            outcome: Outcome::default(),
            say,
        }
    }

    /// Ends when nothing runs and nothing waits, or after an interrupt when nothing runs any more.
    fn run(&mut self) -> Result<(), StudyError> {
        loop {
            if rt::interrupted() && !self.outcome.interrupted {
                self.outcome.interrupted = true;
                (self.say)(
                    "interrupted: what runs is asked to end; run the same command again to go on",
                );
                for job in &self.running {
                    job.running.interrupt();
                }
            }
            self.poll()?;
            if !self.outcome.interrupted {
                self.start()?;
            }
            let waits = self
                .status
                .iter()
                .any(|status| matches!(status, Status::Waiting | Status::Elsewhere(_)));
            if self.running.is_empty() && (self.outcome.interrupted || !waits) {
                return Ok(());
            }
            rt::sleep_ns(LOOK_NS);
        }
    }

    /// Starts what can be started.
    fn start(&mut self) -> Result<(), StudyError> {
        let now = self.clock.now();
        for place in 0..self.order.len() {
            let index = self.order[place];
            if !self.status[index].is_due(now) {
                continue;
            }
            match self.inputs(index) {
                Inputs::Missing => continue,
                // What is done needs nothing any more.
                Inputs::Lost(_) if self.settled(index) => continue,
                Inputs::Lost(input) => {
                    self.skip(index, &input);
                    continue;
                }
                Inputs::Done => {}
            }
            // A wide cell waits for room; narrower ones behind it would keep it waiting for ever.
            if self.begin(index)? == Begun::NoCores {
                break;
            }
        }
        Ok(())
    }

    /// Says that a cell is not made, since `input` failed or was skipped.
    fn skip(&mut self, index: usize, input: &str) {
        self.status[index] = Status::Skipped;
        self.outcome.skipped += 1;
        self.tell(index, &format!("skipped: it needs {input}"));
    }

    /// How the cells that this one needs stand; the first that is lost decides.
    fn inputs(&self, index: usize) -> Inputs {
        let mut inputs = Inputs::Done;
        for address in self.cells[index].job.inputs() {
            let Some(&input) = self.places.get(&address) else {
                continue;
            };
            match self.status[input] {
                Status::Done => {}
                Status::Failed | Status::Skipped => {
                    let cell = self.cells[input];
                    let kind = cell.job.kind().as_str();
                    return Inputs::Lost(format!(
                        "{kind} {} ({})",
                        cell.address.short(),
                        cell.label
                    ));
                }
                Status::Waiting | Status::Elsewhere(_) | Status::Running => {
                    inputs = Inputs::Missing
                }
            }
        }
        inputs
    }
}

/// The places of `cells` in the order of [`Runner::order`].
fn begin_order(cells: &[&Cell]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..cells.len()).collect();
    order.sort_by_key(|&index| match cells[index].job.kind() {
        Kind::Evaluation => 0,
        Kind::Training => 1,
        Kind::Recording => 2,
    });
    order
}

/// How what a cell needs stands.
enum Inputs {
    Done,
    Missing,
    Lost(String),
}

/// What became of an attempt to begin a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Begun {
    Running,
    Settled,
    Elsewhere,
    NoCores,
    NoGpu,
}
