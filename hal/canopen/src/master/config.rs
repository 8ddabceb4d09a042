//! `config/can.toml`: arms, nodes and buses, checked once, and the plans and drives that follow
//! from it.

use core::f64::consts::TAU;

use serde::Deserialize;

use super::plan::{ArmPlan, AxisPlan, HomingPlan};
use super::space::{Axes, Space};
use crate::bus_load::{Overload, Plan};
use crate::number::{nanoseconds, whole};
use crate::{CanId, NodeId};
use hal::config::{ConfigError, Source};
use hal::count::count_u8;
use hal::psm::{
    ACTUATORS, Actuator, EFFORT_MAX, JAW_MAX, JAW_MIN, POSITION_MAX, POSITION_MIN, VELOCITY_MAX,
};
use hal::tail::TAIL_AXES;

/// The file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    bit_rate_bit_s: u32,
    cycle_us: u32,
    space: String,
    heartbeat_ms: u16,
    #[serde(default)]
    brake_ms: u16,
    vendor: u32,
    product: u32,
    arm: Vec<ArmFile>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmFile {
    interfaces: Vec<String>,
    sync_id: u16,
    master_node: u8,
    nodes: [u8; TAIL_AXES],
    lines: [u8; TAIL_AXES],
    /// Axes whose encoders are not absolute, in the order in which they move.
    #[serde(default)]
    homing: Vec<HomingFile>,
}

/// Units are rad; m for the insertion.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct HomingFile {
    axis: usize,
    method: i8,
    home_position: f64,
    switch_speed: f64,
    zero_speed: f64,
    acceleration: f64,
    time_out_s: f64,
}

/// One arm with the names of its buses.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmOnCan {
    /// Interfaces, line 0 first.
    pub interfaces: Vec<String>,
    /// What is on them.
    pub plan: ArmPlan,
}

/// One or two arms.
#[derive(Clone, Debug, PartialEq)]
pub struct CanConfig {
    /// The arms.
    pub arms: Vec<ArmOnCan>,
}

impl CanConfig {
    /// The file in the repository.
    #[must_use]
    pub fn shipped() -> Source {
        let text = include_str!("../../can.toml");
        Source::embedded("config/can.toml", text)
    }

    /// Reads and checks `source`.
    ///
    /// # Errors
    /// [`ConfigError`] with file, line, key and allowed range.
    pub fn load(source: &Source) -> Result<Self, ConfigError> {
        let file: File = source.parse()?;
        let range = |key: &str, value: u32, low: u32, high: u32| {
            source.check_range(key, value.into(), low.into(), high.into())
        };
        range("bit_rate_bit_s", file.bit_rate_bit_s, 125_000, 1_000_000)?;
        range("cycle_us", file.cycle_us, 500, 20_000)?;
        if !file.cycle_us.is_multiple_of(100) {
            let value = file.cycle_us.to_string();
            return Err(source.out_of_range("cycle_us", &value, "whole hundreds"));
        }
        range("heartbeat_ms", file.heartbeat_ms.into(), 10, 2000)?;
        range("brake_ms", file.brake_ms.into(), 0, 2000)?;
        let space = space_of(source, &file)?;
        if file.arm.is_empty() || file.arm.len() > 2 {
            let count = format!("{} arms", file.arm.len());
            return Err(source.out_of_range("arm", &count, "1 or 2 arms"));
        }
        let arms = (0..).zip(&file.arm);
        let arms = arms
            .map(|(n, arm)| arm_on_can(source, &file, space, n, arm))
            .collect::<Result<_, _>>()?;
        check_shared(source, &file.arm)?;
        Ok(Self { arms })
    }

    /// Whether each interface can carry its part of the first `arms` arms.
    ///
    /// # Errors
    /// [`Overload`] with the arithmetic.
    pub fn check_load(&self, arms: usize) -> Result<(), Overload> {
        let arms = &self.arms[..arms.min(self.arms.len())];
        for (n, name) in arms.iter().flat_map(|arm| &arm.interfaces).enumerate() {
            let on_it = arms.iter().flat_map(|arm| {
                let lines = (0..).zip(&arm.interfaces);
                lines
                    .filter(|(_, other)| *other == name)
                    .map(|(line, _)| arm.plan.traffic(line))
            });
            let together = on_it.reduce(|mut all: Plan, more| {
                all.traffic.extend(more.traffic);
                all.heartbeats.0 += more.heartbeats.0;
                all
            });
            if let Some(mut plan) = together {
                plan.line = count_u8(n);
                plan.check()?;
            }
        }
        Ok(())
    }
}

