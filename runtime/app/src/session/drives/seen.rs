//! What the bus thread hands to whoever shows the drives: plain data, twenty times a second.

use hal::tail::TAIL_AXES;
use hal::{ARMS_MAX, TimeNs};
use trocar_canopen::cia301::NmtState;
use trocar_canopen::cia301::emcy::ErrorCode;
use trocar_canopen::cia402::PowerState;
use trocar_canopen::index;
use trocar_canopen::master::cycle::LINES_MAX;
use trocar_canopen::master::{ArmPlan, Bus as _};
use trocar_drives::{Network, Terminal};

/// Buses of all arms at most.
const BUSES_MAX: usize = LINES_MAX * ARMS_MAX;

/// One drive and its axis, in the units of its plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct AxisSeen {
    /// 1 to 127.
    pub(super) node: u8,
    /// Its own, not what its master last heard.
    pub(super) nmt: NmtState,
    pub(super) power: PowerState,
    /// 6061h.
    ///
    /// The mode of operation display; negative values are a maker's own.
    pub(super) mode: i8,
    /// The error that it reports, if it does.
    pub(super) error: Option<ErrorCode>,
    /// Where the axis is, and where the drive wants it if it has torque.
    pub(super) position: f64,
    /// The drive's own demand, within its position limits.
    pub(super) wanted: Option<f64>,
}

/// All drives and buses at one instant of the drives' time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// Since the drives were switched on.
    pub(super) now: TimeNs,
    /// When all drives were first enabled; the bench fills it in.
    pub(super) begun: Option<TimeNs>,
    /// Time that did not pass for the drives, ns.
    pub(super) stalled_ns: u64,
    /// Frames that found no room.
    pub(super) lost: u64,
    /// Arm by arm; none is a drive without power.
    pub(super) axes: [[Option<AxisSeen>; TAIL_AXES]; ARMS_MAX],
    /// For how long each bus has been busy, ns, and with how many frames.
    pub(super) busy: [(u64, u64); BUSES_MAX],
}

impl Seen {
    /// The drives of `arms` on the buses of `network`, of which the first `lines` are there.
    ///
    /// Copies: nothing is borrowed from the network, so that a page may be slow.
    pub(super) fn look<'a>(
        network: &mut Network<Terminal>,
        arms: impl Iterator<Item = &'a ArmPlan>,
        lines: u8,
    ) -> Self {
        let mut seen = Self {
            now: network.now(),
            begun: None,
            stalled_ns: 0,
            lost: 0,
            axes: [[None; TAIL_AXES]; ARMS_MAX],
            busy: [(0, 0); BUSES_MAX],
        };
        for (axes, plan) in seen.axes.iter_mut().zip(arms) {
            for (axis, place) in axes.iter_mut().enumerate() {
                *place = look_at(network, plan, axis);
            }
        }
        for (busy, line) in seen.busy.iter_mut().zip(0..lines) {
            *busy = network.wire(line).busy();
        }
        seen
    }
}

/// None without power, and for an axis that the plan has not. An error counts only if both the
/// register (1001h) and the code (603Fh) are set: the code alone is what the last error was.
fn look_at(network: &mut Network<Terminal>, plan: &ArmPlan, axis: usize) -> Option<AxisSeen> {
    let axis = plan.axes.get(axis)?;
    if !network.is_powered(axis.node) {
        return None;
    }
    let motor = network.motor(axis.node)?;
    let position = motor.feedback.position_counts / axis.counts_per_unit;
    let wanted = motor.demand.position_counts / axis.counts_per_unit;
    let wanted = motor.demand.torque.then_some(wanted);
    let node = network.node(axis.node)?;
    let dictionary = node.dictionary();
    let code = dictionary.get_as(index::ERROR_CODE);
    let fails = dictionary.get(index::ERROR_REGISTER) != 0 && code != 0;
    Some(AxisSeen {
        node: axis.node.raw(),
        nmt: node.nmt_state(),
        power: node.power_state(),
        mode: dictionary.get_as(index::MODE_DISPLAY),
        error: fails.then_some(ErrorCode(code)),
        position,
        wanted,
    })
}
