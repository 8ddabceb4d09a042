//! The safety filter: the joint velocity nearest to the wanted one that satisfies every row. Hot path: bounded, no I/O, no
//! lock; allocates only inside Clarabel's solve.
//!
//! In units of the joint velocity limits, `x = u / v_max`: minimise the change of the tip's twist plus a little of the joints',
//! `(x - x_nom)' P (x - x_nom) / 2`, subject to the rows of [`super::rows`]. The tip speed is a second-order cone.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT, SolverError,
    SolverStatus,
};
use hal::{JOINT_COUNT, JointVector};
use nalgebra::{Matrix6, Vector6};

use super::config::{ControlConfig, FilterConfig};
use super::report::QpOutcome;
use super::rows::{GEOMETRY_ROWS, Rows};

const BOX_ROWS: usize = 2 * JOINT_COUNT;
const LINEAR_ROWS: usize = BOX_ROWS + GEOMETRY_ROWS;
const CONE_ROWS: usize = 4;
const ROWS: usize = LINEAR_ROWS + CONE_ROWS;
/// Entries of one column of `A`: one upper and one lower bound, the geometry, three of the cone.
const COLUMN: usize = 2 + GEOMETRY_ROWS + 3;
const UPPER_TRIANGLE: usize = JOINT_COUNT * (JOINT_COUNT + 1) / 2;

/// A nominal velocity may exceed its rows by rounding and still pass unchanged.
const PASS_TOLERANCE: f64 = 1e-9;
/// A solution that exceeds its rows by more is not trusted.
const TRUST_TOLERANCE: f64 = 1e-6;
/// A row nearer than this to its bound counts as active.
const ACTIVE_TOLERANCE: f64 = 1e-5;

/// What the filter made of a velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filtered {
    /// Joint velocity, rad/s (m/s); zero if the filter failed.
    pub velocity: JointVector,
    /// How it came about.
    pub outcome: QpOutcome,
    /// Rows that it touches.
    pub rows_active: u32,
    /// Length of the change in units of the joint limits.
    pub correction: f64,
}

/// The filter with its solver, whose memory is made once and whose numbers change every time.
pub struct Filter {
    solver: DefaultSolver<f64>,
    hessian: Vec<f64>,
    linear: Vec<f64>,
    constraint: Vec<f64>,
    bound: Vec<f64>,
    scale: JointVector,
    twist_weight: Vector6<f64>,
    joint_weight: f64,
}

impl Filter {
    /// A filter for `config`.
    ///
    /// # Errors
    /// [`SolverError`] if Clarabel refuses the pattern or its settings.
    pub fn new(config: &ControlConfig) -> Result<Self, SolverError> {
        let linear_weight = (config.tip_speed_m_s * config.tip_speed_m_s).recip();
        let angular_weight =
            (config.filter.angular_speed_rad_s * config.filter.angular_speed_rad_s).recip();
        Ok(Self {
            solver: solver(&config.filter)?,
            hessian: vec![0.0; UPPER_TRIANGLE],
            linear: vec![0.0; JOINT_COUNT],
            constraint: vec![0.0; JOINT_COUNT * COLUMN],
            bound: vec![0.0; ROWS],
            scale: JointVector::from_fn(|joint, _| config.axes[joint].velocity),
            twist_weight: Vector6::new(
                linear_weight,
                linear_weight,
                linear_weight,
                angular_weight,
                angular_weight,
                angular_weight,
            ),
            joint_weight: config.filter.joint_weight,
        })
    }

    /// The velocity nearest to `nominal` that satisfies `rows`; `jacobian` is the tip's.
    pub fn filter(
        &mut self,
        nominal: &JointVector,
        rows: &Rows,
        jacobian: &Matrix6<f64>,
    ) -> Filtered {
        let (velocity, outcome) = if rows.hold(nominal, &self.scale, PASS_TOLERANCE) {
            (*nominal, QpOutcome::NotNeeded)
        } else {
            self.solve(nominal, rows, jacobian).map_or(
                (JointVector::zeros(), QpOutcome::Failed),
                |(velocity, iterations)| (velocity, QpOutcome::Solved { iterations }),
            )
        };
        Filtered {
            velocity,
            outcome,
            rows_active: rows.active(&velocity, &self.scale, ACTIVE_TOLERANCE),
            correction: (velocity - nominal).component_div(&self.scale).norm(),
        }
    }

