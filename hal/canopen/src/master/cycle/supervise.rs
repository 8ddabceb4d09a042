//! The judgement at the end of a cycle, and what it says of the arm. Hot path: bounded, no
//! allocation, no I/O, no lock.

use super::super::fault::Fault;
use super::super::space::Axes;
use super::{
    Cycle, DEVIATION_CYCLES, ENABLE_NS, Goal, LOST_AFTER, PAUSES_MAX, SILENT_AFTER,
    UNSENT_FAULT_AFTER, UNSENT_LOST_AFTER, UNSTEADY_AFTER,
};
use crate::cia402::PowerState;
use crate::number::{nanoseconds, real, whole};
use hal::tail::TAIL_AXES;
use hal::{ArmError, ArmState, JOINT_COUNT, JointVector, TICK_NS, TimeNs};

impl Cycle {
    /// Ends the newest period: ages, heartbeats, and what the drives said. Decides whether the next
    /// one is a pause.
    ///
    /// A PDO carries no sequence number, so after a missing answer the next one may be the missing
    /// one, late, and so may all after it. Then a SYNC is left out, which drives bridge: what comes
    /// without one is late, and if nothing comes the answers are in step again.
    pub fn judge(&mut self, now: TimeNs) {
        self.judge_sending(now);
        if self.sync.is_none() {
            return;
        }
        let mut asks = false;
        for n in 0..TAIL_AXES {
            asks |= self.end_period(n);
            self.judge_presence(n, now);
            self.judge_drive(n, now);
        }
        // Drives that are to stop get their SYNC whatever they answer, and so do those that have
        // waited for one long enough, as after a stall.
        let waited_ns = self.sync.map_or(0, |sync| now.since(sync));
        let patient = 2 * waited_ns <= u64::from(2 * PAUSES_MAX + 1) * self.plan.cycle_ns;
        self.pause = asks && patient && self.pauses < PAUSES_MAX && self.fault.is_none();
        if self.goal == Goal::Enabled && self.is_enabled() {
            self.reached = true;
        }
    }

    /// Counts the answers of the axis `n` in the period that ends; whether a pause would tell which
    /// SYNC they belong to.
    fn end_period(&mut self, n: usize) -> bool {
        let axis = &mut self.axes[n];
        let asks = if self.pauses == 0 {
            axis.end_cycle();
            axis.asks_for_pause()
        } else {
            axis.end_pause(self.pauses)
        };
        if axis.health.age_cycles < LOST_AFTER {
            axis.trusted = axis.sampled;
        }
        asks
    }

    fn judge_sending(&mut self, now: TimeNs) {
        for line in 0..self.plan.lines {
            let Some(health) = self.lines.get_mut(usize::from(line)) else {
                continue;
            };
            let short = core::mem::take(&mut health.short);
            health.unsent = if short { health.unsent + 1 } else { 0 };
            let cycles = health.unsent;
            if cycles >= UNSENT_FAULT_AFTER {
                self.latch(now, Fault::CannotSend { line, cycles });
            }
        }
    }

    fn judge_presence(&mut self, n: usize, now: TimeNs) {
        let who = self.plan.who(n);
        let silent = self.axes[n].silent();
        if silent >= SILENT_AFTER {
            let fault = match self.axes[n].refused {
                Some(rejected) => Fault::Unusable(who, rejected, silent),
                None => Fault::Silent(who, silent),
            };
            self.latch(now, fault);
        }
        if self.axes[n].unsteady_cycles() >= UNSTEADY_AFTER {
            self.latch(now, Fault::Unsteady(who));
        }
        let limit_ns = 3 * u64::from(self.plan.heartbeat_ms) * 1_000_000;
        let last_heartbeat = self.axes[n].last_heartbeat;
        if limit_ns > 0
            && last_heartbeat.is_some_and(|last_heartbeat| now.since(last_heartbeat) > limit_ns)
        {
            self.latch(now, Fault::NodeLost(who));
        }
    }

