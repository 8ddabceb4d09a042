//! Waiting for one frame among others.

use std::io;
use std::time::Duration;

use socketcan::{CanDataFrame, CanFrame, CanSocket, EmbeddedFrame as _, Frame as _, Socket as _};
use trocar::rt::MonotonicClock;

use super::{PATIENCE, frame};

/// The next data frame that is `wanted`, of those that `next` gives, which waits for one for as
/// long as it is told at most. Frames that are not wanted do not prolong the wait: `limit` is for
/// all of it.
fn next_wanted(
    limit: Duration,
    mut next: impl FnMut(Duration) -> io::Result<CanFrame>,
    wanted: impl Fn(&CanDataFrame) -> bool,
) -> io::Result<CanDataFrame> {
    let clock = MonotonicClock::new();
    loop {
        let left = limit.saturating_sub(Duration::from_nanos(clock.now().0));
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        match next(left)? {
            CanFrame::Data(frame) if wanted(&frame) => return Ok(frame),
            CanFrame::Data(_) | CanFrame::Remote(_) | CanFrame::Error(_) => {}
        }
    }
}

/// The next data frame that is `wanted`.
pub(crate) fn await_frame(bus: &CanSocket, wanted: impl Fn(&CanDataFrame) -> bool) -> CanDataFrame {
    next_wanted(PATIENCE, |left| bus.read_frame_timeout(left), wanted).unwrap()
}

/// The next data frame with identifier `id`.
pub(crate) fn receive(bus: &CanSocket, id: u16) -> CanDataFrame {
    await_frame(bus, |frame| frame.raw_id() == u32::from(id))
}

/// Waits until a data frame with identifier `id` says `data`.
pub(crate) fn await_data(bus: &CanSocket, id: u16, data: &[u8]) {
    await_frame(bus, |frame| {
        frame.raw_id() == u32::from(id) && frame.data() == data
    });
}

#[test]
fn others_frames_are_passed_over_and_do_not_prolong_the_wait() {
    const LIMIT: Duration = Duration::from_millis(50);
    let wanted = |frame: &CanDataFrame| frame.raw_id() == 0x185;
    let mut others = 0_u16;
    let heard = next_wanted(
        PATIENCE,
        |_| {
            others += 1;
            let id = if others < 10 { 0x703 } else { 0x185 };
            Ok(frame(id, &others.to_le_bytes()))
        },
        wanted,
    );
    assert_eq!(heard.unwrap().data(), [10, 0]);
    let waited = next_wanted(
        LIMIT,
        |left| {
            assert!(!left.is_zero() && left <= LIMIT);
            Ok(frame(0x703, &[5]))
        },
        wanted,
    );
    assert_eq!(waited.unwrap_err().kind(), io::ErrorKind::TimedOut);
}
