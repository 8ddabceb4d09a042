//! An exact solver for the small dense convex problems of the safety filter. Hot path: bounded, no
//! allocation, no I/O, no lock.
//!
//! Minimise `d' G d / 2` over the change `d`, subject to rows `c . d <= b` and cones `|M d + o| <=
//! r`.
//!
//! The rows are met by the dual active-set method of Goldfarb and Idnani (1983): from the
//! unconstrained optimum `d = 0` one violated row after the other becomes active, and rows whose
//! multiplier falls to zero leave. The cones follow by a sequence of quadratic models: each cone is
//! replaced by the half-space that supports it at the last point, and its multiplier times its
//! curvature is added to `G`. The same method solves each model, starting with the rows that were
//! active before. This is Newton's method with inequalities, so the last steps converge
//! quadratically.
//!
//! A variable that no active row reaches, directly or through `G`, changes by exactly zero.

mod answer;
mod cones;
mod factors;
mod method;
mod model;
mod rows;

use core::fmt;

use method::Method;

/// The most variables: two arms.
pub const VARIABLES_MAX: usize = 14;
/// Variables of one arm; problems of this size take half the work.
const VARIABLES_ONE_ARM: usize = 7;
/// The most linear rows.
pub const ROWS_MAX: usize = 512;
/// The most cones.
pub const CONES_MAX: usize = 4;

/// A row `coefficients . d <= bound`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearRow {
    /// One per variable; those past the problem's size must be zero.
    pub coefficients: [f64; VARIABLES_MAX],
    /// Negative if `d = 0` violates the row.
    pub bound: f64,
}

/// A cone `|matrix d + offset| <= radius`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    /// Three rows; columns past the problem's size must be zero.
    pub matrix: [[f64; VARIABLES_MAX]; 3],
    /// Value at `d = 0`.
    pub offset: [f64; 3],
    /// Largest length, positive.
    pub radius: f64,
}

/// The optimum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// The change `d`; exactly zero past the problem's size.
    pub change: [f64; VARIABLES_MAX],
    /// Steps of the dual method, and models of the cones.
    ///
    /// Of both phases together; what `iterations_max` bounds.
    pub iterations: u32,
}

/// Why there is no optimum. The solver may be used again after each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// Too many iterations.
    ///
    /// Of the whole problem, or more than 40 quadratic models of its cones.
    IterationLimit,
    /// No point satisfies all rows and cones, or a cone has no inside.
    Infeasible,
    /// A number is infinite or NaN.
    NotFinite,
    /// The Hessian has no Cholesky factor.
    NotPositiveDefinite,
    /// More variables, rows or cones than there is room for.
    TooLarge,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::IterationLimit => "too many iterations",
            Self::Infeasible => "no point satisfies all rows",
            Self::NotFinite => "a number is not finite",
            Self::NotPositiveDefinite => "the Hessian is not positive definite",
            Self::TooLarge => "the problem is too large",
        })
    }
}

impl core::error::Error for Failure {}

/// The solver and its memory.
///
/// Two instances of one method, so that the loops have constant bounds: 7 variables for a problem
/// of one arm, 14 for one of two.
#[derive(Clone, Debug)]
pub struct ActiveSet {
    one_arm: Method<VARIABLES_ONE_ARM>,
    two_arms: Method<VARIABLES_MAX>,
}

impl ActiveSet {
    /// Allocates all memory.
    #[must_use]
    pub fn new() -> Self {
        Self {
            one_arm: Method::new(),
            two_arms: Method::new(),
        }
    }

    /// The minimum over the first `variables` variables.
    ///
    /// `hessian` is symmetric; its leading part counts. The same arguments give the same bits,
    /// whatever was solved before.
    ///
    /// # Errors
    /// [`Failure`]; nothing is known about the change then.
    pub fn solve(
        &mut self,
        hessian: &[[f64; VARIABLES_MAX]; VARIABLES_MAX],
        rows: &[LinearRow],
        cones: &[Cone],
        iterations_max: u32,
        variables: usize,
    ) -> Result<Solution, Failure> {
        if variables > VARIABLES_MAX {
            return Err(Failure::TooLarge);
        }
        if variables <= VARIABLES_ONE_ARM {
            self.one_arm.load(hessian, rows, cones, variables)?;
            self.one_arm.solve(iterations_max)
        } else {
            self.two_arms.load(hessian, rows, cones, variables)?;
            self.two_arms.solve(iterations_max)
        }
    }
}

impl Default for ActiveSet {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
