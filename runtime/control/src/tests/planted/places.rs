//! States near every boundary, with velocities that press against it and velocities that have every
//! right to pass.

use super::super::adversary::eyes::Boundary;
use super::super::adversary::kinds::below;
use super::measure::{RATE_TOLERANCE_M_S, rate, slope, stop_distance, tip_shares};
use hal::joints::INSERTION;

use crate::config::ControlConfig;
use crate::motion::{AXES, Axes};
use crate::region::Shape;
use crate::rows::Velocities;
use hal::random::SplitMix64;

/// Tries to find a place near a boundary.
const TRIES: u32 = 60;

/// A state of all arms, and what to ask of the filter there.
#[derive(Clone, Debug)]
pub(super) struct Place {
    /// What is near; nothing in the middle of the workspace.
    pub(super) boundary: Option<Boundary>,
    pub(super) positions: Vec<Axes>,
    /// How far the boundary is, and how fast it comes nearer per velocity of an axis.
    pub(super) clearance: f64,
    pub(super) slope: Velocities,
    /// What would go too far.
    pub(super) presses: Vec<Velocities>,
    /// What breaks nothing, for an arm that moves like that already.
    pub(super) passes: Vec<Velocities>,
}

/// Everything that the scene bounds, ends of links included.
pub(super) fn boundaries(config: &ControlConfig) -> Vec<Boundary> {
    let mut all = Boundary::all(config);
    all.extend(Boundary::ends(config));
    all
}

/// `count` places near each boundary of interest that can be reached, and some in the middle. The
/// second list is of the boundaries that cannot: something else is always in the way.
pub(super) fn places(
    config: &ControlConfig,
    count: usize,
    of_interest: impl Fn(Boundary) -> bool,
) -> (Vec<Place>, Vec<Boundary>) {
    let mut random = SplitMix64::new(71);
    let all = boundaries(config);
    let (mut places, mut unreachable) = (Vec::new(), Vec::new());
    for _ in 0..count {
        if let Some(positions) = middle(config, &all, &mut random) {
            places.push(place(config, &all, None, positions, &mut random));
        }
    }
    for boundary in all
        .iter()
        .copied()
        .filter(|&boundary| of_interest(boundary))
    {
        let before = places.len();
        // Ends are hard to find alone, and hard to press.
        let more = if matches!(boundary, Boundary::End { .. }) {
            3
        } else {
            1
        };
        for _ in 0..TRIES * more {
            if places.len() == before + count * more as usize {
                break;
            }
            if let Some(positions) = near(config, &all, boundary, &mut random) {
                places.push(place(config, &all, Some(boundary), positions, &mut random));
            }
        }
        if places.len() == before {
            unreachable.push(boundary);
        }
    }
    (places, unreachable)
}

/// Anywhere that is clear of everything.
fn middle(config: &ControlConfig, all: &[Boundary], random: &mut SplitMix64) -> Option<Vec<Axes>> {
    (0..10_000)
        .map(|_| anywhere(config, random))
        .find(|positions| {
            all.iter()
                .all(|&one| one.clearance(config, positions) >= keep(config, one))
        })
}

fn anywhere(config: &ControlConfig, random: &mut SplitMix64) -> Vec<Axes> {
    let one = |random: &mut SplitMix64| -> Axes {
        core::array::from_fn(|axis| {
            let limits = &config.axes[axis];
            random.between(limits.low + 1e-3, limits.high - 1e-3)
        })
    };
    config.arms.iter().map(|_| one(random)).collect()
}

