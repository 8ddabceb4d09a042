//! What the master knows of one axis. Hot path: bounded, no allocation, no I/O, no lock.

use core::fmt;

use super::answers::Answers;
use super::plan::{ANSWER_BYTES, AxisPlan};
use crate::cia301::NmtState;
use crate::cia402::Status;
use crate::number::{real, seconds};
use hal::TimeNs;

/// A drive's feedback in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Feedback {
    pub(super) status: Status,
    pub(super) position: i32,
    pub(super) torque: i16,
}

/// A cycle whose answer is not in time weighs as much as this many whose answers are.
const MISS_WEIGHT: u32 = 3;

/// Why an answer was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejected {
    /// So many bytes and not eight.
    Length(usize),
    /// The status word codes no state.
    Status,
    /// The axis cannot have come there since the last answer.
    Jump,
}

impl fmt::Display for Rejected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length(bytes) => {
                write!(f, "process data of {bytes} bytes instead of {ANSWER_BYTES}")
            }
            Self::Status => f.write_str("a status word that codes no state"),
            Self::Jump => f.write_str("a position that the axis cannot have reached"),
        }
    }
}

/// How one axis has been heard.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisHealth {
    /// Periods by which the SYNC that the newest usable answer belongs to may lie back; 0 when it
    /// is the newest one's, and came in time.
    pub age_cycles: u32,
    /// Cycles without a usable answer, ever.
    pub missed: u64,
    /// Answers that came when the next SYNC had been due, or twice.
    pub late: u64,
    /// Answers that were not taken, ever.
    pub rejected: u64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Axis {
    pub(super) newest: Option<Feedback>,
    pub(super) health: AxisHealth,
    pub(super) last_heartbeat: Option<TimeNs>,
    /// The NMT state that its newest heartbeat reported.
    pub(super) nmt_state: Option<NmtState>,
    /// When the drive measured it: the SYNC that it answers.
    pub(super) sampled: TimeNs,
    /// The same of the newest answer that could not have been too old.
    pub(super) trusted: TimeNs,
    /// Counts/s from the last two answers.
    pub(super) velocity: f64,
    /// Set-point, counts.
    pub(super) target: i32,
    /// The newest set-point that was handed to the bus, counts.
    pub(super) sent: i32,
    /// Set-points that found room in the transmit queue since the fault.
    pub(super) stops_sent: u32,
    /// NMT stop commands to its node that found room in the transmit queue.
    pub(super) nmt_stops_sent: u32,
    /// The set-point that the drive was on its way to when it measured.
    pub(super) followed: i32,
    /// Since when it is switched on and its operation disabled, on the way down.
    pub(super) idle: Option<TimeNs>,
    /// Why the newest answer of a period without a usable one was not taken; none if none came.
    pub(super) refused: Option<Rejected>,
    /// Whether a usable answer has come in this period, and how many of any kind.
    usable: bool,
    count: u32,
    /// Which SYNC the newest answer belongs to.
    answers: Answers,
    /// SYNCs whose answers may still come.
    outstanding: u32,
    /// Periods in a row without a usable answer.
    silent: u32,
    /// Weight of the answers that were not in time, less those that were.
    unsteadiness: u32,
    /// The newest answer of an earlier cycle and when it was measured: what this cycle's answers
    /// are held against, so that many in one cycle lead no further than one.
    before: Option<(Feedback, TimeNs)>,
}

impl Axis {
    pub(super) fn new() -> Self {
        Self {
            newest: None,
            health: AxisHealth::default(),
            last_heartbeat: None,
            nmt_state: None,
            sampled: TimeNs(0),
            trusted: TimeNs(0),
            velocity: 0.0,
            target: 0,
            sent: 0,
            stops_sent: 0,
            nmt_stops_sent: 0,
            followed: 0,
            idle: None,
            refused: None,
            usable: false,
            count: 0,
            answers: Answers::Late,
            outstanding: 0,
            silent: 0,
            unsteadiness: 0,
            before: None,
        }
    }

