//! Seven drives on a bus that turn one simulated arm.
//!
//! A drive counts, in the space of the plan; the plant knows joints, or actuators behind the cable
//! coupling. Each drive has torque of its own: an axis without it is limp, as the plant has it,
//! whatever the others do.

use hal::tail::TAIL_AXES;
use hal::{ArmState, JOINT_COUNT, JointVector};
use trocar_canopen::master::{ArmPlan, Space};
use trocar_drives::node::{Demand, Feedback};
use trocar_drives::{Network, Terminal};
use trocar_world::plant::{AxisVector, DriveSetpoint, actuator_efforts};

/// The torque that a drive may use over its rated torque, 6072h in thousandths; 0 without torque.
fn torque_share(demand: &Demand) -> f64 {
    if demand.torque {
        demand.torque_per_mille_max / 1000.0
    } else {
        0.0
    }
}

/// Joint order with the jaw as the seventh axis, as plans and tails have it.
fn with_jaw(joints: &JointVector, jaw: f64) -> AxisVector {
    core::array::from_fn(|axis| {
        if axis < JOINT_COUNT {
            joints[axis]
        } else {
            jaw
        }
    })
}

/// One arm's drives and its plant.
#[derive(Clone, Debug)]
pub(super) struct Coupling {
    /// Says in which space, joints or actuators, the drives count.
    plan: ArmPlan,
    /// Axes that their motors do not turn any more.
    slack: [bool; TAIL_AXES],
}

impl Coupling {
    pub(super) const fn new(plan: &ArmPlan) -> Self {
        Self {
            plan: *plan,
            slack: [false; TAIL_AXES],
        }
    }

    pub(super) const fn plan(&self) -> &ArmPlan {
        &self.plan
    }

    /// The motor of `axis` turns, or nothing turns with it.
    ///
    /// Nothing happens for an axis that there is not.
    pub(super) fn set_slack(&mut self, axis: usize, slack: bool) {
        if let Some(place) = self.slack.get_mut(axis) {
            *place = slack;
        }
    }

    /// What the drives want of the plant.
    ///
    /// Counts are divided by `counts_per_unit` of each axis: rad and rad/s, for the insertion m and
    /// m/s, in the plan's space. Torque is a share of the rated one; a drive without torque or with
    /// a slack axis has 0, and its plant axis is limp. A node that is not on the network counts as
    /// one without torque at position 0.
    pub(super) fn setpoint(&self, network: &mut Network<Terminal>) -> DriveSetpoint {
        let demands: [Option<Demand>; TAIL_AXES] = core::array::from_fn(|axis| {
            let node = self.plan.axes[axis].node;
            network.motor(node).map(|motor| motor.demand)
        });
        let axes = |value: fn(&Demand) -> f64| -> AxisVector {
            core::array::from_fn(|axis| demands[axis].as_ref().map_or(0.0, value))
        };
        let counts_per_unit = self.plan.axes.map(|axis| axis.counts_per_unit);
        let units = |counts: AxisVector| -> AxisVector {
            core::array::from_fn(|axis| counts[axis] / counts_per_unit[axis])
        };
        let shares = axes(torque_share);
        DriveSetpoint {
            actuators: self.plan.space == Space::Actuator,
            position: units(axes(|demand| demand.position_counts)),
            velocity: units(axes(|demand| demand.velocity_counts_s)),
            torque: core::array::from_fn(|axis| if self.slack[axis] { 0.0 } else { shares[axis] }),
        }
    }

    /// Turns each motor to where its drive wants it, if that has torque and the motor is not slack:
    /// nothing else is moved.
    ///
    /// Perfect motors: they are where they are wanted in the same millisecond, report a torque of
    /// 0, and keep their place while the drive has no torque.
    pub(super) fn turn_freely(&self, network: &mut Network<Terminal>) {
        for (axis, slack) in self.plan.axes.iter().zip(self.slack) {
            let Some(motor) = network.motor(axis.node) else {
                continue;
            };
            let demand = motor.demand;
            let turns = demand.torque && !slack;
            motor.feedback = Feedback {
                position_counts: if turns {
                    demand.position_counts
                } else {
                    motor.feedback.position_counts
                },
                velocity_counts_s: if turns { demand.velocity_counts_s } else { 0.0 },
                torque_per_mille: 0.0,
            };
        }
    }

    /// Gives the drives the feedback of an arm in `state`.
    pub(super) fn feed_back(&self, state: &ArmState, network: &mut Network<Terminal>) {
        let feedback = self.feedback(state);
        for (axis, feedback) in self.plan.axes.iter().zip(feedback) {
            if let Some(motor) = network.motor(axis.node) {
                motor.feedback = feedback;
            }
        }
    }

