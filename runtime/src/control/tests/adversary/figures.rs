//! What an attack came to, in numbers.

use core::fmt;

use hal::{ArmCommand, JOINT_COUNT, JointVector, Pose};

use super::eyes::Boundary;
use super::rig::Scene;
use crate::control::motion::{AXES, Axes, JAW};
use crate::control::{QpOutcome, TickOutput};
use crate::verify::tip_in_rcm;

/// How often the clearances are looked at for the figures, in ticks; the verdict is not taken from here.
const LOOK_EVERY: u64 = 5;

/// Figures of all arms together. Shares are of the limits.
#[derive(Clone, Debug, Default)]
pub(super) struct Figures {
    pub(super) ticks: u64,
    /// Arm-ticks in which the arm followed.
    pub(super) enabled: u64,
    /// Of these, those in which it stood still.
    pub(super) stopped: u64,
    /// Arm-ticks in which the guard played its stop.
    pub(super) interventions: u64,
    /// Arm-ticks in which the filter had to solve.
    pub(super) solved: u64,
    /// Arm-ticks in which the filter had no answer.
    pub(super) failed: u64,
    /// Arm-ticks that began with a new fault.
    pub(super) faults: u64,
    pub(super) chunks_accepted: u64,
    pub(super) chunks_refused: u64,
    /// Answers of the filter that were replaced.
    pub(super) garbage: u64,
    pub(super) tails: u64,
    /// Worst share of velocity, acceleration and jerk.
    pub(super) worst: [f64; 3],
    pub(super) tip_speed: f64,
    pub(super) tip_turn: f64,
    /// Least clearance to a place, mm, and between arms.
    pub(super) place_mm: f64,
    pub(super) between_mm: f64,
    /// Least distance of an axis to an end of its range, rad (m).
    pub(super) range: f64,
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [velocity, acceleration, jerk] = self.worst;
        write!(
            f,
            "{} ticks, enabled {}, still {}, solved {}, no answer {}, guard {}, garbage {}, faults {}, chunks {} + {} refused, \
             tails {} | v {velocity:.6} a {acceleration:.6} j {jerk:.6} tip {:.4} turn {:.4} range {:.1e} places {:.3} mm",
            self.ticks,
            self.enabled,
            self.stopped,
            self.solved,
            self.failed,
            self.interventions,
            self.garbage,
            self.faults,
            self.chunks_accepted,
            self.chunks_refused,
            self.tails,
            self.tip_speed,
            self.tip_turn,
            self.range,
            self.place_mm,
        )?;
        if self.between_mm.is_finite() {
            write!(f, " arms {:.3} mm", self.between_mm)?;
        }
        Ok(())
    }
}

/// Takes in every tick.
pub(super) struct Tally<'a> {
    scene: &'a Scene,
    boundaries: Vec<Boundary>,
    before: Vec<Option<ArmCommand>>,
    faulted: Vec<bool>,
    pub(super) figures: Figures,
}

impl<'a> Tally<'a> {
    pub(super) fn new(scene: &'a Scene) -> Self {
        let arms = scene.config.arms.len();
        Self {
            scene,
            boundaries: Boundary::all(&scene.config),
            before: vec![None; arms],
            faulted: vec![false; arms],
            figures: Figures {
                place_mm: f64::INFINITY,
                between_mm: f64::INFINITY,
                range: f64::INFINITY,
                ..Figures::default()
            },
        }
    }

    pub(super) fn look(&mut self, outputs: &[TickOutput]) {
        self.figures.ticks += 1;
        for (arm, output) in outputs.iter().enumerate() {
            self.count(arm, output);
            self.differentiate(arm, &output.command);
        }
        if self.figures.ticks.is_multiple_of(LOOK_EVERY) {
            self.look_around(outputs);
        }
    }

    fn count(&mut self, arm: usize, output: &TickOutput) {
        let report = &output.report;
        let figures = &mut self.figures;
        if report.mode.state == crate::control::OperatingState::Enabled {
            figures.enabled += 1;
            figures.stopped += u64::from(!report.mode.busy);
        }
        figures.interventions += u64::from(report.guard_intervened);
        match report.qp {
            QpOutcome::NotNeeded => {}
            QpOutcome::Solved { .. } => figures.solved += 1,
            QpOutcome::Failed => figures.failed += 1,
        }
        let faulted = report.fault.is_some();
        figures.faults += u64::from(faulted && !self.faulted[arm]);
        self.faulted[arm] = faulted;
    }

    fn differentiate(&mut self, arm: usize, command: &ArmCommand) {
        let before = self.before[arm].replace(*command);
        let Some(before) = before.filter(|before| before.enabled && command.enabled) else {
            return;
        };
        let tick_s = 1e-3;
        let config = &self.scene.config;
        let [velocity, acceleration, jerk] = &mut self.figures.worst;
        for axis in 0..AXES {
            let limits = &config.axes[axis];
            let ((p, v), (p0, v0)) = (motion(command, axis), motion(&before, axis));
            *velocity = velocity.max(((p - p0) / tick_s).abs() / limits.velocity);
            *acceleration = acceleration.max(((v - v0) / tick_s).abs() / limits.acceleration);
            if axis != JAW {
                let change = command.acceleration[axis] - before.acceleration[axis];
                *jerk = jerk.max((change / tick_s).abs() / limits.jerk);
            }
        }
        let (from, to): (Pose, Pose) = (tip_in_rcm(&before.position), tip_in_rcm(&command.position));
        let way_m = (to.translation.vector - from.translation.vector).norm();
        let turn_rad = from.rotation.angle_to(&to.rotation);
        let figures = &mut self.figures;
        figures.tip_speed = figures.tip_speed.max(way_m / tick_s / config.tip_speed_m_s);
        let turn = turn_rad / tick_s / config.tip_angular_speed_rad_s;
        figures.tip_turn = figures.tip_turn.max(turn);
    }

    fn look_around(&mut self, outputs: &[TickOutput]) {
        let positions: Vec<Axes> = outputs
            .iter()
            .map(|output| core::array::from_fn(|axis| motion(&output.command, axis).0))
            .collect();
        for boundary in &self.boundaries {
            let h = boundary.clearance(&self.scene.config, &positions);
            let figures = &mut self.figures;
            match boundary {
                Boundary::Axis { .. } => figures.range = figures.range.min(h),
                Boundary::Workspace { .. } | Boundary::Region { .. } | Boundary::End { .. } => {
                    figures.place_mm = figures.place_mm.min(1e3 * h);
                }
                Boundary::Shafts | Boundary::ToShaft { .. } => {
                    figures.between_mm = figures.between_mm.min(1e3 * h);
                }
            }
        }
    }
}

fn motion(command: &ArmCommand, axis: usize) -> (f64, f64) {
    let joints: (&JointVector, &JointVector) = (&command.position, &command.velocity);
    if axis < JOINT_COUNT {
        (joints.0[axis], joints.1[axis])
    } else {
        (command.jaw_position, command.jaw_velocity)
    }
}
