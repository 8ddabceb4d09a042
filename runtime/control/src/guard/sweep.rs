//! A stop as samples, with what lies between them. Hot path: bounded, no allocation, no I/O, no
//! lock.

use hal::Pose;
use hal::psm::{FINGER_M, WRIST_M};

use super::bounds::Bounds;
use super::way::Way;
use crate::instrument::{Instrument, LINKS};
use crate::motion::AXES;
use crate::snapshot::{Reader, Snapshot, SnapshotError, Words, layout, possible};

/// Intervals into which a stop is cut.
pub(super) const INTERVALS: u32 = 20;

/// Their ends.
pub(super) const SAMPLES: usize = INTERVALS as usize + 1;

/// How far the points of each link can get from where they are in one moment of a stop to where
/// they are in any other, m.
///
/// One axis after the other, the last one first, each moves a point along an arc about it.
pub(super) fn travel_m(wrist_distance_m: f64, ranges: &[(f64, f64); AXES]) -> [f64; LINKS] {
    let [yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw, jaw] =
        ranges.map(|(low, high)| high - low);
    let swing = yaw + pitch;
    let shaft = (wrist_distance_m + insertion) * swing + insertion;
    let wrist = shaft + WRIST_M * (swing + roll + wrist_pitch);
    let fingers = wrist + FINGER_M * (swing + roll + wrist_pitch + wrist_yaw + 0.5 * jaw);
    [shaft, wrist, fingers, fingers]
}

/// Where the links are along a stop.
#[derive(Clone, Debug)]
pub(super) struct Sweep {
    instruments: [Instrument; SAMPLES],
    /// What can happen next to each sample, the worse of its two sides.
    ways: [[Way; LINKS]; SAMPLES],
    count: usize,
    /// Between samples; 0 of an arm at rest.
    gap_s: f64,
    /// Of the whole stop, see the function of this name; stays valid while the stop is played.
    travel_m: [f64; LINKS],
}

impl Sweep {
    /// An arm that rests at `instrument`.
    pub(super) fn at_rest(instrument: Instrument) -> Self {
        Self {
            instruments: [instrument; SAMPLES],
            ways: [[Way::default(); LINKS]; SAMPLES],
            count: 1,
            gap_s: 0.0,
            travel_m: [0.0; LINKS],
        }
    }

    /// Starts anew with the first sample of a stop whose samples are `gap_s` apart.
    pub(super) fn begin(&mut self, instrument: &Instrument, gap_s: f64, travel_m: [f64; LINKS]) {
        self.instruments[0] = *instrument;
        self.ways[0] = [Way::default(); LINKS];
        self.count = 1;
        self.gap_s = gap_s;
        self.travel_m = travel_m;
    }

    /// One more sample and what can happen between it and the last one.
    pub(super) fn push(&mut self, instrument: &Instrument, bounds: &Bounds) {
        let new = bounds.ways();
        for (way, new) in self.ways[self.count - 1].iter_mut().zip(&new) {
            *way = way.worse(new);
        }
        self.instruments[self.count] = *instrument;
        self.ways[self.count] = new;
        self.count += 1;
    }

    /// Turns every sample into another frame.
    pub(super) fn move_to(&mut self, frame: &Pose) {
        for instrument in &mut self.instruments[..self.count] {
            *instrument = instrument.moved(frame);
        }
    }

    /// What is left of the stop after `played_s` of it.
    ///
    /// Begins at the last sample that has been reached, so it may be a gap longer than what is
    /// left, never shorter.
    pub(super) fn rest(&self, played_s: f64) -> Rest<'_> {
        let mut begin = 0;
        let mut passed_s = self.gap_s;
        while begin + 1 < self.count && passed_s <= played_s {
            begin += 1;
            passed_s += self.gap_s;
        }
        Rest {
            instruments: &self.instruments[begin..self.count],
            ways: &self.ways[begin..self.count],
            travel_m: &self.travel_m,
        }
    }
}

// Samples past the last one are left over from stops before, and nothing looks at them.
impl Words for Sweep {
    const LAYOUT: u64 = layout(
        "Sweep count instruments ways gap_s travel_m",
        &[
            <Instrument as Words>::LAYOUT,
            <[Way; LINKS] as Words>::LAYOUT,
        ],
    );
    const WORDS_MAX: usize = 2
        + LINKS
        + SAMPLES * (<Instrument as Words>::WORDS_MAX + <[Way; LINKS] as Words>::WORDS_MAX);

    fn put(&self, to: &mut Snapshot) {
        let Self {
            instruments,
            ways,
            count,
            gap_s,
            travel_m,
        } = self;
        count.put(to);
        for (instrument, ways) in instruments.iter().zip(ways).take(*count) {
            instrument.put(to);
            ways.put(to);
        }
        gap_s.put(to);
        travel_m.put(to);
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        let count = usize::take(from)?;
        possible((1..=SAMPLES).contains(&count))?;
        let mut sweep = Self::at_rest(Words::take(from)?);
        sweep.ways[0] = Words::take(from)?;
        let samples = sweep.instruments.iter_mut().zip(&mut sweep.ways);
        for (instrument, ways) in samples.take(count).skip(1) {
            *instrument = Words::take(from)?;
            *ways = Words::take(from)?;
        }
        sweep.count = count;
        sweep.gap_s = Words::take(from)?;
        sweep.travel_m = Words::take(from)?;
        Ok(sweep)
    }
}

/// A part of a stop, to its end.
#[derive(Clone, Copy)]
pub(super) struct Rest<'a> {
    pub(super) instruments: &'a [Instrument],
    /// Beside each of `instruments`.
    pub(super) ways: &'a [[Way; LINKS]],
    pub(super) travel_m: &'a [f64; LINKS],
}
