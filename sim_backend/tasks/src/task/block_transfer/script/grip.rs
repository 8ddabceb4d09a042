//! Where to grip the block, and how to place it while it is gripped there.

use core::f64::consts::{FRAC_PI_2, PI};

use hal::Pose;
use hal::psm::FINGER_M;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use trocar_world::FINGER_THICKNESS_M;
use trocar_world::block::BlockShape;

use crate::script::hand::straight_down;
use crate::task::block_transfer::BoardShape;

/// Room that a finger takes in the hole, beyond its thickness, because it stands a little aslant,
/// m.
const SLANT_M: f64 = 0.000_4;

/// Room that it shall have beyond that, m.
const SPARE_M: f64 = 0.000_5;

/// Which wall is gripped: its side of the block, 0 to 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Grip {
    side: u32,
}

/// The shapes that decide about grips.
pub(super) struct Gripping<'a> {
    pub(super) block: &'a BlockShape,
    pub(super) board: &'a BoardShape,
}

impl Gripping<'_> {
    /// The grip of this attempt: `before` if there is one, else of the walls that the peg leaves
    /// room for a finger at the one that turns the wrist least; where there is no such wall, the
    /// one with most room.
    pub(super) fn choose(&self, before: Option<Grip>, block_in_scene: &Pose) -> Grip {
        if let Some(grip) = before {
            return grip;
        }
        let peg = self.peg_in(block_in_scene);
        let spare_m = |grip: Grip| {
            let inside = peg.map_or(0.0, |peg| self.block.side_normal(grip.side).dot(&peg));
            let room_m = self.block.hole_m - self.board.peg_radius_m - inside;
            (room_m - FINGER_THICKNESS_M - SLANT_M - SPARE_M).min(0.0)
        };
        let turn_rad = |grip| self.turn_rad(grip, block_in_scene).abs();
        let better = |best: Grip, grip: Grip| {
            let by_room = spare_m(best).total_cmp(&spare_m(grip));
            let order = by_room.then(turn_rad(grip).total_cmp(&turn_rad(best)));
            if order.is_lt() { grip } else { best }
        };
        [1, 2]
            .map(|side| Grip { side })
            .into_iter()
            .fold(Grip { side: 0 }, better)
    }

    /// How far the wrist turns from its home to lay the jaw across a wall: of the two ways, the
    /// nearer.
    fn turn_rad(&self, grip: Grip, block_in_scene: &Pose) -> f64 {
        let outwards = block_in_scene * self.block.side_normal(grip.side);
        let yaw = outwards.y.atan2(outwards.x);
        if yaw.abs() > FRAC_PI_2 {
            yaw - PI.copysign(yaw)
        } else {
            yaw
        }
    }

    /// The pose of the control point in which closing the jaw grips the wall `along_m` beside its
    /// middle, the finger tips `depth_m` below the block's top.
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
        let yaw = self.turn_rad(grip, block_in_scene);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        Pose::from_parts(
            Translation3::new(wall.x, wall.y, wall.z + FINGER_M - depth_m),
            turn * straight_down(),
        )
    }

    /// The block upright, turned as it is, `bottom_m` above the board, with the peg at `goal` in
    /// the middle of what the finger leaves of the hole.
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