    fn solve(
        &mut self,
        nominal: &JointVector,
        rows: &Rows,
        jacobian: &Matrix6<f64>,
    ) -> Option<(JointVector, u32)> {
        self.set_cost(nominal, jacobian);
        self.set_rows(rows);
        let solver = &mut self.solver;
        solver.update_P(&self.hessian).ok()?;
        solver.update_q(&self.linear).ok()?;
        solver.update_A(&self.constraint).ok()?;
        solver.update_b(&self.bound).ok()?;
        solver.solve();
        if solver.solution.status != SolverStatus::Solved {
            return None;
        }
        let x = &solver.solution.x;
        let velocity = JointVector::from_fn(|joint, _| x[joint] * self.scale[joint]);
        // The solver's word is not enough: NaN and inaccurate answers fail here.
        rows.hold(&velocity, &self.scale, TRUST_TOLERANCE)
            .then_some((velocity, solver.solution.iterations))
    }

    fn set_cost(&mut self, nominal: &JointVector, jacobian: &Matrix6<f64>) {
        let twist = jacobian * Matrix6::from_diagonal(&self.scale);
        let cost = twist.transpose() * Matrix6::from_diagonal(&self.twist_weight) * twist
            + Matrix6::identity() * self.joint_weight;
        let wanted = cost * nominal.component_div(&self.scale);
        let mut entries = self.hessian.iter_mut();
        for column in 0..JOINT_COUNT {
            self.linear[column] = -wanted[column];
            for (row, entry) in (0..=column).zip(entries.by_ref()) {
                *entry = cost[(row, column)];
            }
        }
    }

    fn set_rows(&mut self, rows: &Rows) {
        let speed = rows.tip_speed_m_s;
        for (joint, column) in self.constraint.chunks_exact_mut(COLUMN).enumerate() {
            let scale = self.scale[joint];
            column[0] = 1.0;
            column[1] = -1.0;
            for (entry, row) in column[2..].iter_mut().zip(&rows.geometry) {
                *entry = row.coefficients[joint] * scale / speed;
            }
            for (axis, entry) in column[2 + GEOMETRY_ROWS..].iter_mut().enumerate() {
                *entry = -rows.tip[(axis, joint)] * scale / speed;
            }
            self.bound[joint] = rows.high[joint] / scale;
            self.bound[JOINT_COUNT + joint] = -rows.low[joint] / scale;
        }
        for (bound, row) in self.bound[BOX_ROWS..LINEAR_ROWS]
            .iter_mut()
            .zip(&rows.geometry)
        {
            *bound = row.bound / speed;
        }
        self.bound[LINEAR_ROWS] = 1.0;
    }
}

/// A solver for the fixed pattern, every structural entry kept.
fn solver(config: &FilterConfig) -> Result<DefaultSolver<f64>, SolverError> {
    let mut column_starts = vec![0];
    let mut row_indices = Vec::with_capacity(UPPER_TRIANGLE);
    for column in 0..JOINT_COUNT {
        row_indices.extend(0..=column);
        column_starts.push(row_indices.len());
    }
    let cost = CscMatrix::new(
        JOINT_COUNT,
        JOINT_COUNT,
        column_starts,
        row_indices,
        vec![1.0; UPPER_TRIANGLE],
    );

    let mut column_starts = vec![0];
    let mut row_indices = Vec::with_capacity(JOINT_COUNT * COLUMN);
    for column in 0..JOINT_COUNT {
        row_indices.extend([column, JOINT_COUNT + column]);
        row_indices.extend(BOX_ROWS..LINEAR_ROWS);
        row_indices.extend(LINEAR_ROWS + 1..ROWS);
        column_starts.push(row_indices.len());
    }
    let constraint = CscMatrix::new(
        ROWS,
        JOINT_COUNT,
        column_starts,
        row_indices,
        vec![1.0; JOINT_COUNT * COLUMN],
    );

    // No presolve, no dropped zeros: both would forbid new numbers. No equilibration: it is computed once, from the first
    // numbers, and the problem is scaled already. No time limit: it would read the clock.
    let settings = DefaultSettings {
        max_iter: config.iterations_max,
        verbose: false,
        equilibrate_enable: false,
        max_threads: 1,
        direct_solve_method: "qdldl".to_owned(),
        presolve_enable: false,
        input_sparse_dropzeros: false,
        ..DefaultSettings::default()
    };
    let cones = [NonnegativeConeT(LINEAR_ROWS), SecondOrderConeT(CONE_ROWS)];
    DefaultSolver::new(
        &cost,
        &[0.0; JOINT_COUNT],
        &constraint,
        &[1.0; ROWS],
        &cones,
        settings,
    )
}

impl core::fmt::Debug for Filter {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Filter")
            .field("scale", &self.scale)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests;
