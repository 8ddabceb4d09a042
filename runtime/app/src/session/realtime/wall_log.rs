//! What the log says of the time of day. Its own times are of a clock that nobody can set; these
//! events say which time of day they are.

use hal::TimeNs;
use trocar_log::Level;

use super::signals::Signals;
use crate::rt::{self, MonotonicClock, WallClock};

/// Time from one look at the clocks to the next, ns.
const LOOK_EVERY_NS: u64 = 100_000_000;

/// Tells when a run was, and when the system's clock is set while it goes on.
pub(super) struct WallLog {
    /// The run's.
    clock: MonotonicClock,
    wall: WallClock,
    looked: Option<TimeNs>,
}

impl WallLog {
    /// By the run's `clock`.
    pub(super) fn new(clock: MonotonicClock) -> Self {
        Self {
            clock,
            wall: WallClock::default(),
            looked: None,
        }
    }

    /// Looks now and then.
    pub(super) fn look(&mut self, signals: &Signals) {
        let now = self.clock.now();
        match self.looked {
            Some(looked) if now.since(looked) < LOOK_EVERY_NS => return,
            Some(_) => {}
            None => {
                let text = format!("the system's clock says {}", rt::wall_time());
                signals.tell(now, Level::Info, &text);
            }
        }
        self.looked = Some(now);
        if let Some(set_ns) = self.wall.set_ns() {
            let seconds = TimeNs(set_ns.unsigned_abs()).seconds();
            let how = if set_ns > 0 { "ahead" } else { "back" };
            let says = rt::wall_time();
            let text = format!(
                "the system's clock was set {how} by {seconds:.3} s and says {says}; the run goes by another"
            );
            signals.tell(now, Level::Warning, &text);
        }
    }
}
