//! What a task's judge looks for, in numbers: a table without memory of its own, for those who look
//! on.

/// Criteria of a task at most.
pub const CRITERIA_MAX: usize = 8;

/// One thing that has to be so for success.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Criterion {
    /// What, in words.
    pub name: &'static str,
    /// `m`, `m/s`, `rad`, `N` or `s`; empty if it is so (1) or not (0).
    pub unit: &'static str,
    /// How it is; not finite if it is not known yet.
    pub value: f64,
    /// How it is to be: at least, or at most.
    pub goal: f64,
    /// Whether the value is to be the goal or more; otherwise it is to be the goal or less.
    pub at_least: bool,
    /// Whether it is so.
    pub met: bool,
}

/// All that has to be so at once, in the order of insertion. Met if there are none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Criteria([Option<Criterion>; CRITERIA_MAX]);

impl Criteria {
    /// Each of them.
    pub fn iter(&self) -> impl Iterator<Item = &Criterion> {
        self.0.iter().flatten()
    }

    /// Whether all is so.
    #[must_use]
    pub fn are_met(&self) -> bool {
        self.iter().all(|criterion| criterion.met)
    }

    /// The same with a `value` that is to reach `goal`.
    pub(super) fn at_least(
        self,
        name: &'static str,
        unit: &'static str,
        value: f64,
        goal: f64,
    ) -> Self {
        self.with(Criterion {
            name,
            unit,
            value,
            goal,
            at_least: true,
            met: value >= goal,
        })
    }

    /// The same with a `value` that is not to exceed `goal`.
    pub(super) fn at_most(
        self,
        name: &'static str,
        unit: &'static str,
        value: f64,
        goal: f64,
    ) -> Self {
        self.with(Criterion {
            name,
            unit,
            value,
            goal,
            at_least: false,
            met: value <= goal,
        })
    }

    /// The same with something that is to be so.
    pub(super) fn so(self, name: &'static str, is_so: bool) -> Self {
        self.at_least(name, "", f64::from(u8::from(is_so)), 1.0)
    }

    /// Appends one. Panics beyond [`CRITERIA_MAX`]: a mistake of the monitor, which shows at its
    /// first observation.
    fn with(mut self, criterion: Criterion) -> Self {
        let place = self.0.iter_mut().find(|place| place.is_none());
        assert!(place.is_some(), "{criterion:?} finds no room");
        if let Some(place) = place {
            *place = Some(criterion);
        }
        self
    }
}
