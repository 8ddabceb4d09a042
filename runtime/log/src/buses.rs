//! CAN buses of a run's arms: their load and error counters.

use serde::{Deserialize, Serialize};

/// `/buses`: the buses, in the order of their interfaces' names.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BusesRecord {
    /// All of them.
    pub buses: Vec<BusRecord>,
}

/// What the kernel counts of a bus.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BusRecord {
    /// The interface.
    pub interface: String,
    /// Frames a second, both ways.
    pub frames_per_s: f64,
    /// Share of the last second for which it was busy at most, at its bit rate.
    pub load: f64,
    /// Errors and dropped frames since the interface is there.
    pub errors: u64,
}

impl BusesRecord {
    /// Reads a message of `/buses`; none if it is of another form.
    #[must_use]
    pub fn read(message: &[u8]) -> Option<Self> {
        serde_json::from_slice(message).ok()
    }
}
