//! How long it takes from an operator's hand to the command of the arm.

use hal::TimeNs;
use serde::Serialize;

use crate::histogram::Histogram;
use crate::session::summary::LatencyMs;

/// A page's clock may go this much slower than ours without its messages seeming old, as a part:
/// crystals are better.
const DRIFT: f64 = 2e-4;

/// How old a page's messages are when they arrive, beyond the quickest of them: its clock has
/// another origin than ours.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Transit {
    /// The least of arrival minus the page's time, ms, and when it was the least, ms.
    least: Option<(f64, f64)>,
}

impl Transit {
    /// How much longer than the quickest a message of `t_ms` was on its way that arrived at `now`,
    /// ns.
    pub(super) fn excess_ns(&mut self, t_ms: f64, now: TimeNs) -> u64 {
        let now_ms = now.seconds() * 1e3;
        let offset = now_ms - t_ms;
        let allowed = |(least, since): (f64, f64)| least + DRIFT * (now_ms - since);
        match self.least.filter(|&least| allowed(least) < offset) {
            None => {
                self.least = Some((offset, now_ms));
                0
            }
            Some(least) => to_ns(offset - allowed(least)),
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to a day, not negative"
)]
fn to_ns(ms: f64) -> u64 {
    (ms.clamp(0.0, 86_400_000.0) * 1e6) as u64
}

/// What is counted of a run that is moved by hand.
#[derive(Clone, Debug, Default)]
pub(super) struct Counts {
    /// From a message's arrival to the first command that follows it, with what it was late by on
    /// its way.
    pub(super) command: Histogram,
    /// From a picture's instant to the page's word that it is shown.
    pub(super) picture: Histogram,
    /// Of pings to the page and back.
    pub(super) round_trip: Histogram,
    /// Messages that were followed or could have been.
    pub(super) messages: u64,
    /// Clutch-ins.
    pub(super) engagements: u64,
    /// Engagements that ended by force.
    pub(super) losses: u64,
    /// What moved the hand that engaged last.
    pub(super) device: Option<HandDevice>,
    /// What happened beside a policy.
    pub(super) interventions: InterventionSummary,
}

/// What moves an operator's hand, as far as its messages tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum HandDevice {
    /// Keyboard, mouse, gamepad or SpaceMouse of a page.
    Page,
    /// A headset's controller.
    Headset,
    /// A device of `--hands`, at the run's own computer.
    InputDevice,
}

/// What a run that is moved by hand reports beside the rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TeleopSummary {
    /// From the page's message of a hand to the first command that follows it: half the shortest
    /// round trip to the page, what the message was late by against the quickest, and the way from
    /// its arrival to the tick. Absent if no hand was ever followed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hand_to_command_ms: Option<LatencyMs>,
    /// From a picture's instant to its showing on the page that steers: what the page says of every
    /// fifth picture after the browser's next frame began, or once it is uploaded in a headset's
    /// frame, less half the shortest round trip. Absent if none was shown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_to_page_ms: Option<FrameAgeMs>,
    /// The shortest way to the page and back, ms, if it was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub round_trip_ms: Option<f64>,
    /// Messages of hands.
    pub messages: u64,
    /// How often a clutch was engaged.
    pub engagements: u64,
    /// How often one was released by force.
    pub forced_releases: u64,
    /// What moved the hand that engaged last; absent if none did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<HandDevice>,
    /// What part of the hand's way the tip made, at the end.
    pub scale: f64,
    /// Within which angle of its instrument a tracked controller engaged, degrees, at the end.
    pub align_deg: f64,
    /// Of a run that has a policy too.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub interventions: Option<InterventionSummary>,
}

/// Ages of pictures, ms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameAgeMs {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
}

/// How an operator took over from a policy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct InterventionSummary {
    /// How often.
    pub taken_over: u64,
    /// How often the policy was given the arms back.
    pub handed_back: u64,
    /// For how long the operator drove in all, s.
    pub operator_s: f64,
}

impl Counts {
    fn round_trip_ms(&self) -> Option<f64> {
        (self.round_trip.count() > 0).then(|| milliseconds(self.round_trip.min()))
    }

    /// How old pictures were when they were shown.
    pub(super) fn camera_to_page_ms(&self) -> Option<FrameAgeMs> {
        let back = self.round_trip_ms().unwrap_or(0.0) / 2.0;
        let percentile = |share| (milliseconds(self.picture.percentile(share)) - back).max(0.0);
        (self.picture.count() > 0).then(|| FrameAgeMs {
            p50: percentile(0.50),
            p95: percentile(0.95),
            p99: percentile(0.99),
        })
    }

    /// What is reported, with the scale and the bound of the alignment that were chosen.
    pub(super) fn summary(
        &self,
        (scale, align_deg): (f64, f64),
        beside_policy: bool,
    ) -> TeleopSummary {
        let round_trip_ms = self.round_trip_ms();
        let on_the_way = round_trip_ms.unwrap_or(0.0) / 2.0;
        let percentile = |share| milliseconds(self.command.percentile(share)) + on_the_way;
        TeleopSummary {
            hand_to_command_ms: (self.command.count() > 0).then(|| LatencyMs {
                p50: percentile(0.50),
                p99: percentile(0.99),
            }),
            camera_to_page_ms: self.camera_to_page_ms(),
            round_trip_ms,
            messages: self.messages,
            engagements: self.engagements,
            forced_releases: self.losses,
            device: self.device,
            scale,
            align_deg,
            interventions: beside_policy.then_some(self.interventions),
        }
    }
}

fn milliseconds(ns: u64) -> f64 {
    TimeNs(ns).seconds() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lateness_is_counted_from_the_quickest_message() {
        let mut transit = Transit::default();
        let at = |ms: u64| TimeNs(ms * 1_000_000);
        assert_eq!(transit.excess_ns(5000.0, at(100)), 0);
        assert_eq!(transit.excess_ns(5010.0, at(105)), 0, "a quicker one");
        let late = transit.excess_ns(5020.0, at(165));
        assert!((49_900_000..=50_000_000).contains(&late), "{late}");
        // A clock that goes 50 ppm slower for ten minutes makes nothing old.
        let late = transit.excess_ns(5010.0 + 600_000.0 - 30.0, at(600_105));
        assert_eq!(late, 0);
        assert_eq!(transit.excess_ns(-1e300, at(1)), 86_400_000_000_000);
    }
}
