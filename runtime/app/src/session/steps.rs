//! Policy steps in lockstep: when a session takes its observations.

use hal::{POLICY_STEP_NS, TICK_NS, TimeNs};

use super::SessionError;

/// The shortest and the longest policy step, ns: what the gate takes between two targets of a
/// chunk.
const STEP_NS_RANGE: core::ops::RangeInclusive<u64> = TICK_NS..=1_000_000_000;

/// Policy steps that are evenly apart. Step k is due k times their length after an episode's begin,
/// and begins at the tick nearest to that.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PolicySteps {
    step_ns: u64,
}

impl PolicySteps {
    /// Steps of 40 ms, those of every session but an environment's.
    pub const USUAL: Self = Self {
        step_ns: POLICY_STEP_NS,
    };

    /// Steps of `step_ns`.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if that is not 1 ms to 1 s.
    pub fn of_ns(step_ns: u64) -> Result<Self, SessionError> {
        if STEP_NS_RANGE.contains(&step_ns) {
            return Ok(Self { step_ns });
        }
        Err(SessionError::BadArgument(format!(
            "--step-ns {step_ns}: allowed are {} to {}",
            STEP_NS_RANGE.start(),
            STEP_NS_RANGE.end()
        )))
    }

    /// How long a step is, ns.
    #[must_use]
    pub const fn step_ns(self) -> u64 {
        self.step_ns
    }

    /// The step that begins at `tick`, if one does.
    #[must_use]
    pub const fn beginning_at(self, tick: u64) -> Option<u64> {
        let step = self.nearest(TimeNs::from_tick(tick));
        let begins = (step * self.step_ns + TICK_NS / 2) / TICK_NS;
        if begins == tick { Some(step) } else { None }
    }

    /// The step that is due nearest to `at`.
    #[must_use]
    pub const fn nearest(self, at: TimeNs) -> u64 {
        (at.0 + self.step_ns / 2) / self.step_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn begins(steps: PolicySteps, ticks: u64) -> Vec<(u64, u64)> {
        (0..ticks)
            .filter_map(|tick| steps.beginning_at(tick).map(|step| (tick, step)))
            .collect()
    }

    #[test]
    fn usual_steps_begin_every_40_ticks() {
        let expected: Vec<_> = (0..250).map(|step| (40 * step, step)).collect();
        assert_eq!(begins(PolicySteps::USUAL, 10_000), expected);
    }

    #[test]
    fn steps_begin_at_the_nearest_tick() {
        let thirty = PolicySteps::of_ns(1_000_000_000 / 30).unwrap();
        assert_eq!(
            begins(thirty, 134),
            [(0, 0), (33, 1), (67, 2), (100, 3), (133, 4)]
        );
        // Nothing adds up: after an hour a step is as near to its time as at first.
        let (hour, steps) = (3_600_000, 108_000);
        assert_eq!(
            thirty.beginning_at(hour - 1),
            None,
            "{:?}",
            thirty.nearest(TimeNs::from_tick(hour))
        );
        assert_eq!(thirty.beginning_at(hour), Some(steps));
    }

    #[test]
    fn each_step_of_any_length_begins_once() {
        let lengths = (1..=1000)
            .map(|fps| 1_000_000_000 / fps)
            .chain([TICK_NS + 1]);
        for step_ns in lengths {
            let steps = PolicySteps::of_ns(step_ns).unwrap();
            let found = begins(steps, 3000);
            for (expected, &(tick, step)) in (0..).zip(&found) {
                assert_eq!(step, expected, "{step_ns} ns");
                let due_ns = step * step_ns;
                assert!(
                    due_ns.abs_diff(tick * TICK_NS) <= TICK_NS / 2,
                    "{step_ns} ns"
                );
                assert_eq!(steps.nearest(TimeNs::from_tick(tick)), step, "{step_ns} ns");
            }
            assert!(
                found.len() as u64 >= 3_000_000_000 / step_ns,
                "{step_ns} ns"
            );
        }
    }

    #[test]
    fn steps_out_of_range_are_refused() {
        for step_ns in [0, 999_999, 1_000_000_001, u64::MAX] {
            let error = PolicySteps::of_ns(step_ns).unwrap_err();
            assert!(error.is_bad_input());
            let said = error.to_string();
            assert!(
                said.contains(&format!("{step_ns}: allowed are 1000000 to 1000000000")),
                "{said}"
            );
        }
    }
}
