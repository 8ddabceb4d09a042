//! The instrument as the tissue meets it: two fingers and a wrist, where they go in a millisecond,
//! what they feel.

use hal::Pose;
use hal::psm::FINGER_M;
use nalgebra::{Point3, Quaternion, UnitQuaternion, Vector3};

/// Half the width of a finger along its hinge, m.
pub(super) const FINGER_HALF_WIDTH_M: f64 = 0.0015;
/// Thickness of a finger from its inner to its outer face, m.
pub(super) const FINGER_THICKNESS_M: f64 = 0.0015;
/// Where the pad of a finger begins, from the hinge, m.
pub(super) const PAD_FROM_M: f64 = 0.002;
/// Where the middle of a finger's pad is, from the hinge, m.
pub const PAD_MIDDLE_M: f64 = 0.5 * (PAD_FROM_M + FINGER_M);
/// Radius of the wrist, m.
const WRIST_RADIUS_M: f64 = 0.0025;

/// One instrument at the end of a millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JawInput {
    /// The fingers in the scene: origin on the hinge, hinge along x, z towards the end, the inner
    /// face in the xz-plane; the first finger's body is at y > 0, the second's at y < 0.
    pub fingers: [Pose; 2],
    /// Ends of the wrist in the scene: on the wrist-pitch and on the wrist-yaw axis (the hinge), m.
    pub wrist: [Point3<f64>; 2],
    /// Force with which the drive presses each finger on the other, at the middle of its pad, N; 0
    /// while it opens.
    pub grip_n: f64,
}

impl JawInput {
    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let poses = self.fingers.iter().all(|pose| {
            pose.translation.vector.iter().all(|x| x.is_finite())
                && pose.rotation.coords.iter().all(|x| x.is_finite())
        });
        let ends = self
            .wrist
            .iter()
            .all(|end| end.coords.iter().all(|x| x.is_finite()));
        poses && ends && self.grip_n.is_finite()
    }

    /// The frame between the fingers: origin on the hinge, z along the middle.
    #[must_use]
    pub fn middle(&self) -> Pose {
        Pose::from_parts(
            self.fingers[0].translation,
            between(&self.fingers[0].rotation, &self.fingers[1].rotation, 0.5),
        )
    }

    /// Distance of the fingers' ends, inner face to inner face, m.
    #[must_use]
    pub fn gap_m(&self) -> f64 {
        let end = Point3::new(0.0, 0.0, FINGER_M);
        (self.fingers[0] * end - self.fingers[1] * end).norm()
    }
}

/// Force and moment, scene frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrench {
    /// N.
    pub force: Vector3<f64>,
    /// About the hinge (the tip frame's origin), N m.
    pub moment: Vector3<f64>,
}

impl Wrench {
    /// None at all.
    #[must_use]
    pub const fn zero() -> Self {
        Self {
            force: Vector3::new(0.0, 0.0, 0.0),
            moment: Vector3::new(0.0, 0.0, 0.0),
        }
    }

    /// Adds `force` at `lever` from the centre.
    pub fn push(&mut self, lever: &Vector3<f64>, force: &Vector3<f64>) {
        self.force += force;
        self.moment += lever.cross(force);
    }

    /// Adds another one about the same centre.
    pub fn add(&mut self, other: &Self) {
        self.force += other.force;
        self.moment += other.moment;
    }

    /// The same wrench `factor` times as strong.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            force: self.force * factor,
            moment: self.moment * factor,
        }
    }
}

/// Shape of one part of the instrument in its frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Solid {
    /// A box.
    Block {
        centre: Vector3<f64>,
        half: Vector3<f64>,
    },
    /// A capsule along z from the origin.
    Capsule { length_m: f64, radius_m: f64 },
}

impl Solid {
    /// The finger on the side `side` (1 or -1) of the jaw.
    pub(super) fn finger(side: f64) -> Self {
        let half = Vector3::new(
            FINGER_HALF_WIDTH_M,
            0.5 * FINGER_THICKNESS_M,
            0.5 * FINGER_M,
        );
        Self::Block {
            centre: Vector3::new(0.0, side * half.y, half.z),
            half,
        }
    }

    /// The same finger while the jaw is shut: it reaches through to the outer face of the other
    /// one, so that tissue in front of the jaw meets no seam to be drawn into.
    pub(super) fn shut_finger() -> Self {
        Self::Block {
            centre: Vector3::new(0.0, 0.0, 0.5 * FINGER_M),
            half: Vector3::new(FINGER_HALF_WIDTH_M, FINGER_THICKNESS_M, 0.5 * FINGER_M),
        }
    }

