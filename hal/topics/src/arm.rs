//! An arm in another process: what it measures, and what it is to do. A thousand times a second, so
//! apart from the topics of the run, under
//! [`arms_of`]: whoever waits for a frame is not woken by each of them.
//!
//! ```text
//!  the arm's process ── feedback ──> control process
//!                    <── setpoint ──
//! ```
//!
//! An arm publishes feedback all the time, each period of its own, whether anyone commands it or
//! not. A set-point comes with the rest of the stop that follows it ([`hal::SafeTail`]): an arm
//! that gets no further one plays that to rest, and holds.

use iceoryx2::prelude::ZeroCopySend;

use super::Message;
use hal::tail::{AxisPoint, AxisTail, TAIL_AXES, TAIL_PHASES, TailPhase};
use hal::{ArmCommand, ArmError, ArmState, JOINT_COUNT, JointVector, Measured, SafeTail, TimeNs};

/// The run whose topics carry the arms of the run `topics`.
#[must_use]
pub fn arms_of(topics: &str) -> String {
    format!("{topics}-arms")
}

/// What an arm measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/arm_feedback/1")]
pub struct ArmFeedback {
    /// When it was measured, on the system's monotonic clock.
    pub stamp: TimeNs,
    /// Counts the measurements.
    pub sequence: u64,
    /// Joint positions, rad (insertion m).
    pub position: [f64; JOINT_COUNT],
    /// Joint velocities, rad/s (m/s).
    pub velocity: [f64; JOINT_COUNT],
    /// Joint efforts, N m (N).
    pub effort: [f64; JOINT_COUNT],
    /// Angle between the jaw fingers, rad.
    pub jaw_position: f64,
    /// Rate of the jaw angle, rad/s.
    pub jaw_velocity: f64,
    /// Jaw effort, N m; negative closes.
    pub jaw_effort: f64,
    /// 0 as long as all is well; else one more than the axis whose drive has failed, 7 for the jaw.
    pub fault: u64,
    /// The failed drive's own code.
    pub fault_code: u64,
}

impl Message for ArmFeedback {
    const TOPIC: &'static str = "feedback";
}

impl ArmFeedback {
    /// The feedback of an arm in `state`, whose stamp is the system's.
    #[must_use]
    pub fn new(sequence: u64, state: &ArmState) -> Self {
        Self {
            stamp: state.stamp,
            sequence,
            position: state.position.into(),
            velocity: state.velocity.into(),
            effort: state.effort.into(),
            jaw_position: state.jaw_position,
            jaw_velocity: state.jaw_velocity,
            jaw_effort: state.jaw_effort,
            fault: 0,
            fault_code: 0,
        }
    }

    /// The arm's state, bit for bit, or what its drives report.
    ///
    /// # Errors
    /// [`ArmError::DriveFault`].
    pub fn measured(&self) -> Measured {
        if self.fault != 0 {
            let axis = u8::try_from(self.fault - 1).unwrap_or(u8::MAX);
            let code = u16::try_from(self.fault_code).unwrap_or(u16::MAX);
            return Err(ArmError::DriveFault { axis, code });
        }
        Ok(ArmState {
            stamp: self.stamp,
            position: JointVector::from(self.position),
            velocity: JointVector::from(self.velocity),
            effort: JointVector::from(self.effort),
            jaw_position: self.jaw_position,
            jaw_velocity: self.jaw_velocity,
            jaw_effort: self.jaw_effort,
        })
    }
}

/// One axis on its way to rest: a start, and phases of constant jerk.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/axis_stop/1")]
pub struct AxisStop {
    /// Where it begins, rad (m).
    pub position: f64,
    /// Velocity there, rad/s (m/s).
    pub velocity: f64,
    /// Acceleration there, rad/s² (m/s²).
    pub acceleration: f64,
    /// How long each phase lasts, s.
    pub duration_s: [f64; TAIL_PHASES],
    /// The jerk in each, rad/s³ (m/s³).
    pub jerk: [f64; TAIL_PHASES],
}

impl AxisStop {
    fn new(tail: &AxisTail) -> Self {
        Self {
            position: tail.start.position,
            velocity: tail.start.velocity,
            acceleration: tail.start.acceleration,
            duration_s: tail.phases.map(|phase| phase.duration_s),
            jerk: tail.phases.map(|phase| phase.jerk),
        }
    }

    fn tail(&self) -> AxisTail {
        AxisTail {
            start: AxisPoint {
                position: self.position,
                velocity: self.velocity,
                acceleration: self.acceleration,
            },
            phases: core::array::from_fn(|phase| TailPhase {
                duration_s: self.duration_s[phase],
                jerk: self.jerk[phase],
            }),
        }
    }
}

