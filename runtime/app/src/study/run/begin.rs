//! Begins cells.
//!
//! Resources first, then locks, then what an earlier attempt left: a cell that can't be begun now
//! has taken nothing and is looked at again. Processes of other shards may work in the same folder;
//! the locks decide who makes a cell.

use std::fs::File;

use super::super::StudyError;
use super::super::child::Running;
use super::super::commands::{Arguments, Begin};
use super::super::estimate::Class;
use super::super::job::{Job, Kind};
use super::super::schedule::{Allocation, ResourceRequest, Unavailable};
use super::super::store::{Attempts, State};
use super::super::work::{Start, Took, texts};
use super::{Begun, ELSEWHERE_NS, Runner, Status, Work};

/// Locks of a cell that is begun.
struct Held {
    /// Its own.
    lock: File,
    /// Its part in that of the recording that it reads.
    input: Option<File>,
}

impl Runner<'_> {
    /// Begins a cell, unless it is done, or there is no room for it. What was allocated is given
    /// back unless the cell runs.
    ///
    /// # Errors
    /// `Io` if the study's folder can't be used; what is wrong with the cell itself makes it
    /// failed.
    pub(super) fn begin(&mut self, index: usize) -> Result<Begun, StudyError> {
        let cell = self.cells[index];
        if self.settled(index) {
            return Ok(Begun::Settled);
        }
        let need = ResourceRequest::of(&cell.job, self.workshop.file, self.machine.cores);
        let grant = match self.pool.take(need) {
            Ok(grant) => grant,
            Err(Unavailable::Cores) => return Ok(Begun::NoCores),
            Err(Unavailable::Gpu) => return Ok(Begun::NoGpu),
        };
        let begun = self.begin_with(index, &grant)?;
        if begun != Begun::Running {
            self.pool.give(&grant);
        }
        Ok(begun)
    }

    /// Whether nothing is left to do for a cell, as its folder says. It is done, damaged, or its
    /// product is gone and nobody needs it; not so a recording of fewer demonstrations than are
    /// wanted. It notes the outcome and tells of damage, at most once for each cell.
    pub(super) fn settled(&mut self, index: usize) -> bool {
        let cell = self.cells[index];
        match self.workshop.store.state(cell.job.kind(), &cell.address) {
            State::Missing | State::Begun => false,
            State::Bare(_) if self.workshop.store.is_wanted(cell, &self.cells) => false,
            State::Done(manifest) | State::Bare(manifest) => {
                if let (Job::Recording(job), Some(episodes)) = (&cell.job, manifest.episodes)
                    && episodes < job.episodes
                {
                    return false;
                }
                self.durations.add(Class::of(&cell.job), manifest.seconds);
                self.status[index] = Status::Done;
                self.outcome.found += 1;
                true
            }
            State::Damaged(reason) => {
                self.tell(index, &format!("damaged: {reason}"));
                self.status[index] = Status::Failed;
                self.outcome.damaged.push((self.name(index), reason));
                true
            }
        }
    }

    /// Takes the locks and makes the cell ready. The store is looked at again under the lock, since
    /// another process may have done the cell meanwhile; a training holds its recording's lock too,
    /// shared, so that nobody removes the data under it. An attempt counts from here on.
    fn begin_with(&mut self, index: usize, grant: &Allocation) -> Result<Begun, StudyError> {
        let cell = self.cells[index];
        let (kind, address) = (cell.job.kind(), &cell.address);
        let store = self.workshop.store;
        let later = Status::Elsewhere(self.clock.now().plus_ns(ELSEWHERE_NS));
        let Some(lock) = store.lock(kind, address)? else {
            self.status[index] = later;
            return Ok(Begun::Elsewhere);
        };
        // Whoever made it anew may have been killed.
        store.put_back(kind, address)?;
        // Another process may have done it between the first look and the lock.
        if self.settled(index) {
            return Ok(Begun::Settled);
        }
        let mut input = None;
        if let Job::Training(job) = &cell.job {
            input = store.lock_to_read(Kind::Recording, &job.recording)?;
            if input.is_none() {
                self.status[index] = later;
                return Ok(Begun::Elsewhere);
            }
        }
        if let State::Bare(_) = store.state(kind, address) {
            store.set_aside(kind, address)?;
        }
        let before = store.attempts(kind, address);
        let attempts = Attempts {
            count: before.count + 1,
            ..before
        };
        store.keep_attempts(kind, address, attempts)?;
        let held = Held { lock, input };
        match self.workshop.prepare(cell) {
            Ok(Start::Run(arguments, begin)) => {
                let line = (arguments, begin);
                return Ok(self.launch(index, line, attempts, held, grant));
            }
            Ok(Start::Found) => {
                let took = Took {
                    command: Vec::new(),
                    gpu: None,
                    attempts: before,
                    ended: None,
                    gpu_memory_bytes: None,
                };
                self.end(index, took);
            }
            Err(error) => self.fail(index, &error.to_string()),
        }
        Ok(Begun::Settled)
    }

    /// Starts a cell's verb. From now on the child holds the lock too: the cell stays locked until
    /// it ends, even if this process is killed.
    fn launch(
        &mut self,
        index: usize,
        (arguments, begin): (Arguments, Begin),
        before: Attempts,
        Held { lock, input }: Held,
        grant: &Allocation,
    ) -> Begun {
        let cell = self.cells[index];
        let gpu = self.pool.gpu_name(grant);
        let folder = self.workshop.store.cell(cell.job.kind(), &cell.address);
        let executable = &self.workshop.executable;
        let log = folder.join("log.txt");
        let running = match Running::start(executable, &arguments, gpu, &lock, &log) {
            Ok(running) => running,
            Err(error) => {
                self.fail(index, &format!("{}: {error}", executable.display()));
                return Begun::Settled;
            }
        };
        let begun = begun_text(begin, gpu);
        self.status[index] = Status::Running;
        self.running.push(Work {
            cell: index,
            running,
            grant: grant.clone(),
            lock,
            input,
            begun: self.clock.now(),
            before,
            command: texts(arguments.as_slice()),
            begin,
        });
        self.tell(index, &begun);
        Begun::Running
    }
}

/// How a cell was begun, and on which GPU if it has one.
fn begun_text(begin: Begin, gpu: Option<&str>) -> String {
    let how = match begin {
        Begin::Resumed => "goes on",
        Begin::New => "begun",
    };
    let on = gpu.map_or_else(String::new, |gpu| format!(" on GPU {gpu}"));
    format!("{how}{on}")
}
