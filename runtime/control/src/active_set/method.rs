//! The dual active-set method itself. Hot path.
//!
//! One step for an entering row `c` with violation `s = c . x - b > 0`: the primal direction is
//! `z = J2 J2' c`, the active rows' share in `c` is `r = R^-1 J1' c`. The full step is
//! `s / (c . z)`, the longest one that keeps every multiplier `u` from turning negative is
//! `min u_i / r_i` over `r_i > 0`. The shorter one is made: `x -= t z`, `u -= t r`, and `t` is
//! added to the entering multiplier. After a full step the row is active; after a partial one the
//! row whose multiplier vanished leaves. If `z` is zero and no `r_i` is positive, there is no
//! feasible point.

use super::cones::{Cones, Cut, Touch};
use super::factors::{Factors, Seen, add_scaled, dot};
use super::rows::{Rows, UnitRow};
use super::{CONES_MAX, Cone, Failure, LinearRow, Solution, VARIABLES_MAX};

/// A row may be violated by this, in units of `1 + max |d|`.
const TOLERANCE: f64 = 1e-11;
/// The same where a violated row depends on the active ones and nothing can be done.
const TOLERANCE_DEPENDENT: f64 = 1e-9;
/// An active row with a smaller share in the entering row does not leave for it.
const SHARE_MIN: f64 = 1e-12;

/// A row that holds with equality, and how hard it pushes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Active<const N: usize> {
    /// With unit normal, so that its multiplier is in the objective's unit per unit of distance.
    pub(super) row: UnitRow<N>,
    /// Not negative.
    pub(super) multiplier: f64,
    /// Where it supports a cone, unless it is a linear row.
    pub(super) touch: Option<Touch>,
}

impl<const N: usize> Active<N> {
    pub(super) const EMPTY: Self = Self {
        row: UnitRow::EMPTY,
        multiplier: 0.0,
        touch: None,
    };

    const fn linear(row: UnitRow<N>) -> Self {
        Self {
            row,
            multiplier: 0.0,
            touch: None,
        }
    }

    const fn cut(cut: Cut<N>) -> Self {
        Self {
            row: cut.row,
            multiplier: 0.0,
            touch: Some(cut.touch),
        }
    }
}

/// How an entering row ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Entry {
    /// Active.
    Active,
    /// It depends on the active rows and is violated by rounding only.
    Dependent,
}

/// One problem of at most `N` variables, and the way to its solution.
///
/// Filled anew by [`Method::load`]; nothing of an earlier problem counts, which makes the answer a
/// function of the arguments alone.
#[derive(Clone, Debug)]
pub(super) struct Method<const N: usize> {
    /// `G`, without the curvature of cones.
    pub(super) hessian: [[f64; N]; N],
    pub(super) rows: Rows<N>,
    pub(super) cones: Cones<N>,
    pub(super) factors: Factors<N>,
    /// Slope of the model at zero.
    pub(super) slope: [f64; N],
    /// The half-space that stands for each cone.
    pub(super) cuts: [Option<Cut<N>>; CONES_MAX],
    /// The factors are not those of the Hessian alone.
    pub(super) curved: bool,
    /// Multipliers of the cones, as the models' curvature remembers them.
    pub(super) held: [f64; CONES_MAX],
    /// The present point: the optimum of the model on the rows that are active.
    pub(super) x: [f64; N],
    /// In the order of the columns of `R`; the first `active_count` count.
    pub(super) active: [Active<N>; N],
    pub(super) active_count: usize,
    /// Since the problem was loaded, models of cones included.
    pub(super) iterations: u32,
    pub(super) iterations_max: u32,
}

impl<const N: usize> Method<N> {
    /// No problem.
    pub(super) fn new() -> Self {
        Self {
            hessian: [[0.0; N]; N],
            rows: Rows::new(),
            cones: Cones::new(),
            factors: Factors::new(),
            slope: [0.0; N],
            cuts: [None; CONES_MAX],
            curved: false,
            held: [0.0; CONES_MAX],
            x: [0.0; N],
            active: [Active::EMPTY; N],
            active_count: 0,
            iterations: 0,
            iterations_max: 0,
        }
    }

