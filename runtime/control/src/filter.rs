//! The safety filter: the velocities nearest to the wanted ones that satisfy every row. Hot path:
//! bounded, no allocation, no I/O, no lock.
//!
//! In units of the axes' velocity limits, `x = u / v_max`: minimise the change of each tip's twist
//! plus a little of the joints' and all of the jaw's, `d' P d / 2` with `d = x - x_nominal`,
//! subject to the rows of [`super::rows`]. Two arms are one problem, coupled by the rows between
//! them. The tip's speed and angular speed are second-order cones.
//!
//! Of one arm, with `J` its tip Jacobian, `S` the diagonal of the axes' velocity limits and `W`
//! that of `1 / v_tip^2` (three times) and `1 / w_tip^2` (three times), the block of `P` is
//! `S J' W J S + joint_weight I` for the joints and 1 for the jaw. So a change of the tip by its
//! whole speed limit costs as much as one of the jaw by its own, and the small joint weight keeps
//! `P` positive definite where `J` is singular.
//!
//! A bound `low <= u <= high` reads `d <= (high - u_nominal) / v_max` and
//! `-d <= (u_nominal - low) / v_max`; a row of geometry `a . u <= b` reads
//! `(S a / v_tip) . d <= (b - a . u_nominal) / v_tip`; a cone `|M u| <= r` is divided by the tip's
//! limit without `speed_fraction` and pace.

use nalgebra::SMatrix;

use super::active_set::{ActiveSet, CONES_MAX, Cone, LinearRow, ROWS_MAX, VARIABLES_MAX};
use super::config::ControlConfig;
use super::instrument::KinematicState;
use super::motion::{AXES, JAW};
use super::report::QpOutcome;
use super::rows::{ARMS_MAX, GEOMETRY_MAX, Rows, Velocities, WideJacobian, dot, velocity_scale};

/// Nominal velocities may exceed their rows by rounding and still pass unchanged.
const PASS_TOLERANCE: f64 = 1e-9;
/// A solution that exceeds its rows by more is not trusted.
const TRUST_TOLERANCE: f64 = 1e-7;
/// A row nearer than this to its bound counts as active.
const ACTIVE_TOLERANCE: f64 = 1e-5;

/// A quadratic programme in the change `d` of the scaled velocities.
#[derive(Clone, Debug)]
pub struct Problem {
    /// Number of variables.
    pub variables: usize,
    /// `P`, of which the first `variables` rows and columns count.
    pub hessian: [[f64; VARIABLES_MAX]; VARIABLES_MAX],
    /// Bounds, two an axis, then geometry.
    ///
    /// The upper bound of an axis comes before its lower one. At most
    /// `2 * VARIABLES_MAX + GEOMETRY_MAX`.
    pub rows: Vec<LinearRow>,
    /// Speed and angular speed of each tip.
    pub cones: Vec<Cone>,
}

impl Problem {
    /// The rows that `change` touches, in the order of [`names`](super::rows::names). An axis that
    /// may not move at all touches none: it is given, not limited.
    pub fn active<'a>(&'a self, change: &'a Velocities) -> impl Iterator<Item = usize> + 'a {
        let touches =
            move |row: &LinearRow| dot(&row.coefficients, change) >= row.bound - ACTIVE_TOLERANCE;
        let given = move |index: usize| {
            let pair = self.rows.get(index & !1).zip(self.rows.get(index | 1));
            index < 2 * self.variables
                && pair.is_some_and(|(one, other)| touches(one) && touches(other))
        };
        let rows = self.rows.iter().enumerate();
        let rows = rows.filter(move |(index, row)| touches(row) && !given(*index));
        let first = self.rows.len();
        let cones = self.cones.iter().enumerate().filter(|(_, cone)| {
            let reach = cone.matrix.iter().zip(&cone.offset);
            let squares = reach.map(|(row, offset)| (dot(row, change) + offset).powi(2));
            squares.sum::<f64>().sqrt() >= cone.radius * (1.0 - ACTIVE_TOLERANCE)
        });
        let cones = cones.map(move |(index, _)| first + index);
        rows.map(|(index, _)| index).chain(cones)
    }
}

