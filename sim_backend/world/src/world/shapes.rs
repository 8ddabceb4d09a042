//! What things, ground and the instrument's parts are for the collision detection.

use hal::Pose;
use hal::psm::{FINGER_M, WRIST_M};
use nalgebra::{Point3, Vector3};
use rapier3d_f64::geometry::SharedShape;
use rapier3d_f64::math::{Pose as EnginePose, Vector as EngineVector};
use rapier3d_f64::parry::bounding_volume::Aabb;

use super::convert::{engine_pose, engine_vector};
use super::scenery::Shape;

/// Width of a finger along its hinge, m.
pub(super) const FINGER_WIDTH_M: f64 = 0.003;
/// Thickness of a finger from its inner to its outer face, m.
pub const FINGER_THICKNESS_M: f64 = 0.001_5;
/// Radius of the wrist links, m.
pub(super) const WRIST_RADIUS_M: f64 = 0.002_5;

/// A convex shape in the frame of what carries it, with what says quickly that another one is far
/// away.
#[derive(Clone)]
pub(super) struct Body {
    pub(super) shape: SharedShape,
    /// Carrier from shape.
    pub(super) place: EnginePose,
    /// Box around the shape, in its own frame.
    pub(super) bounds: Aabb,
    /// Ball around the shape, in the carrier's frame.
    pub(super) centre: EngineVector,
    pub(super) radius_m: f64,
}

impl Body {
    pub(super) fn new((shape, place): (SharedShape, Pose)) -> Self {
        let place = engine_pose(&place);
        let bounds = shape.compute_local_aabb();
        let ball = shape.compute_local_bounding_sphere();
        Self {
            centre: place * ball.center(),
            radius_m: ball.radius(),
            shape,
            place,
            bounds,
        }
    }

    pub(super) fn of(shape: &Shape) -> Self {
        Self::new(engine_shape(shape))
    }
}

/// Left finger, right finger and wrist, each in its own frame.
pub(super) fn instrument() -> [Body; 3] {
    [finger(1.0), finger(-1.0), wrist()].map(Body::new)
}

/// A box from the hinge to the finger's end whose inner face passes through the hinge.
fn finger(side: f64) -> (SharedShape, Pose) {
    let shape = SharedShape::cuboid(
        0.5 * FINGER_WIDTH_M,
        0.5 * FINGER_THICKNESS_M,
        0.5 * FINGER_M,
    );
    (
        shape,
        Pose::translation(0.0, 0.5 * side * FINGER_THICKNESS_M, 0.5 * FINGER_M),
    )
}

/// A capsule from the wrist-pitch axis to the wrist-yaw axis, in the wrist-pitch frame.
fn wrist() -> (SharedShape, Pose) {
    let (from, to) = (Vector3::zeros(), Vector3::new(WRIST_M, 0.0, 0.0));
    (
        SharedShape::capsule(engine_vector(&from), engine_vector(&to), WRIST_RADIUS_M),
        Pose::identity(),
    )
}

/// Points of a part of the instrument that soft ground presses at, in the part's frame: the corners
/// of a finger's end and the middle of its outer face, or the two ends of the wrist's line, whose
/// balls hang `WRIST_RADIUS_M` lower.
pub(super) fn sample_points(part: usize) -> Vec<Point3<f64>> {
    let side = match part {
        0 => 1.0,
        1 => -1.0,
        _ => return vec![Point3::origin(), Point3::new(WRIST_M, 0.0, 0.0)],
    };
    let outer = side * FINGER_THICKNESS_M;
    let half = 0.5 * FINGER_WIDTH_M;
    vec![
        Point3::new(-half, 0.0, FINGER_M),
        Point3::new(half, 0.0, FINGER_M),
        Point3::new(-half, outer, FINGER_M),
        Point3::new(half, outer, FINGER_M),
        Point3::new(0.0, outer, 0.5 * FINGER_M),
    ]
}

/// A shape for the engine, with its place in the frame that its points are in.
fn engine_shape(shape: &Shape) -> (SharedShape, Pose) {
    match shape {
        Shape::Ball { centre, radius_m } => (
            SharedShape::ball(*radius_m),
            Pose::translation(centre.x, centre.y, centre.z),
        ),
        Shape::Capsule { from, to, radius_m } => (
            SharedShape::capsule(
                engine_vector(&from.coords),
                engine_vector(&to.coords),
                *radius_m,
            ),
            Pose::identity(),
        ),
        Shape::Block { low, high } => {
            let half = (high - low) * 0.5;
            let middle = low + half;
            (
                SharedShape::cuboid(half.x, half.y, half.z),
                Pose::translation(middle.x, middle.y, middle.z),
            )
        }
        Shape::Hull(points) => {
            let corners: Vec<_> = points.iter().map(|p| engine_vector(&p.coords)).collect();
            #[expect(clippy::expect_used, reason = "the hulls of all tasks are solids")]
            let hull = SharedShape::convex_hull(&corners).expect("a hull has a volume");
            (hull, Pose::identity())
        }
    }
}