/// Arms on a common interface must be told apart there, and an arm names an interface once.
fn check_shared(source: &Source, arms: &[ArmFile]) -> Result<(), ConfigError> {
    for (n, arm) in arms.iter().enumerate() {
        for (place, name) in arm.interfaces.iter().enumerate() {
            if arm.interfaces[..place].contains(name) {
                let key = format!("arm.{n}.interfaces");
                return Err(source.out_of_range(&key, name, "interfaces named once"));
            }
        }
    }
    let [first, second] = arms else {
        return Ok(());
    };
    if !first
        .interfaces
        .iter()
        .any(|name| second.interfaces.contains(name))
    {
        return Ok(());
    }
    let taken = |key: &str, value: String| {
        let allowed = "one that the first arm, on the same interface, has not";
        Err(source.out_of_range(&format!("arm.1.{key}"), &value, allowed))
    };
    let is_taken = |node: &u8| first.nodes.contains(node) || *node == first.master_node;
    if first.sync_id == second.sync_id {
        return taken("sync_id", format!("{:#05x}", second.sync_id));
    }
    if is_taken(&second.master_node) {
        return taken("master_node", second.master_node.to_string());
    }
    match second
        .nodes
        .iter()
        .enumerate()
        .find(|(_, node)| is_taken(node))
    {
        Some((axis, node)) => taken(&format!("nodes.{axis}"), node.to_string()),
        None => Ok(()),
    }
}

fn arm_on_can(
    source: &Source,
    file: &File,
    space: Space,
    n: usize,
    arm: &ArmFile,
) -> Result<ArmOnCan, ConfigError> {
    let key = |name: &str| format!("arm.{n}.{name}");
    let count = arm.interfaces.len();
    if !(1..=3).contains(&count) {
        let value = format!("{count} interfaces");
        return Err(source.out_of_range(&key("interfaces"), &value, "1 to 3 interfaces"));
    }
    let lines = count_u8(count);
    let sync_id = CanId::new(arm.sync_id)
        .filter(|id| matches!(id.raw(), 0x080 | 0x100))
        .ok_or_else(|| {
            let value = format!("{:#05x}", arm.sync_id);
            source.out_of_range(&key("sync_id"), &value, "{0x080, 0x100}")
        })?;
    let node = |key: &str, raw: u8| {
        NodeId::new(raw).ok_or_else(|| source.out_of_range(key, &raw.to_string(), "[1, 127]"))
    };
    let master = node(&key("master_node"), arm.master_node)?;
    let mut axes = template(&ACTUATORS, space, (file.vendor, file.product), master)?;
    for (axis, place) in axes.iter_mut().enumerate() {
        let (nodes, on) = (key(&format!("nodes.{axis}")), key(&format!("lines.{axis}")));
        place.node = node(&nodes, arm.nodes[axis])?;
        let line = arm.lines[axis];
        source.check_range(&on, line.into(), 0.0, f64::from(lines - 1))?;
        place.line = line;
    }
    for axis in 0..TAIL_AXES {
        let twice = arm.nodes[..axis].contains(&arm.nodes[axis]);
        if twice || arm.nodes[axis] == arm.master_node {
            let value = arm.nodes[axis].to_string();
            let key = key(&format!("nodes.{axis}"));
            return Err(source.out_of_range(&key, &value, "numbers that no other node has"));
        }
    }
    let homing = homing_sequences(source, n, arm, &axes)?;
    let plan = ArmPlan {
        lines,
        bit_rate: file.bit_rate_bit_s,
        cycle_ns: u64::from(file.cycle_us) * 1000,
        sync_id,
        sync_counter: 0,
        master,
        heartbeat_ms: file.heartbeat_ms,
        brake_ns: u64::from(file.brake_ms) * 1_000_000,
        space,
        axes,
        homing,
    };
    Ok(ArmOnCan {
        interfaces: arm.interfaces.clone(),
        plan,
    })
}

