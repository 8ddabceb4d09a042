//! Which disturbances a demonstration has: drawn once from its seed.

use core::f64::consts::TAU;

use trocar_world::rng::Rng;

use super::{DisturbanceKind, MISS_S_MAX};
use crate::expert::Activity;
use crate::task::TaskConfig;

/// A disturbance that waits for its moment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Planned {
    pub(super) arm: usize,
    /// It begins when the arm has been doing this
    pub(super) activity: Activity,
    /// for so long, s.
    pub(super) delay_s: f64,
    pub(super) duration_s: f64,
    pub(super) what: DisturbanceKind,
}

/// Most offsets of a demonstration; one at least.
const OFFSETS_MAX: usize = 3;

/// Probabilities of a miss, slip or nudge, and of a second one.
const SETBACK: f64 = 0.8;
const SECOND_SETBACK: f64 = 0.25;

/// A kind of setback, after which a grasp is to be tried again or another place to be gone to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Setback {
    Miss,
    Slip,
    Nudge,
}

/// The disturbances of one demonstration of `task`.
pub(super) fn draw(task: &TaskConfig, rng: &mut Rng) -> Vec<Planned> {
    let arms = task.arms.len();
    let mut planned = Vec::new();
    for index in 0..=rng.below(OFFSETS_MAX) {
        // Every arm reaches; not every one carries.
        let activity = if index == 0 {
            Activity::Reach
        } else {
            [Activity::Reach, Activity::Grasp, Activity::Carry][rng.below(3)]
        };
        planned.push(offset(rng.below(arms), activity, rng));
    }
    add_setbacks(task, rng, &mut planned);
    planned
}

/// One setback in some demonstrations, another one in some of those.
fn add_setbacks(task: &TaskConfig, rng: &mut Rng, planned: &mut Vec<Planned>) {
    let arms = task.arms.len();
    let mut setbacks = vec![Setback::Miss, Setback::Slip];
    if task.scene.flap().is_none() {
        setbacks.push(Setback::Nudge);
    }
    for probability in [SETBACK, SECOND_SETBACK] {
        let setback = setbacks.remove(rng.below(setbacks.len()));
        if !rng.chance(probability) {
            break;
        }
        planned.push(match setback {
            Setback::Miss => miss(rng.below(arms), rng),
            Setback::Slip => slip(rng),
            // Before the hand is there, or while the jaw goes around the thing.
            Setback::Nudge => nudge([Activity::Reach, Activity::Grasp][rng.below(2)], rng),
        });
    }
}

/// Around the thing the tip goes back more than sideways, so that it presses on nothing; elsewhere
/// it does not go down.
fn offset(arm: usize, activity: Activity, rng: &mut Rng) -> Planned {
    let mut about = |half: f64| rng.range(-half, half);
    let (in_scene_m, in_tip_m, turn_half_rad) = match activity {
        Activity::Grasp => {
            let beside_m = [about(0.001), about(0.000_5)];
            let back_m = 0.003 + about(0.001);
            ([0.0; 3], [beside_m[0], beside_m[1], -back_m], 0.03)
        }
        Activity::Reach => (
            [about(0.006), about(0.006), 0.002 + about(0.002)],
            [0.0; 3],
            0.10,
        ),
        Activity::Carry | Activity::Lift | Activity::Other => (
            [about(0.004), about(0.004), 0.0015 + about(0.0015)],
            [0.0; 3],
            0.07,
        ),
    };
    let turn_rad = [(); 3].map(|()| about(turn_half_rad));
    Planned {
        arm,
        activity,
        delay_s: rng.range(0.1, 0.8),
        duration_s: rng.range(0.3, 1.0),
        what: DisturbanceKind::Offset {
            in_scene_m,
            in_tip_m,
            turn_rad,
        },
    }
}

fn miss(arm: usize, rng: &mut Rng) -> Planned {
    Planned {
        arm,
        activity: Activity::Grasp,
        delay_s: 0.0,
        duration_s: MISS_S_MAX,
        what: DisturbanceKind::Miss {
            back_m: rng.range(0.005, 0.008),
            beside_m: rng.range(-0.002, 0.002),
        },
    }
}

/// The arm that takes the thing first lets go of it.
fn slip(rng: &mut Rng) -> Planned {
    Planned {
        arm: 0,
        activity: Activity::Lift,
        delay_s: rng.range(0.1, 0.7),
        duration_s: rng.range(0.20, 0.35),
        what: DisturbanceKind::Slip {
            jaw_rad: rng.range(0.25, 0.45),
        },
    }
}

fn nudge(activity: Activity, rng: &mut Rng) -> Planned {
    let (sin, cos) = rng.range(0.0, TAU).sin_cos();
    let speed_m_s = rng.range(0.05, 0.10);
    Planned {
        arm: 0,
        activity,
        delay_s: rng.range(0.1, 0.8),
        duration_s: rng.range(0.04, 0.08),
        what: DisturbanceKind::Nudge {
            velocity_m_s: [speed_m_s * cos, speed_m_s * sin],
            turn_rad_s: rng.range(-2.0, 2.0),
        },
    }
}
