//! How many trials of an evaluation ended how, and what is asked of them: the one place that
//! counts.

use core::fmt;

use super::summary::{TrialSummary, wilson_interval};

/// Trials of an evaluation by how they ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Score {
    /// Trials in which the task was done.
    pub successes: usize,
    /// Trials that were lost.
    pub failures: usize,
    /// Trials that say nothing, since the simulation was at fault.
    pub invalid: usize,
}

impl Score {
    /// Counts `trials`.
    #[must_use]
    pub fn of(trials: &[TrialSummary]) -> Self {
        let mut score = Self::default();
        for trial in trials {
            score.add(trial);
        }
        score
    }

    /// Counts one more trial.
    pub const fn add(&mut self, trial: &TrialSummary) {
        if trial.invalid {
            self.invalid += 1;
        } else if trial.success {
            self.successes += 1;
        } else {
            self.failures += 1;
        }
    }

    /// Trials that count for the rate.
    #[must_use]
    pub const fn trials(self) -> usize {
        self.successes + self.failures
    }

    /// `successes / trials`; 0 without a trial.
    #[must_use]
    pub fn rate(self) -> f64 {
        wilson_interval(self.successes, self.trials()).0
    }

    /// Wilson's 95 % interval of the rate.
    #[must_use]
    pub fn wilson95(self) -> [f64; 2] {
        wilson_interval(self.successes, self.trials()).1
    }
}

impl fmt::Display for Score {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [low, high] = self.wilson95();
        let all = self.trials() + self.invalid;
        write!(f, "{} of {all} succeeded", self.successes)?;
        if self.invalid > 0 {
            let invalid = self.invalid;
            write!(f, ", {invalid} invalid (the simulation was at fault)")?;
        }
        write!(f, ", rate {:.2} [{low:.2}, {high:.2}]", self.rate())
    }
}

/// What an evaluation must reach.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Demand {
    /// The least success rate.
    pub rate: Option<f64>,
    /// The least lower end of Wilson's 95 % interval.
    pub wilson: Option<f64>,
}

impl Demand {
    /// What `score` falls short of, in words; none if nothing.
    #[must_use]
    pub fn unmet(&self, score: Score) -> Option<String> {
        let [low, _] = score.wilson95();
        let found = [
            ("success rate", score.rate(), "--min-rate", self.rate),
            (
                "lower end of Wilson's 95 % interval",
                low,
                "--min-wilson",
                self.wilson,
            ),
        ];
        let short = found
            .into_iter()
            .filter_map(|(what, value, option, least)| {
                let least = least.filter(|&least| value < least)?;
                Some(format!("{what} {value:.4} is below {option} {least}"))
            });
        let short: Vec<String> = short.collect();
        (!short.is_empty()).then(|| short.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::{Demand, Score};

    fn score(successes: usize, failures: usize) -> Score {
        Score {
            successes,
            failures,
            invalid: 0,
        }
    }

    #[test]
    fn what_is_invalid_does_not_count_for_the_rate() {
        let score = Score {
            invalid: 2,
            ..score(3, 1)
        };
        assert_eq!(score.trials(), 4);
        assert_eq!(
            score.to_string(),
            "3 of 6 succeeded, 2 invalid (the simulation was at fault), rate 0.75 [0.30, 0.95]"
        );
    }

    #[test]
    fn a_rate_that_is_just_reached_is_enough() {
        for (successes, trials) in [(49, 50), (7, 10), (1, 3), (0, 5), (3, 3)] {
            #[expect(clippy::cast_precision_loss, reason = "few trials")]
            let least = successes as f64 / trials as f64;
            let demand = Demand {
                rate: Some(least),
                wilson: None,
            };
            assert_eq!(demand.unmet(score(successes, trials - successes)), None);
        }
        let demand = Demand {
            rate: Some(0.98),
            wilson: None,
        };
        assert_eq!(demand.unmet(score(49, 1)), None);
        let unmet = demand.unmet(score(48, 2)).unwrap();
        assert_eq!(unmet, "success rate 0.9600 is below --min-rate 0.98");
    }

    #[test]
    fn the_interval_s_lower_end_is_asked_for_apart() {
        // 50 of 50: Wilson's lower end is 0.9287.
        let demand = |wilson| Demand {
            rate: Some(1.0),
            wilson: Some(wilson),
        };
        assert_eq!(demand(0.92).unmet(score(50, 0)), None);
        let unmet = demand(0.95).unmet(score(50, 0)).unwrap();
        assert!(
            unmet.contains("0.9287") && unmet.contains("--min-wilson 0.95"),
            "{unmet}"
        );
        assert!(!unmet.contains("--min-rate"), "{unmet}");
        let unmet = demand(0.95).unmet(score(40, 10)).unwrap();
        assert!(unmet.contains("--min-rate") && unmet.contains("--min-wilson"));
    }

    #[test]
    fn no_trial_reaches_nothing_but_nothing() {
        assert_eq!(Demand::default().unmet(score(0, 0)), None);
        let demand = Demand {
            rate: Some(0.1),
            wilson: None,
        };
        assert!(demand.unmet(score(0, 0)).is_some());
    }
}
