//! Velocity, acceleration and jerk of a setpoint sequence, by divided differences.
//!
//! A divided difference of order k over k + 1 samples, times k!, is a mean of the k-th derivative
//! between them, at whatever times they were taken. So if the derivative keeps a bound, the
//! quotient does too, whatever happens between the samples: in periods that were skipped as well.
//! No tolerance beyond rounding is needed.

/// Joints and the jaw.
pub(super) const AXES: usize = hal::JOINT_COUNT + 1;

/// The newest setpoints of an arm without a break.
#[derive(Clone, Copy, Debug)]
pub(super) struct History {
    /// Newest first.
    ///
    /// Positions in joint order, then the jaw; rad, of the insertion m.
    samples: [[f64; AXES]; 4],
    /// How many periods ago each was, newest first.
    ages: [f64; 4],
    /// Set-points since the last [`Self::clear`], of which at most four are kept.
    count: usize,
}

/// One difference quotient and how far rounding can have moved it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Quotient {
    /// rad (m) over s to the order.
    pub(super) value: f64,
    /// Same unit, never negative: what a tolerance adds to the bound.
    pub(super) rounding: f64,
}

/// Factorials of the orders.
const FACTORIALS: [f64; 4] = [1.0, 1.0, 2.0, 6.0];

impl History {
    pub(super) const fn new() -> Self {
        Self {
            samples: [[0.0; AXES]; 4],
            ages: [0.0; 4],
            count: 0,
        }
    }

    /// Takes in the next setpoint, which is whole `periods` later than the one before.
    pub(super) fn push(&mut self, sample: [f64; AXES], periods: f64) {
        self.samples.rotate_right(1);
        self.samples[0] = sample;
        self.ages.rotate_right(1);
        for age in &mut self.ages {
            *age += periods;
        }
        self.ages[0] = 0.0;
        self.count += 1;
    }

    /// The newest setpoint.
    pub(super) fn newest(&self) -> Option<&[f64; AXES]> {
        self.samples.first().filter(|_| self.count > 0)
    }

    /// Forgets everything, where the arm was without torque or a record is missing.
    pub(super) fn clear(&mut self) {
        self.count = 0;
    }

    /// What the sample at `index`, of that `age`, is divided by.
    fn divisor(&self, index: usize, age: f64, order: usize) -> f64 {
        // Whole numbers, so that the weights are those of the binomials where no period was
        // skipped.
        let others = self.ages.iter().take(order + 1).enumerate();
        let distances = others.filter(|(other, _)| *other != index);
        distances.map(|(_, other)| other - age).product()
    }

    /// Difference quotient of `order` 1 (velocity), 2 (acceleration) or 3 (jerk) of one axis;
    /// `None` while there are too few samples.
    ///
    /// `k! sum x_i / prod (t_i - t_j)` over the newest `k + 1` samples, with the times in whole
    /// periods, and the sum over `period_s^k`.
    pub(super) fn quotient(&self, axis: usize, order: usize, period_s: f64) -> Option<Quotient> {
        let factorial = FACTORIALS.get(order)?;
        if order == 0 || self.count <= order {
            return None;
        }
        let taken = self.samples.iter().zip(&self.ages).take(order + 1);
        let mut sum = 0.0;
        let mut rounding = 0.0;
        for (index, (sample, age)) in taken.enumerate() {
            let weight = factorial / self.divisor(index, *age, order);
            sum += weight * sample[axis];
            // Each sample carries half a unit in the last place, and so does each sum.
            rounding += 2.0 * weight.abs() * sample[axis].abs() * f64::EPSILON;
        }
        let mut scale = 1.0;
        for _ in 0..order {
            scale /= period_s;
        }
        Some(Quotient {
            value: sum * scale,
            rounding: rounding * scale,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_has_its_own_derivatives() {
        let mut history = History::new();
        for k in 0..6 {
            let t = 0.001 * f64::from(k);
            history.push([0.3 + 0.2 * t + 3.0 * t * t + 50.0 * t * t * t; AXES], 1.0);
        }
        let jerk = history.quotient(2, 3, 0.001).unwrap();
        assert!(
            (jerk.value - 300.0).abs() <= jerk.rounding && jerk.rounding < 1e-4,
            "{jerk:?}"
        );
        let acceleration = history.quotient(2, 2, 0.001).unwrap();
        // The second difference is the acceleration one period before the newest sample.
        assert!(
            (acceleration.value - (6.0 + 300.0 * 0.004)).abs() < 1e-6,
            "{acceleration:?}"
        );
    }

    #[test]
    fn skipped_periods_change_nothing() {
        let mut history = History::new();
        let mut before = 0;
        for k in [0, 1, 2, 5, 6, 13, 14] {
            let t = 0.001 * f64::from(k);
            let place = 0.3 + 0.2 * t + 3.0 * t * t + 50.0 * t * t * t;
            history.push([place; AXES], f64::from(k - before));
            before = k;
            if let Some(jerk) = history.quotient(1, 3, 0.001) {
                assert!((jerk.value - 300.0).abs() <= jerk.rounding, "{k}: {jerk:?}");
            }
        }
        let velocity = history.quotient(1, 1, 0.001).unwrap();
        let t = 0.0135;
        assert!((velocity.value - (0.2 + 6.0 * t + 150.0 * t * t)).abs() < 1e-4);
    }

    #[test]
    fn nothing_is_said_before_there_are_enough_samples() {
        let mut history = History::new();
        history.push([0.0; AXES], 1.0);
        assert_eq!(history.quotient(0, 1, 0.001), None);
        history.push([0.0; AXES], 1.0);
        assert!(history.quotient(0, 1, 0.001).is_some());
        assert_eq!(history.quotient(0, 2, 0.001), None);
        history.clear();
        history.push([0.0; AXES], 1.0);
        assert_eq!(history.quotient(0, 1, 0.001), None);
    }
}
