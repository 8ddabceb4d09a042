//! Homing of one axis over its dictionary alone, before there are process data.

use super::super::client::{LOOK_NS, read_number, write};
use super::super::link::Bus;
use super::super::plan::ArmPlan;
use super::BringUpError;
use crate::can::cia402::{Command, Control, Mode, PowerState, Status};
use crate::can::od::index;

/// How long one step may take, ns.
const STEP_NS: u64 = 1_000_000_000;
/// Method 37: the present position is the reference.
const PRESENT_POSITION: i8 = 37;

/// Gives `axis` the position that its absolute encoder says.
pub(super) fn home<B: Bus>(bus: &mut B, plan: &ArmPlan, axis: usize) -> Result<(), BringUpError> {
    let who = plan.who(axis);
    let (line, node) = (who.line, who.node);
    let position = read_number(bus, line, node, index::POSITION)?;
    write(bus, line, node, index::HOME_OFFSET, &position.to_le_bytes())?;
    let method = PRESENT_POSITION.to_le_bytes();
    write(bus, line, node, index::HOMING_METHOD, &method)?;
    let mode = |mode: Mode| mode.raw().to_le_bytes();
    write(bus, line, node, index::MODE, &mode(Mode::Homing))?;
    for (command, state) in [
        (Command::Shutdown, PowerState::ReadyToSwitchOn),
        (Command::SwitchOn, PowerState::SwitchedOn),
        (Command::EnableOperation, PowerState::OperationEnabled),
    ] {
        let control = Control::new(command);
        step(bus, plan, axis, control, |status| status.state == state)?;
    }
    let start = Control {
        start: true,
        ..Control::new(Command::EnableOperation)
    };
    // Whatever homing came to, the drive is let go.
    let homed = step(bus, plan, axis, start, |status| {
        status.follows && status.target_reached && !status.deviation
    });
    let control = Control::new(Command::DisableVoltage);
    step(bus, plan, axis, control, |status| {
        status.state == PowerState::SwitchOnDisabled
    })?;
    homed?;
    write(bus, line, node, index::MODE, &mode(Mode::CyclicPosition))
}

/// Writes the control word and waits until the status word is as it should be.
fn step<B: Bus>(
    bus: &mut B,
    plan: &ArmPlan,
    axis: usize,
    control: Control,
    reached: impl Fn(&Status) -> bool,
) -> Result<(), BringUpError> {
    let who = plan.who(axis);
    let (line, node) = (who.line, who.node);
    let word = control.emit().to_le_bytes();
    write(bus, line, node, index::CONTROL, &word)?;
    let end = bus.now().plus_ns(STEP_NS);
    loop {
        let status = read_number(bus, line, node, index::STATUS)?;
        let parsed = u16::try_from(status)
            .ok()
            .and_then(|raw| Status::parse(raw).ok());
        if parsed.as_ref().is_some_and(&reached) {
            return Ok(());
        }
        if bus.now() >= end {
            return Err(BringUpError::Homing { who, status });
        }
        bus.wait(bus.now().plus_ns(LOOK_NS));
    }
}
