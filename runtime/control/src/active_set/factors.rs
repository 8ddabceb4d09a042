//! The factors that a dual active-set method keeps: `J' G J = 1` and `J' N = [R; 0]`, `N` the
//! active rows. Hot path.
//!
//! `J` and `R` are those of Goldfarb and Idnani (1983). With `J = [J1 J2]` split after the `count`
//! active rows, the columns of `J2` span the moves that no active row notices. Start costs
//! `O(N^3)`, adding or removing a row `O(N^2)`.

use super::Failure;

/// A pivot of the Cholesky factor below this part of its diagonal entry is not positive.
const PIVOT_MIN: f64 = 1e-14;
/// A row whose part outside the active rows' span is shorter than this (squared, relative) depends
/// on them.
const DEPENDENT_SQUARED: f64 = 1e-22;

/// `a . b`.
pub(super) fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// `y += factor x`.
pub(super) fn add_scaled<const N: usize>(y: &mut [f64; N], factor: f64, x: &[f64; N]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += factor * x;
    }
}

/// A row seen from the factors: `J' c`, and its part that the active rows leave free.
///
/// Computed once for an entering row, and used for the step, the multipliers and the update.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen<const N: usize> {
    /// `J' c`.
    projected: [f64; N],
    /// `J2 J2' c`: how the variables move, up to sign, when the row's multiplier grows.
    pub(super) step: [f64; N],
    /// `c . step`; zero if the row depends on the active rows.
    pub(super) free_squared: f64,
}

/// The factors of a positive definite matrix and of its active rows.
#[derive(Clone, Debug)]
pub(super) struct Factors<const N: usize> {
    /// Columns of `J`; the first `count` belong to the active rows.
    columns: [[f64; N]; N],
    /// Columns of `R`, upper triangular: zero below the diagonal.
    triangle: [[f64; N]; N],
    /// One over the diagonal of `R`.
    diagonal_inverse: [f64; N],
    /// Active rows, at most `N`.
    count: usize,
}

impl<const N: usize> Factors<N> {
    /// Factors of nothing.
    pub(super) const fn new() -> Self {
        Self {
            columns: [[0.0; N]; N],
            triangle: [[0.0; N]; N],
            diagonal_inverse: [0.0; N],
            count: 0,
        }
    }

    /// Starts anew from `hessian`, of which the lower triangle counts, without active rows.
    ///
    /// Cholesky, `G = L L'`, and `J = L^-T` by forward substitution alongside.
    ///
    /// # Errors
    /// [`Failure::NotFinite`] or [`Failure::NotPositiveDefinite`].
    pub(super) fn start(&mut self, hessian: &[[f64; N]; N]) -> Result<(), Failure> {
        self.triangle = [[0.0; N]; N];
        self.count = 0;
        let mut lower = [[0.0; N]; N];
        let mut inverse = [0.0; N];
        for j in 0..N {
            let mut row = [0.0; N];
            let mut pivot = hessian[j][j];
            for k in 0..j {
                let sum: f64 = row.iter().zip(&lower[k]).take(k).map(|(a, b)| a * b).sum();
                row[k] = (hessian[j][k] - sum) * inverse[k];
                pivot -= row[k] * row[k];
            }
            if !pivot.is_finite() {
                return Err(Failure::NotFinite);
            }
            if pivot <= PIVOT_MIN * hessian[j][j].abs() {
                return Err(Failure::NotPositiveDefinite);
            }
            inverse[j] = pivot.sqrt().recip();
            lower[j] = row;
            // Column j of J is row j of the factor's inverse.
            let mut column = [0.0; N];
            column[j] = 1.0;
            for (factor, earlier) in row.iter().zip(&self.columns).take(j) {
                add_scaled(&mut column, -factor, earlier);
            }
            self.columns[j] = column.map(|entry| entry * inverse[j]);
        }
        Ok(())
    }

    /// How the factors see the row `coefficients`.
    pub(super) fn see(&self, coefficients: &[f64; N]) -> Seen<N> {
        let mut projected = [0.0; N];
        for (entry, column) in projected.iter_mut().zip(&self.columns) {
            *entry = dot(column, coefficients);
        }
        let mut step = [0.0; N];
        let mut free_squared = 0.0;
        for (entry, column) in projected.iter().zip(&self.columns).skip(self.count) {
            free_squared += entry * entry;
            add_scaled(&mut step, *entry, column);
        }
        if free_squared <= DEPENDENT_SQUARED * dot(&projected, &projected) {
            free_squared = 0.0;
        }
        Seen {
            projected,
            step,
            free_squared,
        }
    }

    /// The active rows' share in a row: `R^-1 J1' c`.
    pub(super) fn share(&self, seen: &Seen<N>) -> [f64; N] {
        self.back_substituted(seen.projected)
    }

