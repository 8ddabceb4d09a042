//! What the master promises of time: how old its measurements are at most, when its SYNCs come, and
//! that nobody is led by them after a fault.

use hal::{ArmState, TICK_NS, TimeNs};
use trocar_canopen::Frame;
use trocar_canopen::cia301::{Cob, cob::PdoNumber};
use trocar_canopen::master::{ArmPlan, CanArm};
use trocar_drives::network::NODE_STEP_NS;
use trocar_drives::node::{Demand, Feedback};
use trocar_drives::{IdealMotor, Motor};

use crate::noisy::Noisy;

const MS_NS: u64 = 1_000_000;
/// Periods that are remembered.
const PERIODS: usize = 64;
/// Values of a stamp, steps of a motor; one comes again after 15 s.
const STAMPS: u64 = 30_000;
/// Periods by which a measurement may be older than it is told to be, and by which an answer may be
/// late for this to hold.
const OLDER_MAX: u64 = 3;
const LATE_MAX: u64 = 4;
/// SYNCs in a row that may be left out.
const LEFT_OUT_MAX: u32 = 3;

/// A motor that gives as its torque when it was looked at.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Stamped {
    pub(crate) ideal: IdealMotor,
    steps: u64,
}

impl Stamped {
    pub(crate) fn new(ideal: IdealMotor) -> Self {
        Self { ideal, steps: 0 }
    }
}

impl Motor for Stamped {
    fn step(&mut self, step_ns: u64, demand: &Demand) -> Feedback {
        self.steps += 1;
        let stamp = u16::try_from(self.steps % STAMPS).unwrap_or(0);
        Feedback {
            torque_per_mille: f64::from(stamp),
            ..self.ideal.step(step_ns, demand)
        }
    }
}

/// When periods began, and which axes nothing is promised of.
pub(crate) struct Ages {
    began: [TimeNs; PERIODS],
    periods: u64,
    /// Another node spoke in the drive's name, it lost its power, or its answers came later than
    /// can be known.
    void: [bool; 7],
    pub(crate) checked: u64,
    /// By how much a measurement was older than told, at most.
    pub(crate) older_max: u64,
}

impl Ages {
    pub(crate) fn new() -> Self {
        Self {
            began: [TimeNs(0); PERIODS],
            periods: 0,
            void: [false; 7],
            checked: 0,
            older_max: 0,
        }
    }

    /// A period begins.
    pub(crate) fn begin(&mut self, now: TimeNs) {
        self.began[usize::try_from(self.periods).unwrap() % PERIODS] = now;
        self.periods += 1;
    }

    pub(crate) fn void(&mut self, axis: usize) {
        self.void[axis] = true;
    }

    /// How many periods before the newest one the motor was looked at with `stamp`: no more than it
    /// was.
    fn periods_since(&self, stamp: u64, now: TimeNs) -> u64 {
        let steps = now.0 / NODE_STEP_NS + 1;
        let since = (steps + STAMPS - stamp % STAMPS) % STAMPS;
        // A drive knows of its motor what it was at most a step ago, and the first step was at time
        // zero.
        let sampled = TimeNs(steps.saturating_sub(since) * NODE_STEP_NS);
        let kept = self.periods.min(PERIODS as u64);
        (0..kept)
            .find(|back| {
                let place = usize::try_from(self.periods - 1 - back).unwrap() % PERIODS;
                self.began[place] <= sampled
            })
            .unwrap_or(kept)
    }

    /// An answer of a drive came to the master.
    pub(crate) fn on_answer(&mut self, axis: usize, data: &[u8], now: TimeNs) {
        if let [.., low, high] = *data {
            let stamp = u64::from(u16::from_le_bytes([low, high]));
            self.void[axis] |= self.periods_since(stamp, now) >= LATE_MAX;
        }
    }

    /// The master tells a measurement, and how many periods old each axis's is.
    fn check(
        &mut self,
        plan: &ArmPlan,
        state: &ArmState,
        told: &[u32; 7],
        now: TimeNs,
    ) -> Result<(), String> {
        // Answers from before the first period are of none.
        if self.periods < PERIODS as u64 / 4 {
            return Ok(());
        }
        for (axis, age) in told.iter().enumerate() {
            if self.void[axis] {
                continue;
            }
            let effort = state.effort.get(axis).copied();
            let torque = effort.unwrap_or(state.jaw_effort) / plan.axes[axis].torque_rated;
            let stamp = stamp_of(torque * 1000.0);
            // The newest period has just begun; the one before is of age 0.
            let age_true = self.periods_since(stamp, now).saturating_sub(1);
            let older = age_true.saturating_sub(u64::from(*age));
            self.checked += 1;
            self.older_max = self.older_max.max(older);
            if older > OLDER_MAX {
                return Err(format!(
                    "axis {axis} is told to be {age} periods old and is {age_true}"
                ));
            }
        }
        Ok(())
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a stamp is a small whole number"
)]
fn stamp_of(per_mille: f64) -> u64 {
    per_mille.round() as u64
}

