//! All that goes wrong beside the chunks: an operator who presses everything, and measurements that
//! are lost or make no sense.

use hal::{ArmError, ArmState, JOINT_COUNT};

use super::kinds::{below, ticks};
use crate::{OperatingState, OperatorEvent};
use hal::random::SplitMix64;

/// Trouble for one arm. Whatever happens, the arm is enabled again sooner or later.
#[derive(Debug, Default)]
pub(super) struct Trouble {
    wait: u32,
    slow: bool,
    effort_n_m: f64,
}

impl Trouble {
    /// What the operator of an arm in `state` does in this tick.
    pub(super) fn operator(
        &mut self,
        random: &mut SplitMix64,
        state: OperatingState,
    ) -> Option<OperatorEvent> {
        if self.wait > 0 {
            self.wait -= 1;
            return random.happens(1e-3).then(|| any(random));
        }
        // Now and then while the arm still moves.
        self.wait = ticks(random, 1, 400);
        match state {
            OperatingState::Disabled => Some(OperatorEvent::Enable),
            OperatingState::Fault => Some(OperatorEvent::Clear),
            OperatingState::Paused => Some(OperatorEvent::Resume),
            OperatingState::Enabled if self.slow => {
                self.slow = false;
                Some(OperatorEvent::Speed { percent: 100 })
            }
            OperatingState::Enabled => {
                if !random.happens(0.05) {
                    return None;
                }
                let event = any(random);
                self.slow = matches!(event, OperatorEvent::Speed { .. });
                Some(event)
            }
        }
    }

    /// What is measured of `arm` in this tick. An arm without torque is believed wherever it is, so
    /// it is not said to jump.
    pub(super) fn measured(
        &mut self,
        random: &mut SplitMix64,
        arm: &ArmState,
        powered: bool,
    ) -> Result<ArmState, ArmError> {
        if random.happens(2e-3) {
            self.effort_n_m = [0.0, 0.02, -0.05, -0.056, -0.2][below(random, 5)];
        }
        let mut measured = *arm;
        measured.jaw_effort = self.effort_n_m;
        if !powered {
            // Nobody holds it: it trembles.
            for position in measured.position.iter_mut() {
                *position += random.between(-2e-6, 2e-6);
            }
        }
        if !random.happens(1.5e-4) {
            return Ok(measured);
        }
        let joint = below(random, JOINT_COUNT);
        match below(random, 6) {
            0 => return Err(ArmError::MeasurementLost { age_ns: 60_000_000 }),
            1 => {
                let axis = u8::try_from(joint).unwrap();
                return Err(ArmError::DriveFault { axis, code: 0x7305 });
            }
            2 => measured.position[joint] = f64::NAN,
            3 => measured.velocity[joint] = f64::INFINITY,
            4 if powered => measured.position[joint] += random.between(0.6, 2.0),
            _ => measured.jaw_position = f64::NEG_INFINITY,
        }
        Ok(measured)
    }
}

fn any(random: &mut SplitMix64) -> OperatorEvent {
    match below(random, 6) {
        0 => OperatorEvent::Enable,
        1 => OperatorEvent::Disable,
        2 => OperatorEvent::Pause,
        3 => OperatorEvent::Resume,
        4 => OperatorEvent::Clear,
        _ => OperatorEvent::Speed {
            percent: u8::try_from(random.next_u64() % 130).unwrap(),
        },
    }
}
