//! Problems that are hard for the method: rows that repeat, nearly repeat, differ in size or meet
//! in one point.

use super::super::{ActiveSet, LinearRow, VARIABLES_MAX};
use super::problem::{ARM, Problem, Recipe, at_rest, dot, vector};
use hal::random::SplitMix64;

const RECIPE: Recipe = Recipe {
    arms: 1,
    rows_per_arm: 31,
    pair_rows: 0,
    cones_per_arm: 2,
    nominal: 1.5,
};
const CASES: u32 = 500;

fn distance(a: &[f64; VARIABLES_MAX], b: &[f64; VARIABLES_MAX]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

/// Solves seeded problems, then once more with the rows that `more` makes of theirs: the answer
/// stays within `tolerance`.
fn stays(
    seed: u64,
    tolerance: f64,
    more: impl Fn(&mut SplitMix64, &[LinearRow]) -> Vec<LinearRow>,
) {
    let mut random = SplitMix64::new(seed);
    let mut solver = ActiveSet::new();
    for case in 0..CASES {
        let mut problem = Problem::random(&mut random, RECIPE);
        let plain = problem.solve(&mut solver).expect("plain problem").change;
        problem.rows = more(&mut random, &problem.rows);
        let hard = problem
            .solve(&mut solver)
            .unwrap_or_else(|failure| panic!("seed {seed}, case {case}: {failure}"))
            .change;
        let (violation, moved) = (problem.violation(&hard), distance(&plain, &hard));
        assert!(violation <= 1e-9, "seed {seed}, case {case}: {violation:e}");
        assert!(moved <= tolerance, "seed {seed}, case {case}: {moved:e}");
    }
}

fn scaled(row: &LinearRow, factor: f64) -> LinearRow {
    LinearRow {
        coefficients: row.coefficients.map(|entry| entry * factor),
        bound: row.bound * factor,
    }
}

#[test]
fn repeated_rows_change_nothing() {
    stays(11, 1e-9, |_, rows| [rows, rows, rows].concat());
}

#[test]
fn empty_rows_change_nothing() {
    stays(12, 0.0, |_, rows| {
        let empty = LinearRow {
            coefficients: [0.0; VARIABLES_MAX],
            bound: 0.0,
        };
        [rows, &[empty]].concat()
    });
}

#[test]
fn rows_of_any_size_weigh_the_same() {
    stays(13, 1e-9, |random, rows| {
        rows.iter()
            .map(|row| scaled(row, 10.0_f64.powf(random.between(-4.0, 4.0))))
            .collect()
    });
}

#[test]
fn nearly_parallel_rows_of_any_size_change_little() {
    stays(14, 1e-5, |random, rows| {
        let near = |row: &LinearRow, random: &mut SplitMix64| {
            let mut near = *row;
            let bend = vector(random, 0..ARM);
            for (entry, bend) in near.coefficients.iter_mut().zip(bend) {
                *entry += 1e-9 * bend;
            }
            scaled(&near, 10.0_f64.powf(random.between(-4.0, 4.0)))
        };
        let mut all = rows.to_vec();
        for _ in 0..2 {
            all.extend(rows.iter().map(|row| near(row, random)));
        }
        all
    });
}

#[test]
fn equal_bounds_pin_a_variable() {
    let mut random = SplitMix64::new(15);
    let mut solver = ActiveSet::new();
    for case in 0..CASES {
        let mut problem = Problem::random(&mut random, RECIPE);
        // Joint 2 has to stand still: its change is minus its nominal, wherever that lies.
        let plain = problem.solve(&mut solver).expect("plain problem").change;
        for sign in [1.0, -1.0] {
            let mut coefficients = [0.0; VARIABLES_MAX];
            coefficients[2] = sign;
            let bound = sign * plain[2];
            problem.rows.push(LinearRow {
                coefficients,
                bound,
            });
        }
        let pinned = problem.solve(&mut solver).expect("pinned problem").change;
        assert!(distance(&plain, &pinned) <= 1e-9, "case {case}");
    }
}

#[test]
fn rows_that_all_meet_in_one_point_do_not_cycle() {
    let mut random = SplitMix64::new(16);
    let mut solver = ActiveSet::new();
    for arms in [1, 2] {
        for case in 0..CASES {
            let recipe = Recipe {
                arms,
                rows_per_arm: 0,
                cones_per_arm: 0,
                ..RECIPE
            };
            let mut problem = Problem::random(&mut random, recipe);
            let corner = vector(&mut random, 0..problem.variables);
            problem.rows.clear();
            for _ in 0..8 * problem.variables {
                let mut coefficients = vector(&mut random, 0..problem.variables);
                // Zero lies outside of all of them.
                if dot(&coefficients, &corner) > 0.0 {
                    coefficients.iter_mut().for_each(|entry| *entry = -*entry);
                }
                let away = corner.map(|entry| -entry);
                problem.rows.push(at_rest(coefficients, &away, 0.0));
            }
            let solution = problem
                .solve(&mut solver)
                .unwrap_or_else(|failure| panic!("{arms} arms, case {case}: {failure}"));
            let violation = problem.violation(&solution.change);
            assert!(violation <= 1e-9, "{arms} arms, case {case}: {violation:e}");
            let excess = problem.objective(&solution.change) - problem.objective(&corner);
            assert!(excess <= 1e-9, "{arms} arms, case {case}: {excess:e}");
        }
    }
}

/// Two cones of a hundredth of the wanted motion used to take turns: each model dropped the cone
/// that the last one held, and forgot its curvature.
#[test]
fn cones_much_tighter_than_the_motion_do_not_take_turns() {
    let mut random = SplitMix64::new(77);
    let mut solver = ActiveSet::new();
    for case in 0..6 * CASES {
        let recipe = Recipe {
            arms: 2,
            rows_per_arm: 46,
            nominal: random.between(0.1, 3.0),
            ..RECIPE
        };
        let mut problem = Problem::random(&mut random, recipe);
        for cone in &mut problem.cones {
            cone.radius *= 0.01;
        }
        let solution = problem
            .solve(&mut solver)
            .unwrap_or_else(|failure| panic!("case {case}: {failure}"));
        let violation = problem.violation(&solution.change);
        assert!(violation <= 1e-9, "case {case}: {violation:e}");
    }
}