/// When the period of the newest SYNC began, and what was counted until then.
pub(crate) struct SyncPeriod {
    began: Option<TimeNs>,
    sync: Option<TimeNs>,
    left_out: u64,
    syncs: [u64; 3],
    fault: bool,
}

/// Whether SYNCs come when they should.
#[derive(Default)]
pub(crate) struct SyncPeriods {
    in_a_row: u32,
    pub(crate) left_out: u64,
    pub(crate) syncs: u64,
}

impl SyncPeriod {
    pub(crate) fn of(arm: &mut CanArm<Noisy>) -> Self {
        let fault = arm.fault().is_some();
        let syncs = arm.bus_mut().syncs();
        let cycle = arm.cycle();
        Self {
            began: cycle.began(),
            sync: cycle.sync(),
            left_out: cycle.left_out(),
            syncs,
            fault,
        }
    }
}

impl SyncPeriods {
    /// Of each period there is a SYNC on every bus that is not lost, or one that is counted as left
    /// out, and both when they are due. `measured` is what the arm told.
    pub(crate) fn check(
        &mut self,
        arm: &mut CanArm<Noisy>,
        before: &SyncPeriod,
        now: TimeNs,
        told: Option<&ArmState>,
    ) -> Result<(), String> {
        let after = SyncPeriod::of(arm);
        let cycle_ns = arm.plan().cycle_ns;
        let clock_jumped = arm.bus_mut().has_clock_jumped();
        let turned = after.began != before.began;
        let left = after.left_out - before.left_out;
        let lines = arm.cycle().line_health().iter();
        let lines = lines.take(usize::from(arm.plan().lines));
        for (line, (after, before)) in lines.zip(after.syncs.iter().zip(before.syncs)) {
            let said = after - before;
            if !line.off && said + left != u64::from(turned) {
                return Err(format!(
                    "{said} SYNCs and {left} left out, and turned is {turned}"
                ));
            }
        }
        let waited_ns = before.sync.map_or(cycle_ns, |sync| now.since(sync));
        let begun_ns = before.began.map_or(cycle_ns, |began| now.since(began));
        let early_ns = (cycle_ns / 4).min(TICK_NS / 2);
        self.in_a_row = match (turned, left) {
            (true, 0) => 0,
            _ => self.in_a_row + u32::try_from(left).unwrap_or(u32::MAX),
        };
        self.left_out += left;
        let wrong = match (turned, left > 0) {
            (false, _) => begun_ns + early_ns >= cycle_ns,
            (true, false) => waited_ns + early_ns < cycle_ns,
            (true, true) => 2 * waited_ns > 7 * cycle_ns,
        };
        if wrong && !clock_jumped {
            return Err(format!(
                "{waited_ns} ns after a SYNC: turned {turned}, left out {left}"
            ));
        }
        if self.in_a_row > LEFT_OUT_MAX || (left > 0 && before.fault) {
            return Err(format!("{} SYNCs in a row were left out", self.in_a_row));
        }
        if turned {
            let ages_told = arm.cycle().axis_health().map(|health| health.age_cycles);
            let plan = *arm.plan();
            let (ages, real) = arm.bus_mut().ages();
            ages.begin(real);
            if let Some(state) = told {
                ages.check(&plan, state, &ages_told, real)?;
            }
        }
        if turned && left == 0 {
            self.syncs += 1;
            arm.bus_mut().clear_clock_jump();
        }
        Ok(())
    }
}

/// Which of our drives a stranger's frame leads, and for how long.
pub(crate) enum Leads {
    Nobody,
    Axis(usize),
    /// It can change what the drive does from now on.
    AxisForGood(usize),
    All,
}

pub(crate) fn leads(plan: &ArmPlan, frame: &Frame) -> Leads {
    let axis = |node| plan.axes.iter().position(|axis| axis.node == node);
    let cob = Cob::of(frame.id);
    if matches!(cob, Cob::Nmt | Cob::Sync) || frame.id == plan.sync_id {
        return Leads::All;
    }
    if let Cob::ReceivePdo(_, node) = cob {
        return axis(node).map_or(Leads::Nobody, Leads::Axis);
    }
    let first = frame.data().first().copied().unwrap_or(u8::MAX);
    if let Cob::SdoRequest(node) = cob
        && matches!(first >> 5, 0 | 1 | 6)
    {
        return axis(node).map_or(Leads::Nobody, Leads::AxisForGood);
    }
    Leads::Nobody
}

/// The axis of which a frame tells process data.
pub(crate) fn answers(plan: &ArmPlan, frame: &Frame) -> Option<usize> {
    if let Cob::TransmitPdo(PdoNumber::FIRST, node) = Cob::of(frame.id) {
        plan.axes.iter().position(|axis| axis.node == node)
    } else {
        None
    }
}

/// How long after a fault, or after a stranger's last word to it, a drive may still move, ns: until
/// it misses its master, and a quick stop from its greatest speed; a frame may be delayed by 20 ms.
pub(crate) const fn stop_ns(plan: &ArmPlan) -> u64 {
    11 * plan.cycle_ns + 46 * MS_NS
}
