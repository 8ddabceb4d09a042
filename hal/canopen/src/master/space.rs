//! What the drives' positions mean: joints, or the actuators behind the cable coupling.

use hal::joints::JOINT_COUNT;
use hal::psm::COUPLING;
use hal::tail::TAIL_AXES;

/// One value an axis.
pub type Axes = [f64; TAIL_AXES];

/// Index of the first axis behind the coupling.
const FIRST: usize = JOINT_COUNT - 3;

/// What the drives' positions mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Space {
    /// The joints in order, then the jaw.
    Joint,
    /// Yaw, pitch, insertion, then the four discs of the instrument.
    Actuator,
}

impl Space {
    /// Joint positions (rates) as the drives count them.
    #[must_use]
    pub fn from_joints(self, joints: &Axes) -> Axes {
        match self {
            Self::Joint => *joints,
            Self::Actuator => tool(joints, &|tool| solve(&COUPLING, tool)),
        }
    }

    /// The drives' positions (rates) as joints.
    #[must_use]
    pub fn to_joints(self, axes: &Axes) -> Axes {
        match self {
            Self::Joint => *axes,
            Self::Actuator => tool(axes, &|tool| COUPLING.map(|row| dot(&row, &tool))),
        }
    }

    /// The drives' efforts as joint efforts that do the same work.
    #[must_use]
    pub fn efforts_to_joints(self, axes: &Axes) -> Axes {
        match self {
            Self::Joint => *axes,
            Self::Actuator => {
                let transposed = core::array::from_fn(|row| {
                    core::array::from_fn(|column| COUPLING[column][row])
                });
                tool(axes, &|tool| solve(&transposed, tool))
            }
        }
    }
}

fn tool(axes: &Axes, map: &dyn Fn([f64; 4]) -> [f64; 4]) -> Axes {
    let mut all = *axes;
    let mapped = map([
        axes[FIRST],
        axes[FIRST + 1],
        axes[FIRST + 2],
        axes[FIRST + 3],
    ]);
    all[FIRST..].copy_from_slice(&mapped);
    all
}

fn dot(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Solves `matrix * x = right` by elimination with pivots; the coupling is far from singular.
fn solve(matrix: &[[f64; 4]; 4], right: [f64; 4]) -> [f64; 4] {
    let (mut a, mut b) = (*matrix, right);
    for column in 0..4 {
        let pivot = (column..4)
            .max_by(|&i, &j| a[i][column].abs().total_cmp(&a[j][column].abs()))
            .unwrap_or(column);
        a.swap(column, pivot);
        b.swap(column, pivot);
        for row in column + 1..4 {
            let factor = a[row][column] / a[column][column];
            let above = a[column];
            for (place, pivot) in a[row].iter_mut().zip(above).skip(column) {
                *place -= factor * pivot;
            }
            b[row] -= factor * b[column];
        }
    }
    for row in (0..4).rev() {
        let known: f64 = (row + 1..4).map(|k| a[row][k] * b[k]).sum();
        b[row] = (b[row] - known) / a[row][row];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAMPLE: Axes = [0.3, -0.2, 0.11, 1.3, -0.7, 0.45, 0.2];

    fn close(a: &Axes, b: &Axes) -> bool {
        a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-12)
    }

    #[test]
    fn actuators_and_joints_return_and_keep_power() {
        let space = Space::Actuator;
        assert!(close(
            &space.to_joints(&space.from_joints(&SAMPLE)),
            &SAMPLE
        ));
        let disc = space.from_joints(&[0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        assert!((disc[4] - 0.981_740).abs() < 1e-6 && (disc[5] - 0.669_595).abs() < 1e-6);
        let rates = [0.1, 0.4, -0.02, 2.0, -1.0, 0.5, 3.0];
        let power = |a: &Axes, b: &Axes| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let at_joints = power(&space.efforts_to_joints(&SAMPLE), &space.to_joints(&rates));
        assert!((at_joints - power(&SAMPLE, &rates)).abs() < 1e-12);
    }
}
