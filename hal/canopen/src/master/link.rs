//! The interface between the master and its buses: sockets, or buses in memory.

use crate::Frame;
use hal::TimeNs;

/// What comes from a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A frame that another node sent.
    Frame(Frame),
    /// The controller, or the system around it, is in trouble.
    ControllerEvent(ControllerEvent),
}

/// A state change or error that a CAN controller reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControllerEvent {
    /// It counted too many errors and has left the bus.
    BusOff,
    /// It was off the bus and is back.
    Restarted,
    /// Error passive: it counts many errors, and no longer destroys frames in which it finds one.
    ErrorPassive,
    /// Error active again: it counts few errors.
    ErrorActive,
    /// Frames were lost on their way from the bus to us, this many.
    Lost(u32),
    /// A frame that no CANopen device sends: a 29-bit identifier or a remote frame.
    Foreign,
    /// The interface is gone or down.
    Down,
}

/// One to three buses, numbered from 0, and the time.
pub trait Bus {
    /// What time it is.
    fn now(&self) -> TimeNs;

    /// Hands `frames` to the controller of `line`, without waiting; gives how many it took. Fewer
    /// than all means that its queue is full.
    fn send(&mut self, line: u8, frames: &[Frame]) -> usize;

    /// Hands everything that has come on `line` to `sink`, oldest first, without waiting.
    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received));

    /// Forgets what waits to be sent on `line`, so that no stale command leaves later.
    fn flush(&mut self, line: u8);

    /// Waits until `until` or a little later. Only for bring-up and shut-down, never in the cycle.
    fn wait(&mut self, until: TimeNs);
}