/// From somewhere to within 4 mm of the boundary's margin, and out of whatever else is in the way.
fn near(
    config: &ControlConfig,
    all: &[Boundary],
    boundary: Boundary,
    random: &mut SplitMix64,
) -> Option<Vec<Axes>> {
    // The way to the boundary hardly turns the instrument: begin with a posture that matters.
    let mut positions = (0..300)
        .map(|_| anywhere(config, random))
        .find(|positions| matters(config, boundary, positions))?;
    let goal = match boundary {
        Boundary::Axis { .. } => random.between(1e-3, 0.02),
        // Something else of the instrument is nearer.
        Boundary::End { .. } => {
            let far_m = if random.happens(0.3) { 0.011 } else { 0.004 };
            config.margins.filter_m + random.between(1e-4, far_m)
        }
        Boundary::Workspace { .. }
        | Boundary::Region { .. }
        | Boundary::Shafts
        | Boundary::ToShaft { .. } => config.margins.filter_m + random.between(1e-4, 0.004),
    };
    for _ in 0..60 {
        step_to(config, boundary, goal, &mut positions);
        let off = boundary.clearance(config, &positions) - goal;
        let in_the_way = all
            .iter()
            .filter(|other| **other != boundary)
            .map(|&other| {
                (
                    other,
                    other.clearance(config, &positions) - keep(config, other),
                )
            })
            .min_by(|a, b| a.1.total_cmp(&b.1));
        match in_the_way {
            Some((other, lacking)) if lacking < 0.0 => {
                let margin = keep(config, other) + random.between(1e-4, 2e-3);
                step_to(config, other, margin, &mut positions);
            }
            _ if off.abs() < 5e-4 && matters(config, boundary, &positions) => {
                return Some(positions);
            }
            _ if off.abs() < 5e-4 => return None,
            _ => {}
        }
    }
    None
}

/// Whether nothing else stands for the boundary: a link is nearest to a region with flat faces in
/// its middle, and an end that has a row of its own is not the nearest place of a link.
fn matters(config: &ControlConfig, boundary: Boundary, positions: &[Axes]) -> bool {
    let at = |boundary: Boundary| boundary.clearance(config, positions);
    let own = at(boundary);
    match boundary {
        Boundary::Region { arm, region, link } => {
            let ends = [Some(link), [None, Some(0), Some(1), Some(1)][link]];
            let is_box = matches!(config.arms[arm].forbidden[region].shape, Shape::Box(_));
            !is_box
                || ends
                    .into_iter()
                    .flatten()
                    .all(|link| at(Boundary::End { arm, region, link }) > own + 1e-4)
        }
        Boundary::End { arm, region, link } => {
            let sharing: &[usize] = [&[0, 1][..], &[1, 2, 3], &[2], &[3]][link];
            sharing
                .iter()
                .all(|&link| at(Boundary::Region { arm, region, link }) < own - 1e-4)
        }
        Boundary::Axis { .. }
        | Boundary::Workspace { .. }
        | Boundary::Shafts
        | Boundary::ToShaft { .. } => true,
    }
}

/// The shortest way to where the boundary is `goal` away, as far as its slope tells.
fn step_to(config: &ControlConfig, boundary: Boundary, goal: f64, positions: &mut [Axes]) {
    let lacking = goal - boundary.clearance(config, positions);
    // In units in which a metre of insertion and a radian of the others do about the same to the
    // tip.
    let weight = |axis: usize| if axis == INSERTION { 0.01 } else { 1.0 };
    let slope = slope(config, boundary, positions);
    let steepness: f64 = slope
        .iter()
        .enumerate()
        .map(|(variable, s)| s * s * weight(variable % AXES))
        .sum();
    for (arm, position) in positions.iter_mut().enumerate() {
        for (axis, value) in position.iter_mut().enumerate() {
            let limits = &config.axes[axis];
            let step = slope[AXES * arm + axis] * weight(axis) * lacking / steepness.max(1e-9);
            *value = (*value + step.clamp(-0.2, 0.2)).clamp(limits.low + 1e-4, limits.high - 1e-4);
        }
    }
}

/// What keeps the filter out of the way.
fn keep(config: &ControlConfig, boundary: Boundary) -> f64 {
    if matches!(boundary, Boundary::Axis { .. }) {
        1e-4
    } else {
        config.margins.filter_m
    }
}