    /// Takes an answer to the SYNC of `sync`.
    pub(super) fn on_answer(
        &mut self,
        plan: &AxisPlan,
        cycle_ns: u64,
        sync: TimeNs,
        data: &[u8],
    ) -> Result<Feedback, Rejected> {
        if !self.usable {
            self.before = self.newest.map(|newest| (newest, self.sampled));
        }
        self.count = self.count.saturating_add(1);
        let gap_ns = self.before.map_or(0, |(_, sampled)| sync.since(sampled));
        let gap_ns = gap_ns.max(cycle_ns);
        let answer = parse(data).and_then(|answer| self.believe(plan, gap_ns, answer));
        match answer {
            Ok(answer) => {
                if let Some((before, sampled)) = self.before {
                    let way = i64::from(answer.position) - i64::from(before.position);
                    let gap_s = seconds(sync.since(sampled));
                    if gap_s > 0.0 {
                        self.velocity = real(way) / gap_s;
                    }
                }
                self.usable = true;
                self.refused = None;
                self.newest = Some(answer);
                self.sampled = sync;
                Ok(answer)
            }
            Err(rejected) => {
                self.health.rejected += 1;
                self.refused = Some(rejected);
                Err(rejected)
            }
        }
    }

    /// Refuses places that the axis cannot have reached, with half again its greatest speed and a
    /// little for rounding.
    fn believe(
        &self,
        plan: &AxisPlan,
        gap_ns: u64,
        answer: Feedback,
    ) -> Result<Feedback, Rejected> {
        let Some((before, _)) = self.before else {
            return Ok(answer);
        };
        let reach = 1.5 * plan.speed_max * plan.counts_per_unit.abs() * seconds(gap_ns) + 10.0;
        let way = real((i64::from(answer.position) - i64::from(before.position)).abs());
        if way <= reach {
            Ok(answer)
        } else {
            Err(Rejected::Jump)
        }
    }

    /// Ends a period that began with a SYNC. More answers than SYNCs were outstanding weigh like
    /// one that is missing: they hide which SYNC the others belong to.
    pub(super) fn end_cycle(&mut self) {
        let count = core::mem::take(&mut self.count);
        let usable = core::mem::take(&mut self.usable);
        let due = self.outstanding.saturating_add(1);
        self.outstanding = due.saturating_sub(count);
        self.answers = self.answers.after_cycle(count, usable);
        if count == 0 {
            self.refused = None;
        }
        if !usable {
            self.health.missed += 1;
            self.silent = self.silent.saturating_add(1);
            self.age();
            self.not_in_time();
            return;
        }
        self.silent = 0;
        self.health.age_cycles = self.outstanding;
        self.count_late(count, due);
    }

    /// Counts which of the `count` answers of a period are late, of which `due` could come.
    fn count_late(&mut self, count: u32, due: u32) {
        if count > 1 {
            self.health.late += u64::from(count - 1);
            if count > due {
                self.not_in_time();
            }
        } else if self.answers == Answers::InStep {
            self.in_time();
        }
    }

    /// Whether only a pause can tell which SYNC the newest answer was to.
    pub(super) fn asks_for_pause(&self) -> bool {
        self.answers == Answers::Ambiguous
    }

    /// Ends a pause, the last of `pauses` in a row. Tells whether another one would tell more.
    pub(super) fn end_pause(&mut self, pauses: u32) -> bool {
        let late = core::mem::take(&mut self.count);
        let usable = core::mem::take(&mut self.usable);
        self.health.late += u64::from(late);
        let before = self.answers;
        let had_answer = before.has_answer();
        self.outstanding = if late == 0 && had_answer {
            0
        } else {
            self.outstanding.saturating_sub(late)
        };
        self.answers = before.after_pause(late, self.outstanding);
        if had_answer && late > 0 {
            self.not_in_time();
        } else if had_answer {
            // One that was in step has been counted at the end of its own period.
            if before == Answers::Ambiguous {
                self.in_time();
            }
            self.health.age_cycles = pauses;
        }
        if usable {
            self.silent = 0;
            self.health.age_cycles = self.outstanding + pauses;
        } else if !self.answers.has_answer() {
            self.silent = self.silent.saturating_add(u32::from(!had_answer));
            self.age();
        }
        self.answers.may_be_out_of_step() && (had_answer || late > 0)
    }

    fn age(&mut self) {
        self.health.age_cycles = self.health.age_cycles.saturating_add(1);
    }

    fn in_time(&mut self) {
        self.unsteadiness = self.unsteadiness.saturating_sub(1);
    }

