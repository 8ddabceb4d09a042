//! Takes care of cells whose verbs have ended. Children are polled, never waited for: one thread
//! does all of it.

use std::fs::File;

use hal::TimeNs;

use super::super::StudyError;
use super::super::address::Address;
use super::super::child::Ended;
use super::super::commands::Begin;
use super::super::estimate::{Class, in_words};
use super::super::job::{Job, Kind};
use super::super::plan::Cell;
use super::super::schedule::Allocation;
use super::super::store::Attempts;
use super::super::work::Took;
use super::{Runner, Status, Work};

/// The exit code of a verb that refuses what it is given.
const BAD_INPUT: i32 = 2;

impl Runner<'_> {
    /// Takes care of children that have ended. The memory on GPUs is sampled here too, while a cell
    /// that uses one runs.
    ///
    /// # Errors
    /// `Io` if the study's folder can't be used.
    pub(super) fn poll(&mut self) -> Result<(), StudyError> {
        if self
            .running
            .iter()
            .any(|job| self.cells[job.cell].job.on_gpu())
        {
            self.memory.look(self.clock.now());
        }
        let mut still = Vec::new();
        for mut job in std::mem::take(&mut self.running) {
            let polled = job.running.poll();
            match polled {
                Ok(None) => still.push(job),
                Ok(Some(ended)) => self.ended(job, ended)?,
                Err(error) => {
                    self.pool.give(&job.grant);
                    self.fail(job.cell, &error.to_string());
                }
            }
        }
        self.running.append(&mut still);
        Ok(())
    }

    /// Takes what there is to know of a child before its resources and locks go: time, GPU, memory.
    /// Only a training that succeeded may let its recording's data go.
    fn ended(&mut self, job: Work, ended: Ended) -> Result<(), StudyError> {
        let cell = self.cells[job.cell];
        let attempts = self.keep_time(&job)?;
        let gpu = self.gpu_of(&job.grant);
        let gpu_memory_bytes = self.memory.take(job.running.id());
        self.pool.give(&job.grant);
        let success = ended.success;
        if success {
            let took = Took {
                command: job.command,
                gpu,
                attempts,
                ended: Some(ended),
                gpu_memory_bytes,
            };
            self.end(job.cell, took);
        } else {
            self.not_done(job.cell, job.begin, &ended)?;
        }
        self.release(cell, &job.lock, job.input.filter(|_| success))
    }

    /// Adds the time that `job` ran to that of its cell's earlier attempts. They are written at
    /// once: a run that is killed later still knows them.
    fn keep_time(&self, job: &Work) -> Result<Attempts, StudyError> {
        let cell = self.cells[job.cell];
        let seconds = TimeNs(self.clock.now().since(job.begun)).seconds();
        let attempts = Attempts {
            seconds: job.before.seconds + seconds,
            ..job.before
        };
        let store = self.workshop.store;
        store.keep_attempts(cell.job.kind(), &cell.address, attempts)?;
        Ok(attempts)
    }

    /// What the GPU of `grant` is called. Its index if `nvidia-smi` did not name it; none of a cell
    /// without a GPU.
    fn gpu_of(&self, grant: &Allocation) -> Option<String> {
        let gpu = self.pool.gpu_name(grant)?;
        let name = self.gpu_names.get(gpu).cloned();
        Some(name.unwrap_or_else(|| gpu.to_owned()))
    }

    /// A verb has failed or was interrupted. After an interrupt the cell waits for the next run of
    /// the study. One that was resumed and can't go on from what is there begins anew, once: a new
    /// one that fails has failed.
    fn not_done(&mut self, index: usize, begin: Begin, ended: &Ended) -> Result<(), StudyError> {
        let (cell, outcome) = (self.cells[index], &ended.outcome);
        // A recording that failed at its job, as on a full disk, is kept; one that is refused is of
        // no use.
        let useless = match cell.job.kind() {
            Kind::Training => true,
            Kind::Recording => ended.code == Some(BAD_INPUT),
            Kind::Evaluation => false,
        };
        if self.outcome.interrupted {
            self.status[index] = Status::Waiting;
            self.tell(index, "interrupted");
        } else if begin == Begin::Resumed && useless {
            let reason = format!("can't go on from what is there and begins anew: {outcome}");
            self.tell(index, &reason);
            self.workshop.forget_product(cell)?;
            self.status[index] = Status::Waiting;
        } else {
            self.fail(index, outcome);
        }
        Ok(())
    }

    /// Gives up the lock of a cell, and that of the `input` of a training that is done. What was
    /// set aside comes back if the cell was not made anew.
    fn release(&mut self, cell: &Cell, lock: &File, input: Option<File>) -> Result<(), StudyError> {
        self.workshop
            .store
            .put_back(cell.job.kind(), &cell.address)?;
        // Not only closed: a child of the child may still hold it.
        let _unlocked = lock.unlock();
        if let (Job::Training(training), Some(input)) = (&cell.job, input) {
            let _unlocked = input.unlock();
            self.drop_recording(&training.recording)?;
        }
        Ok(())
    }

    /// Removes the data of a recording if the study asks for that and no cell left to do needs it.
    fn drop_recording(&mut self, address: &Address) -> Result<(), StudyError> {
        let Some(&index) = self.places.get(address) else {
            return Ok(());
        };
        let store = self.workshop.store;
        let kept = self.workshop.file.run.keep_recordings;
        if kept || store.is_wanted(self.cells[index], &self.all) {
            return Ok(());
        }
        // Another process may train with it.
        let Some(lock) = store.lock(Kind::Recording, address)? else {
            return Ok(());
        };
        self.workshop.drop_recording(address)?;
        let _unlocked = lock.unlock();
        self.tell(index, "its data is removed: nothing left to do needs it");
        Ok(())
    }

    /// A verb has done its part of a cell. The result is checked and the manifest written; a result
    /// that is not what was asked for makes the cell failed.
    pub(super) fn end(&mut self, index: usize, took: Took) {
        let cell = self.cells[index];
        match self.workshop.finish(cell, took) {
            Ok(manifest) => {
                self.status[index] = Status::Done;
                self.outcome.made += 1;
                self.durations.add(Class::of(&cell.job), manifest.seconds);
                let left = self.left();
                self.tell(
                    index,
                    &format!("done in {}{left}", in_words(manifest.seconds)),
                );
            }
            Err(reason) => self.fail(index, &reason),
        }
    }

    /// Marks a cell as failed, for this run of the study; cells that need it are skipped, all
    /// others go on.
    pub(super) fn fail(&mut self, index: usize, reason: &str) {
        let cell = self.cells[index];
        // Whatever is wrong with the folder is reported when it is used next.
        let _kept = self.workshop.store.put_back(cell.job.kind(), &cell.address);
        self.status[index] = Status::Failed;
        self.tell(index, &format!("failed: {reason}"));
        self.outcome
            .failed
            .push((self.name(index), reason.to_owned()));
    }
}
