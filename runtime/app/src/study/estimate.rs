//! How long the rest of a study takes, from what its cells took so far.

use std::collections::BTreeMap;

use super::job::{Job, Kind, PolicyInput};

/// Cells that take about the same time.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Class {
    kind: Kind,
    /// Task, network, size: whatever is known to matter.
    details: String,
}

impl Class {
    /// Of `job`.
    #[must_use]
    pub fn of(job: &Job) -> Self {
        let details = match job {
            Job::Recording(job) => format!("{} {} {}", job.task.task, job.cameras, job.depth),
            Job::Training(job) => {
                format!(
                    "{} {:?} {:?} {:?} {:?}",
                    job.policy, job.cameras, job.preset, job.steps, job.batch
                )
            }
            Job::Evaluation(job) => {
                let trained = matches!(job.policy, PolicyInput::Training(_));
                format!("{} {} {trained}", job.task.task, job.trials)
            }
        };
        Self {
            kind: job.kind(),
            details,
        }
    }
}

/// Time that cells took.
#[derive(Clone, Debug, Default)]
pub struct Durations {
    by_class: BTreeMap<Class, (f64, f64)>,
    by_kind: BTreeMap<Kind, (f64, f64)>,
}

impl Durations {
    /// Adds a cell that took `seconds`.
    pub fn add(&mut self, class: Class, seconds: f64) {
        for (count, total) in [
            self.by_kind.entry(class.kind).or_default(),
            self.by_class.entry(class).or_default(),
        ] {
            *count += 1.0;
            *total += seconds;
        }
    }

    /// What a cell of `class` takes, s; by its kind if none of its class is known, and unknown
    /// without one of its kind.
    #[must_use]
    pub fn expected(&self, class: &Class) -> Option<f64> {
        let known = self
            .by_class
            .get(class)
            .or_else(|| self.by_kind.get(&class.kind));
        known.map(|(count, total)| total / count)
    }
}

/// A cell that is not done.
#[derive(Clone, Debug)]
pub struct Left {
    /// Its class.
    pub class: Class,
    /// How long it has run, s.
    pub ran: f64,
    /// How many like it run at a time.
    pub at_a_time: f64,
}

/// Time that `left` takes, s, and whether all of it is known.
///
/// Kinds follow each other mostly, since they depend on each other; of one kind as many run as the
/// machine lets. No cell's own time is cut by others.
#[must_use]
pub fn time_left(left: &[Left], durations: &Durations) -> (f64, bool) {
    let mut whole = true;
    let mut total = 0.0;
    for kind in Kind::ALL {
        let mut work = 0.0;
        let mut longest = 0.0_f64;
        for cell in left.iter().filter(|cell| cell.class.kind == kind) {
            let Some(expected) = durations.expected(&cell.class) else {
                whole = false;
                continue;
            };
            let rest = (expected - cell.ran).max(0.0);
            work += rest / cell.at_a_time.max(1.0);
            longest = longest.max(rest);
        }
        total += work.max(longest);
    }
    (total, whole)
}

/// `seconds` as a person says it.
#[must_use]
pub fn in_words(seconds: f64) -> String {
    if seconds < 90.0 {
        format!("{seconds:.0} s")
    } else if seconds < 5400.0 {
        format!("{:.0} min", seconds / 60.0)
    } else {
        format!("{:.1} h", seconds / 3600.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn class(kind: Kind, details: &str) -> Class {
        Class {
            kind,
            details: details.to_owned(),
        }
    }

    #[test]
    fn work_is_shared_by_those_at_a_time_and_kinds_add_up() {
        let mut durations = Durations::default();
        durations.add(class(Kind::Training, "act"), 100.0);
        durations.add(class(Kind::Training, "act"), 200.0);
        let left = |kind, details: &str, ran| Left {
            class: class(kind, details),
            ran,
            at_a_time: 2.0,
        };
        let trainings = [
            left(Kind::Training, "act", 50.0),
            left(Kind::Training, "act", 0.0),
            left(Kind::Training, "dp3", 0.0),
        ];
        // A network without a training that is done takes what the others took.
        let (seconds, whole) = time_left(&trainings, &durations);
        assert!((seconds - 200.0).abs() < 1e-9 && whole, "{seconds}");
        let more = [&trainings[..], &[left(Kind::Evaluation, "", 0.0)]].concat();
        assert!(!time_left(&more, &durations).1);
        durations.add(class(Kind::Evaluation, ""), 30.0);
        let (seconds, whole) = time_left(&more, &durations);
        // One evaluation is no faster for there being room for two.
        assert!((seconds - 230.0).abs() < 1e-9 && whole, "{seconds}");
        assert_eq!(in_words(59.6), "60 s");
        assert_eq!(in_words(600.0), "10 min");
        assert_eq!(in_words(7200.0), "2.0 h");
    }
}