    /// Makes a row active, the last one; false if it depends on those that are.
    ///
    /// A Householder reflection of the columns of `J2` leaves of `J2' c` only its first entry: the
    /// length, up to sign, which is the new diagonal entry of `R`.
    pub(super) fn add(&mut self, seen: &Seen<N>) -> bool {
        let first = self.count;
        if seen.free_squared <= 0.0 || first >= N {
            return false;
        }
        let mut projected = seen.projected;
        // The longest entry leads: entries that are zero, and so their columns, stay out of the
        // reflection.
        let mut lead = first;
        for j in first..N {
            if projected[j].abs() > projected[lead].abs() {
                lead = j;
            }
        }
        projected.swap(first, lead);
        self.columns.swap(first, lead);
        let length = seen.free_squared.sqrt();
        let signed = length.copysign(projected[first]);
        // Householder: v = d2 + signed e1, and J2 v = step + signed j1 is nearly known.
        let mut mixed = seen.step;
        add_scaled(&mut mixed, signed, &self.columns[first]);
        let factor = (length * (length + projected[first].abs())).recip();
        let mut reflector = projected;
        reflector[first] += signed;
        for (entry, column) in reflector.iter().zip(&mut self.columns).skip(first) {
            if *entry != 0.0 {
                add_scaled(column, -factor * entry, &mixed);
            }
        }
        let column = &mut self.triangle[first];
        *column = [0.0; N];
        for (entry, value) in column.iter_mut().zip(&projected).take(first) {
            *entry = *value;
        }
        column[first] = -signed;
        self.diagonal_inverse[first] = -signed.recip();
        self.count += 1;
        true
    }

    /// Makes the active row `place` inactive; those behind it move up.
    ///
    /// Givens rotations restore the triangle that the missing column leaves.
    ///
    /// # Panics
    /// If no active row is there.
    pub(super) fn remove(&mut self, place: usize) {
        assert!(place < self.count, "no such active row");
        self.triangle.copy_within(place + 1..self.count, place);
        self.count -= 1;
        self.triangle[self.count] = [0.0; N];
        for j in place..self.count {
            self.rotate(j);
        }
    }

    /// Rotates rows `j` and `j + 1` of `R`, and the columns of `J`, so that column `j` ends on the
    /// diagonal.
    fn rotate(&mut self, j: usize) {
        assert!(j + 1 < N, "the last row has none behind it");
        let (upper, lower) = (self.triangle[j][j], self.triangle[j][j + 1]);
        if lower == 0.0 {
            self.diagonal_inverse[j] = upper.recip();
            return;
        }
        let inverse = (upper * upper + lower * lower).sqrt().recip();
        let (cosine, sine) = (upper * inverse, lower * inverse);
        for column in self.triangle.iter_mut().take(self.count).skip(j) {
            let (a, b) = (column[j], column[j + 1]);
            column[j] = cosine * a + sine * b;
            column[j + 1] = cosine * b - sine * a;
        }
        self.triangle[j][j + 1] = 0.0;
        self.diagonal_inverse[j] = inverse;
        let (front, back) = self.columns.split_at_mut(j + 1);
        if let (Some(first), Some(second)) = (front.last_mut(), back.first_mut()) {
            for (a, b) in first.iter_mut().zip(second) {
                (*a, *b) = (cosine * *a + sine * *b, cosine * *b - sine * *a);
            }
        }
    }

    /// The minimum of `p' G p / 2 + gradient . p` on the active rows, `c . p = right`, and their
    /// multipliers.
    pub(super) fn minimum(&self, gradient: &[f64; N], right: &[f64; N]) -> ([f64; N], [f64; N]) {
        let mut along = [0.0; N];
        for k in 0..self.count.min(N) {
            let sum: f64 = along
                .iter()
                .zip(&self.triangle[k])
                .take(k)
                .map(|(a, b)| a * b)
                .sum();
            along[k] = (right[k] - sum) * self.diagonal_inverse[k];
        }
        let mut step = [0.0; N];
        let mut pull = [0.0; N];
        for (k, column) in self.columns.iter().enumerate() {
            let slope = dot(column, gradient);
            if k < self.count {
                pull[k] = -(along[k] + slope);
                add_scaled(&mut step, along[k], column);
            } else {
                add_scaled(&mut step, -slope, column);
            }
        }
        (step, self.back_substituted(pull))
    }

    /// `R^-1 right`; only the first `count` entries count.
    fn back_substituted(&self, mut right: [f64; N]) -> [f64; N] {
        let mut solution = [0.0; N];
        for k in (0..self.count.min(N)).rev() {
            solution[k] = right[k] * self.diagonal_inverse[k];
            add_scaled(&mut right, -solution[k], &self.triangle[k]);
        }
        solution
    }
}
