//! The drives in time: joint controllers on encoder counts, limits, friction, and motion.

use core::f64::consts::TAU;

use hal::psm::{ACTUATORS, EFFORT_MAX, STOP_MAX, STOP_MIN};
use hal::{ArmCommand, ArmState, JOINT_COUNT, JointVector, TICK_S, TimeNs};

use super::config::PlantConfig;
use super::coupling::{
    AXIS_COUNT, AxisVector, actuator_efforts, actuator_positions, joint_efforts, joint_positions,
};

/// Stiffness of the mechanical stops ([`STOP_MIN`], [`STOP_MAX`]) in joint space, N m/rad (N/m).
const STOP_STIFFNESS: AxisVector = [2000.0, 2000.0, 2e4, 20.0, 20.0, 20.0, 20.0];
/// Their damping while they are pressed, N m s/rad (N s/m).
const STOP_DAMPING: AxisVector = [20.0, 20.0, 200.0, 0.05, 0.05, 0.05, 0.05];

/// What the world puts on the arm for one millisecond.
#[derive(Clone, Copy, Debug, Default)]
pub struct Load {
    /// Joint efforts, jaw last, N m (N).
    pub efforts: AxisVector,
    /// Damping of what the fingers squeeze, N m s/rad: takes from a positive jaw effort, never
    /// pulls.
    pub squeeze_damping: f64,
}

/// Set-points of seven drives that are commanded one by one, as drives on a bus are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveSetpoint {
    /// Whether an axis is an actuator; otherwise it is a joint, jaw last, and its drive works
    /// through the coupling.
    pub actuators: bool,
    /// Where each axis should be, rad (m).
    pub position: AxisVector,
    /// How fast it should go there, rad/s (m/s).
    pub velocity: AxisVector,
    /// Share of the effort limit that each drive may use; 0 for one without torque.
    pub torque: AxisVector,
}

/// Shares of the effort limits, of drives that are commanded one by one.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shares {
    joint: AxisVector,
    actuator: AxisVector,
}

/// The drives in a sub-step, without dry friction and contacts; actuators in order.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FreeDrives {
    /// Velocity at the end, rad/s (m/s).
    pub(crate) velocity: AxisVector,
    /// Inertia with viscous friction over the sub-step, kg m² (kg).
    pub(crate) inertia: AxisVector,
    /// Velocity that dry friction takes at most, rad/s (m/s).
    pub(crate) stuck: AxisVector,
}

/// The arm's drives, each a motor with gear, encoder and controller.
///
/// Before the first command it holds the position it was made with.
#[derive(Clone, Debug)]
pub struct Plant {
    config: PlantConfig,
    effort_max: AxisVector,
    position: AxisVector,
    velocity: AxisVector,
    effort: AxisVector,
    target_position: AxisVector,
    target_velocity: AxisVector,
    enabled: bool,
    /// None while one command is for all of them.
    shares: Option<Shares>,
}

impl Plant {
    /// Drives at rest at `joints` (rad, insertion m) with the jaw at `jaw` (rad).
    #[must_use]
    pub fn new(config: &PlantConfig, joints: &JointVector, jaw: f64) -> Self {
        let position = actuator_positions(&with_jaw(joints, jaw));
        let mut effort_max = EFFORT_MAX;
        effort_max[JOINT_COUNT] = effort_max[JOINT_COUNT].min(config.jaw_effort_max_n_m);
        Self {
            config: *config,
            effort_max,
            position,
            velocity: [0.0; AXIS_COUNT],
            effort: [0.0; AXIS_COUNT],
            target_position: position,
            target_velocity: [0.0; AXIS_COUNT],
            enabled: true,
            shares: None,
        }
    }

    /// Takes a setpoint, which holds until the next one.
    pub fn command(&mut self, command: &ArmCommand) {
        self.target_position =
            actuator_positions(&with_jaw(&command.position, command.jaw_position));
        self.target_velocity =
            actuator_positions(&with_jaw(&command.velocity, command.jaw_velocity));
        self.enabled = command.enabled;
        self.shares = None;
    }

