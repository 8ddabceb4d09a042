//! What a page says of the operator's hands, and what of it can be believed.

use hal::{ARMS_MAX, Pose};
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

/// Characters that a label may have.
const LABEL_CHARS_MAX: usize = 64;

/// How far from the middle of its space a hand can be, m.
const REACH_M_MAX: f64 = 10.0;

/// How far a rotation's norm may be from 1.
const UNIT_TOLERANCE: f64 = 1e-3;

/// Where the operator's hands are, all of one instant.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct HandsMessage {
    /// When, by the page's own clock, ms.
    pub(super) t: f64,
    /// A hand for each arm, in their order; none for one that no device moves.
    pub(super) arms: Vec<Option<HandMessage>>,
}

/// One hand.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct HandMessage {
    /// Whether the operator holds the clutch.
    pub(super) clutch: bool,
    /// Position in the picture's axes, m.
    pub(super) at: [f64; 3],
    /// Rotation in the picture's axes, unit quaternion x, y, z, w.
    pub(super) turn: [f64; 4],
    /// Whether `turn` is how a tracked controller is held: its grip pose. Otherwise only what it
    /// changes by counts.
    #[serde(default)]
    pub(super) tracked: bool,
    /// How far the trigger is pressed, 0 to 1: 1 closes the jaw.
    pub(super) jaw: f64,
}

/// A hand that makes sense.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hand {
    /// Whether the operator holds the clutch.
    pub(super) clutch: bool,
    /// Whether the pose's rotation is how a tracked controller is held: its grip pose.
    pub(super) tracked: bool,
    /// Where it is in the picture's axes; the origin is the device's own.
    pub(super) pose: Pose,
    /// How far the trigger is pressed, 0 to 1.
    pub(super) jaw: f64,
}

/// Why a message of hands is none. The arms hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum HandsMessageError {
    /// The run has another policy.
    #[error("this run is not moved by hand: its policy is another")]
    NoTeleop,
    /// The page does not steer.
    #[error("only the page that steers moves the arms: take control first")]
    NoSeat,
    /// The page that says how the run went does not steer.
    #[error("only the page that steers marks and labels the run: take control first")]
    NoSeatToMark,
    /// The hands are devices at the run's own computer.
    #[error("the arms are moved by --hands at the robot's computer: a page looks on")]
    Desk,
    /// There are no such arms.
    #[error("hands for {0} arms: there are fewer")]
    Arms(usize),
    /// The page's clock is none, or went back.
    #[error("the time of hands is a finite number of ms that grows")]
    Time,
    /// A number is none.
    #[error(
        "a hand's numbers are finite, its place within {REACH_M_MAX} m, its turn a unit quaternion, its jaw in [0, 1]"
    )]
    Numbers,
    /// There is no policy to hand back to.
    #[error("no policy drives this run: it is moved by hand")]
    NoPolicy,
    /// Nothing is recorded.
    #[error("this run records no demonstration")]
    NoRecording,
    /// Nobody is asked how the run went.
    #[error(
        "this run takes no mark: it has a task that judges it, or no log, or it has not begun or has ended"
    )]
    NoMark,
    /// The text is no label.
    #[error(
        "a label is one line of up to {LABEL_CHARS_MAX} characters, none of them a control character, U+2028 or U+2029"
    )]
    Label,
    /// The wish does not fit how the episode stands.
    #[error("that does not apply now: an episode is started first, and ended once")]
    NotNow,
    /// The scale is out of range.
    #[error("the scale is a number in [0.1, 1]")]
    Scale,
    /// The bound of the alignment is out of range.
    #[error("the angle within which a controller engages is a number of degrees in [5, 180]")]
    Align,
}

/// What a run or a demonstration is called: `text` without blanks at its ends.
///
/// # Errors
/// [`HandsMessageError::Label`] if it is too long, or would break a line.
pub(super) fn label(text: &str) -> Result<&str, HandsMessageError> {
    let breaks = |letter: char| letter.is_control() || matches!(letter, '\u{2028}' | '\u{2029}');
    if text.chars().count() > LABEL_CHARS_MAX || text.chars().any(breaks) {
        return Err(HandsMessageError::Label);
    }
    Ok(text.trim())
}

impl HandsMessage {
    /// The hands for `arms` arms.
    ///
    /// # Errors
    /// [`HandsMessageError`], whatever of it is wrong.
    pub(super) fn hands(&self, arms: usize) -> Result<[Option<Hand>; ARMS_MAX], HandsMessageError> {
        if self.arms.len() > arms {
            return Err(HandsMessageError::Arms(self.arms.len()));
        }
        if !self.t.is_finite() {
            return Err(HandsMessageError::Time);
        }
        let mut hands = [None; ARMS_MAX];
        for (hand, message) in hands.iter_mut().zip(&self.arms) {
            *hand = message.as_ref().map(HandMessage::hand).transpose()?;
        }
        Ok(hands)
    }
}

impl HandMessage {
    fn hand(&self) -> Result<Hand, HandsMessageError> {
        let [x, y, z, w] = self.turn;
        let turn = Quaternion::new(w, x, y, z);
        let at = Vector3::from(self.at);
        let sound = at.iter().all(|value| value.abs() <= REACH_M_MAX)
            && (turn.norm() - 1.0).abs() <= UNIT_TOLERANCE
            && (0.0..=1.0).contains(&self.jaw);
        if !sound {
            return Err(HandsMessageError::Numbers);
        }
        Ok(Hand {
            clutch: self.clutch,
            tracked: self.tracked,
            pose: Pose::from_parts(
                Translation3::from(at),
                UnitQuaternion::from_quaternion(turn),
            ),
            jaw: self.jaw,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Option<Result<[Option<Hand>; ARMS_MAX], HandsMessageError>> {
        let message: HandsMessage = serde_json::from_str(text).ok()?;
        Some(message.hands(1))
    }

    #[test]
    fn hands_are_read_and_nonsense_is_refused() {
        let good =
            r#"{"t":1.5,"arms":[{"clutch":true,"at":[0.1,0,-9.9],"turn":[0,0,0,1],"jaw":0.5}]}"#;
        let [hand, second] = read(good).unwrap().unwrap();
        let hand = hand.unwrap();
        assert!(hand.clutch && !hand.tracked && second.is_none());
        let tracked = good.replace(":0.5", r#":0.5,"tracked":true"#);
        assert!(read(&tracked).unwrap().unwrap()[0].unwrap().tracked);
        assert_eq!((hand.pose.translation.x, hand.jaw), (0.1, 0.5));
        for (from, to) in [
            ("0.1", "10.1"),
            ("0.1", "1e300"),
            ("[0,0,0,1]", "[0,0,0,0]"),
            ("[0,0,0,1]", "[0,0,0.1,1]"),
            (":0.5", ":1.01"),
            (":0.5", ":-0.01"),
        ] {
            let refused = read(&good.replacen(from, to, 1)).unwrap();
            assert_eq!(refused, Err(HandsMessageError::Numbers), "{from} {to}");
        }
        let two = good.replace("}]", "},null]");
        assert_eq!(read(&two), Some(Err(HandsMessageError::Arms(2))));
        for text in [
            good.replace("0.1", "null"),
            good.replace("0.1", "1e999"),
            good.replace("true", "1"),
            good.replace("\"t\":1.5,", ""),
            good.replace(":0.5", ":0.5,\"force\":1"),
        ] {
            assert_eq!(read(&text), None, "{text}");
        }
    }
}
