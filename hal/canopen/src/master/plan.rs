//! Which node drives which axis on which bus, and how fast.

use super::space::Space;
use crate::bus_load::{Overload, Plan};
use crate::number::{turns_a_minute, whole};
use crate::{CanId, NodeId};
use hal::count::count_u8;
use hal::tail::TAIL_AXES;

/// Data bytes of a set-point: control word and target position.
pub const COMMAND_BYTES: u8 = 6;
/// Data bytes of an answer: status word, actual position, actual torque.
pub const ANSWER_BYTES: u8 = 8;

/// Seconds in which a drive comes to rest from its greatest speed: a ramp, a quick stop.
const RAMP_S: f64 = 0.1;
const QUICK_STOP_S: f64 = 0.02;

/// An axis with the node that drives it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisNode {
    /// Joint index, 6 for the jaw.
    pub axis: u8,
    /// Its node.
    pub node: NodeId,
    /// The bus that it is on, from 0.
    pub line: u8,
}

/// One axis on a bus. Units are those of its space: rad, or m for the insertion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisPlan {
    /// Its node.
    pub node: NodeId,
    /// The bus, from 0.
    pub line: u8,
    /// Vendor and product that the node must say it is; 1018h:01 and :02.
    pub identity: (u32, u32),
    /// Counts a unit.
    pub counts_per_unit: f64,
    /// Counts a turn of the motor, 608Fh: CiA 402 has the motor's greatest speed in turns a minute.
    pub counts_per_turn: u32,
    /// Where it may be sent, least and greatest, units; no further than the mechanical stops, see
    /// [`Self::settings`].
    pub range: (f64, f64),
    /// Greatest speed that is believed of it, units/s.
    pub speed_max: f64,
    /// Distance from the set-point that is a fault, units.
    pub following_max: f64,
    /// Torque at 1000 per mille, N m (N).
    pub torque_rated: f64,
}

/// A homing sequence of a drive, in which it moves its axis: CiA 402-2, clause 10. Units are those
/// of the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingPlan {
    /// The axis.
    pub axis: u8,
    /// 6098h; a method that moves.
    pub method: i8,
    /// The position that the axis has at its home point, units; 607Ch.
    pub home_position: f64,
    /// Speed towards the switch, units/s; 6099h:01.
    pub switch_speed: f64,
    /// Speed at which the home point is found, units/s; 6099h:02.
    pub zero_speed: f64,
    /// Acceleration and deceleration, units/s²; 609Ah.
    pub acceleration: f64,
    /// How long it may take, ns.
    pub time_out_ns: u64,
}

/// The limits that a drive keeps by itself, in counts of its encoder: bring-up writes them, and
/// emulated drives have them from the beginning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisSettings {
    /// Least and greatest position, counts; 607Dh.
    pub range: (i32, i32),
    /// Greatest speed, counts/s; 607Fh.
    pub speed_max: u32,
    /// Deceleration of a ramp (6084h) and of a quick stop (6085h), counts/s².
    pub decelerations: (u32, u32),
    /// Following error window, counts; 6065h.
    pub following_window: u32,
}

/// An arm on one to three buses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmPlan {
    /// Buses.
    pub lines: u8,
    /// Bits a second on each.
    pub bit_rate: u32,
    /// Time between two SYNCs, ns; a whole number of 100 us.
    pub cycle_ns: u64,
    /// Identifier of the SYNC. Two arms on one bus need two.
    pub sync_id: CanId,
    /// Greatest value of the SYNC's counter, 2 to 240, or 0 for none.
    pub sync_counter: u8,
    /// Number under which the master's own heartbeat goes out.
    pub master: NodeId,
    /// Time between two heartbeats, of master and drives, ms.
    pub heartbeat_ms: u16,
    /// How long a drive's brake takes to close: for so long it stays switched on when it is taken
    /// down, ns.
    pub brake_ns: u64,
    /// What the drives' positions mean.
    pub space: Space,
    /// Joints in order and the jaw, or actuators in order.
    pub axes: [AxisPlan; TAIL_AXES],
    /// Axes that move for their homing, one after the other in this order. All others have absolute
    /// encoders.
    pub homing: [Option<HomingPlan>; TAIL_AXES],
}