    /// Takes set-points of drives that are commanded one by one, which hold until the next ones.
    pub fn lead(&mut self, setpoint: &DriveSetpoint) {
        let shares = setpoint.torque.map(|share| share.clamp(0.0, 1.0));
        let all = [1.0; AXIS_COUNT];
        if setpoint.actuators {
            self.target_position = setpoint.position;
            self.target_velocity = setpoint.velocity;
        } else {
            self.target_position = actuator_positions(&setpoint.position);
            self.target_velocity = actuator_positions(&setpoint.velocity);
        }
        self.enabled = shares.iter().any(|share| *share > 0.0);
        self.shares = Some(if setpoint.actuators {
            Shares {
                joint: all,
                actuator: shares,
            }
        } else {
            Shares {
                joint: shares,
                actuator: all,
            }
        });
    }

    /// Advances one millisecond under `load`.
    pub fn step(&mut self, load: &Load) {
        let step_s = TICK_S / f64::from(self.config.substeps);
        for _ in 0..self.config.substeps {
            self.substep(load, step_s);
        }
    }

    /// True joint positions, jaw last, rad (insertion m).
    #[must_use]
    pub fn joints(&self) -> AxisVector {
        joint_positions(&self.position)
    }

    /// True joint velocities, jaw last, rad/s (insertion m/s).
    #[must_use]
    pub fn joint_velocities(&self) -> AxisVector {
        joint_positions(&self.velocity)
    }

    /// What the encoders and current sensors say: positions in whole counts, velocities as the
    /// drive firmware estimates them, efforts of the motors in joint space.
    #[must_use]
    pub fn measured(&self, stamp: TimeNs) -> ArmState {
        let position = joint_positions(&counted(&self.position));
        let velocity = self.joint_velocities();
        let effort = joint_efforts(&self.effort);
        ArmState {
            stamp,
            position: JointVector::from_column_slice(&position[..JOINT_COUNT]),
            velocity: JointVector::from_column_slice(&velocity[..JOINT_COUNT]),
            effort: JointVector::from_column_slice(&effort[..JOINT_COUNT]),
            jaw_position: position[JOINT_COUNT],
            jaw_velocity: velocity[JOINT_COUNT],
            jaw_effort: effort[JOINT_COUNT],
        }
    }

    /// Effort of the motors on the jaw, N m: negative while they close it. The cables' friction
    /// takes its part of it.
    #[must_use]
    pub fn jaw_effort(&self) -> f64 {
        joint_efforts(&self.effort)[JOINT_COUNT]
    }

