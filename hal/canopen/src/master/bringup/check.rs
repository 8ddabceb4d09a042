//! The last questions to every node before its drive gets a SYNC: whether anything is wrong with
//! it, and whether it still has its settings.
//!
//! What a node says by itself may be lost, or was said before it counted; and it is said once. What
//! it answers can't be missed.

use super::super::link::Bus;
use super::super::plan::ArmPlan;
use super::BringUpError;
use super::exchange::Exchange;
use crate::cia301::emcy::{ErrorRegister, register};
use crate::cia402::Mode;
use crate::index;

/// Bits of 1001h that a sound drive may have: that there is something, and that it concerns the
/// communication. Until the SYNC comes it misses heartbeat, SYNC, and set-points.
const SOUND: u8 = register::GENERIC | register::COMMUNICATION;

/// Asks the node of `axis`, which was given the home offset `home` if it has one.
///
/// A restart takes away its heartbeat, its mode, and its reference: of these a drive may have
/// stored one or the other, of the bus or of the axis, but hardly all.
pub(super) async fn node<B: Bus>(
    exchange: &Exchange<'_, B>,
    plan: &ArmPlan,
    axis: usize,
    home: Option<u32>,
) -> Result<(), BringUpError> {
    let who = plan.who(axis);
    let read = |address| exchange.read_number(who.line, who.node, address);
    let [register, ..] = read(index::ERROR_REGISTER).await?.to_le_bytes();
    if register & !SOUND != 0 {
        let register = ErrorRegister(register);
        return Err(BringUpError::Unsound { who, register });
    }
    let [mode] = Mode::CyclicPosition.raw().to_le_bytes();
    let settings = [
        (index::HEARTBEAT, Some(plan.heartbeat_ms.into())),
        (index::MODE, Some(mode.into())),
        (index::HOME_OFFSET, home),
    ];
    for (address, expected) in settings {
        let Some(expected) = expected else {
            continue;
        };
        let found = read(address).await?;
        if found != expected {
            return Err(BringUpError::Forgotten {
                who,
                address,
                expected,
                found,
            });
        }
    }
    Ok(())
}
