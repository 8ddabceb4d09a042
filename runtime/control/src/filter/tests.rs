//! Facts about the safety filter.

use super::{Filter, Filtered};
use crate::Deviation;
use crate::active_set::VARIABLES_MAX;
use crate::config::ControlConfig;
use crate::instrument::KinematicState;
use crate::motion::{AXES, JAW, MotionState};
use crate::report::QpOutcome;
use crate::rows::tests::{fill, two_arms};
use crate::rows::{RowInput, Rows, Velocities};
use crate::second_opinion::compare;
use hal::random::SplitMix64;

/// Arms in or near the workspace, in motion, with what the filter is asked.
struct Case {
    config: ControlConfig,
    filter: Filter,
    rows: Rows,
    stances: Vec<KinematicState>,
    random: SplitMix64,
}

impl Case {
    fn new(arms: usize, seed: u64) -> Self {
        let mut config = two_arms();
        config.arms.truncate(arms);
        Self {
            filter: Filter::new(&config),
            rows: Rows::new(&config),
            stances: Vec::new(),
            random: SplitMix64::new(seed),
            config,
        }
    }

    fn draw(&mut self) {
        let centre = [0.0, 0.0, 0.13, 0.0, 0.0, 0.0, 0.5];
        let spread = [0.5, 0.4, 0.04, 4.0, 1.3, 1.3, 0.5];
        let states: Vec<MotionState> = (0..self.config.arms.len())
            .map(|_| MotionState {
                position: core::array::from_fn(|axis| {
                    centre[axis] + self.random.between(-spread[axis], spread[axis])
                }),
                velocity: core::array::from_fn(|axis| {
                    self.random.between(-0.3, 0.3) * self.config.axes[axis].velocity
                }),
                acceleration: [0.0; AXES],
            })
            .collect();
        self.stances = fill(&mut self.rows, &self.config, &states);
    }

    fn velocity(&mut self, share: f64) -> Velocities {
        let variables = AXES * self.config.arms.len();
        core::array::from_fn(|axis| {
            if axis < variables {
                self.random.between(-share, share) * self.filter.scale[axis]
            } else {
                0.0
            }
        })
    }

    fn filter(&mut self, nominal: &Velocities) -> Filtered {
        let stances: Vec<&KinematicState> = self.stances.iter().collect();
        self.filter.filter(nominal, &self.rows, &stances)
    }
}

#[test]
fn a_velocity_within_the_rows_passes_unchanged() {
    for arms in [1, 2] {
        let mut case = Case::new(arms, 41);
        let mut passed = 0;
        for _ in 0..5_000 {
            case.draw();
            let nominal = case.velocity(0.15);
            if case.rows.hold(&nominal, 0.0) {
                let filtered = case.filter(&nominal);
                assert_eq!(
                    (filtered.velocity, filtered.outcome),
                    (nominal, QpOutcome::NotNeeded)
                );
                passed += 1;
            }
        }
        assert!(passed > 50, "{arms} arms: {passed}");
    }
}

/// `cases` problems as they come in, each against Clarabel.
fn clarabel_agrees(arms: usize, seed: u64, cases: u32) {
    let mut case = Case::new(arms, seed);
    let (mut solved, mut rough, mut unsolved) = (0_u32, 0_u32, 0_u32);
    let (mut change, mut gap, mut violation) = (0.0_f64, 0.0_f64, 0.0_f64);
    for index in 0..cases {
        case.draw();
        let nominal = case.velocity(1.5);
        let filtered = case.filter(&nominal);
        assert_ne!(filtered.outcome, QpOutcome::Failed, "case {index}");
        assert!(case.rows.hold(&filtered.velocity, 1e-7), "case {index}");
        if filtered.outcome == QpOutcome::NotNeeded {
            continue;
        }
        solved += 1;
        assert!(filtered.rows_active > 0, "case {index}");
        let Some(found) = compare(case.filter.problem(), case.filter.solution()) else {
            unsolved += 1;
            continue;
        };
        assert!(found.change < 1e-5, "case {index}: {found:?}");
        assert!(found.objective.abs() < 1e-8, "case {index}: {found:?}");
        rough += u32::from(found.tolerance > 1e-10);
        change = change.max(found.change);
        gap = gap.max(found.objective.abs());
        violation = violation.max(found.violation);
    }
    assert!(violation < 1e-8, "{violation:e}");
    assert!(change < 1e-5 && gap < 1e-8, "{change:e} {gap:e}");
    assert!(
        solved > 9 * cases / 10 && rough < solved / 100 && unsolved < solved / 1000,
        "{solved} {rough} {unsolved}"
    );
}

