//! Problems without an answer, and what is said about them.

use super::super::{ActiveSet, Failure, LinearRow, ROWS_MAX, VARIABLES_MAX};
use super::problem::{ARM, ITERATIONS_MAX, Problem, Recipe, vector};
use hal::random::SplitMix64;

const RECIPE: Recipe = Recipe {
    arms: 1,
    rows_per_arm: 31,
    pair_rows: 0,
    cones_per_arm: 2,
    nominal: 1.5,
};

fn bound(joint: usize, sign: f64, bound: f64) -> LinearRow {
    let mut coefficients = [0.0; VARIABLES_MAX];
    coefficients[joint] = sign;
    LinearRow {
        coefficients,
        bound,
    }
}

#[test]
fn infeasible_boxes_are_recognised() {
    let mut random = SplitMix64::new(21);
    let mut solver = ActiveSet::new();
    for case in 0..1000 {
        let arms = 1 + case % 2;
        let mut problem = Problem::random(&mut random, Recipe { arms, ..RECIPE });
        let joint = case % problem.variables;
        let high = random.between(-1.0, 1.0);
        let short = 10.0_f64.powf(random.between(-6.0, 0.0));
        problem.rows.push(bound(joint, 1.0, high));
        problem.rows.push(bound(joint, -1.0, -high - short));
        assert_eq!(
            problem.solve(&mut solver),
            Err(Failure::Infeasible),
            "case {case}"
        );
    }
}

#[test]
fn rows_far_from_a_cone_have_no_answer() {
    let mut random = SplitMix64::new(22);
    let mut solver = ActiveSet::new();
    for case in 0..500 {
        let mut problem = Problem::random(&mut random, RECIPE);
        // Along the cone's first row the value may not be less than three radii.
        let cone = problem.cones[0];
        problem.rows = vec![LinearRow {
            coefficients: cone.matrix[0].map(|entry| -entry),
            bound: cone.offset[0] - 3.0 * cone.radius,
        }];
        let answer = problem.solve(&mut solver);
        assert!(
            matches!(answer, Err(Failure::Infeasible | Failure::IterationLimit)),
            "case {case}: {answer:?}"
        );
    }
}

#[test]
fn an_empty_row_below_zero_is_infeasible() {
    let mut problem = Problem::random(&mut SplitMix64::new(23), RECIPE);
    problem.rows.push(bound(0, 0.0, -1e-3));
    let answer = problem.solve(&mut ActiveSet::new());
    assert_eq!(answer, Err(Failure::Infeasible));
}

#[test]
fn a_cone_without_an_inside_is_infeasible() {
    for radius in [0.0, -1.0] {
        let mut problem = Problem::random(&mut SplitMix64::new(24), RECIPE);
        problem.cones[1].radius = radius;
        let answer = problem.solve(&mut ActiveSet::new());
        assert_eq!(answer, Err(Failure::Infeasible));
    }
}

#[test]
fn numbers_that_are_not_finite_are_refused_wherever_they_stand() {
    let plain = Problem::random(&mut SplitMix64::new(25), RECIPE);
    let mut solver = ActiveSet::new();
    let answer = plain.solve(&mut solver);
    assert!(answer.is_ok());
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let places: [fn(&mut Problem, f64); 8] = [
            |problem, bad| problem.hessian[3][3] = bad,
            |problem, bad| problem.hessian[1][5] = bad,
            |problem, bad| problem.rows[20].coefficients[6] = bad,
            |problem, bad| problem.rows[0].bound = bad,
            |problem, bad| problem.rows[44].bound = bad,
            |problem, bad| problem.cones[1].matrix[2][4] = bad,
            |problem, bad| problem.cones[0].offset[1] = bad,
            |problem, bad| problem.cones[0].radius = bad,
        ];
        for (place, spoil) in places.iter().enumerate() {
            let mut problem = plain.clone();
            spoil(&mut problem, bad);
            assert_eq!(
                problem.solve(&mut solver),
                Err(Failure::NotFinite),
                "place {place}, {bad}"
            );
        }
    }
    // None of it stays behind.
    assert_eq!(plain.solve(&mut solver), answer);
}

#[test]
fn huge_numbers_end_in_a_failure_or_a_finite_answer() {
    let mut random = SplitMix64::new(26);
    let mut solver = ActiveSet::new();
    for _ in 0..2000 {
        let mut problem = Problem::random(&mut random, RECIPE);
        for row in &mut problem.rows {
            if random.happens(0.3) {
                let size = 10.0_f64.powf(random.between(-320.0, 320.0)).min(f64::MAX);
                row.coefficients = vector(&mut random, 0..ARM).map(|entry| entry * size);
                row.bound *= 10.0_f64.powf(random.between(-300.0, 300.0));
            }
        }
        if let Ok(solution) = problem.solve(&mut solver) {
            assert!(solution.change.iter().all(|entry| entry.is_finite()));
        }
    }
}

#[test]
fn a_hessian_that_is_not_positive_definite_is_refused() {
    let plain = Problem::random(&mut SplitMix64::new(27), RECIPE);
    for entry in [0.0, -1.0] {
        let mut problem = plain.clone();
        problem.hessian[4] = [0.0; VARIABLES_MAX];
        problem.hessian.iter_mut().for_each(|row| row[4] = 0.0);
        problem.hessian[4][4] = entry;
        let answer = problem.solve(&mut ActiveSet::new());
        assert_eq!(answer, Err(Failure::NotPositiveDefinite));
    }
}

#[test]
fn the_iteration_limit_is_exact() {
    let mut random = SplitMix64::new(28);
    let mut solver = ActiveSet::new();
    for _ in 0..50 {
        let problem = Problem::random(&mut random, RECIPE);
        let solution = problem.solve(&mut solver).expect("plain problem");
        assert!(solution.iterations < ITERATIONS_MAX / 4);
        for limit in 0..=solution.iterations {
            let answer = solver.solve(
                &problem.hessian,
                &problem.rows,
                &problem.cones,
                limit,
                problem.variables,
            );
            if limit < solution.iterations {
                assert_eq!(answer, Err(Failure::IterationLimit));
            } else {
                assert_eq!(answer, Ok(solution));
            }
        }
    }
}

#[test]
fn more_than_there_is_room_for_is_refused() {
    let mut solver = ActiveSet::new();
    let plain = Problem::random(&mut SplitMix64::new(29), RECIPE);
    let mut problem = plain.clone();
    problem.variables = VARIABLES_MAX + 1;
    assert_eq!(problem.solve(&mut solver), Err(Failure::TooLarge));
    let mut problem = plain.clone();
    problem.rows = vec![plain.rows[0]; ROWS_MAX + 1];
    assert_eq!(problem.solve(&mut solver), Err(Failure::TooLarge));
    let mut problem = plain.clone();
    problem.cones = vec![plain.cones[0]; 5];
    assert_eq!(problem.solve(&mut solver), Err(Failure::TooLarge));
}