fn place(
    config: &ControlConfig,
    all: &[Boundary],
    boundary: Option<Boundary>,
    positions: Vec<Axes>,
    random: &mut SplitMix64,
) -> Place {
    let clearance = boundary.map_or(f64::INFINITY, |boundary| {
        boundary.clearance(config, &positions)
    });
    let slope = boundary.map_or([0.0; 2 * AXES], |boundary| {
        slope(config, boundary, &positions)
    });
    let variables = AXES * positions.len();
    let limit = |variable: usize| config.axes[variable % AXES].velocity;
    let along = |share: f64| -> Velocities {
        core::array::from_fn(|variable| {
            if variable < variables && slope[variable].abs() > 1e-9 {
                slope[variable].signum() * share * limit(variable)
            } else {
                0.0
            }
        })
    };
    let mut presses = vec![along(-2.0), along(-0.2)];
    for _ in 0..4 {
        presses.push(core::array::from_fn(|variable| {
            if variable < variables {
                random.between(-2.0, 2.0) * limit(variable) - slope[variable].signum()
            } else {
                0.0
            }
        }));
    }
    if let Some(Boundary::End { arm, .. }) = boundary {
        presses.extend(wrist_turns(AXES * arm, &limit));
    }
    let mut wanted: Vec<Velocities> = (1..8).map(|part| along(0.1 * f64::from(part))).collect();
    for _ in 0..4 {
        let mut one = [0.0; 2 * AXES];
        let variable = below(random, variables);
        one[variable] = [-0.9, 0.9][below(random, 2)] * limit(variable);
        wanted.push(one);
    }
    if boundary.is_none() {
        wanted.extend(one_by_one(variables, &limit));
    }
    wanted.retain(|velocity| breaks_nothing(config, all, &positions, velocity));
    Place {
        boundary,
        positions,
        clearance,
        slope,
        presses,
        passes: wanted,
    }
}

/// The wrist's three axes turning in all ways at half their speeds.
fn wrist_turns(first: usize, limit: &impl Fn(usize) -> f64) -> Vec<Velocities> {
    (0..27)
        .map(|code| {
            let mut turn = [0.0; 2 * AXES];
            for (axis, power) in [(3, 1), (4, 3), (5, 9)] {
                let way = f64::from(code / power % 3 - 1);
                turn[first + axis] = 0.5 * way * limit(first + axis);
            }
            turn
        })
        .collect()
}

/// Each axis alone, nearly as fast as it may.
fn one_by_one(variables: usize, limit: &impl Fn(usize) -> f64) -> Vec<Velocities> {
    let mut all = Vec::new();
    for variable in 0..variables {
        for share in [-0.9, -0.7, 0.7, 0.9] {
            let mut one = [0.0; 2 * AXES];
            one[variable] = share * limit(variable);
            all.push(one);
        }
    }
    all
}

/// Whether `velocity` is allowed by everything that can be measured, with a little to spare.
fn breaks_nothing(
    config: &ControlConfig,
    all: &[Boundary],
    positions: &[Axes],
    velocity: &Velocities,
) -> bool {
    let fraction = config.filter.speed_fraction - 1e-3;
    let slow = (0..positions.len()).all(|arm| {
        let (speed, turn) = tip_shares(config, positions, velocity, arm);
        speed <= fraction && turn <= fraction
    });
    slow && all.iter().all(|&boundary| {
        let h = boundary.clearance(config, positions);
        if let Boundary::Axis { arm, axis, high } = boundary {
            let speed = velocity[AXES * arm + axis];
            let towards = if high { speed } else { -speed };
            let limits = &config.axes[axis];
            towards <= 0.0 || stop_distance(towards, limits.acceleration, limits.jerk) <= 0.6 * h
        } else {
            let allowed = config.filter.alpha_1_s * (h - config.margins.filter_m).max(0.0);
            rate(config, boundary, positions, velocity) >= RATE_TOLERANCE_M_S - allowed
        }
    })
}