    fn judge_drive(&mut self, n: usize, now: TimeNs) {
        let who = self.plan.who(n);
        let Some(newest) = self.axes[n].newest else {
            return;
        };
        let status = newest.status;
        // Before it is switched on, a drive may well be without.
        let powered = matches!(
            status.state,
            PowerState::SwitchedOn | PowerState::OperationEnabled | PowerState::QuickStopActive
        );
        if powered && !status.voltage {
            self.latch(now, Fault::PowerLost(who));
        }
        let fails = matches!(
            status.state,
            PowerState::Fault | PowerState::FaultReaction | PowerState::QuickStopActive
        );
        let late = self.goal == Goal::Enabled && now.since(self.goal_since) > ENABLE_NS;
        let enabled = status.state == PowerState::OperationEnabled;
        if !enabled && (self.reached || late || (fails && self.goal == Goal::Enabled)) {
            // A drive that says why in an emergency has done so before its status word changed.
            self.latch(now, Fault::NotEnabled(who, status.state));
        }
        let idle = self.goal == Goal::Disabled && status.state == PowerState::SwitchedOn;
        self.axes[n].idle = idle.then(|| self.axes[n].idle.unwrap_or(now));
        let plan = &self.plan.axes[n];
        let limit = whole(plan.following_max * plan.counts_per_unit.abs());
        let deviation = self.axes[n].deviation();
        let deviates = enabled && self.reached && i64::from(deviation) > limit;
        self.deviates[n] = if deviates { self.deviates[n] + 1 } else { 0 };
        let reported = enabled && self.reached && status.deviation;
        if reported || self.deviates[n] >= DEVIATION_CYCLES {
            self.latch(now, Fault::FollowingError(who, deviation));
        }
    }

    /// The arm as the newest answers have it.
    ///
    /// An axis whose answer is missing for a cycle or two is where it was going.
    ///
    /// # Errors
    /// [`ArmError`] for a fault, or when answers are missing for [`LOST_AFTER`] cycles or
    /// set-points cannot be sent.
    pub fn state(&self, now: TimeNs) -> Result<ArmState, ArmError> {
        if let Some(fault) = self.fault() {
            return Err(fault.arm_error());
        }
        let sampled = self.axes.iter().map(|axis| axis.sampled);
        let stamp = sampled.fold(TimeNs(0), TimeNs::max);
        let trusted = self.axes.iter().map(|axis| axis.trusted);
        let age_ns = now.since(trusted.fold(now, TimeNs::min));
        let mut axes = self.axes.iter();
        let lost = axes.any(|axis| axis.health.age_cycles >= LOST_AFTER);
        let mut lines = self.lines.iter();
        let unsent = lines.any(|line| line.unsent >= UNSENT_LOST_AFTER);
        if lost || unsent {
            return Err(ArmError::MeasurementLost { age_ns });
        }
        self.measured(stamp)
            .ok_or(ArmError::MeasurementLost { age_ns })
    }

    /// The arm at `stamp`, once every axis has answered.
    fn measured(&self, stamp: TimeNs) -> Option<ArmState> {
        let [mut position, mut velocity, mut torque]: [Axes; 3] = Default::default();
        for (n, axis) in self.axes.iter().enumerate() {
            let plan = &self.plan.axes[n];
            position[n] = axis.predicted(stamp)? / plan.counts_per_unit;
            velocity[n] = axis.velocity / plan.counts_per_unit;
            torque[n] = real(axis.newest?.torque.into()) / 1000.0 * plan.torque_rated;
        }
        let space = self.plan.space;
        let (position, velocity) = (space.to_joints(&position), space.to_joints(&velocity));
        let effort = space.efforts_to_joints(&torque);
        let joints = |axes: &Axes| JointVector::from_column_slice(&axes[..JOINT_COUNT]);
        Some(ArmState {
            stamp,
            position: joints(&position),
            velocity: joints(&velocity),
            effort: joints(&effort),
            jaw_position: position[JOINT_COUNT],
            jaw_velocity: velocity[JOINT_COUNT],
            jaw_effort: effort[JOINT_COUNT],
        })
    }

    /// Whether a period is over at `now`: a quarter of a cycle early at most, and less than a
    /// control period, or a controller that is faster than the bus would make the bus faster.
    #[must_use]
    pub fn is_due(&self, now: TimeNs) -> bool {
        let early_ns = (self.plan.cycle_ns / 4).min(TICK_NS / 2);
        self.began
            .is_none_or(|began| now.since(began) + early_ns >= self.plan.cycle_ns)
    }

    /// Whole cycles that have passed since the newest period began, at least one.
    #[must_use]
    pub fn cycles_since_sync(&self, now: TimeNs) -> u64 {
        let gap_ns = self.began.map_or(0, |began| now.since(began));
        let half_ns = nanoseconds(crate::number::seconds(self.plan.cycle_ns) / 2.0);
        ((gap_ns + half_ns) / self.plan.cycle_ns.max(1)).max(1)
    }
}
