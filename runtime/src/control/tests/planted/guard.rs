//! Each check of the guard dropped, and each negated, and everything that is added for the time between samples left out.

use std::collections::BTreeMap;

use super::super::adversary::eyes::Boundary;
use super::super::adversary::kinds::below;
use super::super::adversary::rig::Scene;
use super::bench::{Bench, of_arm};
use super::places::{Place, places, slope};
use crate::control::guard::Request;
use crate::control::guard::planted::{Check, Padding, PlantedGuardFault};
use crate::control::motion::{AXES, Axes, AxisLimits, MotionState};
use crate::control::random::SplitMix64;

/// How long the guard is pressed from one place, ticks.
const TICKS: u32 = 200;

/// Places near each boundary of one arm, and between two.
const PLACES: [usize; 2] = [2, 6];

/// The guard's margin here, m: nothing is left that could hide a fault.
const MARGIN_M: f64 = 1e-6;

/// A scene, and the places in it.
struct Ground {
    name: &'static str,
    scene: Scene,
    places: Vec<Place>,
}

impl Ground {
    fn new(
        name: &'static str,
        mut scene: Scene,
        of_interest: impl Fn(Boundary) -> bool,
    ) -> Self {
        scene.config.margins.guard_m = MARGIN_M;
        let (places, _) = places(&scene.config, PLACES[scene.config.arms.len() - 1], of_interest);
        Self {
            name,
            scene,
            places,
        }
    }
}

/// The scene of `arms`, and what of it lets each check be reached.
fn grounds(arms: usize) -> Vec<Ground> {
    let whole = Scene::of_arms(arms);
    let number = toml::Value::Float;
    let empty = |safety: &mut toml::Table, scale: f64| {
        safety.remove("forbidden");
        for arm in safety["arm"].as_array_mut().unwrap() {
            for key in ["workspace_min_m", "workspace_max_m"] {
                for place in arm[key].as_array_mut().unwrap() {
                    *place = number(place.as_float().unwrap() * scale);
                }
            }
        }
    };
    let tight = whole.edited(|control, safety| {
        empty(safety, 1.6);
        for (axis, unit, low, high) in [
            ("yaw", "rad", -0.25, 0.25),
            ("pitch", "rad", -0.25, 0.25),
            ("insertion", "m", 0.085, 0.15),
            ("roll", "rad", -1.5, 1.5),
        ] {
            control["limits"][axis][format!("low_{unit}")] = number(low);
            control["limits"][axis][format!("high_{unit}")] = number(high);
        }
    });
    let small = whole.edited(|_, safety| empty(safety, 0.7));
    let fast = whole.edited(|control, safety| {
        empty(safety, 1.6);
        control["limits"]["tip_speed_m_s"] = number(0.5);
        control["limits"]["tip_angular_speed_rad_s"] = number(20.0);
    });
    let last = whole.edited(|_, safety| {
        let mut far = safety["forbidden"].as_array().unwrap()[0].clone();
        far["center_m"] = toml::Value::Array([0.9, 0.9, 0.9].map(number).to_vec());
        let regions = safety["forbidden"].as_array_mut().unwrap();
        while regions.len() < 8 {
            regions.insert(0, far.clone());
        }
    });
    let between = |boundary| matches!(boundary, Boundary::Shafts | Boundary::ToShaft { .. });
    let region = |boundary| matches!(boundary, Boundary::Region { .. });
    if arms == 2 {
        return vec![Ground::new("as it is", whole, between)];
    }
    vec![
        Ground::new("as it is", whole, region),
        Ground::new("the last slots", last, region),
        Ground::new("tight ranges", tight, |boundary| {
            matches!(boundary, Boundary::Axis { .. })
        }),
        Ground::new("small workspace", small, |boundary| {
            matches!(boundary, Boundary::Workspace { .. })
        }),
        Ground::new("fast tips", fast, |_| false),
    ]
}

/// What is done to the guard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Script {
    /// Straight at the boundary, most of the time.
    Press,
    /// At the boundary and along it at full speed, so that what is nearest is so between two samples.
    Graze,
    /// The same, with velocities and accelerations above the limits.
    TooMuch,
    /// With steps that no motion can make.
    Kicks,
    /// A motion that breaks nothing.
    Benign,
}

/// Plays the script from a place; gives what shows that the guard is not what it should be.
fn play<const ARMS: usize>(
    ground: &Ground,
    place: &Place,
    script: Script,
    fault: Option<PlantedGuardFault>,
) -> Option<String> {
    let config = &ground.scene.config;
    let mut random = SplitMix64::new(81 + place.clearance.to_bits());
    let mut bench =
        Bench::<ARMS>::new(&ground.scene, &place.positions, fault, script == Script::TooMuch);
    let mut wanted = [0.0; 2 * AXES];
    let mut waiting = [0_u32; ARMS];
    for tick in 0..TICKS {
        if tick % 30 == 0 {
            wanted = match (script, place.boundary) {
                (Script::Benign, _) => [0.0; 2 * AXES].map(|_: f64| random.between(-0.1, 0.1)),
                (_, Some(boundary))
                    if random.happens(if script == Script::Graze { 0.4 } else { 0.9 }) =>
                {
                    let slope = slope(config, boundary, &bench.positions());
                    slope.map(|s| if s.abs() > 1e-9 { -2.0 * s.signum() } else { 0.0 })
                }
                _ => [0.0; 2 * AXES].map(|_: f64| [-2.0, 0.0, 2.0][below(&mut random, 3)]),
            };
        }
        let requests = core::array::from_fn(|arm| {
            // Now and then an arm stops on its own.
            if waiting[arm] > 0 {
                waiting[arm] -= 1;
                return Request::Stop;
            }
            if ARMS > 1 && script != Script::Benign && random.happens(0.01) {
                waiting[arm] = 1 + tick % 60;
            }
            let velocity: Axes = of_arm(&wanted, arm);
            let scaled = core::array::from_fn(|axis| velocity[axis] * config.axes[axis].velocity);
            let mut candidate = bench.candidate(arm, &scaled);
            if script == Script::Kicks
                && let Some(state) = &mut candidate
            {
                kick(&mut random, &config.axes, state);
            }
            Request::Follow(candidate)
        });
        bench.step(&requests);
        if let Some(violation) = bench.violation() {
            return Some(violation);
        }
    }
    (script == Script::Benign && bench.refused > 0).then(|| "a benign motion is refused".to_owned())
}

