//! CAN interfaces of this machine: opened with an error that says what to do, and an error frame on
//! purpose.
//!
//! Both the master's side (`realtime::remote_arms::can`) and the drives' side (`drives`) open their
//! buses here, so that a machine without CAN is explained in the same words.

use std::fs;
use std::path::Path;

use socketcan::{CanErrorFrame, CanSocket, Socket as _};
use trocar_canopen::socket::SocketBus;

use super::SessionError;
use super::drives::{FaultKind, InjectedFault};
use crate::doctor::NO_CAN_REMEDY;
use crate::rig::can_clock::CanClock;
use crate::rt::MonotonicClock;

/// Opens the interfaces `names`, line 0 first.
///
/// `clock` is the bus's own. Interfaces that are down are refused first: the kernel would bind a
/// socket to them and every send would fail later.
///
/// # Errors
/// [`SessionError::Interface`] for one that is not there or is down.
pub(super) fn open(
    names: &[String],
    clock: MonotonicClock,
) -> Result<SocketBus<CanClock>, SessionError> {
    // Index 0 stands for all interfaces, so this asks only whether the kernel knows CAN.
    if let (Err(error), Some(name)) = (CanSocket::open_iface(0), names.first()) {
        return Err(SessionError::Interface {
            name: name.clone(),
            reason: format!("there are no CAN sockets: {error}"),
            remedy: NO_CAN_REMEDY.to_owned(),
        });
    }
    for name in names {
        if is_down(Path::new("/sys/class/net"), name) {
            return Err(SessionError::Interface {
                name: name.clone(),
                reason: "is down".to_owned(),
                remedy: format!("`ip link set {name} up` changes that"),
            });
        }
    }
    SocketBus::open(names, CanClock(clock)).map_err(|error| SessionError::Interface {
        reason: format!("cannot be opened as a CAN interface: {}", error.source),
        remedy: format!(
            "`ip link add dev {0} type vcan && ip link set {0} up` makes a virtual one; see `trocar doctor`",
            error.name
        ),
        name: error.name,
    })
}

/// Whether the system says that `name` is there and down.
///
/// Reads bit 0 (`IFF_UP`) of `flags` in `/sys/class/net/NAME`; false if it cannot be read, and then
/// opening says what is wrong.
fn is_down(folder: &Path, name: &str) -> bool {
    const UP: u32 = 1;
    let flags = fs::read_to_string(folder.join(name).join("flags"));
    let flags = flags.ok().and_then(|text| {
        let digits = text.trim().trim_start_matches("0x").to_owned();
        u32::from_str_radix(&digits, 16).ok()
    });
    flags.is_some_and(|flags| flags & UP == 0)
}

/// Tells every socket on a bus that its controller has left it.
///
/// A virtual CAN interface never goes bus-off, so the error frame that a real controller's driver
/// would raise is written to the bus as a frame, and every socket that asked for error frames
/// receives it.
pub(super) struct BusOffInjector {
    /// Line 0 first; none if nobody will ask.
    sockets: Vec<(String, CanSocket)>,
}

impl BusOffInjector {
    /// Opens the interfaces `names` if one of `faults` wants it.
    ///
    /// # Errors
    /// [`SessionError::Interface`].
    pub(super) fn open(names: &[String], faults: &[InjectedFault]) -> Result<Self, SessionError> {
        let wanted = faults.iter().any(|fault| fault.kind == FaultKind::BusOff);
        let names = names.iter().filter(|_| wanted);
        let sockets = names.map(|name| match CanSocket::open(name) {
            Ok(socket) => Ok((name.clone(), socket)),
            Err(error) => Err(failed(name, &error)),
        });
        Ok(Self {
            sockets: sockets.collect::<Result<_, _>>()?,
        })
    }

    /// Says so on `line`, with the error frame that a controller's driver would give.
    ///
    /// The error class of `linux/can/error.h`, `CAN_ERR_BUSOFF`, without data. Does nothing on a
    /// line that was not opened.
    ///
    /// # Errors
    /// [`SessionError::Interface`].
    pub(super) fn send(&self, line: u8) -> Result<(), SessionError> {
        const BUS_OFF: u32 = 0x040;
        let Some((name, socket)) = self.sockets.get(usize::from(line)) else {
            return Ok(());
        };
        let frame = CanErrorFrame::new_error(BUS_OFF, &[0; 8])
            .map_err(|error| failed(name, &error.to_string()))?;
        socket
            .write_frame(&frame)
            .map_err(|error| failed(name, &error))
    }
}

fn failed(name: &str, error: &impl core::fmt::Display) -> SessionError {
    SessionError::Interface {
        name: name.to_owned(),
        reason: format!("an error frame cannot be sent: {error}"),
        remedy: "see `trocar doctor`".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interface_that_is_not_there_is_named_with_what_to_do() {
        let names = ["nocan7".to_owned()];
        let error = open(&names, MonotonicClock::new()).unwrap_err().to_string();
        let (reason, remedy) = match CanSocket::open_iface(0) {
            Ok(_) => (
                "cannot be opened as a CAN interface: ",
                "ip link add dev nocan7 type vcan",
            ),
            Err(_) => ("there are no CAN sockets: ", NO_CAN_REMEDY),
        };
        assert!(
            error.starts_with(&format!("nocan7: {reason}")) && error.contains(remedy),
            "{error}"
        );
    }

    #[test]
    fn an_interface_that_is_down_is_told_from_one_that_is_up() {
        let folder = std::env::temp_dir().join(format!("trocar-interfaces-{}", std::process::id()));
        for (name, flags) in [("up0", "0x10c1\n"), ("down0", "0x80\n")] {
            fs::create_dir_all(folder.join(name)).unwrap();
            fs::write(folder.join(name).join("flags"), flags).unwrap();
        }
        assert!(is_down(&folder, "down0") && !is_down(&folder, "up0"));
        assert!(!is_down(&folder, "absent0"), "opening it says more");
        fs::remove_dir_all(folder).unwrap();
    }
}
