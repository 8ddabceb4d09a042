//! Frames on the CAN interfaces of this machine, as its kernel counts them.
//!
//! Read from `/sys/class/net/NAME/statistics`: up to eight small files for each interface and look,
//! so a thread that shows or logs does it, and never the control thread. The counters are those of
//! all processes on the machine, not of ours alone. What the emulated drives know of their own
//! buses is in `session::drives`.

use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};

use hal::TimeNs;
use trocar_log::{BusRecord, BusesRecord};

use crate::rt::MonotonicClock;

/// Bits of a frame without data, and of each byte that it carries, with as many stuff bits as there
/// can be.
///
/// A base frame of ISO 11898-1 with `n` data bytes is 47 + 8 `n` bits, interframe space included,
/// of which 34 + 8 `n` are subject to stuffing: at most 8 + 2 `n` stuff bits, in sum 55 + 10 `n`.
/// The load is therefore an upper bound.
const FRAME_BITS: u64 = 55;
/// See [`FRAME_BITS`].
const BYTE_BITS: u64 = 10;

/// The kernel's number of CAN among kinds of interfaces, `ARPHRD_CAN`.
const CAN: &str = "280";

/// Rates are over this long, ns.
const OVER_NS: u64 = 1_000_000_000;

/// Some CAN interfaces.
#[derive(Debug)]
pub(crate) struct Buses {
    /// In the order of names from [`Buses::find`], in the given order from [`Buses::named`].
    pub(crate) all: Vec<Bus>,
    /// Dates the counts, from 0 when this value is made.
    clock: MonotonicClock,
}

/// One interface.
#[derive(Debug)]
pub(crate) struct Bus {
    pub(crate) name: String,
    /// The interface's `statistics`.
    folder: PathBuf,
    /// Whether it has no wire: whatever is sent on it is counted as received too.
    is_virtual: bool,
    /// What was counted at some instants, oldest first.
    ///
    /// The first is the newest that is at least [`OVER_NS`] old, once there is one: a rate is over
    /// a second or a little more.
    counted: VecDeque<(TimeNs, Count)>,
    /// Errors and dropped frames.
    ///
    /// Since the interface exists, both directions; 0 before the first look.
    pub(crate) errors: u64,
}

/// What has passed since the interface is there.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Count {
    /// Sent and received; of a virtual interface received loopback frames are left out.
    frames: u64,
    /// Of their data.
    ///
    /// Data field alone, without identifier, CRC and stuff bits.
    bytes: u64,
}

impl Buses {
    /// Those that are there.
    ///
    /// By the kind that the kernel gives each interface; empty where there is no sysfs. Virtual,
    /// serial and real ones alike, up or down.
    pub(crate) fn find() -> Self {
        let entries = fs::read_dir("/sys/class/net").into_iter().flatten();
        let all = entries.flatten().filter_map(|entry| Bus::at(&entry.path()));
        let mut all: Vec<Bus> = all.collect();
        all.sort_by(|one, other| one.name.cmp(&other.name));
        Self {
            all,
            clock: MonotonicClock::new(),
        }
    }

    /// Those called `names`, whether they are there or not.
    ///
    /// One that is not there counts 0 frames for ever.
    pub(crate) fn named<'a>(names: impl Iterator<Item = &'a String>) -> Self {
        Self {
            all: names
                .map(|name| Bus::of(&Path::new("/sys/class/net").join(name)))
                .collect(),
            clock: MonotonicClock::new(),
        }
    }

    /// What is known of them since they were last counted, at this bit rate, bit/s.
    ///
    /// Frames a second are rounded to whole ones and the load to 1e-5, so that log messages stay
    /// short.
    pub(crate) fn record(&self, bit_rate: u32) -> BusesRecord {
        let record = |bus: &Bus| BusRecord {
            interface: bus.name.clone(),
            frames_per_s: bus.frames_per_s().round(),
            load: (bus.load(bit_rate) * 1e5).round() * 1e-5,
            errors: bus.errors,
        };
        let buses = self.all.iter().map(record).collect();
        BusesRecord { buses }
    }

    /// Counts.
    ///
    /// Rates need two looks; how often they come does not matter, since a rate is over about a
    /// second whatever was counted in between.
    pub(crate) fn look(&mut self) {
        let now = self.clock.now();
        self.all.iter_mut().for_each(|bus| bus.look(now));
    }
}

impl Bus {
    /// None if `folder`, of `/sys/class/net`, is not a CAN interface.
    fn at(folder: &Path) -> Option<Self> {
        let kind = fs::read_to_string(folder.join("type")).ok()?;
        (kind.trim() == CAN).then(|| Self::of(folder))
    }

