//! What happens between two SYNCs. Hot path: bounded, no allocation, no I/O, no lock.

mod command;
mod receive;
mod supervise;
mod sync;

pub(super) use command::HOLD_NS;

use super::axis::{Axis, AxisHealth, counts};
use super::fault::Fault;
use super::plan::ArmPlan;
use super::space::Axes;
use crate::cia402::PowerState;
use crate::number::seconds;
use hal::TimeNs;
use hal::tail::TAIL_AXES;

/// Age of the newest answer, cycles, from which on the measurement counts as lost.
pub const LOST_AFTER: u32 = 3;
/// Cycles in a row without an answer that are a fault.
pub const SILENT_AFTER: u32 = 20;
/// Cycles without an answer in time, less a third of those with one, that are a fault.
pub const UNSTEADY_AFTER: u32 = 30;
/// Cycles in a row without room to send from which on the arm counts as lost.
pub const UNSENT_LOST_AFTER: u32 = 2;
/// Cycles in a row without room to send that are a fault.
pub const UNSENT_FAULT_AFTER: u32 = 20;
/// Cycles for which a deviation must last.
const DEVIATION_CYCLES: u32 = 10;
/// How long the drives may take to become enabled, ns.
const ENABLE_NS: u64 = 2_000_000_000;
/// Periods in a row that pass without a SYNC at most, for late answers to come.
const PAUSES_MAX: u32 = 3;
/// Buses at most.
pub const LINES_MAX: usize = 3;

/// What the drives should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Goal {
    /// Without torque.
    Disabled,
    /// Following.
    Enabled,
}

/// How the buses have been.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LineHealth {
    /// Whether our controller has left it, or its interface is gone: nothing is sent to it any
    /// more.
    pub off: bool,
    /// Whether our controller is error passive.
    pub passive: bool,
    /// How often it became so.
    pub passives: u64,
    /// Frames lost before they came to us.
    pub lost: u64,
    /// Frames that no CANopen device sends.
    pub foreign: u64,
    /// Cycles in a row of which some frame found no room.
    pub unsent: u32,
    /// Whether this cycle is one.
    short: bool,
}

/// The arm between two SYNCs.
#[derive(Clone, Debug)]
pub struct Cycle {
    plan: ArmPlan,
    axes: [Axis; TAIL_AXES],
    lines: [LineHealth; LINES_MAX],
    goal: Goal,
    goal_since: TimeNs,
    /// Whether all drives have been enabled since the goal was set.
    reached: bool,
    deviates: [u32; TAIL_AXES],
    /// Set-points that the newest SYNC put into effect, counts.
    applied: [i32; TAIL_AXES],
    fault: Option<(Fault, TimeNs)>,
    /// Whether a second master commands our drives.
    second_master: bool,
    counter: u8,
    /// Stamp of the newest set-points that were taken.
    commanded: Option<TimeNs>,
    sync: Option<TimeNs>,
    /// When the newest period began, with a SYNC or without.
    began: Option<TimeNs>,
    /// Whether the next period begins without a SYNC, and how many in a row have.
    pause: bool,
    pauses: u32,
    /// SYNCs left out so far.
    left_out: u64,
    heartbeat: Option<TimeNs>,
    /// Whether our heartbeat goes out in the newest period.
    alive: bool,
}

impl Cycle {
    /// A cycle that begins at `now` with drives that are operational and have just been heard.
    #[must_use]
    pub fn new(plan: &ArmPlan, now: TimeNs) -> Self {
        let mut axes = [Axis::new(); TAIL_AXES];
        for axis in &mut axes {
            axis.last_heartbeat = Some(now);
        }
        Self {
            plan: *plan,
            axes,
            lines: [LineHealth::default(); LINES_MAX],
            goal: Goal::Disabled,
            goal_since: now,
            reached: false,
            deviates: [0; TAIL_AXES],
            applied: [0; TAIL_AXES],
            fault: None,
            second_master: false,
            counter: 0,
            commanded: None,
            sync: None,
            began: None,
            pause: false,
            pauses: 0,
            left_out: 0,
            heartbeat: None,
            alive: false,
        }
    }

    /// The latched fault.
    #[must_use]
    pub fn fault(&self) -> Option<Fault> {
        self.fault.map(|(fault, _)| fault)
    }