impl AxisPlan {
    /// What its drive has to keep by itself: its range and a tenth more than its speed, so that the
    /// master's own limit comes first. A range ends at the last count before the mechanical stops,
    /// but the jaw's begins below its own, where the fingers meet, by what presses them together;
    /// in actuator space it holds every point of the joints' ranges, and so of two coupled axes
    /// some points that lie beyond a stop.
    #[must_use]
    pub fn settings(&self) -> AxisSettings {
        let speed = 1.1 * self.speed_max;
        AxisSettings {
            range: self.range_counts(),
            speed_max: self.magnitude(speed),
            decelerations: (
                self.magnitude(speed / RAMP_S),
                self.magnitude(speed / QUICK_STOP_S),
            ),
            following_window: self.magnitude(self.following_max),
        }
    }

    /// Its greatest speed, counts/s.
    #[must_use]
    pub fn speed_counts(&self) -> u32 {
        self.magnitude(self.speed_max)
    }

    /// Least and greatest value that the motor's greatest speed may have in a drive, turns a
    /// minute: no less than the axis needs, and what [`Self::settings`] allow, to the next whole
    /// turn.
    #[must_use]
    pub fn turns_min(&self) -> (i64, i64) {
        let whole = |counts_s: u32| turns_a_minute(counts_s, self.counts_per_turn);
        (whole(self.speed_counts()), whole(self.settings().speed_max))
    }

    /// The least and the greatest count within its range: the nearest counts may lie beyond its
    /// ends, which are mechanical stops.
    #[must_use]
    pub fn range_counts(&self) -> (i32, i32) {
        let (a, b) = (
            self.range.0 * self.counts_per_unit,
            self.range.1 * self.counts_per_unit,
        );
        (whole_i32(a.min(b).ceil()), whole_i32(a.max(b).floor()))
    }

    /// The count nearest to the position `units`, also outside of the range.
    #[must_use]
    pub fn position_counts(&self, units: f64) -> i32 {
        whole_i32(units * self.counts_per_unit)
    }

    /// A speed or an acceleration without a sign, counts/s or counts/s²; at least 1, which CiA 402
    /// takes for the slowest.
    #[must_use]
    pub fn rate_counts(&self, units: f64) -> u32 {
        self.magnitude(units).max(1)
    }

    fn magnitude(&self, units: f64) -> u32 {
        let count = whole(units * self.counts_per_unit.abs());
        u32::try_from(count).unwrap_or(u32::MAX)
    }
}

/// The count nearest to `count`; the ends of the range for what is beyond.
fn whole_i32(count: f64) -> i32 {
    let count = whole(count);
    i32::try_from(count).unwrap_or(if count < 0 { i32::MIN } else { i32::MAX })
}

impl ArmPlan {
    /// The axis `axis` with its node.
    #[must_use]
    pub fn who(&self, axis: usize) -> AxisNode {
        let plan = &self.axes[axis];
        AxisNode {
            axis: count_u8(axis),
            node: plan.node,
            line: plan.line,
        }
    }

    /// Which axis `node` on `line` drives.
    #[must_use]
    pub fn axis_of(&self, line: u8, node: NodeId) -> Option<usize> {
        self.axes
            .iter()
            .position(|axis| axis.line == line && axis.node == node)
    }

    /// What `line` has to carry, with this arm alone on it.
    #[must_use]
    pub fn traffic(&self, line: u8) -> Plan {
        let axes = self.axes.iter().filter(|axis| axis.line == line).count();
        let axes = u32::from(count_u8(axes));
        let bytes = (COMMAND_BYTES, ANSWER_BYTES);
        let mut plan = Plan::cyclic(line, self.bit_rate, self.cycle_ns, axes, bytes);
        if self.sync_counter != 0 {
            plan.traffic[0].data_bytes = 1;
        }
        plan.heartbeats = (axes + 1, u64::from(self.heartbeat_ms) * 1_000_000);
        plan
    }

    /// Whether each bus can carry its part.
    ///
    /// # Errors
    /// [`Overload`] with the arithmetic.
    pub fn check_load(&self) -> Result<(), Overload> {
        (0..self.lines).try_for_each(|line| self.traffic(line).check().map(|_| ()))
    }
}
