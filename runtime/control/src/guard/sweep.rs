//! A stop as samples, with what lies between them. Hot path: bounded, no allocation, no I/O, no lock.

use hal::Pose;
use hal::psm::{FINGER_M, WRIST_M};

use super::bounds::Bounds;
use super::way::Way;
use crate::instrument::{Instrument, LINKS};
use crate::motion::AXES;

/// Intervals into which a stop is cut.
pub(super) const INTERVALS: u32 = 20;

/// Their ends.
pub(super) const SAMPLES: usize = INTERVALS as usize + 1;

/// How far the points of each link can get from where they are in one moment of a stop to where they are in any other, m.
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
    gap_s: f64,
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

/// A part of a stop, to its end.
#[derive(Clone, Copy)]
pub(super) struct Rest<'a> {
    pub(super) instruments: &'a [Instrument],
    pub(super) ways: &'a [[Way; LINKS]],
    pub(super) travel_m: &'a [f64; LINKS],
}