    /// How each axis has been heard.
    #[must_use]
    pub fn axis_health(&self) -> [AxisHealth; TAIL_AXES] {
        self.axes.map(|axis| axis.health)
    }

    /// How each bus has been.
    #[must_use]
    pub const fn line_health(&self) -> &[LineHealth; LINES_MAX] {
        &self.lines
    }

    /// Power states as last heard.
    #[must_use]
    pub fn states(&self) -> [Option<PowerState>; TAIL_AXES] {
        self.axes
            .map(|axis| axis.newest.map(|newest| newest.status.state))
    }

    /// Set-points, counts.
    #[must_use]
    pub fn targets(&self) -> [i32; TAIL_AXES] {
        self.axes.map(|axis| axis.target)
    }

    /// Whether every drive follows.
    #[must_use]
    pub fn is_enabled(&self) -> bool {
        self.states()
            .iter()
            .all(|state| *state == Some(PowerState::OperationEnabled))
    }

    /// Whether no drive that is heard is on its way down any more.
    #[must_use]
    pub fn is_down(&self) -> bool {
        self.axes.iter().all(|axis| {
            let state = axis.newest.map(|newest| newest.status.state);
            axis.silent() >= SILENT_AFTER
                || matches!(
                    state,
                    None | Some(
                        PowerState::NotReady | PowerState::SwitchOnDisabled | PowerState::Fault
                    )
                )
        })
    }

    /// Whether every drive has said that it is down, and none is silent: a silent one may have
    /// torque.
    #[must_use]
    pub fn is_confirmed_down(&self) -> bool {
        let all_answer = self
            .axes
            .iter()
            .all(|axis| axis.newest.is_some() && axis.silent() < SILENT_AFTER);
        all_answer && self.is_down()
    }

    /// Whether every drive has said that it is without torque, and none is silent.
    #[must_use]
    pub fn is_confirmed_without_torque(&self) -> bool {
        self.axes.iter().all(|axis| {
            let state = axis.newest.map(|newest| newest.status.state);
            axis.silent() < SILENT_AFTER && state.is_some_and(|state| !state.has_torque())
        })
    }

    /// The newest SYNC.
    #[must_use]
    pub const fn sync(&self) -> Option<TimeNs> {
        self.sync
    }

    /// When the newest period began, with a SYNC or without.
    #[must_use]
    pub const fn began(&self) -> Option<TimeNs> {
        self.began
    }

    fn latch(&mut self, now: TimeNs, fault: Fault) {
        // The first one is the cause; what follows from it is not.
        self.fault.get_or_insert((fault, now));
    }

    /// Sets what the drives should be. A fault wins over it.
    pub fn set_goal(&mut self, now: TimeNs, goal: Goal) {
        if goal != self.goal {
            self.goal = goal;
            self.goal_since = now;
            self.reached = false;
        }
    }

    /// What the drives should be.
    #[must_use]
    pub const fn goal(&self) -> Goal {
        self.goal
    }

    /// Takes set-points in the drives' units for `stamp`; tells whether they can be gone to. If one
    /// is not finite, or further than twice the axis's greatest speed would bring it, none is
    /// taken.
    pub fn set_targets(&mut self, stamp: TimeNs, units: &Axes) -> bool {
        let gap_ns = self.commanded.map_or(0, |before| stamp.since(before));
        let gap_s = seconds(gap_ns.max(self.plan.cycle_ns));
        let mut wanted = [0; TAIL_AXES];
        for (n, place) in wanted.iter_mut().enumerate() {
            let (plan, axis) = (&self.plan.axes[n], &self.axes[n]);
            let Some(target) = counts(plan, units[n]) else {
                return false;
            };
            let follows = axis
                .newest
                .is_some_and(|newest| newest.status.state == PowerState::OperationEnabled);
            let way = f64::from(target) - f64::from(axis.target);
            let reach = 2.0 * plan.speed_max * plan.counts_per_unit.abs() * gap_s + 10.0;
            if follows && way.abs() > reach {
                return false;
            }
            *place = target;
        }
        self.commanded = Some(stamp);
        for (axis, target) in self.axes.iter_mut().zip(wanted) {
            axis.target = target;
        }
        true
    }
}
