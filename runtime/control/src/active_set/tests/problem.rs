//! Seeded problems and Clarabel's answer to them.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT, SolverStatus,
};

use super::super::{ActiveSet, Cone, Failure, LinearRow, Solution, VARIABLES_MAX};
use hal::random::SplitMix64;

/// Variables of one arm.
pub(super) const ARM: usize = 7;
pub(super) const ITERATIONS_MAX: u32 = 400;

pub(super) type Hessian = [[f64; VARIABLES_MAX]; VARIABLES_MAX];

/// One problem, as the solver takes it.
#[derive(Clone, Debug)]
pub(super) struct Problem {
    pub(super) hessian: Hessian,
    pub(super) rows: Vec<LinearRow>,
    pub(super) cones: Vec<Cone>,
    pub(super) variables: usize,
}

/// What a random problem is made of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Recipe {
    pub(super) arms: usize,
    pub(super) rows_per_arm: usize,
    pub(super) pair_rows: usize,
    pub(super) cones_per_arm: usize,
    /// Size of the nominal velocity in units of the bounds: how much has to change.
    pub(super) nominal: f64,
}

pub(super) fn vector(
    random: &mut SplitMix64,
    places: core::ops::Range<usize>,
) -> [f64; VARIABLES_MAX] {
    let mut vector = [0.0; VARIABLES_MAX];
    for entry in &mut vector[places] {
        *entry = random.between(-1.0, 1.0);
    }
    vector
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Problem {
    /// A problem that standing still always solves: `d = -nominal`.
    pub(super) fn random(random: &mut SplitMix64, recipe: Recipe) -> Self {
        let variables = ARM * recipe.arms;
        let mut nominal = vector(random, 0..variables);
        nominal
            .iter_mut()
            .for_each(|entry| *entry *= recipe.nominal);
        let mut hessian = [[0.0; VARIABLES_MAX]; VARIABLES_MAX];
        let mut rows = Vec::new();
        let mut cones = Vec::new();
        for arm in 0..recipe.arms {
            let places = ARM * arm..ARM * (arm + 1);
            let joint_weight = 10.0_f64.powf(random.between(-2.0, -1.0));
            let twist: Vec<_> = (0..6).map(|_| vector(random, places.clone())).collect();
            for i in places.clone() {
                for j in places.clone() {
                    hessian[i][j] = twist.iter().map(|row| row[i] * row[j]).sum();
                }
                hessian[i][i] += joint_weight;
            }
            for joint in places.clone() {
                for sign in [1.0, -1.0] {
                    let mut coefficients = [0.0; VARIABLES_MAX];
                    coefficients[joint] = sign;
                    rows.push(at_rest(coefficients, &nominal, random.between(0.01, 1.0)));
                }
            }
            for _ in 0..recipe.rows_per_arm {
                let coefficients = vector(random, places.clone());
                rows.push(at_rest(coefficients, &nominal, random.between(0.0, 1.0)));
            }
            for _ in 0..recipe.cones_per_arm {
                let matrix = [(); 3].map(|()| vector(random, places.clone()));
                cones.push(Cone {
                    matrix,
                    offset: matrix.map(|row| dot(&row, &nominal)),
                    radius: random.between(0.05, 1.0),
                });
            }
        }
        for _ in 0..recipe.pair_rows {
            let coefficients = vector(random, 0..variables);
            rows.push(at_rest(coefficients, &nominal, random.between(0.0, 1.0)));
        }
        Self {
            hessian,
            rows,
            cones,
            variables,
        }
    }

    /// A problem of any size, all of whose variables act on each other, with three rows a variable
    /// and one cone.
    pub(super) fn of_size(random: &mut SplitMix64, variables: usize) -> Self {
        let nominal = vector(random, 0..variables);
        let mut hessian = [[0.0; VARIABLES_MAX]; VARIABLES_MAX];
        for _ in 0..variables {
            let row = vector(random, 0..variables);
            for i in 0..variables {
                hessian[i][i] += 0.02;
                for j in 0..variables {
                    hessian[i][j] += row[i] * row[j];
                }
            }
        }
        let rows = (0..3 * variables)
            .map(|_| {
                let coefficients = vector(random, 0..variables);
                at_rest(coefficients, &nominal, random.between(0.01, 1.0))
            })
            .collect();
        let matrix = [(); 3].map(|()| vector(random, 0..variables));
        let cone = Cone {
            matrix,
            offset: matrix.map(|row| dot(&row, &nominal)),
            radius: random.between(0.05, 0.5),
        };
        Self {
            hessian,
            rows,
            cones: vec![cone],
            variables,
        }
    }

    pub(super) fn solve(&self, solver: &mut ActiveSet) -> Result<Solution, Failure> {
        solver.solve(
            &self.hessian,
            &self.rows,
            &self.cones,
            ITERATIONS_MAX,
            self.variables,
        )
    }

    pub(super) fn objective(&self, change: &[f64]) -> f64 {
        let rows = self.hessian.iter().zip(change);
        0.5 * rows.map(|(row, x)| x * dot(row, change)).sum::<f64>()
    }

    /// Largest violation; rows divided by their length, cones by their radius.
    pub(super) fn violation(&self, change: &[f64; VARIABLES_MAX]) -> f64 {
        let rows = self.rows.iter().map(|row| {
            let length = dot(&row.coefficients, &row.coefficients).sqrt();
            let excess = dot(&row.coefficients, change) - row.bound;
            if length > 0.0 {
                excess / length
            } else {
                excess
            }
        });
        let cones = self.cones.iter().map(|cone| {
            let mut value = cone.offset;
            for (value, row) in value.iter_mut().zip(&cone.matrix) {
                *value += dot(row, change);
            }
            dot(&value, &value).sqrt() / cone.radius - 1.0
        });
        rows.chain(cones).fold(0.0, f64::max)
    }

    /// Clarabel's answer at 1e-10, if it has one.
    pub(super) fn oracle(&self) -> Option<[f64; VARIABLES_MAX]> {
        let n = self.variables;
        let hessian: Vec<Vec<f64>> = (0..n)
            .map(|i| {
                (0..n)
                    .map(|j| if i <= j { self.hessian[i][j] } else { 0.0 })
                    .collect()
            })
            .collect();
        let mut matrix: Vec<Vec<f64>> = Vec::new();
        let mut right = Vec::new();
        for row in &self.rows {
            matrix.push(row.coefficients[..n].to_vec());
            right.push(row.bound);
        }
        let mut cones = vec![NonnegativeConeT(self.rows.len())];
        for cone in &self.cones {
            matrix.push(vec![0.0; n]);
            right.push(cone.radius);
            for (row, offset) in cone.matrix.iter().zip(cone.offset) {
                matrix.push(row[..n].iter().map(|entry| -entry).collect());
                right.push(offset);
            }
            cones.push(SecondOrderConeT(4));
        }
        let settings = DefaultSettings {
            verbose: false,
            tol_gap_abs: 1e-10,
            tol_gap_rel: 1e-10,
            tol_feas: 1e-10,
            max_threads: 1,
            ..DefaultSettings::default()
        };
        let mut solver = DefaultSolver::new(
            &CscMatrix::from(&hessian),
            &vec![0.0; n],
            &CscMatrix::from(&matrix),
            &right,
            &cones,
            settings,
        )
        .ok()?;
        solver.solve();
        if solver.solution.status != SolverStatus::Solved {
            return None;
        }
        let mut change = [0.0; VARIABLES_MAX];
        change[..n].copy_from_slice(&solver.solution.x);
        Some(change)
    }
}

/// The row that allows `room` more than standing still.
pub(super) fn at_rest(
    coefficients: [f64; VARIABLES_MAX],
    nominal: &[f64; VARIABLES_MAX],
    room: f64,
) -> LinearRow {
    LinearRow {
        coefficients,
        bound: room - dot(&coefficients, nominal),
    }
}
