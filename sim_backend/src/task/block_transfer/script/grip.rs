//! Where to grip the block, and how to place it while it is gripped there.

use core::f64::consts::{FRAC_PI_2, PI};

use hal::Pose;
use hal::psm::FINGER_M;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use crate::block::BlockShape;
use crate::expert::hand::straight_down;
use crate::task::block_transfer::BoardShape;
use crate::world::FINGER_THICKNESS_M;

/// Room that a finger takes in the hole, beyond its thickness, because it stands a little aslant, m.
const SLANT_M: f64 = 0.000_4;

/// Which wall is gripped: its side of the block, 0 to 2.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Grip {
    side: u32,
}

/// The shapes that decide about grips.
pub(super) struct Gripping<'a> {
    pub(super) block: &'a BlockShape,
    pub(super) board: &'a BoardShape,
}

impl Gripping<'_> {
    /// The grip of this attempt: `before` if there is one, else the wall with most room for a finger inside, each side
    /// looking better than it is by its `liking_m`.
    pub(super) fn choose(
        &self,
        before: Option<Grip>,
        liking_m: &[f64; 3],
        block_in_scene: &Pose,
    ) -> Grip {
        if let Some(grip) = before {
            return grip;
        }
        let peg = self.peg_in(block_in_scene);
        let mut best = (Grip::default(), f64::NEG_INFINITY);
        for (side, liking_m) in (0..3).zip(liking_m) {
            let inside = peg.map_or(0.0, |peg| self.block.side_normal(side).dot(&peg));
            let score = liking_m - inside;
            if score > best.1 {
                best = (Grip { side }, score);
            }
        }
        best.0
    }

    /// The pose of the control point in which closing the jaw grips the wall `along_m` beside its middle, the finger
    /// tips `depth_m` below the block's top.
    pub(super) fn tip_pose(
        &self,
        grip: Grip,
        block_in_scene: &Pose,
        along_m: f64,
        depth_m: f64,
    ) -> Pose {
        let normal = self.block.side_normal(grip.side);
        let along = Vector3::z().cross(&normal) * along_m;
        let middle_m = 0.5 * (self.block.side_m + self.block.hole_m);
        // The hole points up or down; a prism has no other way to stand.
        let up = (block_in_scene * Vector3::z()).z.signum();
        let top = Vector3::z() * (0.5 * self.block.height_m * up);
        let wall = block_in_scene * Point3::from(normal * middle_m + along + top);
        let outwards = block_in_scene * normal;
        // Of the two ways to lay the jaw across the wall, the one nearer to the home rotation.
        let mut yaw = outwards.y.atan2(outwards.x);
        if yaw.abs() > FRAC_PI_2 {
            yaw -= PI.copysign(yaw);
        }
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        Pose::from_parts(
            Translation3::new(wall.x, wall.y, wall.z + FINGER_M - depth_m),
            turn * straight_down(),
        )
    }

    /// The block upright, turned as it is, `bottom_m` above the board, with the peg at `goal` in the middle of what the
    /// finger leaves of the hole.
    pub(super) fn placed(
        &self,
        grip: Grip,
        block_in_scene: &Pose,
        goal: &Vector3<f64>,
        bottom_m: f64,
    ) -> Pose {
        let axis = block_in_scene * Vector3::z();
        let upright = Vector3::z() * axis.z.signum();
        let straighten = UnitQuaternion::rotation_between(&axis, &upright)
            .unwrap_or_else(UnitQuaternion::identity);
        let rotation = straighten * block_in_scene.rotation;
        let aside_m = 0.5 * (FINGER_THICKNESS_M + SLANT_M);
        let aside = rotation * self.block.side_normal(grip.side) * aside_m;
        let height_m = bottom_m + 0.5 * self.block.height_m;
        Pose::from_parts(
            Translation3::new(goal.x + aside.x, goal.y + aside.y, height_m),
            rotation,
        )
    }

    /// The peg in the block's hole, in the block frame, if there is one.
    fn peg_in(&self, block_in_scene: &Pose) -> Option<Vector3<f64>> {
        self.board
            .pegs_m
            .iter()
            .map(|[x, y]| {
                let peg = Point3::new(*x, *y, block_in_scene.translation.z);
                block_in_scene.inverse_transform_point(&peg).coords
            })
            .find(|peg| peg.xy().norm() < self.block.side_m)
    }
}
