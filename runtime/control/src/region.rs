//! Regions that no part of an instrument may touch. Hot path: bounded, no allocation, no I/O, no
//! lock.

use hal::Pose;
use nalgebra::{Point3, Rotation3, Vector3};

/// A forbidden region.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    /// What it stands for.
    pub name: String,
    /// Where it is and what it looks like.
    pub shape: Shape,
}

/// The shape of a region; all are convex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A ball.
    Sphere {
        /// Its centre, m.
        center_m: Vector3<f64>,
        /// Its radius, m.
        radius_m: f64,
    },
    /// All that is near a segment.
    Capsule {
        /// One end of the segment, m.
        from_m: Vector3<f64>,
        /// The other end, m.
        to_m: Vector3<f64>,
        /// How near, m.
        radius_m: f64,
    },
    /// All that lies behind a plane.
    HalfSpace {
        /// A point of the plane, m.
        point_m: Vector3<f64>,
        /// Out of the region, unit.
        normal: Vector3<f64>,
    },
    /// A box in any orientation.
    Box(Block),
}

/// A box in any orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// Its centre, m.
    pub center_m: Vector3<f64>,
    /// Half its size along its own axes, m.
    pub half_m: Vector3<f64>,
    /// From its own axes to the frame's.
    pub axes: Rotation3<f64>,
}

impl Block {
    /// The box seen from another frame.
    #[must_use]
    pub fn moved(&self, frame: &Pose) -> Self {
        Self {
            center_m: moved(frame, &self.center_m),
            half_m: self.half_m,
            axes: frame.rotation.to_rotation_matrix() * self.axes,
        }
    }
}

impl Shape {
    /// The shape seen from another frame.
    #[must_use]
    pub fn moved(&self, frame: &Pose) -> Self {
        match *self {
            Self::Sphere { center_m, radius_m } => Self::Sphere {
                center_m: moved(frame, &center_m),
                radius_m,
            },
            Self::Capsule {
                from_m,
                to_m,
                radius_m,
            } => Self::Capsule {
                from_m: moved(frame, &from_m),
                to_m: moved(frame, &to_m),
                radius_m,
            },
            Self::HalfSpace { point_m, normal } => Self::HalfSpace {
                point_m: moved(frame, &point_m),
                normal: frame.rotation * normal,
            },
            Self::Box(block) => Self::Box(block.moved(frame)),
        }
    }
}

/// `point_m` seen from another frame.
fn moved(frame: &Pose, point_m: &Vector3<f64>) -> Vector3<f64> {
    (frame * Point3::from(*point_m)).coords
}
