//! Status of the drives for the pages of the console.
//!
//! Messages are JSON, one object whenever the bus thread has put a new look into the mailbox (20 a
//! second); the page that shows them is `console/page/drives.js`.

use std::collections::VecDeque;

use hal::joints::{INSERTION, JOINT_NAMES};
use hal::{ARM_NAMES, ARMS_MAX, TimeNs};
use serde::Serialize;
use trocar_canopen::cia301::NmtState;
use trocar_canopen::cia402::{Mode, PowerState};
use trocar_canopen::master::Space;
use trocar_log::Level;

use super::seen::{AxisSeen, Seen};
use crate::console::Console;
use crate::mailbox::MailboxReader;
use crate::rig::can_traffic::Buses;

/// Lines of what happened that a page has.
///
/// The page keeps no lines of its own, so each message has all of them.
const LINES_MAX: usize = 40;

/// A bus's load is that of the last whole one of these, ns.
const LOAD_NS: u64 = 1_000_000_000;

/// The drives, on their way to the pages that look at them.
pub(super) struct DrivesPage {
    /// Where messages go; with nobody connected they go nowhere.
    console: Console,
    seen: MailboxReader<Seen>,
    /// One an arm, none where there is no arm: names of axes depend on it.
    spaces: [Option<Space>; ARMS_MAX],
    /// What the kernel counts, beside what the emulated wires know.
    buses: Buses,
    /// Oldest first.
    lines: VecDeque<Line>,
    /// The drives' time of the newest look, which dates lines.
    now: TimeNs,
    /// The drives at the beginning of the time that loads are taken over, and each bus's load in
    /// the one before.
    ///
    /// Replaced once a second.
    before: Option<Seen>,
    /// 0 to 1, one an interface.
    loads: Vec<f64>,
}

/// Something that happened.
#[derive(Clone, Debug, Serialize)]
struct Line {
    /// In the drives' time.
    seconds: f64,
    text: String,
}

/// The whole of a message; keys are the fields' names, and the page reads them by name.
#[derive(Serialize)]
struct DrivesStatus<'a> {
    /// Always `drives`: by it a page knows what message this is.
    kind: &'static str,
    seconds: f64,
    /// Since all drives were enabled for the first time, if they were.
    episode_s: Option<f64>,
    /// Time that did not pass for the drives, since the start.
    stalled_s: f64,
    /// Since the start, over all buses.
    frames_lost: u64,
    arms: Vec<ArmStatus>,
    buses: Vec<BusStatus<'a>>,
    /// The newest 40 lines of the terminal.
    happened: &'a VecDeque<Line>,
}

/// Of an arm that the drives have.
#[derive(Serialize)]
struct ArmStatus {
    name: &'static str,
    /// In axis order, the jaw or the last actuator at the end.
    axes: Vec<AxisStatus>,
}

/// Words for people, ready to be shown; empty or `no power` without power.
#[derive(Serialize)]
struct AxisStatus {
    name: &'static str,
    /// None without power.
    node: Option<u8>,
    nmt: &'static str,
    /// CiA 402's power state.
    state: &'static str,
    mode: &'static str,
    /// The error that it reports, if there is one.
    error: Option<String>,
    /// `m` of the insertion, else `rad`.
    unit: &'static str,
    /// Where the motor is, in `unit`; none without power.
    position: Option<f64>,
    /// Where the drive holds it; none without torque.
    wanted: Option<f64>,
}

#[derive(Serialize)]
struct BusStatus<'a> {
    interface: &'a str,
    /// Since the start, by the emulated wire.
    frames: u64,
    /// Share of the last second for which it was busy at its bit rate.
    load: f64,
    /// What the kernel counts of its interface.
    frames_per_s: f64,
    /// Since the interface exists, by the kernel.
    errors: u64,
}

impl DrivesPage {
    /// Of the drives that `seen` reports, whose plans have these spaces, on buses with these
    /// interfaces.
    pub(super) fn new(
        console: Console,
        seen: MailboxReader<Seen>,
        spaces: impl Iterator<Item = Space>,
        interfaces: Vec<String>,
    ) -> Self {
        let mut all = [None; ARMS_MAX];
        for (place, space) in all.iter_mut().zip(spaces) {
            *place = Some(space);
        }
        Self {
            console,
            seen,
            spaces: all,
            loads: vec![0.0; interfaces.len()],
            buses: Buses::named(interfaces.iter()),
            lines: VecDeque::new(),
            now: TimeNs(0),
            before: None,
        }
    }

    /// Keeps a line of what happened.
    ///
    /// Also goes into the console's log of events, at the time of the newest look.
    pub(super) fn note(&mut self, text: &str) {
        if self.lines.len() == LINES_MAX {
            self.lines.pop_front();
        }
        self.lines.push_back(Line {
            seconds: self.now.seconds(),
            text: text.to_owned(),
        });
        self.console.happened(self.now, Level::Info, text);
    }

    /// Tells the pages how the drives are, if there is something new.
    ///
    /// Called every 5 ms by the first thread. Reads the kernel's counters when there is something
    /// new.
    pub(super) fn turn(&mut self) {
        let Some(seen) = self.seen.take() else {
            return;
        };
        self.take_loads(&seen);
        self.buses.look();
        self.now = seen.now;
        let status = self.status(&seen);
        let axes = |axis: &AxisStatus| (axis.name, axis.position, axis.wanted);
        let arms = status.arms.iter().map(|arm| arm.axes.iter().map(axes));
        self.console.tell_axes(seen.now, arms);
        self.console.tell(&status);
    }

