//! Each row of the filter dropped, and each negated.

use std::collections::BTreeMap;

use super::super::adversary::eyes::Boundary;
use super::super::adversary::rig::Scene;
use super::measure::{RATE_TOLERANCE_M_S, rate, stop_distance, tip_shares};
use super::places::{Place, places};
use crate::Deviation;
use crate::config::ControlConfig;
use crate::filter::Filter;
use crate::instrument::KinematicState;
use crate::motion::{AXES, MotionState};
use crate::region::Shape;
use crate::rows::planted::{RowFault, Which};
use crate::rows::{RowInput, Rows, Velocities};

/// A filter alone, with a fault in its rows or without.
struct Bare<'a> {
    config: &'a ControlConfig,
    filter: Filter,
    rows: Rows,
}

/// How a fault showed itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Symptom {
    /// A boundary came nearer faster than it may.
    Approach,
    /// An axis was faster than its limit, or than it can stop before the end of its range.
    Axis,
    /// A tip was too fast.
    TipSpeed,
    /// A tip turned too fast.
    TipTurn,
    /// A motion that breaks nothing was changed.
    Restraint,
}

impl<'a> Bare<'a> {
    fn new(config: &'a ControlConfig) -> Self {
        Self {
            config,
            filter: Filter::new(config),
            rows: Rows::new(config),
        }
    }

    /// The filter's answer to `wanted` at `place`, for arms that move with `moving`.
    fn answer(
        &mut self,
        place: &Place,
        moving: &Velocities,
        wanted: &Velocities,
        fault: Option<&RowFault>,
    ) -> Velocities {
        let states: Vec<MotionState> = place
            .positions
            .iter()
            .enumerate()
            .map(|(arm, position)| MotionState {
                position: *position,
                velocity: core::array::from_fn(|axis| moving[AXES * arm + axis]),
                ..MotionState::ZERO
            })
            .collect();
        let stances: Vec<KinematicState> = states.iter().map(KinematicState::new).collect();
        let inputs: Vec<RowInput<'_>> = states
            .iter()
            .zip(&stances)
            .map(|(state, stance)| RowInput {
                state,
                stance,
                moves: true,
                jaw_effort_n_m: 0.0,
                pace: 1.0,
                deviation: Deviation::default(),
            })
            .collect();
        self.rows.fill(self.config, &inputs);
        if let Some(fault) = fault {
            self.rows.plant(fault);
        }
        let stances: Vec<&KinematicState> = stances.iter().collect();
        self.filter.filter(wanted, &self.rows, &stances).velocity
    }

    /// What is wrong with the filter at `place`, if anything.
    fn symptom(&mut self, place: &Place, fault: Option<&RowFault>) -> Option<Symptom> {
        for wanted in &place.presses {
            // From rest, and in motion already, where accelerations bound less.
            let moving = core::array::from_fn(|variable| {
                let limit = self.config.axes[variable % AXES].velocity;
                wanted[variable].clamp(-limit, limit)
            });
            for moving in [[0.0; 2 * AXES], moving] {
                let answer = self.answer(place, &moving, wanted, fault);
                if let Some(symptom) = too_far(self.config, place, &answer) {
                    return Some(symptom);
                }
            }
        }
        for wanted in &place.passes {
            let answer = self.answer(place, wanted, wanted, fault);
            let changed = wanted
                .iter()
                .zip(&answer)
                .any(|(a, b)| (a - b).abs() > 1e-9);
            if changed {
                return Some(Symptom::Restraint);
            }
        }
        None
    }
}

/// Whether the answer breaks something that can be measured.
fn too_far(config: &ControlConfig, place: &Place, answer: &Velocities) -> Option<Symptom> {
    for (variable, speed) in answer.iter().enumerate().take(AXES * place.positions.len()) {
        let limits = &config.axes[variable % AXES];
        let position = place.positions[variable / AXES][variable % AXES];
        let room = if *speed > 0.0 {
            limits.high - position
        } else {
            position - limits.low
        };
        let needed = stop_distance(speed.abs(), limits.acceleration, limits.jerk);
        if speed.abs() > limits.velocity * (1.0 + 1e-6) || needed > room.max(0.0) + 1e-9 {
            return Some(Symptom::Axis);
        }
    }
    for arm in 0..place.positions.len() {
        let (speed, turn) = tip_shares(config, &place.positions, answer, arm);
        if speed > 1.0 + 1e-6 {
            return Some(Symptom::TipSpeed);
        }
        if turn > 1.0 + 1e-6 {
            return Some(Symptom::TipTurn);
        }
    }
    let boundary = place.boundary?;
    if matches!(boundary, Boundary::Axis { .. }) {
        return None;
    }
    let allowed = config.filter.alpha_1_s * (place.clearance - config.margins.filter_m).max(0.0);
    let predicted: f64 = place.slope.iter().zip(answer).map(|(s, u)| s * u).sum();
    let too_fast = |rate: f64| rate < -allowed - RATE_TOLERANCE_M_S;
    // Where the nearest place of a link jumps the slope says nothing; so both must agree.
    (too_fast(predicted) && too_fast(rate(config, boundary, &place.positions, answer)))
        .then_some(Symptom::Approach)
}

