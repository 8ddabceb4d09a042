//! Slowly into corners, beyond them, and out again.

use hal::chunk::CHUNK_STEPS_MAX;
use hal::{Chunk, Pose, TICK_NS, TipTarget};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::{Adversary, View, chunk, ticks};
use crate::kinematics::forward;
use hal::random::SplitMix64;

/// A straight line at 2 to 40 mm/s from where the arm is through a corner of the workspace, with a
/// slow turn into the wrist's corner.
#[derive(Default)]
pub(super) struct Drift {
    patience: u32,
}

impl Adversary for Drift {
    fn next(&mut self, random: &mut SplitMix64, view: &View<'_>) -> Option<Chunk> {
        if self.patience > 0 {
            self.patience -= 1;
            return None;
        }
        self.patience = ticks(random, 400, 4000);
        let block = &view.config.arms[view.arm].workspace;
        let mut side = || if random.happens(0.5) { 1.3 } else { -1.3 };
        let corner_m = Vector3::new(side(), side(), side()).component_mul(&block.half_m);
        let goal_m = block.center_m + block.axes * corner_m;
        let start = forward(&view.arms[view.arm].position);
        let way_m = goal_m - start.translation.vector;
        let speed_m_s = random.between(0.002, 0.04);
        let mut unit = || random.between(-1.0, 1.0);
        let axis = Vector3::new(unit(), unit(), unit()).normalize();
        let turn_rad_s = random.between(0.0, 0.6);
        let step_ns = 40 * TICK_NS;
        let mut targets = [TipTarget::new(&start, 0.3); CHUNK_STEPS_MAX];
        for (index, target) in targets.iter_mut().enumerate() {
            let time_s = 0.04 * index as f64;
            let part = (speed_m_s * time_s / way_m.norm().max(1e-6)).min(1.0);
            let pose = Pose::from_parts(
                Translation3::from(start.translation.vector + way_m * part),
                UnitQuaternion::new(axis * (turn_rad_s * time_s)) * start.rotation,
            );
            *target = TipTarget::new(&pose, 0.3 - 0.4 * time_s);
        }
        Some(chunk(view.now, step_ns, &targets))
    }
}
