//! Exact zeros where nothing acts, and the same bits every time.

use super::super::{ActiveSet, VARIABLES_MAX};
use super::problem::{ARM, Problem, Recipe};
use hal::random::SplitMix64;

const RECIPE: Recipe = Recipe {
    arms: 2,
    rows_per_arm: 31,
    pair_rows: 5,
    cones_per_arm: 2,
    nominal: 0.7,
};

fn is_zero(change: &[f64]) -> bool {
    change.iter().all(|entry| entry.to_bits() == 0)
}

#[test]
fn a_satisfied_problem_changes_nothing() {
    let mut random = SplitMix64::new(31);
    for arms in [1, 2] {
        let recipe = Recipe {
            arms,
            nominal: 0.0,
            ..RECIPE
        };
        let problem = Problem::random(&mut random, recipe);
        let solution = problem.solve(&mut ActiveSet::new()).expect("feasible");
        assert!(is_zero(&solution.change));
        assert_eq!(solution.iterations, 0);
    }
}

#[test]
fn an_arm_that_no_active_row_touches_changes_by_exactly_zero() {
    let mut random = SplitMix64::new(32);
    let mut solver = ActiveSet::new();
    let mut moved = 0;
    for case in 0..500 {
        let mut problem = Problem::random(&mut random, RECIPE);
        // The second arm's own rows and the pair's allow its nominal velocity, whatever the first
        // does.
        for row in &mut problem.rows {
            if row.coefficients[ARM..].iter().any(|entry| *entry != 0.0) {
                row.bound = 1e3;
            }
        }
        for cone in &mut problem.cones[2..] {
            cone.radius = 1e3;
        }
        let change = problem.solve(&mut solver).expect("feasible").change;
        assert!(is_zero(&change[ARM..]), "case {case}: {change:?}");
        moved += usize::from(!is_zero(&change[..ARM]));
    }
    assert!(moved > 400);
}

#[test]
fn a_row_of_both_arms_that_left_again_leaves_no_trace() {
    let mut random = SplitMix64::new(33);
    let mut solver = ActiveSet::new();
    let mut apart = 0;
    for case in 0..2000 {
        let recipe = Recipe {
            nominal: random.between(0.05, 0.5),
            ..RECIPE
        };
        let problem = Problem::random(&mut random, recipe);
        let change = problem.solve(&mut solver).expect("feasible").change;
        let method = &solver.two_arms;
        let active = &method.active[..method.active_count];
        for places in [0..ARM, ARM..VARIABLES_MAX] {
            let touched = active.iter().any(|active| {
                let coefficients = &active.row.coefficients[places.clone()];
                coefficients.iter().any(|entry| *entry != 0.0)
            });
            assert_eq!(touched, !is_zero(&change[places]), "case {case}");
            apart += u32::from(!touched);
        }
    }
    assert!(apart > 50, "{apart}");
}

#[test]
fn the_same_problem_has_the_same_bits_whatever_came_before() {
    let mut random = SplitMix64::new(34);
    let mut used = ActiveSet::new();
    for case in 0..300 {
        let arms = 1 + case % 2;
        let problem = Problem::random(&mut random, Recipe { arms, ..RECIPE });
        let bits = |solver: &mut ActiveSet| {
            let solution = problem.solve(solver).expect("feasible");
            (solution.change.map(f64::to_bits), solution.iterations)
        };
        assert_eq!(bits(&mut used), bits(&mut ActiveSet::new()), "case {case}");
        assert_eq!(bits(&mut used), bits(&mut used), "case {case}");
    }
}
