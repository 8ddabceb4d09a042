//! Whether a robot's policy sees: when each of its cameras showed something last, and what is done
//! when one is gone.
//!
//! Without restarts (`[policy]` in `control.toml`) the run ends with it. With some, the arms come
//! to a smooth stop and hold until it shows frames of now again, by itself or by another process in
//! its place, and go on with the next answer.

use hal::TimeNs;
use hal::random::fnv_1a;
use trocar_control::Supervision;
use trocar_log::Level;

use super::super::signals::{HoldCause, Signals};

/// A camera that shows nothing for this long, or nothing but old frames, is gone, ns.
const SILENCE_NS_MAX: u64 = 2_000_000_000;

/// How many values of a frame tell whether it is the one before.
const SAMPLES: usize = 16_384;

/// How a run is supervised, and who says on the terminal what happens.
pub(super) type Rules = (Supervision, fn(&str));

/// The policy's cameras, monitored for loss and stalls.
pub(super) struct CameraMonitor {
    /// By name, when each last showed something, by the run's clock.
    shown: Vec<(String, TimeNs)>,
    /// The size of each one's first frame, pixels, and what is said once one is of another.
    sizes: Vec<Option<(u32, u32)>>,
    resized: Option<String>,
    /// Of each one's newest frame, a hash of its pixels, and since when they are the same.
    pixels: Vec<(u64, TimeNs)>,
    rules: Supervision,
    /// Says on the terminal what happens.
    warn: fn(&str),
    /// Until when one that is gone may come back.
    gone_until: Option<TimeNs>,
    /// How often one was gone.
    times: u32,
}

impl CameraMonitor {
    /// Through the cameras of these names, supervised by these rules.
    pub(super) fn new(names: Vec<String>, (rules, warn): Rules) -> Self {
        Self {
            sizes: vec![None; names.len()],
            pixels: vec![(0, TimeNs(0)); names.len()],
            shown: names.into_iter().map(|name| (name, TimeNs(0))).collect(),
            resized: None,
            rules,
            warn,
            gone_until: None,
            times: 0,
        }
    }

    /// Whether it looks through none.
    pub(super) fn is_blind(&self) -> bool {
        self.shown.is_empty()
    }

    /// Begins at `now`: all that came before does not count.
    pub(super) fn begin(&mut self, now: TimeNs) {
        self.shown.iter_mut().for_each(|(_, shown)| *shown = now);
        self.pixels.iter_mut().for_each(|(_, since)| *since = now);
    }

    /// Takes in the size of a frame of the camera at `index`, pixels.
    pub(super) fn sized(&mut self, index: usize, size: (u32, u32)) {
        let Some(first) = self.sizes.get_mut(index) else {
            return;
        };
        if *first.get_or_insert(size) != size {
            let ((width, height), (name, _)) = (size, &self.shown[index]);
            let told = format!(
                "camera {name} shows other frames than at first: {width} x {height} pixels"
            );
            self.resized = Some(told);
        }
    }

    /// Takes in the `colour` of a frame of `now` of the camera at `index`, if it is to change
    /// within a time.
    pub(super) fn coloured(&mut self, index: usize, colour: &[u8], now: TimeNs) {
        if self.rules.frozen_ns.is_none() {
            return;
        }
        if let Some((known, since)) = self.pixels.get_mut(index) {
            let found = sampled(colour);
            if *known != found {
                (*known, *since) = (found, now);
            }
        }
    }

    /// The camera at `index` shows something of `now`.
    pub(super) fn saw(&mut self, index: usize, now: TimeNs) {
        if let Some((_, shown)) = self.shown.get_mut(index) {
            *shown = now;
        }
    }

    /// Makes the arms hold or go on; why the run ends, if it does: a camera is gone for good, or
    /// shows frames of another size.
    pub(super) fn judge(&mut self, now: TimeNs, signals: &Signals) -> Option<String> {
        if self.resized.is_some() {
            return self.resized.clone();
        }
        let gone = self.gone(now);
        match (gone, self.gone_until) {
            (None, None) => None,
            (None, Some(_)) => {
                self.gone_until = None;
                signals.hold_for_answers(now);
                signals.go_on(HoldCause::Frames);
                self.tell(now, signals, Level::Info, "the cameras show frames again");
                None
            }
            (Some(reason), None) => self.lost(reason, now, signals),
            (Some(reason), Some(until)) => (now > until).then(|| {
                let within_s = TimeNs(self.rules.return_ns).seconds();
                format!("{reason}, and again none within {within_s:.1} s")
            }),
        }
    }

    /// Which camera is gone at `now`, in words.
    fn gone(&self, now: TimeNs) -> Option<String> {
        let mut cameras = self.shown.iter();
        let gone = cameras.find(|(_, shown)| now.since(*shown) > SILENCE_NS_MAX);
        let seconds = SILENCE_NS_MAX / 1_000_000_000;
        gone.map(|(name, _)| format!("camera {name} has published no frame for {seconds} s"))
            .or_else(|| self.frozen())
    }

    /// Which camera has shown the same pixels for too long, in words; one that shows nothing
    /// repeats nothing.
    fn frozen(&self) -> Option<String> {
        let limit_ns = self.rules.frozen_ns?;
        let mut cameras = self.shown.iter().zip(&self.pixels);
        let frozen = cameras.find(|((_, shown), (_, since))| shown.since(*since) > limit_ns);
        let seconds = TimeNs(limit_ns).seconds();
        frozen.map(|((name, _), _)| {
            format!("camera {name} has shown the very same pixels for {seconds} s")
        })
    }

    /// Makes the arms hold; gives back `reason` if nothing is waited for.
    fn lost(&mut self, reason: String, now: TimeNs, signals: &Signals) -> Option<String> {
        if self.times >= self.rules.restarts {
            return Some(reason);
        }
        signals.hold(HoldCause::Frames);
        self.times += 1;
        self.gone_until = Some(now.plus_ns(self.rules.return_ns));
        let (time, of) = (self.times, self.rules.restarts);
        let within_s = TimeNs(self.rules.return_ns).seconds();
        let text = format!(
            "{reason}; the arms stop and hold; it may come back within {within_s:.1} s ({time} of {of})"
        );
        self.tell(now, signals, Level::Warning, &text);
        None
    }

    fn tell(&self, now: TimeNs, signals: &Signals, level: Level, text: &str) {
        signals.tell(now, level, text);
        (self.warn)(text);
    }
}

/// A hash of pixels evenly from a whole frame.
fn sampled(colour: &[u8]) -> u64 {
    // Neither a multiple of 2 nor of 3, so that all channels are sampled.
    let odd = (colour.len() / SAMPLES) | 1;
    let every = if odd.is_multiple_of(3) { odd + 2 } else { odd };
    fnv_1a(colour.iter().step_by(every).copied())
}
