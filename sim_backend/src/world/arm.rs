//! One arm of a world: drives, links, and what pushes at them.

use hal::{ArmCommand, ArmState, JOINT_COUNT, JointVector, Pose, TimeNs};
use nalgebra::{Point3, Vector3};

use super::chain::{Chain, Wrench};
use super::config::WorldConfig;
use super::obstacle::Obstacles;
use super::press::{self, SoftGround};
use super::scenery::Ground;
use super::stage::{PartPoses, Touch};
use crate::plant::{AXIS_COUNT, AxisVector, DriveSetpoint, Load, Plant};
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
    /// Left finger: origin on the wrist-yaw axis, z along the finger, inner face in the xz-plane, body at y > 0.
    pub finger_left: Pose,
    /// Right finger: like the left one with its body at y < 0.
    pub finger_right: Pose,
    /// Nothing to draw: the tip frame, its origin on the wrist-yaw axis, z along the closed fingers, x along their hinge.
    pub tip: Pose,
}

/// Drives and links of one arm.
pub(super) struct ArmUnit {
    scene_from_rcm: Pose,
    plant: Plant,
    pub(super) chain: Chain,
    pressing: Pressing,
    parts: PartPoses,
    load: Load,
    ground_force_n: f64,
}

/// Sample points of the instrument that soft ground presses at, for each part.
struct Pressing {
    left: [Point3<f64>; 5],
    right: [Point3<f64>; 5],
    wrist: [Point3<f64>; 2],
}

impl ArmUnit {
    pub(super) fn new(config: &WorldConfig, start: &ArmStart) -> Self {
        let chain = Chain::new(&start.scene_from_rcm, &start.joints);
        Self {
            scene_from_rcm: start.scene_from_rcm,
            plant: Plant::new(&config.plant, &start.joints, start.jaw),
            pressing: Pressing::new(&chain, start.jaw),
            parts: part_poses(&chain, start.jaw),
            load: Load {
                efforts: [0.0; AXIS_COUNT],
                squeeze_damping: config.squeeze_damping_n_m_s,
            },
            chain,
            ground_force_n: 0.0,
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

    #[cfg(test)]
    pub(super) fn setpoint(&self) -> (AxisVector, AxisVector, bool) {
        self.plant.setpoint()
    }

    /// Lets the drives work for one millisecond.
    pub(super) fn drive(&mut self) {
        self.plant.step(&self.load);
        let joints = self.plant.joints();
        self.chain = Chain::new(
            &self.scene_from_rcm,
            &JointVector::from_column_slice(&joints[..JOINT_COUNT]),
        );
    }

    /// Where the parts are now.
    pub(super) fn part_poses(&self) -> PartPoses {
        part_poses(&self.chain, self.jaw())
    }

    pub(super) fn bodies(&self) -> ArmBodies {
        let jaw = self.jaw();
        ArmBodies {
            shaft: self.chain.frames[3],
            wrist: self.chain.frames[4],
            finger_left: self.chain.finger(jaw, 1.0),
            finger_right: self.chain.finger(jaw, -1.0),
            tip: self.chain.tip,
        }
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

    /// Sum of the forces with which hard ground pushed at the parts in the newest step, N.
    pub(super) const fn ground_force_n(&self) -> f64 {
        self.ground_force_n
    }

    /// Every number that decides the future, for hashing.
    pub(super) fn state(&self) -> impl Iterator<Item = f64> + '_ {
        self.plant.state().chain(self.load.efforts)
    }

    /// Takes in what pushes at the instrument; it reaches the drives in the next millisecond.
    pub(super) fn feel<'a>(
        &mut self,
        config: &WorldConfig,
        ground: &Ground,
        obstacles: &Obstacles,
        touches: impl Iterator<Item = &'a [Touch; 3]>,
        drape: Option<[Wrench; 3]>,
    ) {
        let mut wrenches = match ground {
            Ground::Organ(organ) => self.pressed(config, organ),
            Ground::Bed(bed) => self.pressed(config, bed),
            Ground::Solids(_) => self.pushed(config, obstacles),
        };
        for (wrench, pull) in wrenches.iter_mut().zip(drape.iter().flatten()) {
            wrench.add(pull);
        }
        for touch in touches {
            for (wrench, touch) in wrenches.iter_mut().zip(touch) {
                wrench.add(&touch.wrench);
            }
        }
        self.load.efforts = self.efforts(&wrenches);
    }

    fn pressed(&mut self, config: &WorldConfig, ground: &impl SoftGround) -> [Wrench; 3] {
        let centre = self.chain.tip.translation.vector;
        let now = Pressing::new(&self.chain, self.jaw());
        let before = core::mem::replace(&mut self.pressing, now);
        let press = |points: &[Point3<f64>], before: &[Point3<f64>]| {
            press::pressed(&config.press, ground, points, before, &centre)
        };
        [
            press(&self.pressing.left, &before.left),
            press(&self.pressing.right, &before.right),
            press(&self.pressing.wrist, &before.wrist),
        ]
    }

    fn pushed(&mut self, config: &WorldConfig, obstacles: &Obstacles) -> [Wrench; 3] {
        let centre = self.chain.tip.translation.vector;
        let now = self.part_poses();
        let before = core::mem::replace(&mut self.parts, now);
        let pushes =
            [0, 1, 2].map(|part| obstacles.push(&config.press, part, &now, &before, &centre));
        self.ground_force_n = pushes.iter().map(|push| push.force_n).sum();
        pushes.map(|push| push.wrench)
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

impl Pressing {
    fn new(chain: &Chain, jaw: f64) -> Self {
        Self {
            left: press::finger_points(&chain.finger(jaw, 1.0), 1.0),
            right: press::finger_points(&chain.finger(jaw, -1.0), -1.0),
            wrist: press::wrist_points(&chain.frames[4], &chain.tip),
        }
    }
}

fn part_poses(chain: &Chain, jaw: f64) -> PartPoses {
    [
        chain.finger(jaw, 1.0),
        chain.finger(jaw, -1.0),
        chain.frames[4],
    ]
}
