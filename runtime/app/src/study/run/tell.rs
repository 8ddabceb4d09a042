//! What is said of a run. All goes through `say`, a line at a time; cells are named by kind, short
//! address and label.

use hal::TimeNs;

use super::super::estimate::{Class, Left, in_words, time_left};
use super::super::schedule::{ResourceRequest, at_a_time};
use super::{Runner, Status};

impl Runner<'_> {
    /// How a cell is called in the summary at the end.
    pub(super) fn name(&self, index: usize) -> String {
        let cell = self.cells[index];
        format!(
            "{} {} ({})",
            cell.job.kind().as_str(),
            cell.address.short(),
            cell.label
        )
    }

    /// How long a cell has run, s; none of one that has ended.
    fn ran_s(&self, index: usize) -> Option<f64> {
        match self.status[index] {
            Status::Waiting | Status::Elsewhere(_) => Some(0.0),
            Status::Running => {
                let job = self.running.iter().find(|job| job.cell == index);
                let ran_ns = job.map_or(0, |job| self.clock.now().since(job.begun));
                Some(TimeNs(ran_ns).seconds())
            }
            Status::Done | Status::Failed | Status::Skipped => None,
        }
    }

    /// The time that is left, in words. `more than` where a kind has no cell yet from which its
    /// time is known; empty when nothing is left.
    pub(super) fn left(&self) -> String {
        let mut left = Vec::new();
        for (index, cell) in self.cells.iter().enumerate() {
            let Some(ran) = self.ran_s(index) else {
                continue;
            };
            let need = ResourceRequest::of(&cell.job, self.workshop.file, self.machine.cores);
            #[expect(clippy::cast_precision_loss, reason = "a few hundred at most")]
            let at_a_time = at_a_time(need, self.machine) as f64;
            left.push(Left {
                class: Class::of(&cell.job),
                ran,
                at_a_time,
            });
        }
        if left.is_empty() {
            return String::new();
        }
        let (seconds, whole) = time_left(&left, &self.durations);
        let about = if whole { "about" } else { "more than" };
        format!("; {} left, {about} {}", left.len(), in_words(seconds))
    }

    /// A line of progress, with how many cells of this part have ended, failed and skipped ones
    /// included.
    pub(super) fn tell(&mut self, index: usize, what: &str) {
        let cell = self.cells[index];
        let ended =
            |status: &Status| matches!(status, Status::Done | Status::Failed | Status::Skipped);
        let count = self.status.iter().filter(|status| ended(status)).count();
        let (kind, short, label) = (cell.job.kind().as_str(), cell.address.short(), &cell.label);
        let line = format!(
            "[{count}/{}] {kind} {short} {label}: {what}",
            self.cells.len()
        );
        (self.say)(&line);
    }
}
