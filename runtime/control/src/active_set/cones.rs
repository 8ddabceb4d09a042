//! The second-order cones `|M d + o| <= r` and the half-spaces that support them. Hot path.
//!
//! Of a cone at a point `x` with `v = M x + o`, `n = v / |v|` and `g = M' n` the supporting
//! half-space is `g . x <= r - n . o`. It contains the whole cone, by the Cauchy-Schwarz
//! inequality, whatever `x` is.

use super::factors::{add_scaled, dot};
use super::rows::UnitRow;
use super::{CONES_MAX, Cone, Failure};

/// A direction whose gradient is shorter than this part of the whole matrix cannot be corrected.
const GRADIENT_MIN: f64 = 1e-9;

/// Where a half-space touches a cone.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch {
    /// Which cone.
    pub(super) cone: usize,
    /// Length of the gradient, by which the row was divided.
    pub(super) gradient: f64,
}

/// A half-space that touches a cone.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut<const N: usize> {
    pub(super) touch: Touch,
    pub(super) row: UnitRow<N>,
}

/// The cones of a problem.
#[derive(Clone, Debug)]
pub(super) struct Cones<const N: usize> {
    cones: [Surface<N>; CONES_MAX],
    used: usize,
}

/// A cone with the columns that this size of the method has; the others are zero in the problem.
#[derive(Clone, Copy, Debug)]
struct Surface<const N: usize> {
    /// `M`, row by row.
    matrix: [[f64; N]; 3],
    /// `o`: the value at `x = 0`.
    offset: [f64; 3],
    /// `r`, positive: [`Cones::load`] refuses others.
    radius: f64,
}

impl<const N: usize> Surface<N> {
    const EMPTY: Self = Self {
        matrix: [[0.0; N]; 3],
        offset: [0.0; 3],
        radius: 0.0,
    };

    /// `M x + o`.
    fn value(&self, x: &[f64; N]) -> [f64; 3] {
        let mut value = self.offset;
        for (value, row) in value.iter_mut().zip(&self.matrix) {
            *value += dot(row, x);
        }
        value
    }

    /// `M' direction`, the gradient of `|M x + o|` where that vector has this unit direction.
    fn gradient(&self, direction: &[f64; 3]) -> [f64; N] {
        let mut gradient = [0.0; N];
        for (along, row) in direction.iter().zip(&self.matrix) {
            add_scaled(&mut gradient, *along, row);
        }
        gradient
    }

    /// The half-space with the normal `M' direction`, scaled to unit length; none where the
    /// gradient vanishes against the matrix, so that no change of `x` brings the length down.
    fn cut(&self, cone: usize, direction: [f64; 3]) -> Option<Cut<N>> {
        let gradient = self.gradient(&direction);
        let squared = dot(&gradient, &gradient);
        let whole: f64 = self.matrix.iter().map(|row| dot(row, row)).sum();
        if squared <= GRADIENT_MIN * GRADIENT_MIN * whole {
            return None;
        }
        let length = squared.sqrt();
        Some(Cut {
            touch: Touch {
                cone,
                gradient: length,
            },
            row: UnitRow {
                coefficients: gradient.map(|entry| entry / length),
                bound: (self.radius - dot(&direction, &self.offset)) / length,
            },
        })
    }
}

/// `vector` over its length, and the length; nothing without a direction.
fn unit(vector: [f64; 3]) -> Option<([f64; 3], f64)> {
    let length = dot(&vector, &vector).sqrt();
    (length > 0.0).then(|| (vector.map(|entry| entry / length), length))
}

impl<const N: usize> Cones<N> {
    /// No cones.
    pub(super) const fn new() -> Self {
        Self {
            cones: [Surface::EMPTY; CONES_MAX],
            used: 0,
        }
    }

    /// Takes over `cones`.
    ///
    /// # Errors
    /// [`Failure::TooLarge`] beyond [`CONES_MAX`], [`Failure::NotFinite`], and
    /// [`Failure::Infeasible`] for a radius that is not positive.
    pub(super) fn load(&mut self, cones: &[Cone]) -> Result<(), Failure> {
        if cones.len() > CONES_MAX {
            return Err(Failure::TooLarge);
        }
        self.used = cones.len();
        for (to, from) in self.cones.iter_mut().zip(cones) {
            for (to, from) in to.matrix.iter_mut().zip(&from.matrix) {
                for (to, from) in to.iter_mut().zip(from) {
                    *to = *from;
                }
            }
            to.offset = from.offset;
            to.radius = from.radius;
            let mut entries = to.matrix.iter().flatten().chain(&to.offset);
            if !to.radius.is_finite() || !entries.all(|entry| entry.is_finite()) {
                return Err(Failure::NotFinite);
            }
            if to.radius <= 0.0 {
                return Err(Failure::Infeasible);
            }
        }
        Ok(())
    }

    /// Whether `x` is in all cones, but for `tolerance` in units of `x`, at most a hundred times
    /// that in units of the radius.
    pub(super) fn hold(&self, x: &[f64; N], tolerance: f64) -> bool {
        self.cones.iter().take(self.used).all(|cone| {
            let value = cone.value(x);
            let squared = dot(&value, &value);
            if squared <= cone.radius * cone.radius {
                return true;
            }
            unit(value).is_some_and(|(direction, length)| {
                let gradient = cone.gradient(&direction);
                let scale = dot(&gradient, &gradient).sqrt().min(100.0 * cone.radius);
                length - cone.radius <= tolerance * scale
            })
        })
    }

    /// The half-space of `cone` above `x` if it is `wanted` or `x` is outside.
    pub(super) fn cut_if(
        &self,
        cone: usize,
        wanted: bool,
        x: &[f64; N],
    ) -> Result<Option<Cut<N>>, Failure> {
        let Some(surface) = self.cones.get(cone).filter(|_| cone < self.used) else {
            return Ok(None);
        };
        let value = surface.value(x);
        if !wanted && dot(&value, &value) <= surface.radius * surface.radius {
            return Ok(None);
        }
        let (direction, _) = unit(value).ok_or(Failure::NotFinite)?;
        surface
            .cut(cone, direction)
            .map(Some)
            .ok_or(Failure::Infeasible)
    }

    /// Adds the second derivative of `multiplier |M d + o|` to `hessian`, at the boundary nearest
    /// to `x`. There the cone curves more than at an `x` outside, so the model is stiffer and its
    /// steps fall back to the boundary.
    ///
    /// The second derivative is `multiplier (M' M - g g') / |M x + o|`, with `r` for the length.
    /// None where the value is zero, which has no direction.
    pub(super) fn add_curvature(
        &self,
        cone: usize,
        multiplier: f64,
        x: &[f64; N],
        hessian: &mut [[f64; N]; N],
    ) -> Option<()> {
        let surface = self.cones.get(cone)?;
        let (direction, _) = unit(surface.value(x))?;
        let gradient = surface.gradient(&direction);
        let factor = multiplier / surface.radius;
        for (column, entries) in hessian.iter_mut().enumerate() {
            if surface.matrix.iter().all(|row| row[column] == 0.0) {
                continue;
            }
            for row in &surface.matrix {
                add_scaled(entries, factor * row[column], row);
            }
            add_scaled(entries, -factor * gradient[column], &gradient);
        }
        Some(())
    }
}
