//! Frames of one bus, sent and awaited with a time limit.

use super::super::link::{Bus, ControllerEvent, Received};
use super::BringUpError;
use crate::Frame;

/// How long a node may take to answer, ns.
pub(super) const TIMEOUT_NS: u64 = 500_000_000;
/// How often the bus is looked at meanwhile, ns.
pub(super) const LOOK_NS: u64 = 500_000;

/// Sends `frame`, waiting for room in the transmit queue. Frames received meanwhile are discarded.
pub(super) fn send<B: Bus>(bus: &mut B, line: u8, frame: Frame) -> Result<(), BringUpError> {
    let end = bus.now().plus_ns(TIMEOUT_NS);
    while bus.send(line, &[frame]) == 0 {
        // An interface that is down takes nothing, and says so only to who listens.
        expect(bus, line, 0, |_| None::<()>)?;
        if bus.now() >= end {
            return Err(BringUpError::CannotSend { line });
        }
        bus.wait(bus.now().plus_ns(LOOK_NS));
    }
    Ok(())
}

/// What `pick` finds among the frames of `line` within `limit_ns`; none if nothing came.
pub(super) fn expect<B: Bus, T>(
    bus: &mut B,
    line: u8,
    limit_ns: u64,
    mut pick: impl FnMut(&Frame) -> Option<T>,
) -> Result<Option<T>, BringUpError> {
    let end = bus.now().plus_ns(limit_ns);
    loop {
        let found = look(bus, line, &mut pick)?;
        if found.is_some() || bus.now() >= end {
            return Ok(found);
        }
        bus.wait(bus.now().plus_ns(LOOK_NS));
    }
}

/// Takes all frames that have come on `line`, and the first thing that `pick` finds in them.
fn look<B: Bus, T>(
    bus: &mut B,
    line: u8,
    pick: &mut impl FnMut(&Frame) -> Option<T>,
) -> Result<Option<T>, BringUpError> {
    let (mut found, mut off) = (None, false);
    bus.receive(line, &mut |received| match received {
        Received::Frame(frame) => {
            if found.is_none() {
                found = pick(&frame);
            }
        }
        // What a controller that was restarted has missed is not known.
        Received::ControllerEvent(
            ControllerEvent::BusOff | ControllerEvent::Restarted | ControllerEvent::Down,
        ) => off = true,
        Received::ControllerEvent(_) => {}
    });
    if off {
        return Err(BringUpError::Off { line });
    }
    Ok(found)
}