#[test]
fn clarabel_finds_the_same_answers() {
    clarabel_agrees(1, 42, 2_000);
    clarabel_agrees(2, 43, 1_000);
}

#[test]
fn what_no_row_touches_stays_as_it_is() {
    let mut case = Case::new(2, 46);
    let mut untouched = 0;
    for _ in 0..2_000 {
        case.draw();
        let mut nominal = case.velocity(1.5);
        nominal[AXES..].fill(0.0);
        let filtered = case.filter(&nominal);
        let jaw_within = nominal[JAW] > case.rows.low[JAW] && nominal[JAW] < case.rows.high[JAW];
        let coupled = case.rows.geometry.iter().any(|row| {
            let touches = crate::rows::dot(&row.coefficients, &filtered.velocity);
            row.coefficients[AXES..].iter().any(|c| c.abs() > 0.0) && touches > row.bound - 1e-9
        });
        if !coupled {
            let other: Vec<f64> = filtered.velocity[AXES..].to_vec();
            assert_eq!(other, vec![0.0; AXES]);
            untouched += u32::from(jaw_within);
        }
    }
    assert!(untouched > 200, "{untouched}");
}

#[test]
fn an_arm_that_may_not_move_does_not_stop_the_other() {
    let mut case = Case::new(2, 48);
    for round in 0..2_000 {
        case.draw();
        let states = [(); 2].map(|()| MotionState::ZERO);
        let mut inputs: Vec<RowInput<'_>> = states
            .iter()
            .zip(&case.stances)
            .map(|(state, stance)| RowInput {
                state,
                stance,
                moves: true,
                jaw_effort_n_m: 0.0,
                pace: 1.0,
                deviation: Deviation::default(),
            })
            .collect();
        inputs[1].pace = 0.0;
        inputs[1].moves = round % 2 == 0;
        case.rows.fill(&case.config, &inputs);
        let mut nominal = case.velocity(1.5);
        nominal[AXES..].fill(0.0);
        let filtered = case.filter(&nominal);
        assert_ne!(filtered.outcome, QpOutcome::Failed, "round {round}");
        assert!(filtered.velocity[AXES..].iter().all(|v| v.abs() < 1e-9));
    }
}

#[test]
fn nan_stops_the_arm_and_the_next_problem_is_solved_again() {
    let mut case = Case::new(1, 47);
    case.draw();
    let good = case.velocity(3.0);
    let before = case.filter(&good);
    let mut nominal = good;
    nominal[2] = f64::NAN;
    let broken = case.filter(&nominal);
    assert_eq!(
        (broken.velocity, broken.outcome),
        ([0.0; VARIABLES_MAX], QpOutcome::Failed)
    );
    assert_eq!(case.filter(&good), before);
}

/// Every row has a name; the rows that a solution touches are those that the filter counts, an axis
/// given by its bounds apart.
#[test]
fn active_rows_have_names() {
    for arms in [1, 2] {
        let mut case = Case::new(arms, 49);
        let names = crate::rows::names(&case.config);
        let mut solved = 0;
        for _ in 0..500 {
            case.draw();
            let nominal = case.velocity(3.0);
            let filtered = case.filter(&nominal);
            if !matches!(filtered.outcome, QpOutcome::Solved { .. }) {
                continue;
            }
            solved += 1;
            let problem = case.filter.problem();
            assert_eq!(names.len(), problem.rows.len() + problem.cones.len());
            let solution = *case.filter.solution();
            let active: Vec<usize> = problem.active(&solution).collect();
            assert!(!active.is_empty() || filtered.rows_active == 0);
            assert!(active.iter().all(|&index| index < names.len()));
        }
        assert!(solved > 100, "{solved}");
    }
}

/// An axis that is held at its upper bound is named, and no other.
#[test]
fn the_bound_that_holds_an_axis_is_named() {
    let mut case = Case::new(1, 50);
    case.draw();
    let states = [MotionState::ZERO];
    case.stances = fill(&mut case.rows, &case.config, &states);
    let mut nominal = [0.0; VARIABLES_MAX];
    nominal[JAW] = 2.0 * case.rows.high[JAW];
    let filtered = case.filter(&nominal);
    assert!(matches!(filtered.outcome, QpOutcome::Solved { .. }));
    let names = crate::rows::names(&case.config);
    let solution = *case.filter.solution();
    let active = case.filter.problem().active(&solution);
    let named: Vec<&str> = active.map(|index| names[index].as_str()).collect();
    assert!(named.contains(&"psm1 jaw, upper bound"), "{named:?}");
}
