//! Why emulated drives stopped, and how long after their master's last word they rested.
//!
//! A drive follows if it has power, is in `operation enabled` and in cyclic position mode. It has
//! stopped when it no longer does, and rests when its axis has been slower than 1 % of its greatest
//! speed for 10 ms. Both are counted from the last SYNC, since that is the last word of a master
//! that falls silent.

use core::fmt;

use hal::tail::TAIL_AXES;
use hal::{ARM_NAMES, TimeNs};
use trocar_canopen::NodeId;
use trocar_canopen::cia301::NmtState;
use trocar_canopen::cia301::emcy::ErrorCode;
use trocar_canopen::cia402::{Command, ControlView, Mode, PowerState};
use trocar_canopen::index;
use trocar_canopen::master::ArmPlan;
use trocar_drives::node::Node;
use trocar_drives::{Network, Terminal};

/// An axis slower than this share of its greatest speed rests.
const REST_SHARE: f64 = 0.01;

/// How long an axis must be so slow, ns.
const REST_NS: u64 = 10_000_000;

/// Why a drive stopped following.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopCause {
    /// It reported an error.
    ///
    /// Also an error of the bus or of its master's heartbeat, which has a code of its own.
    Error(ErrorCode),
    /// Its master commanded a quick stop.
    ///
    /// Control word (6040h) with the quick stop bit cleared.
    QuickStop,
    /// Its master switched it off.
    SwitchedOff,
    /// It was taken out of operational, or reset.
    ///
    /// The NMT state it was found in.
    Left(NmtState),
    /// It has lost its power.
    Powerless,
}

impl fmt::Display for StopCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Error(code) => {
                let text = code.text().unwrap_or("a code of its own");
                write!(f, "{:04X}h, {text}", code.0)
            }
            Self::QuickStop => f.write_str("quick stop commanded by its master"),
            Self::SwitchedOff => f.write_str("its master switched it off"),
            Self::Left(state) => write!(f, "it was reset or taken to {state:?}"),
            Self::Powerless => f.write_str("it lost its power"),
        }
    }
}

/// One drive's stop, in the time of the drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stop {
    /// The arm, from 0.
    pub arm: usize,
    /// The axis, 6 for the jaw.
    pub axis: usize,
    /// Its node.
    pub node: NodeId,
    /// Why.
    pub cause: StopCause,
    /// When it left off following.
    pub at: TimeNs,
    /// The last SYNC that it received before.
    ///
    /// None if it never received one.
    pub sync: Option<TimeNs>,
    /// The last instant at which the axis moved, once it rests; the last SYNC if it did not move
    /// then.
    pub rest: Option<TimeNs>,
    /// Time that did not pass for the drives from just before that SYNC until the rest was seen,
    /// ns.
    pub stalled_ns: u64,
}

impl Stop {
    /// How long after the last SYNC the drive left off following, and its axis rested, ns.
    ///
    /// None before the axis rests, or without a SYNC.
    #[must_use]
    pub fn after_sync_ns(&self) -> Option<(u64, u64)> {
        let sync = self.sync?;
        Some((self.at.since(sync), self.rest?.since(sync)))
    }
}

/// What is remembered of one axis from look to look.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// At the last look.
    follows: bool,
    /// The newest SYNC while it followed.
    sync: Option<TimeNs>,
    /// The newest instant at which the axis moved.
    moved: TimeNs,
    /// A stop whose axis has not come to rest; handed on and taken away then.
    stop: Option<Stop>,
}

/// Watches the drives of one arm.
#[derive(Clone, Debug)]
pub(super) struct StopWatch {
    arm: usize,
    /// Greatest speeds and counts a unit of its axes.
    plan: ArmPlan,
    seen: [Seen; TAIL_AXES],
    /// Whether all have followed at once: before that drives come and go.
    enabled: bool,
}

impl StopWatch {
    /// No drive follows yet.
    pub(super) const fn new(arm: usize, plan: &ArmPlan) -> Self {
        let seen = Seen {
            follows: false,
            sync: None,
            moved: TimeNs(0),
            stop: None,
        };
        Self {
            arm,
            plan: *plan,
            seen: [seen; TAIL_AXES],
            enabled: false,
        }
    }

    /// Whether all drives follow.
    pub(super) fn all_follow(&self) -> bool {
        self.seen.iter().all(|seen| seen.follows)
    }

    /// Looks at all drives; `tell` gets every stop that has come to its rest.
    ///
    /// To be called every millisecond of the drives' time: both instants of a stop are as exact as
    /// that.
    pub(super) fn look(
        &mut self,
        now: TimeNs,
        network: &mut Network<Terminal>,
        tell: &mut dyn FnMut(Stop),
    ) {
        for axis in 0..TAIL_AXES {
            self.look_at(axis, now, network, tell);
        }
        if self.all_follow() {
            self.enabled = true;
        } else if self.seen.iter().all(|seen| !seen.follows) {
            // The next bring-up enables its drives one by one again.
            self.enabled = false;
        }
    }

