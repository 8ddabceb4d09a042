//! Frames on the CAN interfaces of this machine, as its kernel counts them.

use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};

use hal::TimeNs;

use crate::rt::MonotonicClock;

/// The kernel's number of CAN among kinds of interfaces, `ARPHRD_CAN`.
const CAN: &str = "280";

/// Rates are over this long, ns.
const OVER_NS: u64 = 1_000_000_000;

/// All CAN interfaces.
#[derive(Debug)]
pub(super) struct Buses {
    pub(super) all: Vec<Bus>,
    clock: MonotonicClock,
}

/// One interface.
#[derive(Debug)]
pub(super) struct Bus {
    pub(super) name: String,
    folder: PathBuf,
    /// Frames at some instants, oldest first.
    counted: VecDeque<(TimeNs, u64)>,
    /// Errors and dropped frames.
    pub(super) errors: u64,
}

impl Buses {
    /// Those that are there.
    pub(super) fn find() -> Self {
        let entries = fs::read_dir("/sys/class/net").into_iter().flatten();
        let all = entries.flatten().filter_map(|entry| Bus::at(&entry.path()));
        let mut all: Vec<Bus> = all.collect();
        all.sort_by(|one, other| one.name.cmp(&other.name));
        Self {
            all,
            clock: MonotonicClock::new(),
        }
    }

    /// Counts.
    pub(super) fn look(&mut self) {
        let now = self.clock.now();
        self.all.iter_mut().for_each(|bus| bus.look(now));
    }
}

impl Bus {
    fn at(folder: &Path) -> Option<Self> {
        let kind = fs::read_to_string(folder.join("type")).ok()?;
        (kind.trim() == CAN).then(|| Self {
            name: folder
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            folder: folder.join("statistics"),
            counted: VecDeque::new(),
            errors: 0,
        })
    }

    fn count(&self, names: &[&str]) -> u64 {
        let read = |name: &&str| fs::read_to_string(self.folder.join(name)).ok();
        let texts = names.iter().filter_map(read);
        texts
            .filter_map(|text| text.trim().parse::<u64>().ok())
            .sum()
    }

    fn look(&mut self, now: TimeNs) {
        let frames = self.count(&["rx_packets", "tx_packets"]);
        self.errors = self.count(&["rx_errors", "tx_errors", "rx_dropped", "tx_dropped"]);
        self.note(now, frames);
    }

    fn note(&mut self, now: TimeNs, frames: u64) {
        self.counted.push_back((now, frames));
        while let Some((second, _)) = self.counted.get(1)
            && now.since(*second) >= OVER_NS
        {
            self.counted.pop_front();
        }
    }

    /// Frames a second, both ways; 0 before there are two counts.
    #[expect(clippy::cast_precision_loss, reason = "frames of a second or so")]
    pub(super) fn frames_per_s(&self) -> f64 {
        let (Some((then, before)), Some((now, frames))) =
            (self.counted.front(), self.counted.back())
        else {
            return 0.0;
        };
        let seconds = TimeNs(now.since(*then)).seconds();
        if seconds > 0.0 {
            frames.saturating_sub(*before) as f64 / seconds
        } else {
            0.0
        }
    }

    #[cfg(test)]
    pub(super) fn counted(name: &str, counts: &[(u64, u64)]) -> Self {
        let mut bus = Self {
            name: name.to_owned(),
            folder: PathBuf::new(),
            counted: VecDeque::new(),
            errors: 0,
        };
        for (ms, frames) in counts {
            bus.note(TimeNs(ms * 1_000_000), *frames);
        }
        bus
    }

    #[cfg(test)]
    pub(super) fn all(buses: Vec<Self>) -> Buses {
        Buses {
            all: buses,
            clock: MonotonicClock::new(),
        }
    }
}
