//! What a page says that moves arms by hand, or marks the run. Only the page that steers may. What
//! the hands then do is `session/teleop`'s. Scale, alignment, label and mark are checked there.

use super::request::Request;
use super::seats::Seat;
use super::shared::Shared;
use crate::session::teleop::{HandsMessageError, ReleaseCause};

/// Does what `request` of the page in `seat` asks for; whatever is not of hands is left alone.
///
/// # Errors
/// [`HandsMessageError`]; the arms hold.
pub(super) fn heard(
    shared: &Shared,
    seat: &Seat,
    request: Request,
) -> Result<(), HandsMessageError> {
    let hands = &shared.hands;
    // To let go is always allowed.
    if request == Request::HandsOff(true) {
        hands.release(seat.id(), ReleaseCause::Hidden);
        return Ok(());
    }
    if !seat.steers() {
        let marks = matches!(request, Request::Mark(_) | Request::Label(_));
        return Err(if marks {
            HandsMessageError::NoSeatToMark
        } else {
            HandsMessageError::NoSeat
        });
    }
    match request {
        Request::Hands(_) if hands.are_at_desk() => return Err(HandsMessageError::Desk),
        Request::Hands(message) => hands.hear(seat.id(), &message)?,
        Request::Scale(scale) => hands.set_scale(scale)?,
        Request::Align(degrees) => hands.set_align_deg(degrees)?,
        Request::HandBack(true) => hands.hand_back()?,
        Request::Episode(wish) => hands.wish(wish)?,
        Request::Label(text) => hands.set_label(&text)?,
        Request::Mark(mark) => hands.mark(mark)?,
        Request::Shown((_, seconds)) => {
            if let Some(age_ns) = shared.board.age_ns(seconds) {
                hands.seen(age_ns);
            }
        }
        Request::HandsOff(_)
        | Request::HandBack(false)
        | Request::Seen(_)
        | Request::Steer(_)
        | Request::Command(_)
        | Request::Show(_)
        | Request::At(_)
        | Request::Open(_) => {}
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use trocar_log::RunMark;

    use super::super::access::Access;
    use super::*;

    /// A page that looks on is refused by the name of what it wanted.
    #[test]
    fn only_the_page_that_steers_marks_and_moves() {
        let shared = Shared::new(Access::new(0).unwrap());
        shared.hands.ask_for_mark();
        let [steering, other] = [(); 2].map(|()| shared.seats.sit().unwrap());
        assert!(steering.steer());
        let mark = || Request::Mark(Some(RunMark::Success));
        let label = || Request::Label("third try".to_owned());
        for (request, refusal) in [
            (mark(), HandsMessageError::NoSeatToMark),
            (label(), HandsMessageError::NoSeatToMark),
            (Request::Scale(0.5), HandsMessageError::NoSeat),
        ] {
            assert_eq!(heard(&shared, &other, request), Err(refusal));
        }
        for request in [mark(), label()] {
            assert_eq!(heard(&shared, &steering, request), Ok(()));
        }
        let said = shared.hands.said().unwrap();
        assert_eq!(said.to_string(), "marked success, label \"third try\"");
    }
}
