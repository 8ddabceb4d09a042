//! What a world is made of besides its arms: things that move, and ground that does not.

use hal::Pose;
use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::config::Surface;
use crate::needle::{NeedleShape, ratio};
use crate::organ::Organ;
use crate::tissue::{self, TissueConfig};

/// Everything in a world but the arms.
#[derive(Clone, Debug)]
pub struct Scenery {
    /// Things that can be pushed and gripped, in the order in which the world counts them.
    pub things: Vec<RigidBody>,
    /// What they lie on.
    pub ground: Ground,
    /// A soft flap over the ground.
    pub flap: Option<Flap>,
}

/// A soft flap of tissue. It lies on a [`Ground::Bed`]; it does not touch things, and no other
/// ground.
#[derive(Clone, Debug)]
pub struct Flap {
    /// What it is.
    pub config: TissueConfig,
    /// What its mark depends on.
    pub seed: u64,
}

/// A rigid body that moves.
#[derive(Clone, Debug)]
pub struct RigidBody {
    /// Where it is at the start, scene frame; it must not overlap anything.
    pub in_scene: Pose,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the thing's frame, m.
    pub centre: Point3<f64>,
    /// Principal moments of inertia about the centre of mass, kg m².
    pub inertia: Vector3<f64>,
    /// How the principal axes are turned in the thing's frame.
    pub axes: UnitQuaternion<f64>,
    /// What it touches with.
    pub pieces: Vec<Collider>,
}

/// A collider: a part of a body's surface.
#[derive(Clone, Debug)]
pub struct Collider {
    /// Its shape, in the thing's frame.
    pub shape: Shape,
    /// What it touches.
    pub meets: CollisionMask,
}

/// What a collider collides with. Bodies do not collide with each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CollisionMask {
    /// Fingers and wrists.
    Instrument,
    /// The ground. These alone rest on soft ground, which meets the ball about each.
    Ground,
    /// Fingers, wrists and hard ground.
    Both,
}

/// A convex shape in some frame, m.
#[derive(Clone, Debug)]
pub enum Shape {
    /// A ball.
    Ball {
        /// Its middle.
        centre: Point3<f64>,
        /// Its radius.
        radius_m: f64,
    },
    /// A ball drawn along a line.
    Capsule {
        /// One end of the line.
        from: Point3<f64>,
        /// Its other end.
        to: Point3<f64>,
        /// Radius of the ball.
        radius_m: f64,
    },
    /// A box along the frame's axes.
    Block {
        /// Its lowest corner.
        low: Point3<f64>,
        /// Its highest corner.
        high: Point3<f64>,
    },
    /// The convex hull of points.
    Hull(Vec<Point3<f64>>),
}

/// What does not move.
#[derive(Clone, Debug)]
pub enum Ground {
    /// A soft organ, a spring contact for the instrument; a rolling one lies on a table.
    Organ(Organ),
    /// Hard convex solids in the scene frame.
    Solids(Vec<Shape>),
    /// A soft organ with a rim, for a flap to lie on, a spring contact for the instrument; things
    /// fall through.
    Bed(tissue::Ground),
    /// A soft organ with hard solids that stand on it.
    OrganWithSolids(SoftOrgan, Vec<Shape>),
}

/// A soft organ whose contact is not that of the world's ground, which is hard.
#[derive(Clone, Debug)]
pub struct SoftOrgan {
    /// Where it is.
    pub organ: Organ,
    /// Contact of each ball of a thing.
    pub ground: Surface,
    /// Contact of each sample point of the instrument.
    pub press: Surface,
}

/// Length of the capsules that make up the needle, m, at most.
const NEEDLE_CAPSULE_M: f64 = 0.002_6;
/// The needle's inertia over that of its shape. A contact is as stiff as the mass it finds at its
/// lever is large, so a slender wire held away from its middle would rock in the jaws; like the
/// raised mass, this stays far below what the grip carries.
const NEEDLE_INERTIA: f64 = 3.0;
/// Balls along the needle that rest on the tissue: a ball meets a smooth surface in one point, and
/// three carry it.
const NEEDLE_BEADS: usize = 9;

impl RigidBody {
    /// A needle as a chain of capsules for fingers and hard ground alike.
    #[must_use]
    pub fn bare_needle(shape: &NeedleShape, in_scene: Pose) -> Self {
        let mut needle = Self::needle_on_any_ground(shape, in_scene);
        needle
            .pieces
            .retain(|piece| piece.meets == CollisionMask::Both);
        needle
    }

    /// A needle as a chain of capsules for fingers and hard ground alike, and of balls for the
    /// tissue.
    #[must_use]
    pub fn needle_on_any_ground(shape: &NeedleShape, in_scene: Pose) -> Self {
        let mut needle = Self::needle(shape, in_scene);
        for piece in &mut needle.pieces {
            if piece.meets == CollisionMask::Instrument {
                piece.meets = CollisionMask::Both;
            }
        }
        needle
    }

    /// A needle as a chain of capsules for the fingers and of balls for the tissue.
    #[must_use]
    pub fn needle(shape: &NeedleShape, in_scene: Pose) -> Self {
        let mass = shape.mass_properties();
        let points = shape.centre_line(capsule_count(shape) + 1);
        let radius_m = shape.wire_radius_m;
        let wire = points.windows(2).map(|pair| Collider {
            shape: Shape::Capsule {
                from: pair[0],
                to: pair[1],
                radius_m,
            },
            meets: CollisionMask::Instrument,
        });
        let beads = shape
            .centre_line(NEEDLE_BEADS)
            .into_iter()
            .map(|centre| Collider {
                shape: Shape::Ball { centre, radius_m },
                meets: CollisionMask::Ground,
            });
        Self {
            in_scene,
            mass_kg: shape.mass_kg,
            centre: mass.centre,
            inertia: mass.inertia * NEEDLE_INERTIA,
            axes: UnitQuaternion::from_axis_angle(&Vector3::z_axis(), mass.axes_rad),
            pieces: wire.chain(beads).collect(),
        }
    }
}

/// Odd, so that a capsule lies across the middle of the arc.
fn capsule_count(shape: &NeedleShape) -> usize {
    let length_m = shape.arc_radius_m * shape.arc_angle_rad;
    let fits = |count: &usize| ratio(1, *count) * length_m <= NEEDLE_CAPSULE_M;
    (1..=41).step_by(2).find(fits).unwrap_or(41)
}
