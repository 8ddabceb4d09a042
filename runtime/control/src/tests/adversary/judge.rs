//! The judge: `verify`, which reads the limits from the texts and the motion from the commands, and
//! shares nothing with the controller.

use hal::{ArmError, ArmState, SafeTail};

use super::rig::Scene;
use crate::TickOutput;
use trocar_verify::Stream;

/// The test oracle: checks every command, and some tails.
pub(in crate::tests) struct Oracle {
    stream: Stream,
    tick: u64,
    /// Ticks whose tails were followed to rest.
    pub(in crate::tests) tails: u64,
}

/// How near the commands came to the limits.
#[derive(Clone, Copy, Debug)]
pub(in crate::tests) struct Nearest {
    /// Worst share of velocity, acceleration and jerk of any axis.
    pub(in crate::tests) derivatives: [f64; 3],
    /// Worst shares of the tip's speed and angular speed.
    pub(in crate::tests) tip: [f64; 2],
    /// Least distance of an axis to the end of its range, rad (m).
    pub(in crate::tests) range: f64,
    /// Least clearance of workspace and regions, mm.
    pub(in crate::tests) place_mm: f64,
    /// Least gap between the arms beyond the one that they keep, mm.
    pub(in crate::tests) between_mm: f64,
}

impl Oracle {
    pub(in crate::tests) fn new(scene: &Scene) -> Self {
        let stream = Stream::new(scene.control.text(), scene.safety.text()).unwrap();
        Self {
            stream,
            tick: 0,
            tails: 0,
        }
    }

    /// Takes in one tick of all arms.
    pub(in crate::tests) fn look(
        &mut self,
        measured: &[Result<ArmState, ArmError>],
        outputs: &[TickOutput],
    ) {
        let arms: Vec<_> = outputs
            .iter()
            .map(|output| &output.command)
            .zip(measured)
            .collect();
        self.stream.tick(self.tick, &arms);
        self.tick += 1;
    }

    /// Follows the tails of the newest tick to rest.
    pub(in crate::tests) fn follow_tails(&mut self, outputs: &[TickOutput]) {
        let tails: Vec<&SafeTail> = outputs.iter().map(|output| &output.tail).collect();
        self.stream.tails(&tails);
        self.tails += 1;
    }

    /// What was broken, the first hundred thousand times. Measurements that are made up say nothing
    /// of where an arm is.
    pub(in crate::tests) fn violations(&self, made_up: bool) -> Vec<String> {
        let violations = self.stream.violations().iter();
        violations
            .filter(|found| !made_up || !found.limit.starts_with("measured."))
            .map(ToString::to_string)
            .collect()
    }

    /// The smallest clearance of any measured arm, m.
    pub(in crate::tests) fn measured_m(&self) -> f64 {
        let all = self.stream.measured().into_iter();
        all.fold(f64::INFINITY, |least, found| least.min(found.clearance_m))
    }

    /// How near the commands, their tails apart, came to every limit.
    pub(in crate::tests) fn nearest(&self) -> Nearest {
        let mut nearest = Nearest {
            derivatives: [0.0; 3],
            tip: [0.0; 2],
            range: f64::INFINITY,
            place_mm: f64::INFINITY,
            between_mm: f64::INFINITY,
        };
        for worst in self.stream.worst() {
            let name = worst.limit.as_str();
            let share = worst.value.abs() / worst.bound.abs();
            let most = |kept: &mut f64| *kept = kept.max(share);
            let least = |kept: &mut f64, value: f64| *kept = kept.min(value);
            if name.starts_with("tail.") {
                continue;
            } else if name.starts_with("workspace.") || name.starts_with("forbidden.") {
                least(&mut nearest.place_mm, 1e3 * worst.margin);
            } else if name.starts_with("between_arms.") {
                least(&mut nearest.between_mm, 1e3 * worst.margin);
            } else if name.ends_with(".low") || name.ends_with(".high") {
                least(&mut nearest.range, worst.margin);
            } else if name == "tip_speed" {
                most(&mut nearest.tip[0]);
            } else if name == "tip_angular_speed" {
                most(&mut nearest.tip[1]);
            } else if let Some(order) = ["velocity", "acceleration", "jerk"]
                .iter()
                .position(|kind| name.ends_with(&format!(".{kind}")))
            {
                most(&mut nearest.derivatives[order]);
            }
        }
        nearest
    }
}
