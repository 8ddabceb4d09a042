//! One arm of a world: drives, links, and what pushes at them.

use hal::psm::{DH, FINGER_M, JAW_MAX};
use hal::{ArmCommand, ArmState, JOINT_COUNT, JointVector, Pose, TimeNs};
use nalgebra::{Point3, Vector3};

use super::chain::{Chain, Wrench};
use super::config::WorldConfig;
use super::contact::DIRECTIONS;
use crate::plant::{
    AXIS_COUNT, AxisVector, DriveSetpoint, FreeDrives, Load, Plant, actuator_efforts,
};
use crate::tissue::{JawInput, PAD_MIDDLE_M};

/// Where an arm stands and how it starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmStart {
    /// Scene frame from the arm's base frame (the RCM).
    pub scene_from_rcm: Pose,
    /// Joints at the start, rad (insertion m).
    pub joints: JointVector,
    /// Jaw angle at the start, rad.
    pub jaw: f64,
}

/// Poses of the instrument's parts in the scene frame, for drawing.
#[derive(Clone, Copy, Debug)]
pub struct ArmBodies {
    /// Shaft: origin on the wrist-pitch axis, the shaft behind it along -z.
    pub shaft: Pose,
    /// Wrist: origin on the wrist-pitch axis, the wrist-yaw axis at x = 9.1 mm.
    pub wrist: Pose,
    /// Left finger: origin on the wrist-yaw axis, z along the finger, inner face in the xz-plane,
    /// body at y > 0.
    pub finger_left: Pose,
    /// Right finger: like the left one with its body at y < 0.
    pub finger_right: Pose,
    /// Nothing to draw: the tip frame, its origin on the wrist-yaw axis, z along the closed
    /// fingers, x along their hinge.
    pub tip: Pose,
}

impl ArmBodies {
    /// Those of an arm whose remote centre is at `scene_from_rcm`, with these joints, rad
    /// (insertion m), and the jaw's angle, rad.
    #[must_use]
    pub fn at(scene_from_rcm: &Pose, joints: &JointVector, jaw: f64) -> Self {
        Self::of(&Chain::new(scene_from_rcm, joints), jaw)
    }

    fn of(chain: &Chain, jaw: f64) -> Self {
        Self {
            shaft: chain.frames[3],
            wrist: chain.frames[4],
            finger_left: chain.finger(jaw, 1.0),
            finger_right: chain.finger(jaw, -1.0),
            tip: chain.tip,
        }
    }
}

/// Poses of the instrument's moving parts, in the order left finger, right finger, wrist.
pub(super) type PartPoses = [Pose; 3];

/// The wrist among the parts; the fingers come before it.
const WRIST: usize = 2;

/// Drives and links of one arm.
pub(super) struct ArmUnit {
    scene_from_rcm: Pose,
    plant: Plant,
    pub(super) chain: Chain,
    load: Load,
}

impl ArmUnit {
    pub(super) fn new(config: &WorldConfig, start: &ArmStart) -> Self {
        let chain = Chain::new(&start.scene_from_rcm, &start.joints);
        Self {
            scene_from_rcm: start.scene_from_rcm,
            plant: Plant::new(&config.plant, &start.joints, start.jaw),
            load: Load {
                efforts: [0.0; AXIS_COUNT],
                squeeze_damping: config.squeeze_damping_n_m_s,
            },
            chain,
        }
    }

    pub(super) fn measured(&self, stamp: TimeNs) -> ArmState {
        self.plant.measured(stamp)
    }

    pub(super) fn command(&mut self, command: &ArmCommand) {
        self.plant.command(command);
    }

    pub(super) fn lead(&mut self, setpoint: &DriveSetpoint) {
        self.plant.lead(setpoint);
    }

    pub(super) fn setpoint(&self) -> (AxisVector, AxisVector, bool) {
        self.plant.setpoint()
    }

    /// Lets the drives work for one millisecond in which nothing rigid is touched.
    pub(super) fn drive(&mut self) {
        self.plant.step(&self.load);
        self.follow();
    }

    /// Brings the links to where the drives are.
    pub(super) fn follow(&mut self) {
        let joints = self.plant.joints();
        self.chain = Chain::new(
            &self.scene_from_rcm,
            &JointVector::from_column_slice(&joints[..JOINT_COUNT]),
        );
    }

    /// Actuator velocities now.
    pub(super) const fn velocities(&self) -> &AxisVector {
        self.plant.actuator_velocities()
    }

    /// How many sub-steps a millisecond has.
    pub(super) const fn substeps(&self) -> u32 {
        self.plant.substeps()
    }

