//! What is seen of a life: each motor, and what must not be.

use hal::TimeNs;
use trocar_canopen::cia301::Cob;
use trocar_canopen::cia301::cob::PdoNumber;
use trocar_canopen::master::AxisPlan;
use trocar_canopen::{Frame, NodeId};
use trocar_drives::AxisConfig;

/// What was thrown, what moved, and what was wrong.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen {
    /// Frames that found room on a bus.
    pub(crate) thrown: u64,
    /// Things that happened beside them.
    pub(crate) troubles: u64,
    /// How far all motors went together, counts.
    pub(crate) travelled: f64,
    /// Times at which all motors were looked at.
    pub(crate) looks: u64,
    /// Motors that had to rest after a fault when they were looked at.
    pub(crate) stills: u64,
    /// Measurements whose age was looked at, and by how many periods one was older than told at
    /// most.
    pub(crate) ages: u64,
    pub(crate) older_max: u64,
    /// Greatest share of its drive's greatest speed that an axis had.
    pub(crate) speed_share: f64,
    /// The first thing that must not be.
    pub(crate) wrong: Option<String>,
}

impl Seen {
    pub(crate) fn add(&mut self, other: &Self) {
        self.thrown += other.thrown;
        self.troubles += other.troubles;
        self.travelled += other.travelled;
        self.looks += other.looks;
        self.stills += other.stills;
        self.ages += other.ages;
        self.older_max = self.older_max.max(other.older_max);
        self.speed_share = self.speed_share.max(other.speed_share);
    }

    /// Notes what `what` says unless `holds`.
    pub(crate) fn must(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds {
            self.wrong.get_or_insert_with(what);
        }
    }
}

/// An axis, where its motor was, and where its drive last said that it is, counts.
#[derive(Clone, Copy)]
pub(crate) struct Watched {
    pub(crate) node: NodeId,
    pub(crate) range: (f64, f64),
    pub(crate) speed_max: f64,
    pub(crate) before: f64,
    /// Where the master may send it.
    pub(crate) planned: (f64, f64),
    pub(crate) told: Option<i32>,
    /// When a stranger last led it, and whether what he said may last.
    pub(crate) led: TimeNs,
    pub(crate) led_for_good: bool,
}

impl Watched {
    pub(crate) fn of(axis: &AxisPlan) -> Self {
        let drive = AxisConfig::of(axis, 0);
        let counts = |units: f64| units * axis.counts_per_unit;
        let (a, b) = (counts(axis.range.0), counts(axis.range.1));
        Self {
            node: axis.node,
            range: (drive.range.0.into(), drive.range.1.into()),
            speed_max: drive.speed_max.into(),
            before: f64::NAN,
            planned: (a.min(b) - 1.0, a.max(b) + 1.0),
            told: None,
            led: TimeNs(0),
            led_for_good: false,
        }
    }
}

/// Where a drive says that it is.
pub(crate) fn note(watched: &mut [Watched; 7], frame: &Frame) {
    if let Cob::TransmitPdo(PdoNumber::FIRST, node) = Cob::of(frame.id)
        && let [_, _, p0, p1, p2, p3, _, _] = *frame.data()
        && let Some(axis) = watched.iter_mut().find(|axis| axis.node == node)
    {
        axis.told = Some(i32::from_le_bytes([p0, p1, p2, p3]));
    }
}
