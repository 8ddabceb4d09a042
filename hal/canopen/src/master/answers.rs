//! Which SYNC an axis' newest answer belongs to. Hot path: bounded, no allocation.
//!
//! Process data carry no sequence number. After a missing answer the next one may be the missing
//! one, late, and so may all that follow. A pause, a period without a SYNC, tells: what comes in it
//! was late, and if nothing comes the answers are in step again.

/// What the newest period says of the answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answers {
    /// The newest answer is to the newest SYNC.
    InStep,
    /// One has come, to the newest SYNC or to one before it.
    Ambiguous,
    /// None has come to the newest SYNC, and some may still come.
    Missing,
    /// None was to the newest SYNC, and none will come.
    Late,
}

impl Answers {
    /// After a period that began with a SYNC, in which so many answers of any kind came, and a
    /// usable one or not.
    pub(super) const fn after_cycle(self, count: u32, usable: bool) -> Self {
        match (usable, count, self) {
            (false, ..) => Self::Missing,
            (true, 0 | 1, Self::InStep | Self::Late) => Self::InStep,
            (true, ..) => Self::Ambiguous,
        }
    }

    /// After a pause in which so many answers came; `outstanding` SYNCs may still be answered.
    pub(super) const fn after_pause(self, count: u32, outstanding: u32) -> Self {
        match (self.has_answer(), count, outstanding) {
            (true, 0, _) => Self::InStep,
            (_, _, 0) => Self::Late,
            (..) => Self::Missing,
        }
    }

    /// Whether a usable answer came in the newest SYNC's own period, and none in a pause after it.
    pub(super) const fn has_answer(self) -> bool {
        matches!(self, Self::InStep | Self::Ambiguous)
    }

    /// Whether answers and SYNCs may be out of step.
    pub(super) const fn may_be_out_of_step(self) -> bool {
        matches!(self, Self::Ambiguous | Self::Missing)
    }
}

#[cfg(test)]
mod tests {
    use super::Answers::{Ambiguous, InStep, Late, Missing};

    #[test]
    fn transitions_after_a_cycle() {
        // Nothing usable; one answer; two.
        let table = [
            (InStep, [Missing, InStep, Ambiguous]),
            (Ambiguous, [Missing, Ambiguous, Ambiguous]),
            (Missing, [Missing, Ambiguous, Ambiguous]),
            (Late, [Missing, InStep, Ambiguous]),
        ];
        for (from, [none, one, two]) in table {
            assert_eq!(from.after_cycle(0, false), none, "{from:?}");
            assert_eq!(from.after_cycle(1, false), none, "{from:?}");
            assert_eq!(from.after_cycle(1, true), one, "{from:?}");
            assert_eq!(from.after_cycle(2, true), two, "{from:?}");
        }
    }

    #[test]
    fn transitions_after_a_pause() {
        // No answer, or one; with no SYNC outstanding, or one.
        let table = [
            (InStep, [[InStep, InStep], [Late, Missing]]),
            (Ambiguous, [[InStep, InStep], [Late, Missing]]),
            (Missing, [[Late, Missing], [Late, Missing]]),
            (Late, [[Late, Missing], [Late, Missing]]),
        ];
        for (from, rows) in table {
            for (count, row) in (0..).zip(rows) {
                for (outstanding, to) in (0..).zip(row) {
                    let after = from.after_pause(count, outstanding);
                    assert_eq!(after, to, "{from:?} {count} {outstanding}");
                }
            }
        }
    }
}
