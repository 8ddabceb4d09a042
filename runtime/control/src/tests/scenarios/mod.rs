//! What the chain makes of situations that a user meets: walls, corners, other arms, bad starts,
//! slower limits.

mod minimal;
mod recovery;
mod two_arms;
mod viability;
mod walls;

use hal::{Chunk, JointVector, Pose, TICK_NS, TipTarget};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::adversary::eyes::Boundary;
use super::adversary::rig::{Rig, home};
use crate::TickOutput;
use crate::config::ControlConfig;
use crate::kinematics::forward;
use crate::motion::Axes;

/// A policy step.
const STEP_NS: u64 = 40 * TICK_NS;

/// How often a chunk arrives, ticks.
const CHUNK_EVERY: u64 = 200;

/// Lets every arm follow `path`, a function of the arm and of the time in seconds since now; `each`
/// sees every tick.
fn follow<const ARMS: usize>(
    rig: &mut Rig<ARMS>,
    duration_s: f64,
    path: impl Fn(usize, f64) -> TipTarget,
    mut each: impl FnMut(&Rig<ARMS>, &[TickOutput; ARMS]),
) {
    let start = rig.now();
    let mut elapsed = 0;
    while rig.now().seconds() - start.seconds() < duration_s {
        if elapsed % CHUNK_EVERY == 0 {
            for (arm, slot) in rig.chunks.iter_mut().enumerate() {
                let now = crate::tests::TimeNs::from_tick(rig.tick);
                let mut chunk = Chunk::new(now, rig.tick + 1, STEP_NS, &[path(arm, 0.0); 100]);
                for index in 0..100 {
                    let time_s = chunk.due(index).seconds() - start.seconds();
                    chunk.targets[index] = path(arm, time_s);
                }
                *slot = Some(Box::new(chunk));
            }
        }
        elapsed += 1;
        let outputs = rig.quiet_step();
        each(rig, &outputs);
    }
}

/// A target at a place in the RCM frame with home's orientation, turned.
fn target(place_m: Vector3<f64>, turn: Vector3<f64>) -> TipTarget {
    let rotation = UnitQuaternion::new(turn) * forward(&home().position).rotation;
    TipTarget::new(
        &Pose::from_parts(Translation3::from(place_m), rotation),
        0.2,
    )
}

/// Home's place, m.
fn home_m() -> Vector3<f64> {
    forward(&home().position).translation.vector
}

/// The least clearance of places and other arms, m.
fn least_clearance(config: &ControlConfig, positions: &[Axes]) -> f64 {
    Boundary::all(config)
        .into_iter()
        .filter(|boundary| !matches!(boundary, Boundary::Axis { .. }))
        .map(|boundary| boundary.clearance(config, positions))
        .fold(f64::INFINITY, f64::min)
}

/// Where the control point is, m.
fn tip_m(position: &Axes) -> Vector3<f64> {
    forward(&JointVector::from_fn(|joint, _| position[joint]))
        .translation
        .vector
}