    /// Every number that decides the future, for hashing.
    pub(crate) fn state(&self) -> impl Iterator<Item = f64> + '_ {
        let parts = [
            &self.position,
            &self.velocity,
            &self.effort,
            &self.target_position,
            &self.target_velocity,
        ];
        parts
            .into_iter()
            .flatten()
            .copied()
            .chain([if self.enabled { 1.0 } else { 0.0 }])
            .chain(
                self.shares
                    .iter()
                    .flat_map(|shares| shares.joint.into_iter().chain(shares.actuator)),
            )
    }

    /// Position and velocity setpoints in joint space, jaw last, and whether the drives are
    /// enabled.
    #[must_use]
    pub fn setpoint(&self) -> (AxisVector, AxisVector, bool) {
        (
            joint_positions(&self.target_position),
            joint_positions(&self.target_velocity),
            self.enabled,
        )
    }

    fn substep(&mut self, load: &Load, step_s: f64) {
        let free = self.begin(load, step_s);
        let velocity = core::array::from_fn(|axis| {
            let dragged = free.velocity[axis];
            (dragged.abs() - free.stuck[axis])
                .max(0.0)
                .copysign(dragged)
        });
        self.finish(&velocity, step_s);
    }

    /// How many sub-steps a millisecond has.
    pub(crate) const fn substeps(&self) -> u32 {
        self.config.substeps
    }

    /// Actuator velocities now, rad/s (m/s).
    pub(crate) const fn actuator_velocities(&self) -> &AxisVector {
        &self.velocity
    }

    /// Efforts on the joints from outside: of their stops and of `load`, N m (N).
    fn outside_efforts(&self, load: &Load) -> AxisVector {
        let rate = self.joint_velocities();
        let mut outside = stop_efforts(&self.joints(), &rate);
        for (sum, effort) in outside.iter_mut().zip(&load.efforts) {
            *sum += effort;
        }
        let squeezed = load.efforts[JOINT_COUNT].max(0.0);
        outside[JOINT_COUNT] -=
            (load.squeeze_damping * rate[JOINT_COUNT]).clamp(-squeezed, squeezed);
        outside
    }

    /// Begins a sub-step of `step_s`: lets the joint controllers work, and says where that leads
    /// but for dry friction and contacts.
    pub(crate) fn begin(&mut self, load: &Load, step_s: f64) -> FreeDrives {
        self.effort = if self.enabled {
            self.controller()
        } else {
            [0.0; AXIS_COUNT]
        };
        let outside = actuator_efforts(&self.outside_efforts(load));
        let mut free = FreeDrives::default();
        for (axis, outside) in outside.iter().enumerate() {
            let per_inertia = step_s / self.config.inertia[axis];
            let pushed = self.velocity[axis] + per_inertia * (self.effort[axis] + outside);
            // Both frictions implicitly: they stop the axis, never reverse it.
            let drag = 1.0 + per_inertia * self.config.viscous[axis];
            free.velocity[axis] = pushed / drag;
            free.inertia[axis] = self.config.inertia[axis] * drag;
            free.stuck[axis] = per_inertia * self.config.coulomb[axis];
        }
        free
    }

    /// Ends a sub-step of `step_s` with the actuators at `velocity`.
    pub(crate) fn finish(&mut self, velocity: &AxisVector, step_s: f64) {
        self.velocity = *velocity;
        for (position, velocity) in self.position.iter_mut().zip(velocity) {
            *position += step_s * velocity;
        }
    }

    /// Actuator efforts of the shipped PD law, first within the joints' limits, then within the
    /// motors' currents.
    fn controller(&self) -> AxisVector {
        let measured = counted(&self.position);
        let wanted: AxisVector = core::array::from_fn(|axis| {
            let position_error = self.target_position[axis] - measured[axis];
            let velocity_error = self.target_velocity[axis] - self.velocity[axis];
            ACTUATORS[axis].p * position_error + ACTUATORS[axis].d * velocity_error
        });
        let all = [1.0; AXIS_COUNT];
        let shares = self.shares.unwrap_or(Shares {
            joint: all,
            actuator: all,
        });
        let joint = joint_efforts(&wanted);
        let joint = core::array::from_fn(|axis| {
            let limit = self.effort_max[axis] * shares.joint[axis];
            joint[axis].clamp(-limit, limit)
        });
        let actuator = actuator_efforts(&joint);
        core::array::from_fn(|axis| {
            let drive = &ACTUATORS[axis];
            let limit = drive.current_max_a * drive.torque_constant_n_m_a * drive.gear_ratio;
            let limit = limit * shares.actuator[axis];
            actuator[axis].clamp(-limit, limit)
        })
    }
}

fn with_jaw(joints: &JointVector, jaw: f64) -> AxisVector {
    [
        joints[0], joints[1], joints[2], joints[3], joints[4], joints[5], jaw,
    ]
}

/// Actuator positions as whole encoder counts.
fn counted(actuator: &AxisVector) -> AxisVector {
    core::array::from_fn(|axis| {
        let drive = &ACTUATORS[axis];
        let quantum = TAU / drive.encoder_counts_per_turn / drive.gear_ratio;
        (actuator[axis] / quantum).round() * quantum
    })
}

fn stop_efforts(joint: &AxisVector, rate: &AxisVector) -> AxisVector {
    core::array::from_fn(|axis| {
        let excess = joint[axis] - joint[axis].clamp(STOP_MIN[axis], STOP_MAX[axis]);
        if excess.abs() > 0.0 {
            -STOP_STIFFNESS[axis] * excess - STOP_DAMPING[axis] * rate[axis]
        } else {
            0.0
        }
    })
}