/// A step of one axis's position, velocity or acceleration that is more than its jerk can make in a tick, from one extreme to
/// beyond the other.
fn kick(random: &mut SplitMix64, axes: &[AxisLimits; AXES], state: &mut MotionState) {
    let axis = below(random, AXES);
    let (t, jerk) = (1e-3, axes[axis].jerk);
    let way = [-1.0, 1.0][below(random, 2)];
    let most = [4.0, 20.0, 100.0][below(random, 3)];
    let size = way * random.between(2.2, most) * jerk;
    match below(random, 3) {
        0 => state.acceleration[axis] += size * t,
        1 => state.velocity[axis] += size * t * t / 2.0,
        _ => state.position[axis] += size * t * t * t / 6.0,
    }
}

/// Which scripts suit a place.
fn scripts(place: &Place) -> &'static [Script] {
    match place.boundary {
        None => &[Script::Benign, Script::Kicks, Script::TooMuch, Script::Press],
        Some(_) => &[Script::Press, Script::Graze],
    }
}

/// Every script at every place, as indices.
fn trials(grounds: &[Ground]) -> Vec<(usize, usize, Script)> {
    let mut all = Vec::new();
    for (index, ground) in grounds.iter().enumerate() {
        for (at, place) in ground.places.iter().enumerate() {
            all.extend(scripts(place).iter().map(|&script| (index, at, script)));
        }
    }
    all
}

/// Plants each of `faults` and expects it to be found or to be explained.
fn hunt<const ARMS: usize>(faults: &[PlantedGuardFault]) {
    let grounds = grounds(ARMS);
    let trials = trials(&grounds);
    for &(ground, place, script) in &trials {
        let ground = &grounds[ground];
        let place = &ground.places[place];
        let found = play::<ARMS>(ground, place, script, None);
        assert_eq!(
            found, None,
            "without a fault, {}, {script:?} at {:?}",
            ground.name, place.boundary
        );
    }
    let mut kinds: BTreeMap<&str, u32> = BTreeMap::new();
    let (mut explained, mut survivors) = (Vec::new(), Vec::new());
    let mut from = 0;
    for &fault in faults {
        let hit = (0..trials.len()).map(|step| (from + step) % trials.len()).find_map(|index| {
            let (ground, place, script) = trials[index];
            let ground = &grounds[ground];
            let found = play::<ARMS>(ground, &ground.places[place], script, Some(fault))?;
            Some((index, found))
        });
        if let Some((index, found)) = hit {
            from = index;
            let benign = found.contains("benign");
            *kinds.entry(if benign { "restraint" } else { "violation" }).or_default() += 1;
        } else if let Some(reason) = equivalent(fault) {
            explained.push(format!("{fault:?}: {reason}"));
        } else {
            survivors.push(fault);
        }
    }
    println!(
        "{ARMS} arms: {} faults planted in the guard over {} trials, {} found {kinds:?}, {} change nothing {explained:#?}, {} survive {survivors:?}",
        faults.len(),
        trials.len(),
        faults.len() - explained.len() - survivors.len(),
        explained.len(),
        survivors.len(),
    );
    assert!(survivors.is_empty(), "{survivors:#?}");
}

/// Why a fault changes nothing, if it does not.
fn equivalent(fault: PlantedGuardFault) -> Option<&'static str> {
    let _ = fault;
    None
}

/// Whether the fault is about two arms.
fn between_arms(fault: &PlantedGuardFault) -> bool {
    match fault {
        PlantedGuardFault::Dropped(check) | PlantedGuardFault::Negated(check) => {
            matches!(check, Check::Pair(_))
        }
        PlantedGuardFault::NoPadding(padding) | PlantedGuardFault::NegatedPadding(padding) => {
            matches!(padding, Padding::Pair | Padding::PairTravel)
        }
        PlantedGuardFault::EqualTimesOnly | PlantedGuardFault::HeldStopsForgotten => true,
        PlantedGuardFault::GuardSkipped => false,
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "long, so in release only: make test-adversary")]
fn every_fault_in_the_guard_is_found() {
    let mut faults = PlantedGuardFault::all();
    faults.retain(|fault| !between_arms(fault));
    hunt::<1>(&faults);
}

#[test]
#[cfg_attr(debug_assertions, ignore = "long, so in release only: make test-adversary")]
fn every_fault_between_two_arms_is_found() {
    let mut faults = PlantedGuardFault::all();
    faults.retain(between_arms);
    hunt::<2>(&faults);
}
