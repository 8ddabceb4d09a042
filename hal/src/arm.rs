//! The interface to a robot: feedback, command, and the trait that every backend implements.

use core::fmt;

use crate::joints::INSERTION;
use crate::psm::{JAW_MAX, JAW_MIN, POSITION_MAX, POSITION_MIN};
use crate::{JointVector, SafeTail, TimeNs};

/// Names of the arms of a run in topics, logs and datasets, in their order; the first is the one
/// that every run has.
pub const ARM_NAMES: [&str; 2] = ["psm1", "psm2"];

/// The names of the first `count` arms: those of a run with so many.
pub fn arm_names(count: usize) -> impl Iterator<Item = &'static str> {
    ARM_NAMES.into_iter().take(count)
}

/// How far beyond an axis's mechanical range a measurement is believed, rad, and m for the
/// insertion.
const BELIEVED_RAD: f64 = 0.2;
const BELIEVED_M: f64 = 0.02;

/// What an arm measured in one control period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmState {
    /// When it was measured.
    pub stamp: TimeNs,
    /// Joint positions, rad (insertion m).
    pub position: JointVector,
    /// Joint velocities, rad/s (m/s).
    pub velocity: JointVector,
    /// Joint efforts, N m (N).
    pub effort: JointVector,
    /// Angle between the two jaw fingers, rad; 0 is closed.
    pub jaw_position: f64,
    /// Rate of the jaw angle, rad/s.
    pub jaw_velocity: f64,
    /// Jaw effort, N m; negative closes.
    pub jaw_effort: f64,
}

impl ArmState {
    /// An arm at rest at `position` with the jaw at `jaw_position`.
    #[must_use]
    pub fn at_rest(stamp: TimeNs, position: JointVector, jaw_position: f64) -> Self {
        Self {
            stamp,
            position,
            velocity: JointVector::zeros(),
            effort: JointVector::zeros(),
            jaw_position,
            jaw_velocity: 0.0,
            jaw_effort: 0.0,
        }
    }

    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let vectors = [&self.position, &self.velocity, &self.effort];
        vectors.iter().all(|v| v.iter().all(|x| x.is_finite()))
            && self.jaw_position.is_finite()
            && self.jaw_velocity.is_finite()
            && self.jaw_effort.is_finite()
    }

    /// The first axis, 6 for the jaw, that is measured where no instrument can be, and where: far
    /// beyond its mechanical range. Such an outlier must not become the place where an arm is
    /// enabled.
    #[must_use]
    pub fn impossible(&self) -> Option<(u8, f64)> {
        let joints = POSITION_MIN.iter().zip(&POSITION_MAX).zip(&self.position);
        let jaw = ((&JAW_MIN, &JAW_MAX), &self.jaw_position);
        let mut axes = (0..).zip(joints.chain([jaw]));
        axes.find_map(|(axis, ((low, high), value))| {
            let slack = if usize::from(axis) == INSERTION {
                BELIEVED_M
            } else {
                BELIEVED_RAD
            };
            let possible = (low - slack..=high + slack).contains(value);
            (!possible).then_some((axis, *value))
        })
    }
}

/// One setpoint for an arm: position with the velocity and acceleration that go with it.
///
/// The jaw angle may be commanded below contact; the position error is then the grip force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmCommand {
    /// The control period it is meant for.
    pub stamp: TimeNs,
    /// Joint positions, rad (insertion m).
    pub position: JointVector,
    /// Joint velocities, rad/s (m/s).
    pub velocity: JointVector,
    /// Joint accelerations, rad/s² (m/s²); information, drives need not use it.
    pub acceleration: JointVector,
    /// Angle between the jaw fingers, rad.
    pub jaw_position: f64,
    /// Rate of the jaw angle, rad/s.
    pub jaw_velocity: f64,
    /// Whether the drives should hold torque at all.
    pub enabled: bool,
}

impl ArmCommand {
    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let vectors = [&self.position, &self.velocity, &self.acceleration];
        vectors.iter().all(|v| v.iter().all(|x| x.is_finite()))
            && self.jaw_position.is_finite()
            && self.jaw_velocity.is_finite()
    }
}

/// An arm: simulated, on a bus, or replayed.
///
/// A backend is read once and written once a control period, in that order. Before the first write
/// it holds the position at which it was found. When no further command comes it finishes alone the
/// stop that came with the last one.
///
/// `tests/tests/conformance.rs` holds every backend to what is said here.
pub trait Arm {
    /// The newest measurement at `now`.
    ///
    /// Its stamp is when it was measured: never later than `now`, and never earlier than that of
    /// the measurement before. As long as nothing newer has come the same measurement is given
    /// again; reading more often changes nothing.
    ///
    /// # Errors
    /// [`ArmError`] when the measurement is lost or the drives have failed; the controller then
    /// faults. A measurement that was lost may be followed by others. Drives that have failed stay
    /// so until the operator has brought them up again.
    fn read(&mut self, now: TimeNs) -> Result<ArmState, ArmError>;

    /// Hands over one setpoint, with the checked stop that follows if no other does.
    ///
    /// A backend that gets no further command must play `tail` to rest, from the control period
    /// after `command` on, and then hold: for good, since only another command may move it again.
    /// If `tail` is disabled the drives let go when it begins, and it never enables them.
    /// [`TailPlayer`](crate::tail::TailPlayer) does this for a backend that commands every period
    /// itself; one whose drives are out of reach when its own process dies sends them
    /// [`SafeTail::points`] ahead.
    ///
    /// A command after periods of silence must follow from where `tail` had led by then: a backend
    /// bridges no jump.
    ///
    /// If any number of `command` or `tail` is not finite both are refused: it is a period without
    /// a command.
    ///
    /// # Errors
    /// [`ArmError`] when it could not be sent, as after a failure of the drives.
    fn write(&mut self, command: &ArmCommand, tail: &SafeTail) -> Result<(), ArmError>;
}

/// Why an arm could not be read or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmError {
    /// No measurement arrived for this period.
    MeasurementLost {
        /// Age of the newest one, ns.
        age_ns: u64,
    },
    /// A drive reported a fault.
    DriveFault {
        /// Joint index, 6 for the jaw.
        axis: u8,
        /// The drive's own code.
        code: u16,
    },
    /// The recording has no more samples.
    EndOfRecording,
}

impl fmt::Display for ArmError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::MeasurementLost { age_ns } => {
                write!(f, "no measurement for {:.4} s", TimeNs(*age_ns).seconds())
            }
            Self::DriveFault { axis, code } => {
                write!(f, "drive of axis {axis} reports fault {code:#06x}")
            }
            Self::EndOfRecording => write!(f, "the recording has ended"),
        }
    }
}

impl std::error::Error for ArmError {}