    /// Takes over `hessian`, with the identity past `variables`.
    ///
    /// The identity makes the spare variables positive definite and independent of the others.
    fn load_hessian(
        &mut self,
        hessian: &[[f64; VARIABLES_MAX]; VARIABLES_MAX],
        variables: usize,
    ) -> Result<(), Failure> {
        for (i, (to, from)) in self.hessian.iter_mut().zip(hessian).enumerate() {
            for (j, (to, from)) in to.iter_mut().zip(from).enumerate() {
                let identity = if i == j { 1.0 } else { 0.0 };
                *to = if i < variables && j < variables {
                    *from
                } else {
                    identity
                };
                if !to.is_finite() {
                    return Err(Failure::NotFinite);
                }
            }
        }
        Ok(())
    }

    /// Takes over a problem. Variables past `variables` are there but nothing moves them.
    pub(super) fn load(
        &mut self,
        hessian: &[[f64; VARIABLES_MAX]; VARIABLES_MAX],
        rows: &[LinearRow],
        cones: &[Cone],
        variables: usize,
    ) -> Result<(), Failure> {
        self.load_hessian(hessian, variables)?;
        self.rows.load(rows)?;
        self.cones.load(cones)?;
        self.factors.start(&self.hessian)?;
        self.slope = [0.0; N];
        self.cuts = [None; CONES_MAX];
        self.curved = false;
        self.held = [0.0; CONES_MAX];
        self.x = [0.0; N];
        self.active_count = 0;
        self.iterations = 0;
        Ok(())
    }

    /// Solves the loaded problem.
    pub(super) fn solve(&mut self, iterations_max: u32) -> Result<Solution, Failure> {
        self.iterations_max = iterations_max;
        let mut settled = self.settle()?;
        if !self.cones.hold(&self.x, self.tolerance()) {
            settled = self.meet_cones()?;
        }
        if settled == Entry::Dependent {
            self.accept_dependent()?;
        }
        // A violation of NaN counts as none.
        if !self.x.iter().all(|entry| entry.is_finite()) {
            return Err(Failure::NotFinite);
        }
        Ok(self.solution())
    }

    /// Makes violated rows and half-spaces active, worst first, until none is left.
    ///
    /// Before it calls the point optimal it computes it anew from the factors and looks once more,
    /// since the steps have added rounding.
    pub(super) fn settle(&mut self) -> Result<Entry, Failure> {
        // The point comes from the factors, at the start as well.
        let mut refreshed = true;
        loop {
            let (violation, index) = self.rows.worst(&self.x);
            let cut = self.worst_cut(violation.max(self.tolerance()));
            let entering = if let Some(cut) = cut {
                Active::cut(cut)
            } else if violation > self.tolerance() {
                Active::linear(self.rows.row(index))
            } else if refreshed {
                return Ok(Entry::Active);
            } else {
                self.refresh();
                refreshed = true;
                continue;
            };
            if self.enter(entering)? == Entry::Dependent {
                return Ok(Entry::Dependent);
            }
            refreshed = false;
        }
    }

    /// The half-space that the point violates most, above `tolerance`.
    fn worst_cut(&self, tolerance: f64) -> Option<Cut<N>> {
        let mut worst = (tolerance, None);
        for cut in self.cuts.iter().flatten() {
            let violation = dot(&cut.row.coefficients, &self.x) - cut.row.bound;
            if violation > worst.0 {
                worst = (violation, Some(*cut));
            }
        }
        worst.1
    }

    /// The violation that counts as none.
    pub(super) fn tolerance(&self) -> f64 {
        TOLERANCE * (1.0 + largest(&self.x))
    }

