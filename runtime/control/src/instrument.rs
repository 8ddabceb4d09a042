//! The instrument as four links, each a segment with the shaft's radius about it, and how its
//! points move. Hot path: bounded, no allocation, no I/O, no lock.

use hal::psm::{FINGER_M, JAW_MAX};
use hal::{JointVector, Pose};
use nalgebra::{Point3, SMatrix, Vector3};

use super::motion::{AXES, MotionState};
use super::snapshot::words;
use crate::kinematics::Frames;

/// Shaft, wrist and two fingers.
pub const LINKS: usize = 4;

/// Velocity of a point per joint and jaw velocity.
pub type PointJacobian = SMatrix<f64, 3, AXES>;

/// A part of the instrument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// From the remote centre to the wrist-pitch axis.
    Shaft,
    /// From there to the control point.
    Wrist,
    /// From the control point to the tip of the finger on the left, the tip frame's y.
    LeftFinger,
    /// From the control point to the tip of the other finger.
    RightFinger,
}

impl Link {
    /// All of them, in the order of [`Instrument::links`].
    pub const ALL: [Self; LINKS] = [
        Self::Shaft,
        Self::Wrist,
        Self::LeftFinger,
        Self::RightFinger,
    ];

    /// What people call it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Shaft => "shaft",
            Self::Wrist => "wrist",
            Self::LeftFinger => "left_finger",
            Self::RightFinger => "right_finger",
        }
    }
}

/// Where the instrument's links end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instrument {
    /// The remote centre, where the shaft begins, m.
    pub rcm_m: Vector3<f64>,
    /// The wrist-pitch axis on the shaft, m.
    pub wrist_m: Vector3<f64>,
    /// The control point, m.
    pub tip_m: Vector3<f64>,
    /// The tips of the fingers, left and right, m.
    pub fingers_m: [Vector3<f64>; 2],
}

words!(Instrument {
    rcm_m: Vector3<f64>,
    wrist_m: Vector3<f64>,
    tip_m: Vector3<f64>,
    fingers_m: [Vector3<f64>; 2],
});

impl Instrument {
    /// The instrument in the RCM frame, with the jaw at `jaw` rad.
    #[must_use]
    pub fn new(frames: &Frames, jaw: f64) -> Self {
        let (along, across) = opening(jaw);
        let side = frames.wrist_yaw_axis.cross(&frames.approach);
        let finger = |sign: f64| {
            frames.tip_m + (frames.approach * along + side * (sign * across)) * FINGER_M
        };
        Self {
            rcm_m: Vector3::zeros(),
            wrist_m: frames.wrist_m,
            tip_m: frames.tip_m,
            fingers_m: [finger(1.0), finger(-1.0)],
        }
    }

    /// The ends of each link, the one nearer to the remote centre first.
    #[must_use]
    pub const fn links(&self) -> [(Vector3<f64>, Vector3<f64>); LINKS] {
        let [left, right] = self.fingers_m;
        [
            (self.rcm_m, self.wrist_m),
            (self.wrist_m, self.tip_m),
            (self.tip_m, left),
            (self.tip_m, right),
        ]
    }

    /// The instrument seen from another frame.
    #[must_use]
    pub fn moved(&self, frame: &Pose) -> Self {
        let moved = |point_m: &Vector3<f64>| (frame * Point3::from(*point_m)).coords;
        Self {
            rcm_m: moved(&self.rcm_m),
            wrist_m: moved(&self.wrist_m),
            tip_m: moved(&self.tip_m),
            fingers_m: self.fingers_m.each_ref().map(moved),
        }
    }
}

/// Cosine and sine of each finger's angle from the approach direction. Negative jaw angles press
/// the closed fingers together.
fn opening(jaw: f64) -> (f64, f64) {
    let half = 0.5 * jaw.clamp(0.0, JAW_MAX);
    (half.cos(), half.sin())
}

/// Axes, points and joint motion of one commanded state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KinematicState {
    /// Axes and points, RCM frame.
    pub frames: Frames,
    /// The links' ends, RCM frame.
    pub instrument: Instrument,
    /// Joints, then jaw.
    pub position: [f64; AXES],
}

impl KinematicState {
    /// The stance at `state`.
    #[must_use]
    pub fn new(state: &MotionState) -> Self {
        let joints: JointVector = state.joints();
        let frames = Frames::at(&joints);
        let jaw = state.position[super::motion::JAW];
        Self {
            frames,
            instrument: Instrument::new(&frames, jaw),
            position: state.position,
        }
    }

