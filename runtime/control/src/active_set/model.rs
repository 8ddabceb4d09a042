//! Cones met by a sequence of quadratic models with the cones' curvature: Newton's method with
//! inequalities. Hot path.
//!
//! The model at `x_k` has the Hessian `G + sum_j m_j K_j`, with `m_j` the multiplier of cone `j`
//! and `K_j` its curvature there, and the slope `(G - H) x_k` at zero, which makes its gradient at
//! `x_k` that of the true objective. Its constraints are the linear rows and one supporting
//! half-space a cone.

use super::CONES_MAX;
use super::Failure;
use super::factors::dot;
use super::method::{Entry, Method, largest};

/// Models of one problem.
const MODELS_MAX: u32 = 40;
/// After a step shorter than this, in units of `1 + max |d|`, the next changes nothing: convergence
/// is quadratic.
const CONVERGED: f64 = 1e-7;
/// A multiplier that vanishes fades by this from model to model. Without, a cone that is hardly
/// active in one model would be forgotten in the next, and a few tight cones could take turns for
/// ever.
const FADING: f64 = 0.25;
/// A cone may be violated by this, in units of `1 + max |d|`.
const TOLERANCE: f64 = 1e-12;

impl<const N: usize> Method<N> {
    /// From the optimum without cones to the one with them.
    ///
    /// Ends when a step is shorter than [`CONVERGED`], no multiplier of the model was a faded one,
    /// and all cones hold. After a short step with a faded multiplier or a violated cone it drops
    /// the remembered multipliers and goes on.
    ///
    /// # Errors
    /// [`Failure::IterationLimit`] after [`MODELS_MAX`] models, [`Failure::Infeasible`] where a
    /// model cannot be built, and what [`Method::settle`] returns.
    pub(super) fn meet_cones(&mut self) -> Result<Entry, Failure> {
        for _ in 0..MODELS_MAX {
            self.count_iteration()?;
            let before = self.x;
            let exact = self.set_model()?;
            let settled = self.settle()?;
            let mut step = before;
            for (step, x) in step.iter_mut().zip(&self.x) {
                *step -= x;
            }
            if largest(&step) > CONVERGED * (1.0 + largest(&self.x)) {
                continue;
            }
            let tolerance = TOLERANCE * (1.0 + largest(&self.x));
            if exact && self.cones.hold(&self.x, tolerance) {
                return Ok(settled);
            }
            self.held = [0.0; CONES_MAX];
        }
        Err(Failure::IterationLimit)
    }

    /// The `forces`, none less than what the last ones have faded to.
    fn fade(&mut self, mut forces: [f64; CONES_MAX]) -> [f64; CONES_MAX] {
        for (force, held) in forces.iter_mut().zip(&mut self.held) {
            *held = force.max(FADING * *held);
            *force = *held;
        }
        forces
    }

    /// Puts half-spaces at the point in the place of the cones, and the cones' curvature into the
    /// factors. False if a cone curves the model more than its multiplier does.
    fn set_model(&mut self) -> Result<bool, Failure> {
        let pushing = self.forces();
        let forces = self.fade(pushing);
        let exact = forces.iter().zip(&pushing).all(|(held, now)| held <= now);
        let mut hessian = self.hessian;
        for (cone, (force, cut)) in forces.iter().zip(&mut self.cuts).enumerate() {
            *cut = self.cones.cut_if(cone, *force > 0.0, &self.x)?;
            if *force > 0.0 {
                self.cones
                    .add_curvature(cone, *force, &self.x, &mut hessian)
                    .ok_or(Failure::Infeasible)?;
            }
        }
        let curved = forces.iter().any(|force| *force > 0.0);
        if !curved && !self.curved {
            // The factors are those of the Hessian alone, as before.
            return Ok(exact);
        }
        self.curved = curved;
        for ((slope, curved), plain) in self.slope.iter_mut().zip(&hessian).zip(&self.hessian) {
            *slope = dot(plain, &self.x) - dot(curved, &self.x);
        }
        // With a positive definite Hessian only multipliers without bound fail: the cones and rows
        // do not meet.
        self.factors
            .start(&hessian)
            .map_err(|_| Failure::Infeasible)?;
        self.restart();
        Ok(exact)
    }

    /// The multiplier of each cone.
    ///
    /// The active multiplier is that of the unit row; over the gradient's length it is that of
    /// `|M x + o| <= r`.
    fn forces(&self) -> [f64; CONES_MAX] {
        let mut forces = [0.0; CONES_MAX];
        for active in self.active.iter().take(self.active_count) {
            if let Some(touch) = active.touch {
                forces[touch.cone] += active.multiplier / touch.gradient;
            }
        }
        forces
    }

    /// Starts the new model with those of the active rows that still push.
    fn restart(&mut self) {
        let actives = self.active;
        let count = self.active_count;
        self.active_count = 0;
        for mut active in actives.into_iter().take(count) {
            if let Some(touch) = active.touch {
                let Some(cut) = self.cuts[touch.cone] else {
                    continue;
                };
                active.row = cut.row;
                active.touch = Some(cut.touch);
            }
            let seen = self.factors.see(&active.row.coefficients);
            self.add(active, &seen);
        }
        loop {
            let (multiplier, place) = self.refresh();
            if multiplier >= 0.0 {
                break;
            }
            self.remove(place);
        }
    }
}