    fn arms_status(&self, seen: &Seen) -> Vec<ArmStatus> {
        let arms = ARM_NAMES.into_iter().zip(&self.spaces).zip(&seen.axes);
        let arms = arms.filter_map(|((name, space), axes)| {
            let space = (*space)?;
            let axes = axes.iter().enumerate();
            let axes = axes.map(|(axis, seen)| axis_status(axis, space, seen.as_ref()));
            Some(ArmStatus {
                name,
                axes: axes.collect(),
            })
        });
        arms.collect()
    }

    /// Allocates; borrows names and lines.
    fn status(&self, seen: &Seen) -> DrivesStatus<'_> {
        let buses = self.buses.all.iter().zip(&seen.busy).zip(&self.loads);
        let buses = buses.map(|((bus, (_, frames)), load)| BusStatus {
            interface: &bus.name,
            frames: *frames,
            load: *load,
            frames_per_s: bus.frames_per_s().round(),
            errors: bus.errors,
        });
        let begun = seen.begun.map(|begun| seen.now.since(begun));
        DrivesStatus {
            kind: "drives",
            seconds: seen.now.seconds(),
            episode_s: begun.map(|since_ns| TimeNs(since_ns).seconds()),
            stalled_s: TimeNs(seen.stalled_ns).seconds(),
            frames_lost: seen.lost,
            arms: self.arms_status(seen),
            buses: buses.collect(),
            happened: &self.lines,
        }
    }

    /// Until the first second is over loads are 0.
    fn take_loads(&mut self, seen: &Seen) {
        let before = self.before.get_or_insert(*seen);
        let elapsed_ns = seen.now.since(before.now);
        if elapsed_ns < LOAD_NS {
            return;
        }
        for ((load, now), then) in self.loads.iter_mut().zip(&seen.busy).zip(&before.busy) {
            *load = TimeNs(now.0 - then.0).seconds() / TimeNs(elapsed_ns).seconds();
        }
        *before = *seen;
    }
}

/// `axis` counts from 0; `seen` is none of a drive without power.
fn axis_status(axis: usize, space: Space, seen: Option<&AxisSeen>) -> AxisStatus {
    let name = JOINT_NAMES.get(axis).copied().unwrap_or("jaw");
    let name = match space {
        Space::Joint => name,
        Space::Actuator => ACTUATORS.get(axis).copied().unwrap_or(name),
    };
    let unit = if axis == INSERTION { "m" } else { "rad" };
    AxisStatus {
        name,
        node: seen.map(|seen| seen.node),
        nmt: seen.map_or("no power", |seen| nmt_name(seen.nmt)),
        state: seen.map_or("no power", |seen| power_name(seen.power)),
        mode: seen.map_or("", |seen| mode_name(seen.mode)),
        error: seen.and_then(|seen| {
            let code = seen.error?;
            let text = code.text().unwrap_or("a code of its own");
            Some(format!("{:04X}h, {text}", code.0))
        }),
        unit,
        position: seen.map(|seen| seen.position),
        wanted: seen.and_then(|seen| seen.wanted),
    }
}

/// Axes behind the cable coupling.
const ACTUATORS: [&str; 7] = [
    "yaw",
    "pitch",
    "insertion",
    "disk 1",
    "disk 2",
    "disk 3",
    "disk 4",
];

/// As CiA 301 names it.
const fn nmt_name(state: NmtState) -> &'static str {
    match state {
        NmtState::BootUp => "boot-up",
        NmtState::Stopped => "stopped",
        NmtState::Operational => "operational",
        NmtState::PreOperational => "pre-operational",
    }
}

/// As CiA 402 names it.
const fn power_name(state: PowerState) -> &'static str {
    match state {
        PowerState::NotReady => "not ready to switch on",
        PowerState::SwitchOnDisabled => "switch on disabled",
        PowerState::ReadyToSwitchOn => "ready to switch on",
        PowerState::SwitchedOn => "switched on",
        PowerState::OperationEnabled => "operation enabled",
        PowerState::QuickStopActive => "quick stop active",
        PowerState::FaultReaction => "fault reaction active",
        PowerState::Fault => "fault",
    }
}

/// Of 6061h, the mode that the drive is in, not the one it was asked for.
fn mode_name(mode: i8) -> &'static str {
    match Mode::try_from(mode) {
        Ok(Mode::None) => "none",
        Ok(Mode::ProfilePosition) => "profile position",
        Ok(Mode::Velocity) => "velocity",
        Ok(Mode::ProfileVelocity) => "profile velocity",
        Ok(Mode::ProfileTorque) => "profile torque",
        Ok(Mode::Homing) => "homing",
        Ok(Mode::InterpolatedPosition) => "interpolated position",
        Ok(Mode::CyclicPosition) => "cyclic position",
        Ok(Mode::CyclicVelocity) => "cyclic velocity",
        Ok(Mode::CyclicTorque) => "cyclic torque",
        Err(_) => "unknown",
    }
}

#[cfg(test)]
impl DrivesPage {
    /// A page's news of `seen`, after the `lines`.
    pub(super) fn told(&mut self, seen: &Seen, lines: &[&str]) -> serde_json::Value {
        self.take_loads(seen);
        lines.iter().for_each(|line| self.note(line));
        serde_json::to_value(self.status(seen)).unwrap_or_default()
    }
}