/// What the filter made of the velocities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filtered {
    /// Velocities of all axes, rad/s (m/s); zero if the filter failed.
    pub velocity: Velocities,
    /// How they came about.
    ///
    /// With [`QpOutcome::Failed`] the caller brakes: zero velocity satisfies every row.
    pub outcome: QpOutcome,
    /// Rows that they touch.
    pub rows_active: u32,
    /// Length of the change of each arm in units of its velocity limits.
    ///
    /// Euclidean, over joints and jaw; 0 for an arm that passed unchanged. Where the filter failed,
    /// the length of the whole nominal velocity.
    pub correction: [f64; ARMS_MAX],
}

impl Filtered {
    /// No arm follows.
    pub const AT_REST: Self = Self {
        velocity: [0.0; VARIABLES_MAX],
        outcome: QpOutcome::NotNeeded,
        rows_active: 0,
        correction: [0.0; ARMS_MAX],
    };
}

/// The filter with its solver; all memory is made once.
#[derive(Debug)]
pub struct Filter {
    solver: Box<ActiveSet>,
    problem: Problem,
    /// Of the last QP that was solved, in scaled units; kept for a second opinion.
    solution: Velocities,
    scale: Velocities,
    tip_speed_m_s: f64,
    /// The diagonal of `W`: s²/m² three times, then s²/rad².
    twist_weights: [f64; 6],
    joint_weight: f64,
    iterations_max: u32,
}

impl Filter {
    /// A filter for `config`.
    #[must_use]
    pub fn new(config: &ControlConfig) -> Self {
        const {
            assert!(2 * VARIABLES_MAX + GEOMETRY_MAX <= ROWS_MAX && 2 * ARMS_MAX <= CONES_MAX);
        }
        let weight = |speed: f64| (speed * speed).recip();
        let linear = weight(config.tip_speed_m_s);
        let angular = weight(config.tip_angular_speed_rad_s);
        Self {
            solver: Box::new(ActiveSet::new()),
            problem: Problem {
                variables: 0,
                hessian: [[0.0; VARIABLES_MAX]; VARIABLES_MAX],
                rows: Vec::with_capacity(2 * VARIABLES_MAX + GEOMETRY_MAX),
                cones: Vec::with_capacity(2 * ARMS_MAX),
            },
            solution: [0.0; VARIABLES_MAX],
            scale: velocity_scale(config),
            tip_speed_m_s: config.tip_speed_m_s,
            twist_weights: [linear, linear, linear, angular, angular, angular],
            joint_weight: config.filter.joint_weight,
            iterations_max: config.filter.iterations_max,
        }
    }

    /// The velocities nearest to `nominal` that satisfy `rows`, which were filled for `stances`.
    ///
    /// The QP is built and solved only if `nominal` violates a row. A solution counts only if it
    /// passes the same check.
    pub fn filter(
        &mut self,
        nominal: &Velocities,
        rows: &Rows,
        stances: &[&KinematicState],
    ) -> Filtered {
        let (velocity, outcome) = if rows.hold(nominal, PASS_TOLERANCE) {
            (*nominal, QpOutcome::NotNeeded)
        } else {
            self.solve(nominal, rows, stances).map_or(
                ([0.0; VARIABLES_MAX], QpOutcome::Failed),
                |(velocity, iterations)| (velocity, QpOutcome::Solved { iterations }),
            )
        };
        Filtered {
            velocity,
            outcome,
            rows_active: rows.active(&velocity, ACTIVE_TOLERANCE),
            correction: self.correction(nominal, &velocity),
        }
    }

    /// The problem that was solved last, for a second opinion.
    #[must_use]
    pub const fn problem(&self) -> &Problem {
        &self.problem
    }

    /// Its solution: the change of each axis in units of its velocity limit.
    #[must_use]
    pub const fn solution(&self) -> &Velocities {
        &self.solution
    }

    fn correction(&self, nominal: &Velocities, velocity: &Velocities) -> [f64; ARMS_MAX] {
        const { assert!(VARIABLES_MAX == ARMS_MAX * AXES) };
        let mut corrections = [0.0_f64; ARMS_MAX];
        let changes = nominal.iter().zip(velocity).zip(&self.scale);
        for (axis, ((wanted, got), scale)) in changes.enumerate() {
            corrections[axis / AXES] += ((got - wanted) / scale).powi(2);
        }
        corrections.map(f64::sqrt)
    }

