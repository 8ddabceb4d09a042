//! How the task of a world in another process stands: what its success asks for, in numbers, for
//! those who look on.

use iceoryx2::prelude::ZeroCopySend;

use super::{Line, Message};
use hal::TimeNs;

/// Criteria of a task at most.
pub const CRITERIA_MAX: usize = 8;

/// One thing that has to be so for success.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/criterion/1")]
pub struct CriterionReport {
    /// What, in words.
    pub name: Line,
    /// `m`, `m/s`, `rad`, `N` or `s`; empty if it is so (1) or not (0).
    pub unit: Line,
    /// How it is, in that unit; not finite if it is not known yet.
    pub value: f64,
    /// How it is to be: at least, or at most.
    pub goal: f64,
    /// 1 if the value is to be the goal or more; otherwise it is to be the goal or less.
    pub at_least: u64,
    /// 1 if it is so.
    pub met: u64,
}

/// How a task stands at a policy step.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/task_report/1")]
pub struct TaskReport {
    /// When it was so: on topics on the system's monotonic clock, the stamp of the scene's report.
    pub stamp: TimeNs,
    /// The policy step, as in the scene's report.
    pub sequence: u64,
    /// What has not happened as long as there is no success, in words.
    pub missing: Line,
    /// How many of `criteria` there are.
    pub criterion_count: u64,
    /// What has to be so at once.
    pub criteria: [CriterionReport; CRITERIA_MAX],
}

impl Message for TaskReport {
    const TOPIC: &'static str = "task";
}

impl TaskReport {
    /// Those of `criteria` that there are; of a count that is nonsense all.
    #[must_use]
    pub fn criteria(&self) -> &[CriterionReport] {
        let count = usize::try_from(self.criterion_count).unwrap_or(CRITERIA_MAX);
        &self.criteria[..count.min(CRITERIA_MAX)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_count_beyond_all_criteria_is_all_of_them() {
        for (criterion_count, expected) in [(0, 0), (3, 3), (8, 8), (9, 8), (u64::MAX, 8)] {
            let report = TaskReport {
                criterion_count,
                ..TaskReport::default()
            };
            assert_eq!(report.criteria().len(), expected, "{criterion_count}");
        }
    }
}
