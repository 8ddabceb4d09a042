//! Random problems: Clarabel's answer, and the optimality conditions themselves.

use super::super::method::Method;
use super::super::{ActiveSet, VARIABLES_MAX};
use super::problem::{Problem, Recipe, dot};
use hal::random::SplitMix64;

const CASES: u32 = 1000;

const ONE_ARM: Recipe = Recipe {
    arms: 1,
    rows_per_arm: 31,
    pair_rows: 0,
    cones_per_arm: 0,
    nominal: 1.0,
};
const ONE_ARM_CONES: Recipe = Recipe {
    cones_per_arm: 2,
    ..ONE_ARM
};
const TWO_ARMS: Recipe = Recipe {
    arms: 2,
    rows_per_arm: 46,
    pair_rows: 5,
    ..ONE_ARM
};
const TWO_ARMS_CONES: Recipe = Recipe {
    cones_per_arm: 2,
    ..TWO_ARMS
};

/// Solves seeded problems of all sizes and shows each, with its seed and the solved solver, to
/// `check`.
fn each_problem(
    recipe: Recipe,
    seed: u64,
    mut check: impl FnMut(u32, &Problem, &ActiveSet, &[f64; VARIABLES_MAX]),
) {
    let mut random = SplitMix64::new(seed);
    let mut solver = ActiveSet::new();
    for case in 0..CASES {
        let nominal = random.between(0.2, 2.0);
        let problem = Problem::random(&mut random, Recipe { nominal, ..recipe });
        let solution = problem
            .solve(&mut solver)
            .unwrap_or_else(|failure| panic!("seed {seed}, case {case}: {failure}"));
        check(case, &problem, &solver, &solution.change);
    }
}

fn agrees_with_clarabel(recipe: Recipe, seed: u64) {
    let mut compared = 0;
    each_problem(recipe, seed, |case, problem, _, change| {
        let violation = problem.violation(change);
        assert!(violation <= 1e-9, "seed {seed}, case {case}: {violation:e}");
        let Some(oracle) = problem.oracle() else {
            return;
        };
        compared += 1;
        let distance = change
            .iter()
            .zip(&oracle)
            .fold(0.0, |most: f64, (ours, theirs)| {
                most.max((ours - theirs).abs())
            });
        assert!(distance <= 1e-5, "seed {seed}, case {case}: {distance:e}");
        let (ours, theirs) = (problem.objective(change), problem.objective(&oracle));
        let gap = (ours - theirs).abs() / (1.0 + theirs);
        assert!(gap <= 1e-8, "seed {seed}, case {case}: gap {gap:e}");
    });
    // Clarabel itself stops short of 1e-10 now and then.
    assert!(compared >= CASES * 99 / 100, "only {compared} compared");
}

#[test]
fn one_arm_agrees_with_clarabel() {
    agrees_with_clarabel(ONE_ARM, 1);
}

#[test]
fn one_arm_with_cones_agrees_with_clarabel() {
    agrees_with_clarabel(ONE_ARM_CONES, 2);
}

#[test]
fn two_arms_agree_with_clarabel() {
    agrees_with_clarabel(TWO_ARMS, 3);
}

#[test]
fn two_arms_with_cones_agree_with_clarabel() {
    agrees_with_clarabel(TWO_ARMS_CONES, 4);
}

/// How far the answer is from the optimality conditions, relative to the multipliers; and how many
/// cones push.
fn residual<const N: usize>(
    problem: &Problem,
    method: &Method<N>,
    change: &[f64; VARIABLES_MAX],
) -> (f64, u32) {
    let mut slope: Vec<f64> = problem.hessian.iter().map(|row| dot(row, change)).collect();
    let mut slackness = 0.0_f64;
    let mut total = 1.0;
    let mut cones_pushing = 0;
    for active in &method.active[..method.active_count] {
        assert!(active.multiplier >= 0.0);
        total += active.multiplier;
        if let Some(touch) = active.touch {
            // The cone itself, not the half-space that the solver ended with.
            let cone = &problem.cones[touch.cone];
            let value: Vec<f64> = (0..3)
                .map(|axis| cone.offset[axis] + dot(&cone.matrix[axis], change))
                .collect();
            let length = dot(&value, &value).sqrt();
            let force = active.multiplier / touch.gradient;
            for (value, row) in value.iter().zip(&cone.matrix) {
                for (slope, entry) in slope.iter_mut().zip(row) {
                    *slope += force * value / length * entry;
                }
            }
            slackness = slackness.max((force * (length - cone.radius)).abs());
            cones_pushing += u32::from(active.multiplier > 1e-6);
        } else {
            for (slope, entry) in slope.iter_mut().zip(&active.row.coefficients) {
                *slope += active.multiplier * entry;
            }
            let room = active.row.bound - dot(&active.row.coefficients, change);
            slackness = slackness.max((active.multiplier * room).abs());
        }
    }
    let steepest = slope
        .iter()
        .fold(0.0, |most: f64, entry| most.max(entry.abs()));
    (steepest.max(slackness) / total, cones_pushing)
}

fn satisfies_the_conditions(recipe: Recipe, seed: u64) {
    let mut cones_pushing = 0;
    each_problem(recipe, seed, |case, problem, solver, change| {
        let (residual, pushing) = if recipe.arms == 1 {
            residual(problem, &solver.one_arm, change)
        } else {
            residual(problem, &solver.two_arms, change)
        };
        assert!(residual <= 1e-10, "seed {seed}, case {case}: {residual:e}");
        cones_pushing += pushing;
    });
    assert_eq!(recipe.cones_per_arm > 0, cones_pushing > CASES / 2);
}

#[test]
fn one_arm_satisfies_the_optimality_conditions() {
    satisfies_the_conditions(ONE_ARM, 5);
    satisfies_the_conditions(ONE_ARM_CONES, 6);
}

#[test]
fn two_arms_satisfy_the_optimality_conditions() {
    satisfies_the_conditions(TWO_ARMS, 7);
    satisfies_the_conditions(TWO_ARMS_CONES, 8);
}

#[test]
fn every_size_agrees_with_clarabel() {
    let mut random = SplitMix64::new(9);
    let mut solver = ActiveSet::new();
    for variables in 1..=VARIABLES_MAX {
        let mut compared = 0;
        for case in 0..100 {
            let problem = Problem::of_size(&mut random, variables);
            let change = problem.solve(&mut solver).expect("feasible").change;
            assert!(change[variables..].iter().all(|entry| entry.to_bits() == 0));
            let violation = problem.violation(&change);
            assert!(violation <= 1e-9, "{variables}, {case}: {violation:e}");
            if let Some(oracle) = problem.oracle() {
                let (ours, theirs) = (problem.objective(&change), problem.objective(&oracle));
                let gap = (ours - theirs).abs() / (1.0 + theirs);
                assert!(gap <= 1e-8, "{variables}, {case}: {gap:e}");
                compared += 1;
            }
        }
        assert!(compared >= 95, "{variables}: only {compared} compared");
    }
}
