//! The check as a stream: command after command, for one arm or two, without a log.

use hal::{ArmCommand, ArmError, ArmState, SafeTail, TimeNs};

use super::arm::Arm;
use super::ledger::{Ledger, LimitId, Worst};
use super::limits::Limits;
use super::measured::MeasuredClearance;
use super::pair::Pair;
use super::tail::Tails;
use super::{VerifyError, Violation};

/// Checks commands as they come.
///
/// Feed it every tick, in order: derivatives are differences between ticks.
#[derive(Clone, Debug)]
pub struct Stream {
    ledger: Ledger,
    arms: Vec<Arm>,
    pair: Option<Pair>,
    tails: Tails,
    /// More commands than arms in `safety.toml`.
    strangers: LimitId,
    /// Fewer.
    absent: LimitId,
    clock: LimitId,
    contents: LimitId,
    /// Arms that the newest tick had commands for.
    commanded: usize,
    /// When the newest tick was.
    now_ns: Option<u64>,
}

impl Stream {
    /// A check against the limits in the texts of `control.toml` and of a task's `safety.toml`.
    ///
    /// # Errors
    /// [`VerifyError::Malformed`] when a text does not say what the limits are.
    pub fn new(control: &str, safety: &str) -> Result<Self, VerifyError> {
        let limits = Limits::parse(control, safety)?;
        let mut ledger = Ledger::default();
        let arms = limits.arms.iter();
        let arms = arms
            .map(|arm| Arm::new(&mut ledger, &limits, arm))
            .collect();
        let between = limits.between_arms.as_ref();
        Ok(Self {
            arms,
            pair: between.and_then(|between| Pair::new(&mut ledger, &limits, between)),
            tails: Tails::new(&mut ledger, &limits),
            strangers: ledger.open("", "unknown_arms".to_owned()),
            absent: ledger.open("", "missing_arms".to_owned()),
            clock: ledger.open("", "clock_ns".to_owned()),
            contents: ledger.open("", "contents_mismatches".to_owned()),
            commanded: 0,
            now_ns: None,
            ledger,
        })
    }

    /// Checks the commands of `tick`, each with what its arm had measured, in the order of the arms
    /// in `safety.toml`.
    ///
    /// Without the second arm neither it nor the gaps between the two are checked. More arms than
    /// the file has are a violation.
    pub fn tick(&mut self, tick: u64, arms: &[(&ArmCommand, &Result<ArmState, ArmError>)]) {
        self.ledger.tick = tick;
        self.commanded = arms.len();
        for (arm, (command, measured)) in self.arms.iter_mut().zip(arms) {
            arm.tick(&mut self.ledger, command, measured);
        }
        if arms.len() > self.arms.len() {
            self.ledger.judge(self.strangers, 1.0, 0.0, 1.0, 0.0);
        }
        if arms.len() == 2
            && let [first, second] = self.arms.as_slice()
            && let (Some(first), Some(second)) = (&first.newest, &second.newest)
            && let Some(pair) = &mut self.pair
        {
            pair.tick(&mut self.ledger, [first, second]);
        }
    }

    /// Checks the safe tails that travel with the commands of the newest [`Self::tick`], in the
    /// same order.
    ///
    /// A tail goes on from its command, keeps every limit of the axes at every moment and every
    /// other limit in every millisecond, and ends at rest. Two tails are played together. Limits
    /// are named as those of commands, with `tail.` in front.
    pub fn tails(&mut self, tails: &[&SafeTail]) {
        self.tails
            .check(&mut self.ledger, &mut self.arms, self.pair.as_mut(), tails);
    }

    /// Checks the time of the newest [`Self::tick`], which is `now`: it is after all that came
    /// before, missing ticks too, and its commands are of then.
    pub fn clock(&mut self, now: TimeNs) {
        #[expect(clippy::cast_precision_loss, reason = "for people")]
        let number = |ns: u64| ns as f64;
        if let Some(before_ns) = self.now_ns.replace(now.0)
            && now.0 <= before_ns
        {
            let [value, bound] = [now.0, before_ns].map(number);
            self.ledger.judge(self.clock, 1.0, 0.0, value, bound);
        }
        let commands = self.arms.iter().take(self.commanded);
        let commands = commands.filter_map(|arm| arm.newest.as_ref());
        for stamp in commands.map(|newest| newest.command.stamp) {
            if stamp != now {
                let [value, bound] = [now.0, stamp.0].map(number);
                self.ledger.judge(self.clock, 1.0, 0.0, value, bound);
            }
        }
    }

    /// How near the measured arms came to each boundary, and to one another, while they held
    /// torque.
    #[must_use]
    pub fn measured(&self) -> Vec<MeasuredClearance> {
        let arms = self.arms.iter().flat_map(|arm| arm.measured.found());
        let pair = self.pair.iter().filter_map(Pair::measured);
        arms.chain(pair).collect()
    }

    /// Says that what was checked is not what the run wrote.
    pub fn other_contents(&mut self) {
        self.ledger.judge(self.contents, 1.0, 0.0, 1.0, 0.0);
    }

    /// The violations in the order in which they were found: the first hundred thousand.
    #[must_use]
    pub fn violations(&self) -> &[Violation] {
        self.ledger.violations()
    }

    /// How many violations were found.
    #[must_use]
    pub const fn violation_count(&self) -> u64 {
        self.ledger.count()
    }

    /// For every limit that was looked at, how near the commands came to it.
    pub fn worst(&self) -> impl Iterator<Item = Worst> + '_ {
        self.ledger.worst()
    }

    /// Control periods that the driver skipped; no violation.
    #[must_use]
    pub fn skipped_periods(&self) -> u64 {
        let skipped = self.arms.iter().map(|arm| arm.skipped_periods);
        skipped.max().unwrap_or(0)
    }

    /// Says that the newest tick had commands for `count` arms and should have had one for each.
    pub fn expect_arms(&mut self, count: usize) {
        if count < self.arms.len() {
            self.ledger.judge(self.absent, 1.0, 0.0, 1.0, 0.0);
        }
    }

    /// Says that `count` ticks before `tick` are missing.
    pub fn missing(&mut self, tick: u64, count: u64) {
        self.ledger.tick = tick;
        for arm in &mut self.arms {
            arm.missing(&mut self.ledger, count);
        }
        if let Some(pair) = &mut self.pair {
            pair.forget();
        }
    }

    /// Says that the next tick is not the first of its run: what came before is not known.
    pub fn resume(&mut self) {
        self.arms.iter_mut().for_each(Arm::resume);
        if let Some(pair) = &mut self.pair {
            pair.forget();
        }
    }

    /// Says that the commands are not the ones that the run reported.
    pub fn other_hash(&mut self) {
        if let Some(arm) = self.arms.first() {
            arm.other_hash(&mut self.ledger);
        }
    }

    /// The violations, as [`Self::violations`] has them.
    #[must_use]
    pub fn into_violations(self) -> Vec<Violation> {
        self.ledger.into_violations()
    }
}