    fn not_in_time(&mut self) {
        self.unsteadiness = self.unsteadiness.saturating_add(MISS_WEIGHT);
    }

    /// Periods in a row without a usable answer.
    pub(super) const fn silent(&self) -> u32 {
        self.silent
    }

    /// Cycles without an answer in time, less a third of those with one, never below 0: it grows
    /// while fewer than three in four answers are in time.
    pub(super) const fn unsteady_cycles(&self) -> u32 {
        self.unsteadiness / MISS_WEIGHT
    }

    /// Where it is at `now` if it has gone on as it did, counts.
    pub(super) fn predicted(&self, now: TimeNs) -> Option<f64> {
        let newest = self.newest?;
        let ahead = self.velocity * seconds(now.since(self.sampled));
        Some(f64::from(newest.position) + ahead)
    }

    /// Whether its brake may still be closing, for which its drive, which has been switched on
    /// without operation since `idle`, or has just become so, stays switched on.
    pub(super) fn brakes(&self, now: TimeNs, brake_ns: u64) -> bool {
        now.since(self.idle.unwrap_or(now)) < brake_ns
    }

    /// How far it is from the set-point that it was following, counts.
    pub(super) fn deviation(&self) -> u32 {
        self.newest.map_or(0, |newest| {
            let way = i64::from(newest.position) - i64::from(self.followed);
            u32::try_from(way.unsigned_abs()).unwrap_or(u32::MAX)
        })
    }
}

fn parse(data: &[u8]) -> Result<Feedback, Rejected> {
    if data.len() != usize::from(ANSWER_BYTES) {
        return Err(Rejected::Length(data.len()));
    }
    let [s0, s1, p0, p1, p2, p3, t0, t1] =
        <[u8; 8]>::try_from(data).map_err(|_| Rejected::Length(data.len()))?;
    let status = u16::from_le_bytes([s0, s1]);
    Ok(Feedback {
        status: Status::parse(status).map_err(|_| Rejected::Status)?,
        position: i32::from_le_bytes([p0, p1, p2, p3]),
        torque: i16::from_le_bytes([t0, t1]),
    })
}

/// `units` in counts, inside the axis's range as its drive has it; none if it is not finite.
pub(super) fn counts(plan: &AxisPlan, units: f64) -> Option<i32> {
    let (low, high) = plan.range_counts();
    units
        .is_finite()
        .then(|| plan.position_counts(units).max(low).min(high))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NodeId;

    const CYCLE_NS: u64 = 2_000_000;

    #[test]
    fn many_answers_in_a_cycle_lead_no_further_than_one() {
        let plan = AxisPlan {
            node: NodeId::new(3).unwrap(),
            line: 0,
            identity: (0, 0),
            counts_per_unit: 100_000.0,
            counts_per_turn: 10_000,
            range: (-1.0, 1.0),
            speed_max: 1.0,
            following_max: 0.1,
            torque_rated: 1.0,
        };
        let answer = |position: i32| {
            let mut data = [0x37, 0x02, 0, 0, 0, 0, 0, 0];
            data[2..6].copy_from_slice(&position.to_le_bytes());
            data
        };
        // 1.5 times the greatest speed over a cycle, and 10 counts.
        let reach = 310;
        let mut axis = Axis::new();
        let mut sync = TimeNs(CYCLE_NS);
        let hear = |axis: &mut Axis, sync, position| {
            axis.on_answer(&plan, CYCLE_NS, sync, &answer(position))
        };
        assert!(hear(&mut axis, sync, 0).is_ok());
        axis.end_cycle();
        sync = sync.plus_ns(CYCLE_NS);
        assert!(hear(&mut axis, sync, reach).is_ok());
        for step in 2..30 {
            let far = hear(&mut axis, sync, step * reach);
            assert_eq!(far, Err(Rejected::Jump), "{step}");
        }
        assert_eq!(axis.newest.unwrap().position, reach);
        assert!((axis.velocity - 155_000.0).abs() < 1.0, "{}", axis.velocity);
        // The last of several that can be is taken, and the next cycle starts from it.
        assert!(hear(&mut axis, sync, 100).is_ok());
        axis.end_cycle();
        sync = sync.plus_ns(CYCLE_NS);
        assert!(hear(&mut axis, sync, 100 + reach).is_ok());
    }
}