    /// Makes `entering` active while every active row keeps its equality and the optimality
    /// conditions hold.
    fn enter(&mut self, mut entering: Active<N>) -> Result<Entry, Failure> {
        loop {
            self.count_iteration()?;
            let violation = dot(&entering.row.coefficients, &self.x) - entering.row.bound;
            let seen = self.factors.see(&entering.row.coefficients);
            let share = self.factors.share(&seen);
            let (dual_step, leaving) = self.blocking(&share);
            let full_step = if seen.free_squared > 0.0 {
                violation / seen.free_squared
            } else {
                f64::INFINITY
            };
            let step = dual_step.min(full_step);
            if step == f64::INFINITY {
                return if violation <= TOLERANCE_DEPENDENT * (1.0 + largest(&self.x)) {
                    Ok(Entry::Dependent)
                } else {
                    Err(Failure::Infeasible)
                };
            }
            if !step.is_finite() {
                return Err(Failure::NotFinite);
            }
            for (active, share) in self.active.iter_mut().zip(&share).take(self.active_count) {
                active.multiplier = (active.multiplier - step * share).max(0.0);
            }
            entering.multiplier += step;
            if seen.free_squared > 0.0 {
                add_scaled(&mut self.x, -step, &seen.step);
            }
            if full_step <= dual_step {
                self.add(entering, &seen);
                return Ok(Entry::Active);
            }
            self.remove(leaving);
        }
    }

    /// How far the entering multiplier may grow until an active one falls to zero, and which.
    fn blocking(&self, share: &[f64; N]) -> (f64, usize) {
        let mut first = (f64::INFINITY, 0);
        let actives = self.active.iter().zip(share).take(self.active_count);
        for (place, (active, share)) in actives.enumerate() {
            if *share > SHARE_MIN {
                let step = active.multiplier / share;
                if step < first.0 {
                    first = (step, place);
                }
            }
        }
        first
    }

    /// Makes `entering` the last of the active rows, unless the factors find it dependent on the
    /// others.
    pub(super) fn add(&mut self, entering: Active<N>, seen: &Seen<N>) {
        if self.factors.add(seen) {
            self.active[self.active_count] = entering;
            self.active_count += 1;
        }
    }

    /// Takes the active row at `place` out of the factors and the list.
    pub(super) fn remove(&mut self, place: usize) {
        self.factors.remove(place);
        self.active[place..self.active_count].rotate_left(1);
        self.active_count -= 1;
    }

    /// The point and the multipliers anew from the factors, without the rounding of the steps.
    /// Returns the least multiplier, and whose it is.
    pub(super) fn refresh(&mut self) -> (f64, usize) {
        let mut right = [0.0; N];
        for (right, active) in right.iter_mut().zip(&self.active).take(self.active_count) {
            *right = active.row.bound;
        }
        let (x, multipliers) = self.factors.minimum(&self.slope, &right);
        self.x = x;
        let mut least = (f64::INFINITY, 0);
        let actives = self.active.iter_mut().take(self.active_count);
        for (place, (active, multiplier)) in actives.zip(multipliers).enumerate() {
            active.multiplier = multiplier.max(0.0);
            if multiplier < least.0 {
                least = (multiplier, place);
            }
        }
        least
    }

    /// Ends at a point that a dependent row does not let improve, if it satisfies everything else.
    ///
    /// # Errors
    /// [`Failure::Infeasible`] if a row or a cone is violated by more than [`TOLERANCE_DEPENDENT`].
    fn accept_dependent(&self) -> Result<(), Failure> {
        let tolerance = TOLERANCE_DEPENDENT * (1.0 + largest(&self.x));
        if self.rows.worst(&self.x).0 <= tolerance && self.cones.hold(&self.x, tolerance) {
            Ok(())
        } else {
            Err(Failure::Infeasible)
        }
    }

    /// Uses up one of the problem's iterations.
    ///
    /// # Errors
    /// [`Failure::IterationLimit`] if none is left.
    pub(super) fn count_iteration(&mut self) -> Result<(), Failure> {
        if self.iterations >= self.iterations_max {
            return Err(Failure::IterationLimit);
        }
        self.iterations += 1;
        Ok(())
    }
}

/// Largest absolute value.
pub(super) fn largest<const N: usize>(x: &[f64; N]) -> f64 {
    x.iter()
        .fold(0.0, |largest, entry| entry.abs().max(largest))
}
