//! Where a drive sends its motor: at rest, along a line to the next set-point, or down a ramp.
//!
//! A pure function of time: nothing is stepped, so a drive that is asked late answers the same.
//! Continuous in position; the velocity may jump from one line to the next.

use hal::TimeNs;
use trocar_canopen::number::{nanoseconds, seconds};

/// A way in time, counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Motion {
    /// At rest.
    Rest {
        /// Where.
        position: f64,
    },
    /// To a set-point within an interpolation period. Without a new one the line goes on for
    /// another period and then ends in a ramp.
    ///
    /// The second period covers a SYNC that is late or lost without a stop.
    Line {
        /// Since when.
        start: TimeNs,
        /// From where.
        from: f64,
        /// To where.
        to: f64,
        /// Within, ns.
        period_ns: u64,
        /// Deceleration of the ramp after it, counts/s².
        deceleration: f64,
    },
    /// To rest.
    ///
    /// Rest after `|v| / d` and a way of `v^2 / (2 d)`.
    Ramp {
        /// Since when.
        start: TimeNs,
        /// From where.
        from: f64,
        /// Velocity at the start, counts/s.
        velocity: f64,
        /// Deceleration, counts/s².
        deceleration: f64,
    },
}

impl Motion {
    /// Position and velocity at `now`, counts and counts/s.
    pub(super) fn at(&self, now: TimeNs) -> (f64, f64) {
        match *self {
            Self::Rest { position } => (position, 0.0),
            Self::Line {
                start,
                from,
                to,
                period_ns,
                deceleration,
            } => {
                let velocity = (to - from) / seconds(period_ns.max(1));
                let end = TimeNs(start.0.saturating_add(period_ns.saturating_mul(2)));
                if now < end {
                    (from + velocity * seconds(now.since(start)), velocity)
                } else {
                    let ramp = Self::Ramp {
                        start: end,
                        from: to + (to - from),
                        velocity,
                        deceleration,
                    };
                    ramp.at(now)
                }
            }
            Self::Ramp {
                start,
                from,
                velocity,
                deceleration,
            } => {
                let whole_s = velocity.abs() / deceleration;
                let time_s = seconds(now.since(start)).min(whole_s);
                let slope = deceleration.copysign(velocity);
                let position = from + time_s * (velocity - slope * time_s / 2.0);
                let rests = time_s >= whole_s;
                (
                    position,
                    if rests {
                        0.0
                    } else {
                        velocity - slope * time_s
                    },
                )
            }
        }
    }

    /// From here down a ramp.
    ///
    /// A deceleration below 1 count/s² counts as 1. Of an axis at rest it is a ramp of no length.
    pub(super) fn stopped(&self, now: TimeNs, deceleration: f64) -> Self {
        let (from, velocity) = self.at(now);
        Self::Ramp {
            start: now,
            from,
            velocity,
            deceleration: deceleration.max(1.0),
        }
    }

    /// Whether it has come to rest by `now`.
    pub(super) fn rests(&self, now: TimeNs) -> bool {
        match self {
            Self::Rest { .. } => true,
            Self::Ramp {
                start,
                velocity,
                deceleration,
                ..
            } => now.since(*start) >= nanoseconds(velocity.abs() / deceleration),
            Self::Line { .. } => self.at(now).1.abs() <= 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_without_successor_ends_at_rest_without_a_jump() {
        let line = Motion::Line {
            start: TimeNs(0),
            from: 0.0,
            to: 100.0,
            period_ns: 1_000_000,
            deceleration: 1e7,
        };
        let mut before = line.at(TimeNs(0)).0;
        for us in 1..30_000 {
            let (position, velocity) = line.at(TimeNs(us * 1000));
            assert!(position >= before && position - before < 0.101, "{us}");
            assert!(velocity <= 100_000.1);
            before = position;
        }
        // Two periods and v²/2a.
        assert!((before - 700.0).abs() < 1e-6, "{before}");
        assert!(line.rests(TimeNs(12_000_001)));
        assert!(!line.rests(TimeNs(11_000_000)));
    }

    #[test]
    fn a_stop_starts_where_the_motion_is() {
        let line = Motion::Line {
            start: TimeNs(0),
            from: 0.0,
            to: -100.0,
            period_ns: 1_000_000,
            deceleration: 1e7,
        };
        let now = TimeNs(500_000);
        let stop = line.stopped(now, 1e8);
        assert_eq!(stop.at(now), line.at(now));
        let end = stop.at(TimeNs(2_000_000));
        assert!((end.0 - (-50.0 - 50.0)).abs() < 1e-6 && end.1.abs() <= 0.0);
        assert!(stop.rests(TimeNs(1_500_001)));
    }
}
