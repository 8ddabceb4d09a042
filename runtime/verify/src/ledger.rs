//! What was found: every violation, and for every limit how near the commands came to it.

use super::Violation;

/// Violations that are kept in full; the rest are only counted.
const KEPT_MAX: usize = 100_000;

/// A limit in the ledger.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LimitId(usize);

/// How near the commands came to a limit, or how far beyond it they went.
#[derive(Clone, Debug, PartialEq)]
pub struct Worst {
    /// The arm; both with a `+` between them where the limit is between two.
    pub arm: String,
    /// The limit, as [`Violation::limit`] names it.
    pub limit: String,
    /// The tick in which it happened first.
    pub tick: u64,
    /// The value that came nearest to the bound, or went farthest beyond it.
    pub value: f64,
    /// The bound on its side that held then.
    pub bound: f64,
    /// How far within the bound it was, in the value's unit; negative beyond it. A velocity's bound
    /// is on its absolute value.
    pub margin: f64,
    /// Ticks in which the limit was broken.
    pub broken: u64,
}

/// Everything that was found up to now.
#[derive(Clone, Debug, Default)]
pub(super) struct Ledger {
    /// The tick that is being checked.
    pub(super) tick: u64,
    limits: Vec<Limit>,
    /// In the order in which they were found.
    violations: Vec<Violation>,
    /// All of them, kept or not.
    count: u64,
}

#[derive(Clone, Debug)]
struct Limit {
    arm: String,
    name: String,
    /// None while no value was judged by this limit.
    worst: Option<Extreme>,
    broken: u64,
}

#[derive(Clone, Copy, Debug)]
struct Extreme {
    tick: u64,
    value: f64,
    bound: f64,
    /// Value beyond bound; negative within, NaN if the value is.
    excess: f64,
}

impl Limit {
    /// The first of equals stays; NaN is worse than everything.
    fn keep_worst(&mut self, extreme: Extreme) {
        let no_worse = self
            .worst
            .is_some_and(|worst| extreme.excess <= worst.excess || worst.excess.is_nan());
        if !no_worse {
            self.worst = Some(extreme);
        }
    }

    fn violated(&self, extreme: &Extreme) -> Violation {
        Violation {
            tick: extreme.tick,
            arm: self.arm.clone(),
            limit: self.name.clone(),
            value: extreme.value,
            bound: extreme.bound,
        }
    }
}

impl Ledger {
    /// A new limit called `name`. Names are made here once, not where the limit is checked.
    pub(super) fn open(&mut self, arm: &str, name: String) -> LimitId {
        self.limits.push(Limit {
            arm: arm.to_owned(),
            name,
            worst: None,
            broken: 0,
        });
        LimitId(self.limits.len() - 1)
    }

    /// Notes that `value` exceeds `bound` by `excess`, which may be negative: a violation unless it
    /// is at most `tolerance`. NaN is one.
    pub(super) fn judge(
        &mut self,
        limit: LimitId,
        excess: f64,
        tolerance: f64,
        value: f64,
        bound: f64,
    ) {
        let Some(entry) = self.limits.get_mut(limit.0) else {
            return;
        };
        let extreme = Extreme {
            tick: self.tick,
            value,
            bound,
            excess,
        };
        entry.keep_worst(extreme);
        let fine = excess <= tolerance;
        if !fine {
            entry.broken += 1;
            self.count += 1;
            if self.violations.len() < KEPT_MAX {
                self.violations.push(entry.violated(&extreme));
            }
        }
    }

    /// The largest excess over `limit` until now; minus infinity before the first, or after NaN,
    /// which nothing tops.
    pub(super) fn worst_excess(&self, limit: LimitId) -> f64 {
        let worst = self.limits.get(limit.0).and_then(|entry| entry.worst);
        worst.map_or(f64::NEG_INFINITY, |worst| worst.excess)
    }

    pub(super) fn violations(&self) -> &[Violation] {
        &self.violations
    }

    pub(super) fn into_violations(self) -> Vec<Violation> {
        self.violations
    }

    pub(super) const fn count(&self) -> u64 {
        self.count
    }

    /// For every limit that was looked at, the worst that was seen.
    pub(super) fn worst(&self) -> impl Iterator<Item = Worst> + '_ {
        self.limits.iter().filter_map(|limit| {
            let worst = limit.worst?;
            Some(Worst {
                arm: limit.arm.clone(),
                limit: limit.name.clone(),
                tick: worst.tick,
                value: worst.value,
                bound: worst.bound,
                margin: -worst.excess,
                broken: limit.broken,
            })
        })
    }
}
