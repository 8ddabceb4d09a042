//! Looks at the arm and goes where a boundary or the other arm comes nearer fastest.

use hal::{Chunk, JOINT_COUNT, JointVector, TipTarget};

use super::super::eyes::Boundary;
use super::super::rig::axes_of;
use super::{Adversary, View, below, hold, ticks};
use crate::kinematics::forward;
use crate::motion::{Axes, JAW};
use hal::random::SplitMix64;

/// Climbs towards one boundary for a while, then towards another, most often the nearest.
#[derive(Default)]
pub(super) struct Climber {
    goal: Option<Boundary>,
    patience: u32,
    pause: u32,
}

impl Adversary for Climber {
    fn next(&mut self, random: &mut SplitMix64, view: &View<'_>) -> Option<Chunk> {
        if self.pause > 0 {
            self.pause -= 1;
            self.patience = self.patience.saturating_sub(self.pause.min(1));
            return None;
        }
        let positions: Vec<Axes> = view.arms.iter().map(axes_of).collect();
        if self.patience == 0 || self.goal.is_none() {
            self.patience = ticks(random, 100, 1500);
            self.goal = choose(random, view, &positions);
        }
        self.pause = ticks(random, 5, 40);
        let goal = self.goal?;
        let speeds = steepest(view, goal, &positions);
        let reach_s = random.between(0.1, 0.6);
        let here = &positions[view.arm];
        let joints = JointVector::from_fn(|joint, _| {
            let step = reach_s * speeds[joint] + random.between(-0.02, 0.02) * reach_s;
            here[joint] + step
        });
        let mut target = TipTarget::new(&forward(&joints), here[JAW] + reach_s * speeds[JAW]);
        if random.happens(0.1) {
            // A kick along the boundary.
            target.position_m[below(random, 3)] += random.between(-0.05, 0.05);
        }
        Some(hold(view.now, target))
    }
}

/// The nearest boundary that this arm can do something about, or any.
fn choose(random: &mut SplitMix64, view: &View<'_>, positions: &[Axes]) -> Option<Boundary> {
    let own: Vec<Boundary> = Boundary::all(view.config)
        .into_iter()
        .filter(|boundary| match *boundary {
            Boundary::Axis { arm, .. }
            | Boundary::Workspace { arm, .. }
            | Boundary::Region { arm, .. }
            | Boundary::End { arm, .. } => arm == view.arm,
            Boundary::Shafts | Boundary::ToShaft { .. } => true,
        })
        .collect();
    let away = |boundary: &Boundary| {
        let h = boundary.clearance(view.config, positions);
        // A radian of a joint is about as far as its speed is high: compare in seconds.
        if let Boundary::Axis { axis, .. } = *boundary {
            h / view.config.axes[axis].velocity
        } else {
            h / view.config.tip_speed_m_s
        }
    };
    match below(random, 5) {
        0 => own.get(below(random, own.len())).copied(),
        1 => own
            .into_iter()
            .filter(|boundary| matches!(boundary, Boundary::Shafts | Boundary::ToShaft { .. }))
            .min_by(|a, b| away(a).total_cmp(&away(b))),
        2 => own
            .into_iter()
            .filter(|boundary| !matches!(boundary, Boundary::Axis { .. }))
            .min_by(|a, b| away(a).total_cmp(&away(b))),
        _ => own.into_iter().min_by(|a, b| away(a).total_cmp(&away(b))),
    }
}

/// The axes' highest speeds, each towards the boundary.
fn steepest(view: &View<'_>, goal: Boundary, positions: &[Axes]) -> Axes {
    let mut moved = positions.to_vec();
    let h = goal.clearance(view.config, positions);
    core::array::from_fn(|axis| {
        moved[view.arm][axis] += 1e-5;
        let slope = (goal.clearance(view.config, &moved) - h) / 1e-5;
        moved[view.arm][axis] = positions[view.arm][axis];
        let share = if axis < JOINT_COUNT { 1.0 } else { 0.5 };
        if slope.abs() < 1e-6 {
            0.0
        } else {
            -slope.signum() * share * view.config.axes[axis].velocity
        }
    })
}
