//! Disturbances of a demonstration, so that it shows how the expert recovers.
//!
//! What is *executed* leaves what the expert intends, and what it intends is what a recording
//! keeps: so a policy learns the corrections in states that it comes to by itself (Laskey et al.,
//! "DART: Noise Injection for Robust Imitation Learning", 2017). Four kinds, all drawn from the
//! episode's seed, at most one at a time on each arm:
//!
//! | kind   | what happens                                                                      | what the expert shows      |
//! |--------|-----------------------------------------------------------------------------------|----------------------------|
//! | offset | the tip is led off its way by a few mm and degrees, for 0.3 s to 1 s              | back to the way            |
//! | miss   | the hand falls short of the thing by 5 mm to 8 mm until the jaw has closed        | open, back, again          |
//! | slip   | the jaw opens for 0.2 s to 0.35 s just after the thing has been lifted            | open, back, fetch it again |
//! | nudge  | the thing slides by up to 8 mm before, or while, the jaw goes around it           | follow it, or again        |

mod plan;
#[cfg(test)]
mod tests;

use hal::{Chunk, Pose, TimeNs, TipTarget};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use serde::Serialize;
use trocar_world::rng::Rng;

use crate::expert::Activity;
use crate::simulation::{Nudge, Simulation};
use crate::task::TaskConfig;
use hal::ARMS_MAX;
use plan::Planned;

/// Time that a disturbance takes to begin or to end where it does not do so by itself, s.
const RAMP_S: f64 = 0.3;

/// The same of a jaw, s.
const JAW_RAMP_S: f64 = 0.08;

/// Longest time that a miss is kept up, s.
const MISS_S_MAX: f64 = 4.0;

/// How far an intention may be from the one foreseen a step before until the expert counts as
/// having thought again, m: then it goes on from where its hand is, and what led the hand there is
/// over.
const REPLANNED_M: f64 = 0.002;

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Disturbance {
    /// The arm that it befell, or that was about to take the thing, counted from 0.
    pub arm: usize,
    /// When it began, s.
    pub from_s: f64,
    /// When it was over, s.
    pub to_s: f64,
    /// What it was.
    #[serde(flatten)]
    pub what: DisturbanceKind,
}

/// Kinds of disturbances, each with its greatest extent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum DisturbanceKind {
    /// The tip is led off its way.
    Offset {
        /// Along the scene's axes, m.
        in_scene_m: [f64; 3],
        /// Along the tip's axes, m.
        in_tip_m: [f64; 3],
        /// About the tip's axes, rad.
        turn_rad: [f64; 3],
    },
    /// The hand falls short of the thing.
    Miss {
        /// Back along the instrument, m.
        back_m: f64,
        /// Along the hinge of the jaw, m.
        beside_m: f64,
    },
    /// The jaw opens.
    Slip {
        /// To this angle, rad.
        jaw_rad: f64,
    },
    /// The thing slides.
    Nudge {
        /// Along the scene's x and y, m/s.
        velocity_m_s: [f64; 2],
        /// About the scene's z, rad/s.
        turn_rad_s: f64,
    },
}

/// Disturbs one demonstration.
#[derive(Clone, Debug)]
pub struct Disturber {
    bases: Vec<Pose>,
    planned: Vec<Planned>,
    active: [Option<Active>; ARMS_MAX],
    watched: [Watched; ARMS_MAX],
    happened: Vec<Disturbance>,
}

/// A disturbance under way.
#[derive(Clone, Copy, Debug)]
struct Active {
    what: DisturbanceKind,
    from_s: f64,
    to_s: f64,
}

/// What is known of an arm.
#[derive(Clone, Copy, Debug, Default)]
struct Watched {
    activity: Activity,
    since_s: f64,
    /// Where it will want to be a step later.
    foreseen: Option<Pose>,
}

impl Watched {
    /// Notes what the arm does at `now_s`; whether it did something else before.
    fn is_now(&mut self, activity: Activity, now_s: f64) -> bool {
        let changed = self.activity != activity;
        if changed {
            self.activity = activity;
            self.since_s = now_s;
        }
        changed
    }
}

/// Whether a target is elsewhere than the chunk before foresaw it.
fn is_replanned(foreseen: &Pose, wanted: &Pose) -> bool {
    let gap = foreseen.translation.vector - wanted.translation.vector;
    gap.norm() > REPLANNED_M
}

impl Disturber {
    /// A disturber of the demonstration `seed` of `task`; none in `1 - share` of them.
    #[must_use]
    pub fn draw(task: &TaskConfig, seed: u64, share: f64) -> Option<Self> {
        let mut rng = Rng::stream(seed, "disturb");
        rng.chance(share).then(|| Self {
            planned: plan::draw(task, &mut rng),
            bases: task.arms.iter().map(|arm| arm.scene_from_rcm).collect(),
            active: [None; ARMS_MAX],
            watched: [Watched::default(); ARMS_MAX],
            happened: Vec::new(),
        })
    }

    /// What happened so far.
    #[must_use]
    pub fn happened(&self) -> &[Disturbance] {
        &self.happened
    }

    /// What is to be executed in place of what the expert wants at this step: `intended`, a chunk
    /// for each arm. Also nudges the thing, if that is due.
    pub fn step(
        &mut self,
        now: TimeNs,
        activities: [Activity; ARMS_MAX],
        intended: &[Chunk],
        simulation: &mut Simulation,
    ) -> Vec<Chunk> {
        let now_s = now.seconds();
        for (arm, chunk) in intended.iter().enumerate() {
            self.watch(arm, now_s, activities[arm], chunk);
        }
        self.begin_what_is_due(now_s, simulation);
        let executed = |(arm, chunk): (usize, &Chunk)| self.executed(arm, chunk);
        let chunks = intended.iter().enumerate().map(executed).collect();
        for active in &mut self.active {
            if active.is_some_and(|active| active.to_s <= now_s) {
                *active = None;
            }
        }
        chunks
    }

