//! Whether a hand moves its arm.

use core::fmt;

/// An arm's clutch.
///
/// | in | the hand holds it | holds it, but is not aligned | the hand does not | something is wrong |
/// |---|---|---|---|---|
/// | lost | lost | lost | open | lost |
/// | open | engaged, anew | open | open | lost: whoever comes back has to be seen with it open |
/// | engaged | engaged | engaged | open | lost |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Clutch {
    /// It was released by force, or never was free: before the hand can engage it has to let go.
    Released(ReleaseCause),
    /// The hand can engage.
    Open,
    /// The arm follows the hand; the number is that of the engagement, counted from 1.
    Engaged(u64),
}

/// What a hand does with its clutch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Grip {
    /// It does not hold it.
    Open,
    /// It holds it, but is not held as its instrument points.
    Misaligned,
    /// It holds it.
    Held,
}

/// Why a clutch was released by force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ReleaseCause {
    /// No message of a hand has come.
    NotYet,
    /// No message of the hand came for too long, or the newest is old.
    Stale,
    /// The page's connection has ended.
    PageGone,
    /// The page gave up the right to steer.
    Seat,
    /// The page is hidden or has lost the focus.
    Hidden,
    /// The hand went further between two messages than a hand does.
    Jump,
    /// A message made no sense.
    Nonsense,
    /// The device is gone.
    NoDevice,
    /// The arm is not enabled, or paused.
    NotEnabled,
    /// No episode is under way.
    NoEpisode,
    /// The policy drives again.
    HandedBack,
}

impl Clutch {
    /// What it is after a message of what the hand does with it; `engagements` counts.
    #[must_use]
    pub(super) const fn after(self, grip: Grip, engagements: &mut u64) -> Self {
        match (self, grip) {
            (Self::Released(why), Grip::Held | Grip::Misaligned) => Self::Released(why),
            (Self::Released(_) | Self::Open | Self::Engaged(_), Grip::Open)
            | (Self::Open, Grip::Misaligned) => Self::Open,
            (Self::Open, Grip::Held) => {
                *engagements += 1;
                Self::Engaged(*engagements)
            }
            (Self::Engaged(number), Grip::Held | Grip::Misaligned) => Self::Engaged(number),
        }
    }

    /// What it is after something went wrong.
    #[must_use]
    pub(super) const fn lost(self, why: ReleaseCause) -> Self {
        match self {
            Self::Engaged(_) | Self::Open => Self::Released(why),
            Self::Released(_) => self,
        }
    }

    /// Why it was released by force, if it was.
    pub(super) const fn why(self) -> Option<ReleaseCause> {
        match self {
            Self::Released(why) => Some(why),
            Self::Open | Self::Engaged(_) => None,
        }
    }

    /// Whether the arm follows the hand.
    pub(super) const fn is_engaged(self) -> bool {
        matches!(self, Self::Engaged(_))
    }
}

impl fmt::Display for ReleaseCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotYet => "no hand yet",
            Self::Stale => "no hand pose in time",
            Self::PageGone => "the page's connection ended",
            Self::Seat => "the page gave up control",
            Self::Hidden => "the page was hidden",
            Self::Jump => "the hand jumped",
            Self::Nonsense => "an invalid message",
            Self::NoDevice => "the device disconnected",
            Self::NotEnabled => "the arm is not enabled",
            Self::NoEpisode => "no episode is under way",
            Self::HandedBack => "the policy drives again",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Walks the table: state, what the hand does (none: something is wrong), the state after it.
    #[test]
    fn clutch_follows_its_table() {
        let lost = Clutch::Released(ReleaseCause::Stale);
        let (open, misaligned, held) = (Some(Grip::Open), Some(Grip::Misaligned), Some(Grip::Held));
        let mut engagements = 4;
        for (before, grip, after) in [
            (lost, held, lost),
            (lost, misaligned, lost),
            (lost, open, Clutch::Open),
            (lost, None, lost),
            (Clutch::Open, misaligned, Clutch::Open),
            (Clutch::Open, held, Clutch::Engaged(5)),
            (Clutch::Open, open, Clutch::Open),
            (Clutch::Open, None, Clutch::Released(ReleaseCause::Jump)),
            (Clutch::Engaged(5), held, Clutch::Engaged(5)),
            (Clutch::Engaged(5), misaligned, Clutch::Engaged(5)),
            (Clutch::Engaged(5), open, Clutch::Open),
            (
                Clutch::Engaged(5),
                None,
                Clutch::Released(ReleaseCause::Jump),
            ),
            (Clutch::Open, held, Clutch::Engaged(6)),
        ] {
            let found = match grip {
                Some(grip) => before.after(grip, &mut engagements),
                None => before.lost(ReleaseCause::Jump),
            };
            assert_eq!(found, after, "{before:?} {grip:?}");
        }
    }
}
