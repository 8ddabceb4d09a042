//! How fast a training goes, and how long it still takes.

use std::collections::VecDeque;
use std::fmt;

use trocar_train::CurveRow;

/// The pace is that of so much time before now, s.
const RECENT_S: f64 = 300.0;
/// A training that still takes longer than this is warned of, s.
const DAY_S: f64 = 86_400.0;
/// Steps after the first one reported, or time since, s, from which on the pace is one to go by.
const STEADY: (u64, f64) = (10, 30.0);

/// Where a training stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainingStatus {
    /// Steps done.
    pub step: u64,
    /// Steps of the whole training.
    pub steps: u64,
    /// Time since the start, s.
    pub seconds: f64,
    /// What is minimised: of the last step, or the mean of those since the row of the loss curve
    /// before this one.
    pub loss: f64,
    /// The row of the loss curve, if this is one.
    pub row: Option<CurveRow>,
    /// Samples a second in the last five minutes; unknown before the first step.
    pub samples_per_second: Option<f64>,
    /// Time that is left, s, evaluations included; an estimate.
    pub seconds_left: Option<f64>,
}

/// The part of a status line that only a row of the curve has.
fn write_row(f: &mut fmt::Formatter<'_>, row: &CurveRow) -> fmt::Result {
    let CurveRow {
        l1,
        kl,
        gradient_norm,
        ..
    } = row;
    write!(f, ", l1 {l1:.5}, kl {kl:.5}, gradient {gradient_norm:.3}")?;
    match row.validation_l1 {
        Some(l1) => write!(f, ", validation l1 {l1:.5}"),
        None => Ok(()),
    }
}

impl fmt::Display for TrainingStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "step {}/{}: loss {:.5}",
            self.step, self.steps, self.loss
        )?;
        if let Some(row) = &self.row {
            write_row(f, row)?;
        }
        if let Some(rate) = self.samples_per_second {
            write!(f, "; {rate:.1} samples/s")?;
        }
        write!(f, "; {:.0} s", self.seconds)?;
        match self.seconds_left {
            Some(left) => write!(f, ", {left:.0} s left"),
            None => Ok(()),
        }
    }
}

/// Measures a training whose steps have `batch` samples.
///
/// What comes before the first step (decoding) does not count, nor what is done aside, and once
/// there are others, nor the first step, for which an accelerator looks for its best kernels.
#[derive(Clone, Debug)]
pub(super) struct Pace {
    batch: usize,
    /// Steps and times in the last five minutes, oldest first.
    ///
    /// Times are without those aside.
    recent: VecDeque<(u64, f64)>,
    /// The first step reported, and when.
    first: Option<(u64, f64)>,
    samples_per_second: Option<f64>,
    /// First and last row of the loss curve.
    rows: Option<[(u64, f64); 2]>,
    /// Time spent aside, s, and how many times.
    aside: (f64, u64),
    warned: bool,
}

impl Pace {
    pub(super) const fn new(batch: usize) -> Self {
        Self {
            batch,
            recent: VecDeque::new(),
            first: None,
            samples_per_second: None,
            rows: None,
            aside: (0.0, 0),
            warned: false,
        }
    }

    /// The steps begin after `step` of them.
    pub(super) fn begin(&mut self, step: u64, seconds: f64) {
        self.recent = VecDeque::from([(step, seconds - self.aside.0)]);
    }

    /// An evaluation took so long.
    pub(super) fn aside(&mut self, seconds: f64) {
        self.aside = (self.aside.0 + seconds, self.aside.1 + 1);
    }

    /// Where the training stands after `step` of `steps`, with as many times aside still to come.
    pub(super) fn standing(
        &mut self,
        (step, steps): (u64, u64),
        loss: (f64, Option<CurveRow>),
        seconds: f64,
        asides_left: u64,
    ) -> TrainingStatus {
        let now = (step, seconds - self.aside.0);
        if loss.1.is_some() {
            let first = self.rows.map_or(now, |[first, _]| first);
            self.rows = Some([first, now]);
        }
        self.measure(now);
        TrainingStatus {
            step,
            steps,
            seconds,
            loss: loss.0,
            row: loss.1,
            samples_per_second: self.samples_per_second,
            seconds_left: self.left_s(steps.saturating_sub(step), asides_left),
        }
    }

    /// The time for `steps` and `asides`, s, at the pace that is known.
    ///
    /// None before there is a rate.
    fn left_s(&self, steps: u64, asides: u64) -> Option<f64> {
        let rate = self.samples_per_second?;
        let samples = number(steps) * number(self.batch as u64);
        Some(samples / rate + number(asides) * self.aside_mean())
    }

    /// The rate is over all that is remembered, so a single slow step moves it little. At least two
    /// entries stay, however old they are.
    fn measure(&mut self, now: (u64, f64)) {
        if let Some(rate) = self.recent.front().and_then(|from| self.rate(*from, now)) {
            self.samples_per_second = Some(rate);
        }
        if self.first.is_none() {
            self.first = Some(now);
            self.recent.clear();
        }
        self.recent.push_back(now);
        while self.recent.len() > 2 && self.recent[0].1 < now.1 - RECENT_S {
            self.recent.pop_front();
        }
    }

    /// Samples a second from one step to another.
    fn rate(&self, from: (u64, f64), to: (u64, f64)) -> Option<f64> {
        let samples = number(to.0.saturating_sub(from.0)) * number(self.batch as u64);
        let seconds = to.1 - from.1;
        (samples > 0.0 && seconds > 0.0).then(|| samples / seconds)
    }

