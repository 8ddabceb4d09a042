//! Time as an argument: whole nanoseconds since the start of a run.

use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;
use serde::{Deserialize, Serialize};

/// One control period at 1 kHz, in nanoseconds.
pub const TICK_NS: u64 = 1_000_000;

/// The same, s.
pub const TICK_S: f64 = 1e-3;

/// A point in time, in nanoseconds since the run began.
///
/// In lockstep it is the tick counter times [`TICK_NS`]; in a real-time run the driver supplies it.
/// Nothing else reads a clock.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Serialize,
    Deserialize,
    ZeroCopySend,
)]
#[repr(C)]
#[type_name("trocar/time_ns/1")]
#[serde(transparent)]
pub struct TimeNs(pub u64);

impl TimeNs {
    /// The time at which `tick` begins.
    #[must_use]
    pub const fn from_tick(tick: u64) -> Self {
        Self(tick * TICK_NS)
    }

    /// The tick that this time falls into.
    #[must_use]
    pub const fn tick(self) -> u64 {
        self.0 / TICK_NS
    }

    /// Nanoseconds from `earlier` to `self`, zero if `earlier` is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }

    /// This time moved forward.
    #[must_use]
    pub const fn plus_ns(self, delta_ns: u64) -> Self {
        Self(self.0 + delta_ns)
    }

    /// In seconds, for people and plots; never for control.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "exact below 104 days")]
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }
}