    /// Velocity of the point of `link` that is at `point_m` (RCM frame) per joint and jaw velocity,
    /// in the RCM frame.
    ///
    /// For the shaft the point is `fraction` of the way from the remote centre, where the insertion
    /// does not move it, to the wrist.
    ///
    /// Rows x, y, z, in m/s per rad/s (per m/s for the insertion); columns the six joints and the
    /// jaw. `fraction` counts for the shaft alone. A finger turns by half the jaw's velocity, and
    /// not at all where the jaw is outside 0 to `JAW_MAX`.
    #[must_use]
    pub fn point_jacobian(
        &self,
        link: Link,
        point_m: &Vector3<f64>,
        fraction: f64,
    ) -> PointJacobian {
        let frames = &self.frames;
        let from_wrist = point_m - frames.wrist_m;
        let from_tip = point_m - frames.tip_m;
        let zero = Vector3::zeros();
        let mut columns = [
            frames.yaw_axis.cross(point_m),
            frames.pitch_axis.cross(point_m),
            frames.shaft,
            frames.shaft.cross(&from_wrist),
            frames.wrist_pitch_axis.cross(&from_wrist),
            frames.wrist_yaw_axis.cross(&from_tip),
            zero,
        ];
        match link {
            Link::Shaft => {
                columns[2] *= fraction;
                (columns[3], columns[4], columns[5]) = (zero, zero, zero);
            }
            Link::Wrist => columns[5] = zero,
            Link::LeftFinger => columns[6] = self.opening_axis().cross(&from_tip),
            Link::RightFinger => columns[6] = -self.opening_axis().cross(&from_tip),
        }
        PointJacobian::from_columns(&columns)
    }

    /// What the left finger turns about per jaw velocity; the right one turns the other way.
    fn opening_axis(&self) -> Vector3<f64> {
        let jaw = self.position[super::motion::JAW];
        if (0.0..=JAW_MAX).contains(&jaw) {
            self.frames.wrist_yaw_axis * 0.5
        } else {
            Vector3::zeros()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{KinematicState, LINKS, Link};
    use crate::motion::{AXES, JAW, MotionState};
    use hal::psm::{FINGER_M, POSITION_MAX, POSITION_MIN};
    use hal::random::SplitMix64;

    fn random_state(random: &mut SplitMix64) -> MotionState {
        let position = core::array::from_fn(|axis| match axis {
            JAW => random.between(0.05, 1.3),
            2 => random.between(0.06, 0.23),
            _ => random.between(POSITION_MIN[axis], POSITION_MAX[axis]),
        });
        MotionState {
            position,
            velocity: core::array::from_fn(|_| random.between(-1.0, 1.0)),
            acceleration: [0.0; AXES],
        }
    }

    #[test]
    fn points_move_as_their_jacobians_say() {
        let mut random = SplitMix64::new(41);
        let step = 1e-6;
        for _ in 0..2_000 {
            let mut state = random_state(&mut random);
            let here = KinematicState::new(&state);
            let velocity = nalgebra::SVector::<f64, AXES>::from(state.velocity);
            for axis in 0..AXES {
                state.position[axis] += step * state.velocity[axis];
            }
            let there = KinematicState::new(&state);
            let fraction = random.between(0.0, 1.0);
            let ends = here.instrument.links().into_iter();
            let later = there.instrument.links().into_iter();
            for (link, (before, after)) in Link::ALL.into_iter().zip(ends.zip(later)) {
                let at = |ends: (nalgebra::Vector3<f64>, nalgebra::Vector3<f64>)| {
                    ends.0 + (ends.1 - ends.0) * fraction
                };
                let moved = (at(after) - at(before)) / step;
                let said = here.point_jacobian(link, &at(before), fraction) * velocity;
                assert!((moved - said).norm() < 1e-5, "{link:?}: {moved} {said}");
            }
        }
    }

    #[test]
    fn fingers_open_evenly_about_the_approach_direction() {
        let mut random = SplitMix64::new(42);
        let state = random_state(&mut random);
        let stance = KinematicState::new(&state);
        let [left, right] = stance.instrument.fingers_m;
        let between = (left - stance.frames.tip_m).angle(&(right - stance.frames.tip_m));
        assert!((between - state.position[JAW]).abs() < 1e-12);
        let middle = (left + right) / 2.0 - stance.frames.tip_m;
        assert!(middle.angle(&stance.frames.approach) < 1e-7);
        assert!(((left - stance.frames.tip_m).norm() - FINGER_M).abs() < 1e-15);
        assert_eq!(stance.instrument.links().len(), LINKS);
    }
}
