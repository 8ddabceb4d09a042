//! Clarabel on the filter's problems: another algorithm, by other people, for tests and for
//! replays. It allocates, so the tick does without it.
//!
//! Clarabel solves `min x' P x / 2 + q' x` subject to `A x + s = b`, `s` in a product of cones.
//! With `q = 0` a linear row is `(c, b)` in the nonnegative cone, and a cone is the four rows
//! `[0; -M]`, `[r; o]` in the second-order cone.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT, SolverStatus,
    SupportedConeT,
};

use super::active_set::{Cone, LinearRow, VARIABLES_MAX};
use super::filter::Problem;

/// Tolerances of gap and feasibility, set in Clarabel one after the other; it does not always reach
/// the first.
const TOLERANCES: [f64; 2] = [1e-10, 1e-9];

/// Iterations after which Clarabel gives up; no limit on time, which would read a clock.
const ITERATIONS_MAX: u32 = 100;

/// How two answers to one problem compare.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Comparison {
    /// Largest difference of a variable, in units of its velocity limit.
    pub change: f64,
    /// Difference of the objective values, first answer less second.
    pub objective: f64,
    /// What the first answer exceeds a row by, in units of the speed limits.
    pub violation: f64,
    /// To what tolerance the second answer is.
    pub tolerance: f64,
}

/// Clarabel's answer to `tolerance`; `None` unless it calls the problem solved.
#[must_use]
pub fn solve(problem: &Problem, tolerance: f64) -> Option<[f64; VARIABLES_MAX]> {
    let variables = problem.variables;
    let constraint = dense(problem.rows.len() + 4 * problem.cones.len(), variables, {
        let rows = problem.rows.iter().map(|row| row.coefficients);
        let cones = problem.cones.iter().flat_map(|cone| {
            let [x, y, z] = cone.matrix.map(|row| row.map(|entry| -entry));
            [[0.0; VARIABLES_MAX], x, y, z]
        });
        rows.chain(cones)
    });
    let bounds: Vec<f64> = problem
        .rows
        .iter()
        .map(|row| row.bound)
        .chain(problem.cones.iter().flat_map(|cone| {
            let [x, y, z] = cone.offset;
            [cone.radius, x, y, z]
        }))
        .collect();
    let upper = problem.hessian.iter().enumerate().map(|(row, line)| {
        let mut line = *line;
        for entry in line.iter_mut().take(row) {
            *entry = 0.0;
        }
        line
    });
    let hessian = dense(variables, variables, upper.take(variables));
    let mut cones: Vec<SupportedConeT<f64>> = vec![NonnegativeConeT(problem.rows.len())];
    cones.extend(problem.cones.iter().map(|_| SecondOrderConeT(4)));
    let settings = DefaultSettings {
        max_iter: ITERATIONS_MAX,
        verbose: false,
        max_threads: 1,
        direct_solve_method: "qdldl".to_owned(),
        tol_gap_abs: tolerance,
        tol_gap_rel: tolerance,
        tol_feas: tolerance,
        ..DefaultSettings::default()
    };
    let zero = vec![0.0; variables];
    let mut solver =
        DefaultSolver::new(&hessian, &zero, &constraint, &bounds, &cones, settings).ok()?;
    solver.solve();
    if solver.solution.status != SolverStatus::Solved {
        return None;
    }
    let mut change = [0.0; VARIABLES_MAX];
    for (entry, value) in change.iter_mut().zip(&solver.solution.x) {
        *entry = *value;
    }
    Some(change)
}

/// How `answer` compares to Clarabel's; `None` if that has none.
#[must_use]
pub fn compare(problem: &Problem, answer: &[f64; VARIABLES_MAX]) -> Option<Comparison> {
    let (other, tolerance) = TOLERANCES
        .into_iter()
        .find_map(|tolerance| Some((solve(problem, tolerance)?, tolerance)))?;
    let differences = answer.iter().zip(&other).map(|(a, b)| (a - b).abs());
    Some(Comparison {
        change: differences.fold(0.0, f64::max),
        objective: objective(problem, answer) - objective(problem, &other),
        violation: violation(problem, answer),
        tolerance,
    })
}

/// `d' P d / 2`.
fn objective(problem: &Problem, change: &[f64; VARIABLES_MAX]) -> f64 {
    let lines = problem.hessian.iter().zip(change);
    lines.map(|(line, x)| x * dot(line, change)).sum::<f64>() / 2.0
}

/// Over rows and cones; 0 if all hold.
fn violation(problem: &Problem, change: &[f64; VARIABLES_MAX]) -> f64 {
    let row = |row: &LinearRow| dot(&row.coefficients, change) - row.bound;
    let cone = |cone: &Cone| {
        let squares = cone.matrix.iter().zip(&cone.offset);
        let squares = squares.map(|(line, offset)| (dot(line, change) + offset).powi(2));
        squares.sum::<f64>().sqrt() - cone.radius
    };
    let rows = problem.rows.iter().map(row);
    rows.chain(problem.cones.iter().map(cone))
        .fold(0.0, f64::max)
}

fn dot(a: &[f64; VARIABLES_MAX], b: &[f64; VARIABLES_MAX]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// A matrix from its rows, without its zeros.
fn dense(
    height: usize,
    width: usize,
    rows: impl Iterator<Item = [f64; VARIABLES_MAX]>,
) -> CscMatrix<f64> {
    let (mut is, mut js, mut values) = (Vec::new(), Vec::new(), Vec::new());
    for (i, row) in rows.enumerate() {
        for (j, value) in row.into_iter().take(width).enumerate() {
            if value.abs() > 0.0 {
                is.push(i);
                js.push(j);
                values.push(value);
            }
        }
    }
    CscMatrix::new_from_triplets(height, width, is, js, values)
}