/// What a fault is called.
fn name(config: &ControlConfig, geometry: &[String], fault: &RowFault) -> String {
    let axis = |variable: usize| {
        let axis = variable % AXES;
        let joint = hal::joints::JOINT_NAMES.get(axis).unwrap_or(&"jaw");
        format!("{}.{joint}", config.arms[variable / AXES].name)
    };
    let row = match fault.which {
        Which::Low(variable) => format!("{}.low", axis(variable)),
        Which::High(variable) => format!("{}.high", axis(variable)),
        Which::Geometry(index) => geometry[index].clone(),
        Which::Cone(index) => {
            let what = ["tip_speed", "tip_turn"][index % 2];
            format!("{}.{what}", config.arms[index / 2].name)
        }
    };
    format!("{row} {:?}", fault.wrong)
}

/// Why a fault changes nothing, if it does not.
fn equivalent(config: &ControlConfig, name: &str) -> Option<&'static str> {
    let planes = config.arms.iter().flat_map(|arm| {
        let planes = arm
            .forbidden
            .iter()
            .filter(|region| matches!(region.shape, Shape::HalfSpace { .. }));
        planes.map(move |region| format!("{}.{}.", arm.name, region.name))
    });
    let row = name.strip_suffix(" Dropped")?;
    let link = planes
        .into_iter()
        .find_map(|plane| row.strip_prefix(&plane))?;
    match link {
        "shaft.end" => {
            Some("the shaft's end is nearer to a plane than the rest of it, which has a row")
        }
        "shaft" | "wrist" | "left_finger" | "right_finger" => {
            Some("a link is nearest to a plane at an end, and every end has a row of its own")
        }
        _ => None,
    }
}

/// The scene of `arms`, and without its regions but with ranges or a workspace so tight that each
/// end can be reached.
fn variants(arms: usize) -> [ControlConfig; 3] {
    let config = Scene::of_arms(arms).config;
    let mut empty = config.clone();
    for arm in &mut empty.arms {
        arm.forbidden.clear();
    }
    let mut tight = empty.clone();
    let ranges = [(-0.25, 0.25), (-0.25, 0.25), (0.085, 0.15), (-1.5, 1.5)];
    for (axis, (low, high)) in tight.axes.iter_mut().zip(ranges) {
        (axis.low, axis.high) = (low, high);
    }
    for arm in &mut tight.arms {
        arm.workspace.half_m *= 1.5;
    }
    for arm in &mut empty.arms {
        arm.workspace.half_m *= 0.7;
    }
    [config, tight, empty]
}

/// What was found of the faults of one configuration.
#[derive(Debug, Default)]
struct Hunt {
    names: Vec<String>,
    found: BTreeMap<String, Symptom>,
    unreachable: Vec<Boundary>,
}

/// Plants every fault in the rows of `config`, one after the other.
fn hunt(config: &ControlConfig) -> Hunt {
    let (places, unreachable) = places(config, 6, |_| true);
    let mut bare = Bare::new(config);
    for place in &places {
        let symptom = bare.symptom(place, None);
        assert_eq!(symptom, None, "without a fault, at {place:#?}");
    }
    let geometry = crate::rows::planted::geometry_names(config);
    let mut hunt = Hunt {
        unreachable,
        ..Hunt::default()
    };
    let mut from = 0;
    for fault in &RowFault::all(&bare.rows) {
        let name = name(config, &geometry, fault);
        let hit = (0..places.len())
            .map(|step| (from + step) % places.len())
            .find_map(|index| Some((index, bare.symptom(&places[index], Some(fault))?)));
        if let Some((index, symptom)) = hit {
            from = index;
            hunt.found.insert(name.clone(), symptom);
        }
        hunt.names.push(name);
    }
    hunt
}

/// Expects every fault of the scene's rows to be found in one of its variants, or to be explained.
fn every_fault_is_found(arms: usize) {
    let variants = variants(arms);
    let hunts = variants.each_ref().map(hunt);
    let [whole, ..] = &hunts;
    println!("never the nearest: {:?}", whole.unreachable);
    let mut symptoms: BTreeMap<Symptom, u32> = BTreeMap::new();
    let (mut explained, mut survivors) = (Vec::new(), Vec::new());
    for name in &whole.names {
        if let Some(symptom) = hunts.iter().find_map(|hunt| hunt.found.get(name)) {
            *symptoms.entry(*symptom).or_default() += 1;
        } else if let Some(reason) = equivalent(&variants[0], name) {
            explained.push(format!("{name}: {reason}"));
        } else {
            survivors.push(name);
        }
    }
    println!(
        "{arms} arms: {} faults planted in rows, {} found {symptoms:?}, {} change nothing {explained:#?}, {} survive",
        whole.names.len(),
        whole.names.len() - explained.len() - survivors.len(),
        explained.len(),
        survivors.len(),
    );
    assert!(survivors.is_empty(), "{survivors:#?}");
}

#[test]
fn every_fault_in_a_row_is_found() {
    every_fault_is_found(1);
}

#[test]
fn every_fault_in_a_row_of_two_arms_is_found() {
    every_fault_is_found(2);
}
