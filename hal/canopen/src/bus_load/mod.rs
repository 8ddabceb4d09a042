//! What a plan of frames costs, and whether a bus can carry it.
//!
//! A plan counts what is on the bus in every cycle while all is well: SYNC, a set-point and an
//! answer an axis, heartbeats. It takes for granted that its nodes say nothing else by themselves,
//! which bring-up sees to (no other PDO, no answer by the clock, no SYNC and no time stamp of a
//! drive's own), and that nodes which are in no plan are silent. What is said when something is
//! wrong (emergencies, which are not held up), and what anybody asks a dictionary, has the share
//! that is left over.

pub mod bits;

use core::fmt;

use crate::number::{real, seconds};

/// Share of the bus that a plan may use at worst-case stuffing, per mille. The rest is for
/// transfers, emergencies and repeated frames.
pub const SHARE_MAX_PER_MILLE: u64 = 950;

/// Frames of one kind in each cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Traffic {
    /// What they are.
    pub what: &'static str,
    /// How many in a cycle.
    pub count: u32,
    /// Data bytes of each.
    pub data_bytes: u8,
}

/// What one bus has to carry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Which bus, from 0.
    pub line: u8,
    /// Bits a second.
    pub bit_rate: u32,
    /// Length of the cycle, ns.
    pub cycle_ns: u64,
    /// Frames of each cycle.
    pub traffic: Vec<Traffic>,
    /// Heartbeats on this bus, master included, and the time between two of one node, ns.
    pub heartbeats: (u32, u64),
}

/// What a plan costs, in bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Load {
    /// A cycle without stuffing.
    pub least: u64,
    /// A cycle with as much stuffing as can be, heartbeats' share included.
    pub most: u64,
    /// A cycle has room for.
    pub room: u64,
}

impl Load {
    /// Worst-case share of the bus, per mille, rounded up.
    #[must_use]
    pub fn per_mille(&self) -> u64 {
        (self.most * 1000).div_ceil(self.room.max(1))
    }
}

impl Plan {
    /// The plan of a bus with `axes`, of which each gets a set-point of `command_bytes` and answers
    /// with `answer_bytes` in every cycle.
    #[must_use]
    pub fn cyclic(
        line: u8,
        bit_rate: u32,
        cycle_ns: u64,
        axes: u32,
        (command_bytes, answer_bytes): (u8, u8),
    ) -> Self {
        let traffic = |what, count, data_bytes| Traffic {
            what,
            count,
            data_bytes,
        };
        Self {
            line,
            bit_rate,
            cycle_ns,
            traffic: vec![
                traffic("SYNC", 1, 0),
                traffic("set-points", axes, command_bytes),
                traffic("answers", axes, answer_bytes),
            ],
            heartbeats: (0, 1),
        }
    }

    /// What it costs.
    #[must_use]
    pub fn load(&self) -> Load {
        let sum = |bits: fn(u8) -> u32| {
            self.traffic
                .iter()
                .map(|kind| u64::from(kind.count) * u64::from(bits(kind.data_bytes)))
                .sum::<u64>()
        };
        let (nodes, period_ns) = self.heartbeats;
        let beats = u64::from(nodes) * u64::from(bits::most(1)) * self.cycle_ns;
        Load {
            least: sum(bits::least),
            most: sum(bits::most) + beats.div_ceil(period_ns.max(1)),
            room: self.cycle_ns * u64::from(self.bit_rate) / 1_000_000_000,
        }
    }

    /// The cost, if the bus can carry it.
    ///
    /// # Errors
    /// [`Overload`] with the arithmetic.
    pub fn check(&self) -> Result<Load, Overload> {
        let load = self.load();
        if load.most * 1000 <= load.room * SHARE_MAX_PER_MILLE {
            Ok(load)
        } else {
            Err(Overload { plan: self.clone() })
        }
    }
}

/// A plan that a bus cannot carry. Its text is the whole calculation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Overload {
    /// The plan.
    pub plan: Plan,
}

impl fmt::Display for Overload {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let plan = &self.plan;
        let load = plan.load();
        write!(f, "bus {}: ", plan.line)?;
        for (n, kind) in plan.traffic.iter().enumerate() {
            let plus = if n == 0 { "" } else { " + " };
            let bits = bits::most(kind.data_bytes);
            write!(f, "{plus}{} {} x {bits}", kind.count, kind.what)?;
        }
        if plan.heartbeats.0 > 0 {
            write!(f, " + heartbeats of {} nodes", plan.heartbeats.0)?;
        }
        let cycle_us = seconds(plan.cycle_ns) * 1e6;
        let rate_mbit_s = f64::from(plan.bit_rate) * 1e-6;
        let share = real(i64::try_from(load.per_mille()).unwrap_or(i64::MAX)) / 10.0;
        write!(
            f,
            " = {} bits with stuffing, but a cycle of {cycle_us} us at {rate_mbit_s} Mbit/s has {}: {share:.1} % of the \
             bus, of which at most {} % may be planned; use more buses or a longer cycle",
            load.most,
            load.room,
            SHARE_MAX_PER_MILLE / 10,
        )
    }
}

impl std::error::Error for Overload {}