    /// `folder` need not exist; its last part is the name.
    fn of(folder: &Path) -> Self {
        let name = folder.file_name().unwrap_or_default();
        Self {
            name: name.to_string_lossy().into_owned(),
            folder: folder.join("statistics"),
            // A serial adapter has no device either.
            is_virtual: !folder.join("device").exists()
                && !name.to_string_lossy().starts_with("slcan"),
            counted: VecDeque::new(),
            errors: 0,
        }
    }

    /// The sum of these counters; one that cannot be read adds nothing.
    fn count(&self, names: &[&str]) -> u64 {
        let read = |name: &&str| fs::read_to_string(self.folder.join(name)).ok();
        let texts = names.iter().filter_map(read);
        texts
            .filter_map(|text| text.trim().parse::<u64>().ok())
            .sum()
    }

    fn look(&mut self, now: TimeNs) {
        let ways = if self.is_virtual { 1 } else { 2 };
        let count = Count {
            frames: self.count(&["tx_packets", "rx_packets"][..ways]),
            bytes: self.count(&["tx_bytes", "rx_bytes"][..ways]),
        };
        self.errors = self.count(&["rx_errors", "tx_errors", "rx_dropped", "tx_dropped"]);
        self.note(now, count);
    }

    /// Adds a count and drops those that no rate needs any more.
    fn note(&mut self, now: TimeNs, count: Count) {
        self.counted.push_back((now, count));
        while let Some((second, _)) = self.counted.get(1)
            && now.since(*second) >= OVER_NS
        {
            self.counted.pop_front();
        }
    }

    /// Frames a second, both ways; 0 before there are two counts.
    pub(crate) fn frames_per_s(&self) -> f64 {
        self.per_s(|count| count.frames)
    }

    /// Share of the time for which frames keep a bus of `bit_rate` bits a second busy, with as many
    /// stuff bits as there can be.
    ///
    /// More than 1 is possible: on a virtual interface nothing limits the rate. A `bit_rate` of 0
    /// counts as 1.
    pub(crate) fn load(&self, bit_rate: u32) -> f64 {
        let bits = |count: &Count| FRAME_BITS * count.frames + BYTE_BITS * count.bytes;
        self.per_s(bits) / f64::from(bit_rate.max(1))
    }

    /// The mean over all counts that are kept; 0 also if a counter went back, as when an interface
    /// was made anew.
    #[expect(clippy::cast_precision_loss, reason = "bits of a second or so")]
    fn per_s(&self, of: impl Fn(&Count) -> u64) -> f64 {
        let (Some((then, before)), Some((now, newest))) =
            (self.counted.front(), self.counted.back())
        else {
            return 0.0;
        };
        let seconds = TimeNs(now.since(*then)).seconds();
        if seconds > 0.0 {
            of(newest).saturating_sub(of(before)) as f64 / seconds
        } else {
            0.0
        }
    }

    #[cfg(test)]
    pub(crate) fn counted(name: &str, counts: &[(u64, u64)]) -> Self {
        let mut bus = Self::of(Path::new(name));
        for (ms, frames) in counts {
            let (frames, bytes) = (*frames, 8 * frames);
            bus.note(TimeNs(ms * 1_000_000), Count { frames, bytes });
        }
        bus
    }

    #[cfg(test)]
    pub(crate) fn all(buses: Vec<Self>) -> Buses {
        Buses {
            all: buses,
            clock: MonotonicClock::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is sent on an interface without a wire is counted once, and the load is that of frames
    /// with most stuff bits.
    #[test]
    fn frames_load_and_errors_are_the_kernels() {
        let folder = std::env::temp_dir().join(format!("trocar-traffic-{}", std::process::id()));
        let statistics = folder.join("can7/statistics");
        fs::create_dir_all(&statistics).unwrap();
        let write = |frames: u64, errors: u64| {
            for way in ["rx", "tx"] {
                for (of, value) in [
                    ("packets", frames),
                    ("bytes", 8 * frames),
                    ("errors", errors),
                ] {
                    fs::write(statistics.join(format!("{way}_{of}")), format!("{value}\n"))
                        .unwrap();
                }
            }
        };
        for (wired, times) in [(false, 1.0), (true, 2.0)] {
            if wired {
                fs::create_dir(folder.join("can7/device")).unwrap();
            }
            let mut bus = Bus::of(&folder.join("can7"));
            for (second, frames) in [(0, 0), (1, 2000)] {
                write(frames, 3 * second);
                bus.look(TimeNs(second * 1_000_000_000));
            }
            assert!((bus.frames_per_s() - times * 2000.0).abs() < 1e-6);
            assert!((bus.load(1_000_000) - times * 0.27).abs() < 1e-9, "{bus:?}");
            assert_eq!((bus.name.as_str(), bus.errors), ("can7", 6));
        }
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_frame_has_at_most_so_many_bits() {
        for bytes in 0..=8 {
            let most = FRAME_BITS + BYTE_BITS * u64::from(bytes);
            assert_eq!(most, u64::from(trocar_canopen::bus_load::bits::most(bytes)));
        }
    }
}
