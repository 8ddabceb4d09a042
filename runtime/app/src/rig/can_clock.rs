//! The runtime's clock, lent to CAN buses.
//!
//! The bus code reads and waits on a clock that it is given, so that its tests need none; in a run
//! all buses, the control thread and the log have this one.

use hal::TimeNs;
use trocar_canopen::socket::Clock;

use crate::rt::MonotonicClock;

/// A monotonic clock for the master or the drives of a bus.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CanClock(pub(crate) MonotonicClock);

impl Clock for CanClock {
    fn now(&self) -> TimeNs {
        self.0.now()
    }

    fn wait(&mut self, until: TimeNs) {
        self.0.wait_until(until);
    }
}
