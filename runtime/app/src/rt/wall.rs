//! CLOCK_REALTIME beside CLOCK_MONOTONIC: the time of day, for people and for no deadline.

use std::time::Duration;

use time::OffsetDateTime;

use super::sys;

/// A smaller step counts as slewing, ns.
const SET_NS_MIN: u64 = 10_000_000;

/// Detects steps of CLOCK_REALTIME, by a person or NTP.
#[derive(Debug, Default)]
pub struct WallClock {
    /// How far it was ahead of the monotonic clock at the last look, ns.
    ahead_ns: Option<i64>,
}

impl WallClock {
    /// By how much the clock was set ahead since the last look, ns; less than 0 if back. None if it
    /// was not, and at the first look.
    ///
    /// Less than 10 ms is no setting: that is how a clock is slewed.
    pub fn set_ns(&mut self) -> Option<i64> {
        // A thread that was interrupted between the two clocks looks again.
        sys::wall_ahead_ns().and_then(|ahead_ns| self.note(ahead_ns))
    }

    fn note(&mut self, ahead_ns: i64) -> Option<i64> {
        let before = self.ahead_ns.replace(ahead_ns)?;
        let set_ns = ahead_ns - before;
        (set_ns.unsigned_abs() >= SET_NS_MIN).then_some(set_ns)
    }
}

/// What the system's clock says: date and time of day in UTC, to the millisecond.
#[must_use]
pub fn wall_time() -> String {
    utc(sys::wall_ns())
}

/// The date and the time of day that is `unix_ns` after 1970 began.
fn utc(unix_ns: u64) -> String {
    let at = OffsetDateTime::UNIX_EPOCH + Duration::from_nanos(unix_ns);
    let (date, (hour, minute, second, ms)) = (at.date(), at.to_hms_milli());
    format!("{date} {hour:02}:{minute:02}:{second:02}.{ms:03} UTC")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As `date --utc` says them.
    #[test]
    fn dates_are_those_of_the_calendar() {
        for (seconds, said) in [
            (0, "1970-01-01 00:00:00.007 UTC"),
            (951_782_399, "2000-02-28 23:59:59.007 UTC"),
            (951_868_799, "2000-02-29 23:59:59.007 UTC"),
            (1_735_689_599, "2024-12-31 23:59:59.007 UTC"),
            (1_735_689_600, "2025-01-01 00:00:00.007 UTC"),
            (1_795_864_463, "2026-11-28 11:14:23.007 UTC"),
            (4_107_542_400, "2100-03-01 00:00:00.007 UTC"),
        ] {
            assert_eq!(utc(seconds * 1_000_000_000 + 7_999_999), said);
        }
    }

    #[test]
    fn a_clock_that_is_set_is_noticed_once() {
        let (mut wall, hour) = (WallClock::default(), 3_600_000_000_000);
        assert_eq!(wall.note(5_000), None, "the first look");
        assert_eq!(wall.note(9_999_000), None, "slewed");
        assert_eq!(wall.note(9_999_000 + hour), Some(hour));
        assert_eq!(wall.note(9_999_000 + hour), None);
        assert_eq!(wall.note(9_999_000), Some(-hour));
        assert_eq!(wall.note(-1_000), Some(-10_000_000));
    }
}
