//! Homing of one axis: control words as set-points with a SYNC, status words from its dictionary.

use super::super::client::{LOOK_NS, read_number, send, write};
use super::super::fault::Who;
use super::super::link::Bus;
use super::super::plan::ArmPlan;
use super::BringUpError;
use crate::cia301::cob::PdoNumber;
use crate::cia301::emcy::ErrorCode;
use crate::cia301::sync::Sync;
use crate::cia301::{AbortCode, Cob, NmtCommand, NmtTarget};
use crate::cia402::{Command, Control, Mode, PowerState, Status};
use crate::index;
use crate::{Frame, Payload};

/// How long one step may take, ns.
const STEP_NS: u64 = 1_000_000_000;
/// Method 37: the present position is the reference.
const PRESENT_POSITION: i8 = 37;

/// Gives `axis` the position that its absolute encoder says; its home offset then, none if it has no such object.
pub(super) fn home<B: Bus>(
    bus: &mut B,
    plan: &ArmPlan,
    axis: usize,
) -> Result<Option<u32>, BringUpError> {
    let who = plan.who(axis);
    let (line, node) = (who.line, who.node);
    let position = read_number(bus, line, node, index::POSITION)?;
    let told = match write(bus, line, node, index::HOME_OFFSET, &position.to_le_bytes()) {
        // A drive without a home offset calls its reference zero, which is right if it stands there.
        Err(BringUpError::Refused { code, .. })
            if code == AbortCode::NO_OBJECT && position == 0 =>
        {
            None
        }
        other => other.map(|()| Some(position))?,
    };
    let method = PRESENT_POSITION.to_le_bytes();
    write(bus, line, node, index::HOMING_METHOD, &method)?;
    let mode = |mode: Mode| mode.raw().to_le_bytes();
    write(bus, line, node, index::MODE, &mode(Mode::Homing))?;
    send(bus, line, NmtCommand::Start.emit(NmtTarget::Node(node)))?;
    let homed = reference(bus, plan, axis, position);
    // Whatever homing came to, the drive is let go.
    let control = Control::new(Command::DisableVoltage);
    let let_go = step(bus, plan, axis, control, position, |status| {
        status.state == PowerState::SwitchOnDisabled
    });
    // One that does not go is stopped: pre-operational takes nobody's torque, see CiA 402-2.
    let leave = match let_go {
        Ok(()) => NmtCommand::EnterPreOperational,
        Err(_) => NmtCommand::Stop,
    };
    send(bus, line, leave.emit(NmtTarget::Node(node)))?;
    homed?;
    let_go?;
    write(bus, line, node, index::MODE, &mode(Mode::CyclicPosition))?;
    Ok(told)
}

fn reference<B: Bus>(
    bus: &mut B,
    plan: &ArmPlan,
    axis: usize,
    position: u32,
) -> Result<(), BringUpError> {
    for (command, state) in [
        (Command::Shutdown, PowerState::ReadyToSwitchOn),
        (Command::SwitchOn, PowerState::SwitchedOn),
        (Command::EnableOperation, PowerState::OperationEnabled),
    ] {
        let control = Control::new(command);
        step(bus, plan, axis, control, position, |status| {
            status.state == state
        })?;
    }
    let start = Control {
        start: true,
        ..Control::new(Command::EnableOperation)
    };
    step(bus, plan, axis, start, position, |status| {
        status.follows && status.target_reached && !status.deviation
    })
}

/// Gives the control word, with the target where the axis is, until the status word is as it should be.
fn step<B: Bus>(
    bus: &mut B,
    plan: &ArmPlan,
    axis: usize,
    control: Control,
    target: u32,
    reached: impl Fn(&Status) -> bool,
) -> Result<(), BringUpError> {
    let who = plan.who(axis);
    let (line, node) = (who.line, who.node);
    let [a, b] = control.emit().to_le_bytes();
    let [c, d, e, f] = target.to_le_bytes();
    let id = Cob::ReceivePdo(PdoNumber::FIRST, node).id();
    let set_point = Frame::new(id, Payload::truncated(&[a, b, c, d, e, f]));
    let sync = Sync::counted(1).filter(|_| plan.sync_counter != 0);
    let sync = sync.unwrap_or(Sync::PLAIN).emit(plan.sync_id);
    let end = bus.now().plus_ns(STEP_NS);
    loop {
        send(bus, line, set_point)?;
        send(bus, line, sync)?;
        bus.wait(bus.now().plus_ns(LOOK_NS));
        let status = read_number(bus, line, node, index::STATUS)?;
        let parsed = u16::try_from(status)
            .ok()
            .and_then(|raw| Status::parse(raw).ok());
        if parsed.as_ref().is_some_and(&reached) {
            return Ok(());
        }
        if bus.now() >= end {
            let faulty = parsed.is_some_and(|status| status.state == PowerState::Fault);
            return Err(faulty
                .then(|| reason(bus, who))
                .flatten()
                .unwrap_or(BringUpError::Homing { who, status }));
        }
    }
}

/// Why the drive of `who` is in fault, if it says so.
fn reason<B: Bus>(bus: &mut B, who: Who) -> Option<BringUpError> {
    let code = read_number(bus, who.line, who.node, index::ERROR_CODE).ok()?;
    let code = ErrorCode(u16::try_from(code).ok()?);
    (code != ErrorCode::RESET).then_some(BringUpError::Faulty { who, code })
}