    /// Notes what an arm does, and ends what this puts an end to.
    fn watch(&mut self, arm: usize, now_s: f64, activity: Activity, chunk: &Chunk) {
        let mut targets = chunk.valid_targets().iter().map(TipTarget::tip_in_rcm);
        let (wanted, next) = (targets.next(), targets.next());
        let watched = &mut self.watched[arm];
        let replanned = watched
            .foreseen
            .zip(wanted)
            .is_some_and(|(foreseen, wanted)| is_replanned(&foreseen, &wanted));
        watched.foreseen = next;
        let changed = watched.is_now(activity, now_s);
        let Some(active) = &mut self.active[arm] else {
            return;
        };
        let is_miss = matches!(active.what, DisturbanceKind::Miss { .. });
        let is_slip = matches!(active.what, DisturbanceKind::Slip { .. });
        if replanned && !is_slip {
            active.to_s = now_s;
        } else if is_miss && changed {
            active.to_s = active.to_s.min(now_s + RAMP_S);
        }
        let to_s = active.to_s;
        if let Some(last) = self.happened.iter_mut().rfind(|last| last.arm == arm) {
            last.to_s = to_s;
        }
    }

    fn begin_what_is_due(&mut self, now_s: f64, simulation: &mut Simulation) {
        let planned = core::mem::take(&mut self.planned);
        for plan in planned {
            let watched = &self.watched[plan.arm];
            let is_due =
                watched.activity == plan.activity && now_s - watched.since_s >= plan.delay_s;
            if !is_due || self.active[plan.arm].is_some() {
                self.planned.push(plan);
                continue;
            }
            let Some(duration_s) = plan.begin(simulation) else {
                continue;
            };
            let (from_s, to_s) = (now_s, now_s + duration_s);
            let (arm, what) = (plan.arm, plan.what);
            self.active[arm] = Some(Active { what, from_s, to_s });
            self.happened.push(Disturbance {
                arm,
                from_s,
                to_s,
                what,
            });
        }
    }

    /// `intended` with what befalls the arm at the time of each target.
    fn executed(&self, arm: usize, intended: &Chunk) -> Chunk {
        let Some(active) = self.active[arm] else {
            return *intended;
        };
        let base = &self.bases[arm];
        let mut due = intended.observed_at;
        let mut targets = Vec::with_capacity(intended.valid_targets().len());
        for target in intended.valid_targets() {
            targets.push(active.applied(base, due.seconds(), target));
            due = due.plus_ns(intended.step_ns);
        }
        Chunk::new(
            intended.observed_at,
            intended.sequence,
            intended.step_ns,
            &targets,
        )
    }
}

impl Active {
    /// `target`, which is for the time `at_s`, disturbed.
    fn applied(&self, base: &Pose, at_s: f64, target: &TipTarget) -> TipTarget {
        let tip = target.tip_in_rcm();
        match self.what {
            DisturbanceKind::Offset {
                in_scene_m,
                in_tip_m,
                turn_rad,
            } => {
                let share = self.swell(at_s);
                let in_rcm = base.rotation.inverse() * (Vector3::from(in_scene_m) * share);
                let turn = UnitQuaternion::new(Vector3::from(turn_rad) * share);
                let in_tip = Translation3::from(Vector3::from(in_tip_m) * share);
                let led = Translation3::from(in_rcm) * tip * in_tip * turn;
                TipTarget::new(&led, target.jaw)
            }
            DisturbanceKind::Miss { back_m, beside_m } => {
                let off = Vector3::new(beside_m, 0.0, -back_m) * self.plateau(at_s, RAMP_S);
                TipTarget::new(&(tip * Translation3::from(off)), target.jaw)
            }
            DisturbanceKind::Slip { jaw_rad } => {
                let share = self.plateau(at_s, JAW_RAMP_S);
                let jaw = target.jaw + (jaw_rad - target.jaw).max(0.0) * share;
                TipTarget::new(&tip, jaw)
            }
            DisturbanceKind::Nudge { .. } => *target,
        }
    }

    /// From 0 at the beginning to 1 in the middle and back, without a jump in velocity.
    fn swell(&self, at_s: f64) -> f64 {
        let share = (at_s - self.from_s) / (self.to_s - self.from_s).max(1e-9);
        (core::f64::consts::PI * share.clamp(0.0, 1.0))
            .sin()
            .powi(2)
    }

    /// From 0 to 1 within `ramp_s`, and back at the end.
    fn plateau(&self, at_s: f64, ramp_s: f64) -> f64 {
        let nearest_end_s = (at_s - self.from_s).min(self.to_s - at_s);
        let share = (nearest_end_s / ramp_s).clamp(0.0, 1.0);
        share * share * (3.0 - 2.0 * share)
    }
}

impl Planned {
    /// Begins it; gives how long it will last, s, or none if it can't be.
    fn begin(&self, simulation: &mut Simulation) -> Option<f64> {
        let DisturbanceKind::Nudge {
            velocity_m_s,
            turn_rad_s,
        } = self.what
        else {
            return Some(self.duration_s);
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a nudge lasts a tenth of a second at most"
        )]
        let steps = (self.duration_s * 1e3) as u32;
        let nudge = Nudge::new(velocity_m_s, turn_rad_s, steps);
        simulation.nudge(nudge).then_some(self.duration_s)
    }
}