    /// The `nominal` velocities with the solution added.
    fn changed(&self, nominal: &Velocities) -> Velocities {
        let mut velocity = *nominal;
        let changes = self.solution.iter().zip(&self.scale);
        for (velocity, (change, scale)) in velocity.iter_mut().zip(changes) {
            *velocity += change * scale;
        }
        velocity
    }

    /// The solution and the number of iterations; `None` if there is none that can be trusted.
    fn solve(
        &mut self,
        nominal: &Velocities,
        rows: &Rows,
        stances: &[&KinematicState],
    ) -> Option<(Velocities, u32)> {
        self.problem.variables = rows.variables;
        self.set_cost(stances);
        self.set_rows(nominal, rows);
        self.set_cones(nominal, rows);
        let Problem {
            hessian,
            rows: linear,
            cones,
            variables,
        } = &self.problem;
        let solver = &mut self.solver;
        let solution = solver.solve(hessian, linear, cones, self.iterations_max, *variables);
        let solution = solution.ok()?;
        self.solution = solution.change;
        let velocity = self.changed(nominal);
        let trusted = rows.hold(&velocity, TRUST_TOLERANCE);
        trusted.then_some((velocity, solution.iterations))
    }

    fn set_cost(&mut self, stances: &[&KinematicState]) {
        self.problem.hessian = [[0.0; VARIABLES_MAX]; VARIABLES_MAX];
        for (arm, stance) in stances.iter().enumerate() {
            let first = AXES * arm;
            let mut scaled = stance.frames.tip_jacobian();
            for (joint, mut column) in scaled.column_iter_mut().enumerate() {
                column *= self.scale[joint];
            }
            let mut weighted = scaled;
            for (mut row, weight) in weighted.row_iter_mut().zip(self.twist_weights) {
                row *= weight;
            }
            let cost: SMatrix<f64, 6, 6> = scaled.transpose() * weighted;
            let block = self.problem.hessian.iter_mut().skip(first).take(AXES);
            for (axis, line) in block.enumerate() {
                for (other, entry) in line.iter_mut().skip(first).take(JAW).enumerate() {
                    if axis < JAW {
                        *entry = cost[(axis, other)];
                    }
                }
                line[first + axis] += if axis == JAW { 1.0 } else { self.joint_weight };
            }
        }
    }

    fn set_rows(&mut self, nominal: &Velocities, rows: &Rows) {
        self.problem.rows.clear();
        for axis in 0..rows.variables {
            let wanted = nominal[axis];
            for (sign, room) in [
                (1.0, rows.high[axis] - wanted),
                (-1.0, wanted - rows.low[axis]),
            ] {
                let mut coefficients = [0.0; VARIABLES_MAX];
                coefficients[axis] = sign;
                self.problem.rows.push(LinearRow {
                    coefficients,
                    bound: room / self.scale[axis],
                });
            }
        }
        self.add_geometry_rows(nominal, rows);
    }

    /// The rows of boundaries in space, scaled to the tip's speed limit.
    fn add_geometry_rows(&mut self, nominal: &Velocities, rows: &Rows) {
        for row in &rows.geometry {
            let mut coefficients = row.coefficients;
            for (coefficient, scale) in coefficients.iter_mut().zip(&self.scale) {
                *coefficient *= scale / self.tip_speed_m_s;
            }
            let room = row.bound - dot(&row.coefficients, nominal);
            self.problem.rows.push(LinearRow {
                coefficients,
                bound: room / self.tip_speed_m_s,
            });
        }
    }

    fn set_cones(&mut self, nominal: &Velocities, rows: &Rows) {
        self.problem.cones.clear();
        for (index, cone) in rows.cones.iter().enumerate() {
            // In units of the whole limit, so that a soft start does not blow the numbers up.
            let unit = self.twist_weights[3 * (index % 2)].sqrt();
            let mut matrix: WideJacobian = cone.matrix;
            for row in &mut matrix {
                for (entry, scale) in row.iter_mut().zip(&self.scale) {
                    *entry *= scale * unit;
                }
            }
            self.problem.cones.push(Cone {
                matrix,
                offset: cone.matrix.map(|row| dot(&row, nominal) * unit),
                radius: cone.limit * unit,
            });
        }
    }
}

#[cfg(test)]
mod tests;