    /// Bound on the speed of any point of fingers and wrist, m/s.
    pub(super) fn tip_speed_m_s(&self) -> f64 {
        let rates = self.plant.joint_velocities();
        let tip = self.chain.tip.translation.vector;
        let links = self.chain.frames.iter().zip(&rates).enumerate();
        let links = links.map(|(joint, (frame, rate))| {
            if DH[joint].prismatic {
                rate.abs()
            } else {
                rate.abs() * ((tip - frame.translation.vector).norm() + FINGER_M)
            }
        });
        links.sum::<f64>() + rates[JOINT_COUNT].abs() * FINGER_M
    }

    /// Begins a sub-step; see [`Plant::begin`].
    pub(super) fn begin(&mut self, step_s: f64) -> FreeDrives {
        self.plant.begin(&self.load, step_s)
    }

    /// Ends a sub-step; see [`Plant::finish`].
    pub(super) fn finish(&mut self, velocity: &AxisVector, step_s: f64) {
        self.plant.finish(velocity, step_s);
    }

    /// Velocity of `point` (scene frame) of a part along each axis of `frame`, and its angular
    /// velocity about the first one, a row each, for each actuator's velocity.
    pub(super) fn jacobian(
        &self,
        part: usize,
        point: &Vector3<f64>,
        frame: &[Vector3<f64>; 3],
    ) -> [AxisVector; DIRECTIONS] {
        let mut joints = [[0.0; AXIS_COUNT]; DIRECTIONS];
        let mut set = |joint: usize, linear: &Vector3<f64>, angular: &Vector3<f64>| {
            for (row, axis) in joints.iter_mut().zip(frame) {
                row[joint] = linear.dot(axis);
            }
            joints[DIRECTIONS - 1][joint] = angular.dot(&frame[0]);
        };
        let carried_by = if part == WRIST {
            JOINT_COUNT - 1
        } else {
            JOINT_COUNT
        };
        for (joint, link) in self.chain.frames.iter().enumerate().take(carried_by) {
            let axis = link.rotation * Vector3::z();
            if DH[joint].prismatic {
                set(joint, &axis, &Vector3::zeros());
            } else {
                set(
                    joint,
                    &axis.cross(&(point - link.translation.vector)),
                    &axis,
                );
            }
        }
        // Beyond its range the jaw's drive moves on, but the fingers do not.
        if part != WRIST && (0.0..=JAW_MAX).contains(&self.jaw()) {
            let turn = if part == 0 { -0.5 } else { 0.5 };
            let hinge = self.chain.tip.rotation * Vector3::x() * turn;
            let arm = point - self.chain.tip.translation.vector;
            set(JOINT_COUNT, &hinge.cross(&arm), &hinge);
        }
        // Velocities go through the coupling as efforts go back.
        joints.map(|row| actuator_efforts(&row))
    }

    /// Where the parts are now.
    pub(super) fn part_poses(&self) -> PartPoses {
        part_poses(&self.chain, self.jaw())
    }

    pub(super) fn bodies(&self) -> ArmBodies {
        ArmBodies::of(&self.chain, self.jaw())
    }

    /// The instrument as a flap meets it.
    pub(super) fn jaw_input(&self) -> JawInput {
        let jaw = self.jaw();
        let ends = [&self.chain.frames[4], &self.chain.tip];
        JawInput {
            fingers: [1.0, -1.0].map(|side| self.chain.finger(jaw, side)),
            wrist: ends.map(|frame| Point3::from(frame.translation.vector)),
            // Power: each finger turns by half of the jaw's angle, and there are two.
            grip_n: (-self.plant.jaw_effort() / PAD_MIDDLE_M).max(0.0),
        }
    }

    /// Every number that decides the future, for hashing.
    pub(super) fn state(&self) -> impl Iterator<Item = f64> + '_ {
        self.plant.state().chain(self.load.efforts)
    }

    /// Takes in what a flap does to left finger, right finger and wrist; it reaches the drives in
    /// the next millisecond.
    pub(super) fn feel(&mut self, wrenches: &[Wrench; 3]) {
        self.load.efforts = self.efforts(wrenches);
    }

    /// Joint efforts, jaw last, of wrenches on left finger, right finger and wrist.
    fn efforts(&self, [left, right, wrist]: &[Wrench; 3]) -> AxisVector {
        let hinge = self.chain.tip.rotation * Vector3::x();
        // Opening turns the left finger by -1/2 about the hinge and the right one by +1/2.
        let jaw_effort = 0.5 * hinge.dot(&(right.moment - left.moment));
        let mut all = *wrist;
        all.add(left);
        all.add(right);
        let joints = self.chain.joint_efforts(&all);
        core::array::from_fn(|axis| {
            if axis < JOINT_COUNT {
                joints[axis]
            } else {
                jaw_effort
            }
        })
    }

    fn jaw(&self) -> f64 {
        self.plant.joints()[JOINT_COUNT]
    }
}

fn part_poses(chain: &Chain, jaw: f64) -> PartPoses {
    [
        chain.finger(jaw, 1.0),
        chain.finger(jaw, -1.0),
        chain.frames[4],
    ]
}