/// The homing sequences of an arm, checked against its axes.
fn homing_sequences(
    source: &Source,
    n: usize,
    arm: &ArmFile,
    axes: &[AxisPlan; TAIL_AXES],
) -> Result<[Option<HomingPlan>; TAIL_AXES], ConfigError> {
    let mut sequences = [None; TAIL_AXES];
    for (place, file) in arm.homing.iter().enumerate() {
        let key = |name: &str| format!("arm.{n}.homing.{place}.{name}");
        let refuse = |name: &str, value: String, allowed: &str| {
            Err(source.out_of_range(&key(name), &value, allowed))
        };
        let twice = arm.homing[..place]
            .iter()
            .any(|other| other.axis == file.axis);
        let axis = axes.get(file.axis).filter(|_| !twice);
        let (Some(axis), Ok(number)) = (axis, u8::try_from(file.axis)) else {
            return refuse("axis", file.axis.to_string(), "0 to 6, each axis once");
        };
        if !moves(file.method) {
            let allowed = "[-128, -1], [1, 14], [17, 30], 33 or 34: methods that move the axis";
            return refuse("method", file.method.to_string(), allowed);
        }
        let range = |name: &str, value: f64, low: f64, high: f64| {
            source.check_range(&key(name), value, low, high)
        };
        let (low, high) = axis.range;
        let slowest = 1.0 / axis.counts_per_unit.abs();
        range("home_position", file.home_position, low, high)?;
        range("switch_speed", file.switch_speed, slowest, axis.speed_max)?;
        range("zero_speed", file.zero_speed, slowest, file.switch_speed)?;
        range("acceleration", file.acceleration, slowest, 100.0)?;
        range("time_out_s", file.time_out_s, 1.0, 600.0)?;
        sequences[place] = Some(HomingPlan {
            axis: number,
            method: file.method,
            home_position: file.home_position,
            switch_speed: file.switch_speed,
            zero_speed: file.zero_speed,
            acceleration: file.acceleration,
            time_out_ns: nanoseconds(file.time_out_s),
        });
    }
    Ok(sequences)
}

/// Whether a homing method (CiA 402-2, clause 10) moves the axis; negative ones are the
/// manufacturer's.
const fn moves(method: i8) -> bool {
    matches!(method, i8::MIN..=-1 | 1..=14 | 17..=30 | 33 | 34)
}

/// In which coordinates the drives of `file` count.
fn space_of(source: &Source, file: &File) -> Result<Space, ConfigError> {
    match file.space.as_str() {
        "joint" => Ok(Space::Joint),
        "actuator" => Ok(Space::Actuator),
        other => {
            let allowed = "{\"joint\", \"actuator\"}";
            Err(source.out_of_range("space", other, allowed))
        }
    }
}

/// The axes of a patient-side manipulator with these `motors` in `space`, with counts of its own
/// encoders.
fn template(
    motors: &[Actuator; TAIL_AXES],
    space: Space,
    identity: (u32, u32),
    node: NodeId,
) -> Result<[AxisPlan; TAIL_AXES], ConfigError> {
    let mut turns = [0; TAIL_AXES];
    for (axis, turn) in turns.iter_mut().enumerate() {
        *turn = counts_per_turn(axis, motors[axis].encoder_counts_per_turn)?;
    }
    let jaw_last = |joints: &[f64], jaw: f64| -> Axes {
        core::array::from_fn(|axis| joints.get(axis).copied().unwrap_or(jaw))
    };
    let low = jaw_last(&POSITION_MIN, JAW_MIN);
    let high = jaw_last(&POSITION_MAX, JAW_MAX);
    let (range_low, range_high) = extremes(space, &low, &high);
    let (_, speed) = extremes(space, &VELOCITY_MAX.map(|v| -v), &VELOCITY_MAX);
    Ok(core::array::from_fn(|axis| {
        let motor = &motors[axis];
        AxisPlan {
            node,
            line: 0,
            identity,
            counts_per_unit: motor.gear_ratio * motor.encoder_counts_per_turn / TAU,
            counts_per_turn: turns[axis],
            range: (range_low[axis], range_high[axis]),
            speed_max: speed[axis],
            following_max: motor.trip_error,
            torque_rated: EFFORT_MAX[axis],
        }
    }))
}

/// The encoder counts of a motor turn as 608Fh has them. They are the manipulator's and not the
/// file's.
fn counts_per_turn(axis: usize, counts: f64) -> Result<u32, ConfigError> {
    u32::try_from(whole(counts))
        .ok()
        .filter(|turn| *turn > 0 && f64::from(*turn).to_bits() == counts.to_bits())
        .ok_or_else(|| {
            let key = format!("ACTUATORS.{axis}.encoder_counts_per_turn");
            let allowed = "whole numbers in [1, 4294967295]";
            Source::embedded("hal/src/psm.rs", "").out_of_range(&key, &counts.to_string(), allowed)
        })
}

/// Least and greatest value of each axis over the box of joints from `low` to `high`: a linear map
/// has them at corners.
fn extremes(space: Space, low: &Axes, high: &Axes) -> (Axes, Axes) {
    let (mut least, mut most) = ([f64::INFINITY; TAIL_AXES], [f64::NEG_INFINITY; TAIL_AXES]);
    for corner in 0..1_u32 << TAIL_AXES {
        let joints = core::array::from_fn(|axis| {
            if corner >> axis & 1 == 1 {
                high[axis]
            } else {
                low[axis]
            }
        });
        let axes = space.from_joints(&joints);
        for axis in 0..TAIL_AXES {
            least[axis] = least[axis].min(axes[axis]);
            most[axis] = most[axis].max(axes[axis]);
        }
    }
    (least, most)
}

#[cfg(test)]
mod tests;