    /// 0 before the first.
    fn aside_mean(&self) -> f64 {
        self.aside.0 / number(self.aside.1).max(1.0)
    }

    /// Samples a second between the first row of the loss curve and the last.
    pub(super) fn samples_per_second(&self) -> Option<f64> {
        let [first, last] = self.rows?;
        self.rate(first, last)
    }

    /// What to say, once, of a training that still takes more than a day.
    pub(super) fn warning(&mut self, standing: &TrainingStatus) -> Option<String> {
        let (first, since) = self.first?;
        let now = standing.seconds - self.aside.0;
        let steady =
            standing.step >= first + STEADY.0 || (standing.step > first && now - since >= STEADY.1);
        let left = standing.seconds_left.filter(|&left| left > DAY_S)?;
        if self.warned || !steady {
            return None;
        }
        self.warned = true;
        Some(format!(
            "at {:.1} samples/s the {} steps that are left take about {:.1} days; fewer --steps, a smaller --preset or --batch, or \
             --device cuda take less; Ctrl-C keeps the state, and --resume goes on",
            standing.samples_per_second.unwrap_or(0.0),
            standing.steps - standing.step,
            left / DAY_S
        ))
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^52")]
const fn number(count: u64) -> f64 {
    count as f64
}

#[cfg(test)]
mod tests {
    use super::{Pace, TrainingStatus};
    use trocar_train::CurveRow;

    fn row(step: u64) -> CurveRow {
        CurveRow {
            step,
            loss: 1.0,
            l1: 0.5,
            kl: 0.1,
            gradient_norm: 2.0,
            lr: 1e-4,
            validation_l1: None,
        }
    }

    fn at(pace: &mut Pace, step: u64, seconds: f64) -> TrainingStatus {
        pace.standing((step, 400), (1.0, Some(row(step))), seconds, 0)
    }

    #[test]
    fn rate_and_time_left_are_there_from_the_first_step() {
        let mut pace = Pace::new(8);
        // Decoding took 80 s, the first step 2 s.
        pace.begin(0, 80.0);
        let first = at(&mut pace, 1, 82.0);
        assert_eq!(first.samples_per_second, Some(4.0));
        assert_eq!(first.seconds_left, Some(798.0));
        assert_eq!(pace.samples_per_second(), None);
        // Later the first step does not count.
        let later = at(&mut pace, 201, 92.0);
        assert_eq!(later.samples_per_second, Some(160.0));
        assert_eq!(later.seconds_left, Some(9.95));
        assert_eq!(pace.samples_per_second(), Some(160.0));
        let line = later.to_string();
        assert!(
            line.starts_with("step 201/400: loss 1.00000, l1 0.5")
                && line.ends_with("; 160.0 samples/s; 92 s, 10 s left"),
            "{line}"
        );
    }

    #[test]
    fn the_pace_is_that_of_the_last_five_minutes() {
        let mut pace = Pace::new(1);
        pace.begin(0, 0.0);
        let mut last = at(&mut pace, 1, 5.0);
        for step in 2..=100_u32 {
            last = at(&mut pace, step.into(), 5.0 * f64::from(step));
        }
        assert!((last.samples_per_second.unwrap() - 0.2).abs() < 1e-9);
        // Four times as fast from here.
        for step in 101..=400_u32 {
            last = at(&mut pace, step.into(), 500.0 + f64::from(step - 100) * 1.25);
        }
        assert!((last.samples_per_second.unwrap() - 0.8).abs() < 0.01);
    }

    #[test]
    fn an_evaluation_is_no_training_but_takes_time() {
        let mut pace = Pace::new(10);
        pace.begin(0, 0.0);
        at(&mut pace, 1, 1.0);
        at(&mut pace, 11, 11.0);
        pace.aside(50.0);
        let loss = (1.0, None);
        let standing = pace.standing((21, 31), loss, 71.0, 2);
        assert_eq!(standing.samples_per_second, Some(10.0));
        assert_eq!(standing.seconds_left, Some(10.0 + 2.0 * 50.0));
    }

    /// A training of more than a day is warned of once and not by its first step.
    #[test]
    fn long_training_is_warned_of_once() {
        let long = |pace: &mut Pace, step: u64, seconds: f64| {
            let standing = pace.standing((step, 100_000), (1.0, None), seconds, 0);
            pace.warning(&standing)
        };
        let mut pace = Pace::new(8);
        pace.begin(0, 0.0);
        assert_eq!(long(&mut pace, 1, 60.0), None, "one slow step says nothing");
        assert_eq!(long(&mut pace, 3, 64.0), None);
        let warning = long(&mut pace, 11, 80.0).unwrap();
        assert!(
            warning.contains("at 4.0 samples/s the 99989 steps")
                && warning.contains("about 2.3 days"),
            "{warning}"
        );
        assert_eq!(long(&mut pace, 12, 82.0), None, "once");
        // A step of a minute: two are enough to know.
        let mut pace = Pace::new(8);
        pace.begin(0, 0.0);
        assert_eq!(long(&mut pace, 1, 60.0), None);
        assert!(long(&mut pace, 2, 120.0).is_some());
        // Less than a day.
        let mut pace = Pace::new(8);
        pace.begin(0, 0.0);
        for step in 1..100_u32 {
            assert_eq!(long(&mut pace, step.into(), f64::from(step) * 0.8), None);
        }
    }
}