/// One set-point for an arm, with the stop that follows if no other comes.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("trocar/arm_setpoint/1")]
pub struct ArmSetpoint {
    /// The control period that it is for, on the system's monotonic clock.
    pub stamp: TimeNs,
    /// Counts the set-points.
    pub sequence: u64,
    /// Joint positions, rad (insertion m).
    pub position: [f64; JOINT_COUNT],
    /// Joint velocities, rad/s (m/s).
    pub velocity: [f64; JOINT_COUNT],
    /// Joint accelerations, rad/s² (m/s²).
    pub acceleration: [f64; JOINT_COUNT],
    /// Angle between the jaw fingers, rad; below contact the position error is the grip force.
    pub jaw_position: f64,
    /// Rate of the jaw angle, rad/s.
    pub jaw_velocity: f64,
    /// Whether the drives should hold torque; 0 is no.
    pub enabled: u64,
    /// When the stop starts, on the system's monotonic clock.
    pub stop_stamp: TimeNs,
    /// Whether the drives hold torque on the way and at rest; 0 is no.
    pub stop_enabled: u64,
    /// The stop: the joints in order, then the jaw.
    pub stop: [AxisStop; TAIL_AXES],
}

/// A set-point that is older than this is of no controller that still lives, ns: the arm that has
/// it plays the stop of the one before.
pub const SETPOINT_AGE_NS_MAX: u64 = 100_000_000;

impl Message for ArmSetpoint {
    const TOPIC: &'static str = "setpoint";

    // An arm that makes up for periods that it was late for finds the set-points of then, as long
    // as a controller waits for its measurements.
    const UNREAD: usize = 64;
}

impl ArmSetpoint {
    /// The message of `command` and `tail`, whose stamps are the system's.
    #[must_use]
    pub fn new(sequence: u64, command: &ArmCommand, tail: &SafeTail) -> Self {
        Self {
            stamp: command.stamp,
            sequence,
            position: command.position.into(),
            velocity: command.velocity.into(),
            acceleration: command.acceleration.into(),
            jaw_position: command.jaw_position,
            jaw_velocity: command.jaw_velocity,
            enabled: u64::from(command.enabled),
            stop_stamp: tail.stamp,
            stop_enabled: u64::from(tail.enabled),
            stop: tail.axes.map(|axis| AxisStop::new(&axis)),
        }
    }

    /// The command, bit for bit.
    #[must_use]
    pub fn command(&self) -> ArmCommand {
        ArmCommand {
            stamp: self.stamp,
            position: JointVector::from(self.position),
            velocity: JointVector::from(self.velocity),
            acceleration: JointVector::from(self.acceleration),
            jaw_position: self.jaw_position,
            jaw_velocity: self.jaw_velocity,
            enabled: self.enabled != 0,
        }
    }

    /// The stop, bit for bit.
    #[must_use]
    pub fn tail(&self) -> SafeTail {
        SafeTail {
            stamp: self.stop_stamp,
            axes: self.stop.map(|axis| axis.tail()),
            enabled: self.stop_enabled != 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What comes out on the other side is what went in: bits of the command and of its stop, and a
    /// failed drive by its axis.
    #[test]
    fn messages_hold_commands_stops_and_states_bit_for_bit() {
        let number = |seed: usize| f64::from(u32::try_from(seed).unwrap()) * 0.1 - 0.7;
        let joints = |seed: usize| JointVector::from_fn(|joint, _| number(seed + joint));
        let command = ArmCommand {
            stamp: TimeNs(41),
            position: joints(1),
            velocity: joints(11),
            acceleration: joints(21),
            jaw_position: 0.3,
            jaw_velocity: -0.2,
            enabled: true,
        };
        let tail = SafeTail {
            stamp: TimeNs(42),
            axes: core::array::from_fn(|axis| AxisTail {
                start: AxisPoint {
                    position: number(axis),
                    velocity: number(axis + 3),
                    acceleration: number(axis + 5),
                },
                phases: core::array::from_fn(|phase| TailPhase {
                    duration_s: number(axis + 10 * phase),
                    jerk: number(axis + 20 * phase),
                }),
            }),
            enabled: false,
        };
        let message = ArmSetpoint::new(7, &command, &tail);
        assert_eq!((message.command(), message.tail()), (command, tail));
        let state = ArmState {
            velocity: joints(2),
            effort: joints(4),
            jaw_effort: -0.1,
            ..ArmState::at_rest(TimeNs(9), joints(8), 0.5)
        };
        let feedback = ArmFeedback::new(3, &state);
        assert_eq!(feedback.measured(), Ok(state));
        let failed = ArmFeedback {
            fault: 7,
            fault_code: 0x8611,
            ..feedback
        };
        let axis_and_code = ArmError::DriveFault {
            axis: 6,
            code: 0x8611,
        };
        assert_eq!(failed.measured(), Err(axis_and_code));
    }
}