    /// A stop is noted only once all drives have been enabled together, since bring-up and homing
    /// enable and disable them one by one.
    fn look_at(
        &mut self,
        axis: usize,
        now: TimeNs,
        network: &mut Network<Terminal>,
        tell: &mut dyn FnMut(Stop),
    ) {
        let plan = self.plan.axes[axis];
        let powered = network.is_powered(plan.node);
        let speed = network
            .motor(plan.node)
            .map_or(0.0, |motor| motor.feedback.velocity_counts_s.abs());
        let Some(node) = network.node(plan.node) else {
            return;
        };
        // A drive that is homed is enabled, too, and has no set-points yet.
        let mode = node.dictionary().get(index::MODE_DISPLAY);
        let follows = powered
            && node.power_state() == PowerState::OperationEnabled
            && mode == i64::from(Mode::CyclicPosition.raw());
        let seen = &mut self.seen[axis];
        if follows {
            seen.sync = node.newest_sync().or(seen.sync);
        }
        if speed > REST_SHARE * plan.speed_max * plan.counts_per_unit.abs() {
            seen.moved = now;
        }
        if seen.follows && !follows && self.enabled {
            seen.stop = Some(Stop {
                arm: self.arm,
                axis,
                node: plan.node,
                cause: cause(node, powered),
                at: now,
                sync: node.newest_sync().or(seen.sync),
                rest: None,
                stalled_ns: 0,
            });
        }
        seen.follows = follows;
        let since = seen.stop.map_or(now, |stop| stop.at.max(seen.moved));
        if now.since(since) >= REST_NS
            && let Some(mut stop) = seen.stop.take()
        {
            stop.rest = Some(stop.sync.map_or(since, |sync| seen.moved.max(sync)));
            tell(stop);
        }
    }
}

/// In order of rank: no power, an error that the drive reports, an NMT state other than
/// operational, a quick stop, and what is left.
fn cause(node: &Node, powered: bool) -> StopCause {
    let dictionary = node.dictionary();
    let code: u16 = dictionary.get_as(index::ERROR_CODE);
    let control: u16 = dictionary.get_as(index::CONTROL);
    let command = ControlView(control).command();
    if !powered {
        StopCause::Powerless
    } else if dictionary.get(index::ERROR_REGISTER) != 0 && code != 0 {
        StopCause::Error(ErrorCode(code))
    } else if node.nmt_state() != NmtState::Operational {
        StopCause::Left(node.nmt_state())
    } else if command == Command::QuickStop {
        StopCause::QuickStop
    } else {
        StopCause::SwitchedOff
    }
}

/// The stops of `stops` in a few lines: those of one arm for one reason together.
///
/// In the order of the first of each group. Quadratic in their number, which is a few.
#[must_use]
pub(super) fn lines(stops: &[Stop]) -> Vec<String> {
    let mut lines = Vec::new();
    for (place, stop) in stops.iter().enumerate() {
        let alike = |other: &&Stop| (other.arm, other.cause) == (stop.arm, stop.cause);
        if stops[..place].iter().any(|other| alike(&other)) {
            continue;
        }
        let group: Vec<&Stop> = stops.iter().filter(alike).collect();
        lines.push(line(stop, &group));
    }
    lines
}

/// The stops of `group`, of which `stop` is the first, in a line.
///
/// The slowest of the group gives the times.
fn line(stop: &Stop, group: &[&Stop]) -> String {
    let nodes: Vec<String> = group.iter().map(|stop| stop.node.to_string()).collect();
    let arm = ARM_NAMES[stop.arm];
    let plural = if group.len() == 1 { "node" } else { "nodes" };
    let mut line = format!(
        "{arm}: {plural} {} stopped at {:.3} s: {}",
        nodes.join(" "),
        stop.at.seconds(),
        stop.cause
    );
    let after = group.iter().filter_map(|stop| stop.after_sync_ns());
    if let Some((at_ns, rest_ns)) = after.max_by_key(|(_, rest_ns)| *rest_ns) {
        line += &format!(
            "; stopped {:.1} ms and at rest {:.1} ms after the last SYNC",
            TimeNs(at_ns).seconds() * 1e3,
            TimeNs(rest_ns).seconds() * 1e3
        );
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stop(arm: usize, node: u8, cause: StopCause, rest_ms: u64) -> Stop {
        let ms = |ms: u64| TimeNs(ms * 1_000_000);
        Stop {
            arm,
            axis: 0,
            node: NodeId::new(node).unwrap(),
            cause,
            at: ms(1020),
            sync: Some(ms(1000)),
            rest: Some(ms(1000 + rest_ms)),
            stalled_ns: 0,
        }
    }

    #[test]
    fn stops_of_one_cause_are_one_line_with_the_slowest() {
        let lost = StopCause::Error(ErrorCode::SYNC_CONTROLLER);
        let told = lines(&[
            stop(0, 1, lost, 31),
            stop(0, 2, lost, 37),
            stop(1, 11, lost, 25),
            stop(0, 3, StopCause::Powerless, 20),
        ]);
        assert_eq!(told.len(), 3);
        assert!(
            told[0].starts_with("psm1: nodes 1 2 stopped at 1.020 s: 8700h, "),
            "{}",
            told[0]
        );
        assert!(
            told[0].ends_with("; stopped 20.0 ms and at rest 37.0 ms after the last SYNC"),
            "{}",
            told[0]
        );
        assert!(told[1].starts_with("psm2: node 11 stopped"), "{}", told[1]);
        assert!(told[2].contains("it lost its power"), "{}", told[2]);
    }
}