    /// What the drives' encoders and current sensors say of an arm in `state`.
    ///
    /// Positions and velocities go from joints into the plan's space and into counts; efforts, N m
    /// or N, become per mille of the rated torque of each axis. Counts are not rounded here: the
    /// drive's objects do that.
    pub(super) fn feedback(&self, state: &ArmState) -> [Feedback; TAIL_AXES] {
        let space = self.plan.space;
        let position = space.from_joints(&with_jaw(&state.position, state.jaw_position));
        let velocity = space.from_joints(&with_jaw(&state.velocity, state.jaw_velocity));
        let effort = with_jaw(&state.effort, state.jaw_effort);
        let effort = match space {
            Space::Joint => effort,
            Space::Actuator => actuator_efforts(&effort),
        };
        core::array::from_fn(|axis| {
            let plan = &self.plan.axes[axis];
            Feedback {
                position_counts: position[axis] * plan.counts_per_unit,
                velocity_counts_s: velocity[axis] * plan.counts_per_unit,
                torque_per_mille: effort[axis] / plan.torque_rated * 1000.0,
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use hal::{Arm as _, TimeNs};
    use trocar_canopen::master::CanConfig;
    use trocar_drives::AxisConfig;
    use trocar_drives::node::Node;
    use trocar_tasks::simulation::{Rendering, Simulation};
    use trocar_tasks::task::TaskConfig;

    use super::*;

    fn plan(space: Space) -> ArmPlan {
        let mut plan = CanConfig::load(&CanConfig::shipped()).unwrap().arms[0].plan;
        plan.space = space;
        plan
    }

    fn network(coupling: &Coupling, state: &ArmState) -> Network<Terminal> {
        let mut network = Network::new(1, 1_000_000, 64);
        let feedback = coupling.feedback(state);
        for (axis, feedback) in feedback.into_iter().enumerate() {
            let axis = &coupling.plan().axes[axis];
            let node = Node::new(axis.node, &AxisConfig::of(axis, 1));
            network.add(0, node, Terminal::new(feedback));
        }
        network
    }

    /// Drives with torque that want their axes to be where `wanted` is, of which `limp` has no
    /// torque.
    fn lead(space: Space, limp: Option<usize>) -> (ArmState, ArmState) {
        let task = TaskConfig::built_in("needle-lift").unwrap();
        let mut simulation = Simulation::new(&task, 0, Rendering::Off).unwrap();
        let before = simulation.read(TimeNs(0)).unwrap();
        let coupling = Coupling::new(&plan(space));
        let mut network = network(&coupling, &before);
        let mut wanted = before;
        wanted.position[0] += 0.02;
        wanted.position[4] -= 0.05;
        wanted.jaw_position += 0.1;
        for (axis, feedback) in coupling.feedback(&wanted).into_iter().enumerate() {
            let motor = network.motor(coupling.plan().axes[axis].node).unwrap();
            motor.demand = Demand {
                torque: limp != Some(axis),
                position_counts: feedback.position_counts,
                velocity_counts_s: 0.0,
                torque_per_mille_max: 1000.0,
            };
        }
        for _ in 0..500 {
            let setpoint = coupling.setpoint(&mut network);
            simulation.arm(0).unwrap().lead(&setpoint);
            simulation.wait();
        }
        let after = simulation.read(TimeNs(1)).unwrap();
        (wanted, after)
    }

    #[test]
    fn drives_bring_the_plant_where_they_are_told_in_either_space() {
        for space in [Space::Joint, Space::Actuator] {
            let (wanted, after) = lead(space, None);
            let error = (after.position - wanted.position).abs().max();
            assert!(error < 0.02, "{space:?}: {error}");
            let jaw = (after.jaw_position - wanted.jaw_position).abs();
            assert!(jaw < 0.02, "{space:?}: {jaw}");
        }
    }

    #[test]
    fn a_drive_without_torque_moves_nothing_and_the_others_do() {
        let (wanted, after) = lead(Space::Joint, Some(0));
        let off = (after.position[0] - wanted.position[0]).abs();
        assert!((off - 0.02).abs() < 1e-3, "yaw stayed: {off}");
        assert!((after.position[4] - wanted.position[4]).abs() < 0.02);
    }

    #[test]
    fn what_the_encoders_say_is_what_was_measured() {
        let task = TaskConfig::built_in("needle-lift").unwrap();
        let mut simulation = Simulation::new(&task, 0, Rendering::Off).unwrap();
        let state = simulation.read(TimeNs(0)).unwrap();
        for space in [Space::Joint, Space::Actuator] {
            let coupling = Coupling::new(&plan(space));
            let feedback = coupling.feedback(&state);
            let axes = core::array::from_fn(|axis| {
                feedback[axis].position_counts / coupling.plan().axes[axis].counts_per_unit
            });
            let joints = space.to_joints(&axes);
            for (joint, measured) in joints.iter().zip(&state.position) {
                assert!((joint - measured).abs() < 1e-9);
            }
        }
    }
}