    /// The wrist, `length_m` long.
    pub(super) const fn wrist(length_m: f64) -> Self {
        Self::Capsule {
            length_m,
            radius_m: WRIST_RADIUS_M,
        }
    }

    /// Middle and radius of a ball around it, in its frame, m.
    pub(super) fn ball(&self) -> (Vector3<f64>, f64) {
        match *self {
            Self::Block { centre, half } => (centre, half.norm()),
            Self::Capsule { length_m, radius_m } => {
                (Vector3::z() * (0.5 * length_m), 0.5 * length_m + radius_m)
            }
        }
    }

    /// Distance of `point` from the surface, negative inside, and the direction out of the solid,
    /// in its frame.
    #[inline]
    pub(super) fn distance_m(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        match *self {
            Self::Block { centre, half } => block_distance(&(point - centre), &half),
            Self::Capsule { length_m, radius_m } => {
                let along = point.z.clamp(0.0, length_m);
                let away = point - Vector3::new(0.0, 0.0, along);
                let norm = away.norm();
                let normal = if norm > 0.0 {
                    away / norm
                } else {
                    Vector3::x()
                };
                (norm - radius_m, normal)
            }
        }
    }
}

#[inline]
fn block_distance(point: &Vector3<f64>, half: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let beyond = point.abs() - half;
    let outside = beyond.sup(&Vector3::zeros());
    let norm = outside.norm();
    if norm > 0.0 {
        return (norm, outside.zip_map(point, f64::copysign) / norm);
    }
    let axis = if beyond.x > beyond.y && beyond.x > beyond.z {
        0
    } else if beyond.y > beyond.z {
        1
    } else {
        2
    };
    let mut normal = Vector3::zeros();
    normal[axis] = 1.0_f64.copysign(point[axis]);
    (beyond[axis], normal)
}

/// How a part moves through one millisecond.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    from: Pose,
    to: Pose,
    /// m/s, of the origin.
    linear: Vector3<f64>,
    /// rad/s.
    angular: Vector3<f64>,
}

impl Motion {
    /// From one pose to the next within `dt_s`.
    pub(super) fn new(from: &Pose, to: &Pose, dt_s: f64) -> Self {
        let turn = to.rotation * from.rotation.inverse();
        let turn = turn.quaternion();
        let sign = if turn.w < 0.0 { -1.0 } else { 1.0 };
        Self {
            from: *from,
            to: *to,
            linear: (to.translation.vector - from.translation.vector) / dt_s,
            angular: turn.imag() * (2.0 * sign / dt_s),
        }
    }

    /// The pose after the share `share` of the millisecond.
    pub(super) fn at(&self, share: f64) -> Pose {
        let (from, to) = (self.from.translation.vector, self.to.translation.vector);
        Pose::from_parts(
            (from + (to - from) * share).into(),
            between(&self.from.rotation, &self.to.rotation, share),
        )
    }

    /// Velocity of the part's material at `point` while its frame is at `pose`, scene frame, m/s.
    pub(super) fn velocity(&self, pose: &Pose, point: &Vector3<f64>) -> Vector3<f64> {
        self.linear + self.angular.cross(&(point - pose.translation.vector))
    }
}

/// The rotation `share` of the way from one to another: linear and normalised, which needs no
/// angles and is exact to a thousandth for the small turns of a millisecond.
pub(super) fn between(
    from: &UnitQuaternion<f64>,
    to: &UnitQuaternion<f64>,
    share: f64,
) -> UnitQuaternion<f64> {
    let sign = if from.coords.dot(&to.coords) < 0.0 {
        -1.0
    } else {
        1.0
    };
    let mixed = from.coords * (1.0 - share) + to.coords * (sign * share);
    UnitQuaternion::new_normalize(Quaternion::from(mixed))
}

/// A frame at `from` whose z points at `to`, and their distance.
pub(super) fn frame_along(from: &Point3<f64>, to: &Point3<f64>) -> (Pose, f64) {
    let along = to - from;
    let length_m = along.norm();
    // Half-way quaternion of z and the direction; straight down any half turn will do.
    let (x, y, z) = (along.x, along.y, along.z + length_m);
    let rotation = if z > 1e-9 * length_m {
        UnitQuaternion::new_normalize(Quaternion::new(z, -y, x, 0.0))
    } else {
        UnitQuaternion::new_normalize(Quaternion::new(0.0, 1.0, 0.0, 0.0))
    };
    (Pose::from_parts((*from).into(), rotation), length_m)
}
