//! Measurements and commands as joint messages, and back.
//!
//! Units are rad, rad/s, rad/s² and N m, of the insertion m, m/s, m/s² and N. Doubles travel as
//! they are, NaN included, so that a measurement is read back to the bit.

use hal::joints::JOINT_NAMES;
use hal::{ArmCommand, ArmState, JOINT_COUNT, JointVector, TimeNs};

use super::messages::{JointState, JointStates, Timestamp};

/// Names of the jaw's joints: measured and commanded.
///
/// Both are in one message, told apart by these names: the jaw's stamp is the command's.
const JAW: &str = "jaw";
const JAW_SETPOINT: &str = "jaw_setpoint";

/// The joint messages of one arm in one tick, built once and filled in place.
pub(super) struct JointMessages {
    /// `/psm1/measured_js`: position, velocity, effort.
    pub(super) measured: JointStates,
    /// `/psm1/setpoint_js`: position, velocity, acceleration.
    pub(super) setpoint: JointStates,
    /// `/psm1/jaw`: the measured jaw, then its command.
    pub(super) jaw: JointStates,
}

impl JointMessages {
    pub(super) fn new() -> Self {
        Self {
            measured: named(&JOINT_NAMES),
            setpoint: named(&JOINT_NAMES),
            jaw: named(&[JAW, JAW_SETPOINT]),
        }
    }

    /// Fills in a measurement; without one the jaw's measured values are absent and `measured` is
    /// stale.
    pub(super) fn set_measured(&mut self, state: Option<&ArmState>) {
        if let Some(state) = state {
            self.measured.timestamp = Some(Timestamp::new(state.stamp));
            for (index, joint) in self.measured.joints.iter_mut().enumerate() {
                joint.position = state.position.get(index).copied();
                joint.velocity = state.velocity.get(index).copied();
                joint.effort = state.effort.get(index).copied();
            }
        }
        if let Some(jaw) = self.jaw.joints.first_mut() {
            jaw.position = state.map(|state| state.jaw_position);
            jaw.velocity = state.map(|state| state.jaw_velocity);
            jaw.effort = state.map(|state| state.jaw_effort);
        }
    }

    /// Fills in a command.
    pub(super) fn set_command(&mut self, command: &ArmCommand) {
        self.setpoint.timestamp = Some(Timestamp::new(command.stamp));
        self.jaw.timestamp = self.setpoint.timestamp;
        for (index, joint) in self.setpoint.joints.iter_mut().enumerate() {
            joint.position = command.position.get(index).copied();
            joint.velocity = command.velocity.get(index).copied();
            joint.acceleration = command.acceleration.get(index).copied();
        }
        if let Some(jaw) = self.jaw.joints.get_mut(1) {
            jaw.position = Some(command.jaw_position);
            jaw.velocity = Some(command.jaw_velocity);
        }
    }
}

/// Joints of these names without values.
fn named(names: &[&str]) -> JointStates {
    let joints = names.iter().map(|name| JointState {
        name: (*name).to_owned(),
        ..JointState::default()
    });
    JointStates {
        timestamp: None,
        joints: joints.collect(),
    }
}

/// The measurement in a pair of messages; `None` if something is missing.
///
/// The stamp is that of `measured`: when the arm was measured, which may be before the tick.
pub(super) fn state(measured: &JointStates, jaw: &JointStates) -> Option<ArmState> {
    let finger = jaw.joints.iter().find(|joint| joint.name == JAW)?;
    Some(ArmState {
        stamp: stamp(measured)?,
        position: vector(measured, |joint| joint.position)?,
        velocity: vector(measured, |joint| joint.velocity)?,
        effort: vector(measured, |joint| joint.effort)?,
        jaw_position: finger.position?,
        jaw_velocity: finger.velocity?,
        jaw_effort: finger.effort?,
    })
}

/// The command in a pair of messages; `None` if something is missing.
pub(super) fn command(
    setpoint: &JointStates,
    jaw: &JointStates,
    enabled: bool,
) -> Option<ArmCommand> {
    let finger = jaw.joints.iter().find(|joint| joint.name == JAW_SETPOINT)?;
    Some(ArmCommand {
        stamp: stamp(setpoint)?,
        position: vector(setpoint, |joint| joint.position)?,
        velocity: vector(setpoint, |joint| joint.velocity)?,
        acceleration: vector(setpoint, |joint| joint.acceleration)?,
        jaw_position: finger.position?,
        jaw_velocity: finger.velocity?,
        enabled,
    })
}

fn stamp(message: &JointStates) -> Option<TimeNs> {
    message.timestamp?.time()
}

/// A number of each joint, rad or m; none if a joint is missing or has another name.
fn vector(
    message: &JointStates,
    value: impl Fn(&JointState) -> Option<f64>,
) -> Option<JointVector> {
    if message.joints.len() != JOINT_COUNT {
        return None;
    }
    let mut vector = JointVector::zeros();
    for ((entry, joint), name) in vector.iter_mut().zip(&message.joints).zip(JOINT_NAMES) {
        if joint.name != name {
            return None;
        }
        *entry = value(joint)?;
    }
    Some(vector)
}
