//! The linear rows, scaled to length one and laid out so that four are evaluated at a time. Hot
//! path.

use super::{Failure, LinearRow, ROWS_MAX};

/// Rows that are evaluated together: four doubles fill a vector register of 256 bits.
const LANES: usize = 4;
/// A row without coefficients may be short of zero by rounding.
const EMPTY_TOLERANCE: f64 = 1e-9;

/// Four rows side by side.
///
/// Column-major: `coefficients[variable][lane]`.
#[derive(Clone, Copy, Debug)]
struct Lanes<const N: usize> {
    coefficients: [[f64; LANES]; N],
    /// Infinite where there is no row.
    bound: [f64; LANES],
}

impl<const N: usize> Lanes<N> {
    const EMPTY: Self = Self {
        coefficients: [[0.0; LANES]; N],
        bound: [f64::INFINITY; LANES],
    };

    /// Puts `row` into the lane `lane`, times `scale`.
    fn set(&mut self, lane: usize, row: &LinearRow, scale: f64) {
        for (to, from) in self.coefficients.iter_mut().zip(&row.coefficients) {
            to[lane] = from * scale;
        }
        self.bound[lane] = row.bound * scale;
    }

    /// `c . x - b` of each lane; minus infinity where there is no row, so that it never is the
    /// worst.
    fn violations(&self, x: &[f64; N]) -> [f64; LANES] {
        let mut violations = self.bound.map(|bound| -bound);
        for (x, coefficients) in x.iter().zip(&self.coefficients) {
            for (violation, coefficient) in violations.iter_mut().zip(coefficients) {
                *violation += x * coefficient;
            }
        }
        violations
    }
}

/// One row, `coefficients . d <= bound`, with coefficients of length one.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnitRow<const N: usize> {
    pub(super) coefficients: [f64; N],
    pub(super) bound: f64,
}

impl<const N: usize> UnitRow<N> {
    pub(super) const EMPTY: Self = Self {
        coefficients: [0.0; N],
        bound: 0.0,
    };
}

/// All linear rows of a problem.
#[derive(Clone, Debug)]
pub(super) struct Rows<const N: usize> {
    lanes: Vec<Lanes<N>>,
    used: usize,
}

impl<const N: usize> Rows<N> {
    /// Room for [`ROWS_MAX`] rows.
    pub(super) fn new() -> Self {
        Self {
            lanes: vec![Lanes::EMPTY; ROWS_MAX.div_ceil(LANES)],
            used: 0,
        }
    }

    /// Takes over `rows`, scaled.
    ///
    /// A row without coefficients is left out if zero satisfies it.
    ///
    /// # Errors
    /// [`Failure::TooLarge`] beyond [`ROWS_MAX`], [`Failure::NotFinite`], and
    /// [`Failure::Infeasible`] for an empty row that zero violates.
    pub(super) fn load(&mut self, rows: &[LinearRow]) -> Result<(), Failure> {
        if rows.len() > ROWS_MAX {
            return Err(Failure::TooLarge);
        }
        self.used = rows.len().div_ceil(LANES);
        for (lanes, rows) in self.lanes.iter_mut().zip(rows.chunks(LANES)) {
            *lanes = Lanes::EMPTY;
            for (lane, row) in rows.iter().enumerate().take(LANES) {
                let squared: f64 = row.coefficients.iter().take(N).map(|c| c * c).sum();
                if !squared.is_finite() || !row.bound.is_finite() {
                    return Err(Failure::NotFinite);
                }
                if squared < f64::MIN_POSITIVE {
                    if row.bound < -EMPTY_TOLERANCE {
                        return Err(Failure::Infeasible);
                    }
                    continue;
                }
                lanes.set(lane, row, squared.sqrt().recip());
            }
        }
        Ok(())
    }

    /// The largest violation at `x` and the number of its row; negative infinity without rows.
    pub(super) fn worst(&self, x: &[f64; N]) -> (f64, usize) {
        let mut worst = (f64::NEG_INFINITY, 0);
        for (place, lanes) in self.lanes.iter().take(self.used).enumerate() {
            for (lane, violation) in lanes.violations(x).into_iter().enumerate() {
                if violation > worst.0 {
                    worst = (violation, place * LANES + lane);
                }
            }
        }
        worst
    }

    /// Row `index`, as [`Self::worst`] counts them.
    pub(super) fn row(&self, index: usize) -> UnitRow<N> {
        let (lanes, lane) = (&self.lanes[index / LANES], index % LANES);
        UnitRow {
            coefficients: lanes.coefficients.map(|lanes| lanes[lane]),
            bound: lanes.bound[lane],
        }
    }
}
