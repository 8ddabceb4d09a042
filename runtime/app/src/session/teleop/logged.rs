//! What a log says of an operator's hands: lines that a run writes as something changes, and what
//! pages of the log are told of them.

use core::fmt;

use hal::{ARM_NAMES, TimeNs};

use super::source::closed;
use super::status::{ArmStatus, TeleopStatus};
use super::{Driver, SCALES};

const OPERATOR_DRIVES: &str = "the operator drives";
const POLICY_DRIVES: &str = "the policy drives";
const SCALE: &str = "the scale of the operator's hands is ";
const ENGAGED: &str = "the operator's hand engaged";
const LET_GO: &str = "the operator released the clutch";
const RELEASED: &str = "the operator's hand was released: ";
const BLOCKED: &str = "the hand can't engage: ";
const FREE: &str = "the hand can engage";

/// A reason that is longer, bytes, is none of ours. Each later change holds it again.
const WHY_LEN_MAX: usize = 200;

/// A change, as a line of the log.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum HandsNotice {
    /// Who drives from now on.
    Driver(Driver),
    /// The motion scale from now on: the tip's way over the hand's.
    Scale(f64),
    /// What the hand of an arm does, and the arm's number from 0.
    Hand(usize, HandNotice),
}

/// What the hand of an arm does.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum HandNotice {
    /// The arm follows it.
    Engaged,
    /// It has let the clutch go.
    LetGo,
    /// It was released by force, for this reason.
    Released(String),
    /// It has to let the clutch go before it can engage, for this reason.
    Blocked(String),
    /// It can engage.
    Free,
}

impl HandsNotice {
    /// The change that a line of a log says; none of a line on something else.
    pub(crate) fn read(line: &str) -> Option<Self> {
        match line {
            OPERATOR_DRIVES => return Some(Self::Driver(Driver::Operator)),
            POLICY_DRIVES => return Some(Self::Driver(Driver::Policy)),
            _ => {}
        }
        if let Some(scale) = line.strip_prefix(SCALE) {
            let scale = scale.parse::<f64>().ok();
            let scale = scale.filter(|scale| SCALES.contains(scale));
            return scale.map(Self::Scale);
        }
        let (name, words) = line.split_once(": ")?;
        let arm = ARM_NAMES.iter().position(|known| *known == name)?;
        Some(Self::Hand(arm, HandNotice::read(words)?))
    }
}

impl HandNotice {
    fn read(words: &str) -> Option<Self> {
        let because = |start: &str| {
            let why = words.strip_prefix(start)?;
            (why.len() <= WHY_LEN_MAX).then(|| why.to_owned())
        };
        match words {
            ENGAGED => Some(Self::Engaged),
            LET_GO => Some(Self::LetGo),
            FREE => Some(Self::Free),
            _ => because(RELEASED)
                .map(Self::Released)
                .or_else(|| because(BLOCKED).map(Self::Blocked)),
        }
    }
}

impl fmt::Display for HandsNotice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Driver(Driver::Operator) => f.write_str(OPERATOR_DRIVES),
            Self::Driver(Driver::Policy) => f.write_str(POLICY_DRIVES),
            Self::Scale(scale) => write!(f, "{SCALE}{scale}"),
            Self::Hand(arm, notice) => {
                let name = ARM_NAMES.get(*arm).copied().unwrap_or_default();
                write!(f, "{name}: {notice}")
            }
        }
    }
}

impl fmt::Display for HandNotice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Engaged => f.write_str(ENGAGED),
            Self::LetGo => f.write_str(LET_GO),
            Self::Released(why) => write!(f, "{RELEASED}{why}"),
            Self::Blocked(why) => write!(f, "{BLOCKED}{why}"),
            Self::Free => f.write_str(FREE),
        }
    }
}

/// The hands of a log, as they were at any of its times.
#[derive(Debug)]
pub(crate) struct LoggedHands {
    /// From when on, in order.
    changes: Vec<(TimeNs, TeleopStatus)>,
}

impl LoggedHands {
    /// Of a log of so many arms with these `notices`, in which the hands are the policy if they are
    /// `alone`. None of a log in which no hand drove.
    pub(crate) fn new(
        arms: usize,
        alone: bool,
        mut notices: Vec<(TimeNs, HandsNotice)>,
    ) -> Option<Self> {
        if !alone && notices.is_empty() {
            return None;
        }
        notices.sort_by_key(|(at, _)| *at);
        let mut status = at_first(arms, alone, &notices);
        let mut changes = vec![(TimeNs(0), status.clone())];
        for (at, notice) in notices {
            status.take(notice);
            changes.push((at, status.clone()));
        }
        Some(Self { changes })
    }

    /// What pages are told of the time `now`, in which the jaws were commanded to these angles,
    /// rad.
    pub(crate) fn at(
        &self,
        now: TimeNs,
        jaws_rad: impl Iterator<Item = f64>,
    ) -> Option<TeleopStatus> {
        let until = self.changes.partition_point(|(at, _)| *at <= now);
        let (_, status) = self.changes.get(until.checked_sub(1)?)?;
        let mut status = status.clone();
        for (arm, jaw_rad) in status.arms.iter_mut().zip(jaws_rad) {
            arm.jaw = closed(jaw_rad);
        }
        Some(status)
    }
}

/// How the hands were before the first of `notices`, as far as these tell: the beginning of a log
/// with a bound is not kept. The scale is the first that is told, which a whole log has before any
/// hand engages.
fn at_first(arms: usize, alone: bool, notices: &[(TimeNs, HandsNotice)]) -> TeleopStatus {
    let notices = || notices.iter().map(|(_, notice)| notice);
    let next_driver = notices().find_map(|notice| match notice {
        HandsNotice::Driver(driver) => Some(*driver),
        HandsNotice::Scale(_) | HandsNotice::Hand(..) => None,
    });
    let driver = match next_driver {
        Some(Driver::Operator) => Driver::Policy,
        // What hands do is told of hands that drive.
        Some(Driver::Policy) | None => Driver::Operator,
    };
    let arms = (0..arms).map(|arm| {
        let next = notices().find_map(|notice| match notice {
            HandsNotice::Hand(of, notice) if *of == arm => Some(notice),
            HandsNotice::Hand(..) | HandsNotice::Driver(_) | HandsNotice::Scale(_) => None,
        });
        let ends = matches!(next, Some(HandNotice::LetGo | HandNotice::Released(_)));
        ArmStatus {
            engaged: ends,
            lost: None,
            misaligned_deg: None,
            tip: None,
            jaw: 0.0,
        }
    });
    TeleopStatus {
        desk: false,
        scale: notices().find_map(|notice| match notice {
            HandsNotice::Scale(scale) => Some(*scale),
            HandsNotice::Driver(_) | HandsNotice::Hand(..) => None,
        }),
        align_deg: None,
        driver: (!alone).then_some(driver),
        arms: arms.collect(),
        recording: None,
        label: String::new(),
        camera_to_page_ms: None,
    }
}

impl TeleopStatus {
    fn take(&mut self, notice: HandsNotice) {
        match notice {
            HandsNotice::Driver(driver) => self.driver = self.driver.and(Some(driver)),
            HandsNotice::Scale(scale) => self.scale = Some(scale),
            HandsNotice::Hand(arm, notice) => {
                if let Some(arm) = self.arms.get_mut(arm) {
                    arm.engaged = notice == HandNotice::Engaged;
                    arm.lost = match notice {
                        HandNotice::Released(why) | HandNotice::Blocked(why) => Some(why),
                        HandNotice::Engaged | HandNotice::LetGo | HandNotice::Free => None,
                    };
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::teleop::source::JAW_CLOSED_RAD;

    fn hand(arm: usize, notice: HandNotice) -> HandsNotice {
        HandsNotice::Hand(arm, notice)
    }

    /// Who drives, the scale in percent, and of each arm whether it is engaged and why it holds.
    fn told(hands: &LoggedHands, at: u64) -> String {
        let status = hands.at(TimeNs(at), [0.0; 2].into_iter()).unwrap();
        let arms = status.arms.iter().map(|arm| {
            let lost = arm.lost.as_deref().unwrap_or("-");
            let clutch = if arm.engaged { "engaged" } else { "open" };
            format!("{clutch} {lost}")
        });
        let arms: Vec<String> = arms.collect();
        let percent = status.scale.map_or(0.0, |scale| (scale * 100.0).round());
        let driver = status.driver;
        format!("{driver:?} {percent} {}", arms.join(" "))
    }

    #[test]
    fn notices_are_read_as_they_are_written() {
        let why = || "the hand jumped".to_owned();
        for notice in [
            HandsNotice::Driver(Driver::Operator),
            HandsNotice::Driver(Driver::Policy),
            HandsNotice::Scale(0.45),
            hand(0, HandNotice::Engaged),
            hand(1, HandNotice::LetGo),
            hand(0, HandNotice::Released(why())),
            hand(1, HandNotice::Blocked(why())),
            hand(0, HandNotice::Free),
        ] {
            let line = notice.to_string();
            assert_eq!(HandsNotice::read(&line), Some(notice), "{line}");
        }
        for line in [
            "psm1: DISABLED to ENABLED",
            "psm3: the hand can engage",
            "the hand can engage",
            "the scale of the operator's hands is large",
            "the scale of the operator's hands is NaN",
            "the scale of the operator's hands is 1.5",
            "",
        ] {
            assert_eq!(HandsNotice::read(line), None, "{line}");
        }
        let long = hand(0, HandNotice::Released("x".repeat(WHY_LEN_MAX + 1)));
        assert_eq!(HandsNotice::read(&long.to_string()), None);
    }

    /// A hand takes over from a policy, is lost, engages anew and hands back.
    #[test]
    fn hands_are_told_as_they_were_at_each_time() {
        let why = "the page was hidden".to_owned();
        let back = "the policy drives again".to_owned();
        let notices = [
            (10, HandsNotice::Scale(0.4)),
            (10, hand(1, HandNotice::Engaged)),
            (10, HandsNotice::Driver(Driver::Operator)),
            (20, hand(1, HandNotice::Released(why))),
            (30, hand(1, HandNotice::Free)),
            (40, HandsNotice::Scale(0.5)),
            (40, hand(1, HandNotice::Engaged)),
            (50, hand(1, HandNotice::Released(back))),
            (50, HandsNotice::Driver(Driver::Policy)),
        ];
        let notices = notices.map(|(at, notice)| (TimeNs(at), notice)).to_vec();
        let hands = LoggedHands::new(2, false, notices).unwrap();
        for (at, expected) in [
            (9, "Some(Policy) 40 open - open -"),
            (10, "Some(Operator) 40 open - engaged -"),
            (29, "Some(Operator) 40 open - open the page was hidden"),
            (35, "Some(Operator) 40 open - open -"),
            (45, "Some(Operator) 50 open - engaged -"),
            (99, "Some(Policy) 50 open - open the policy drives again"),
        ] {
            assert_eq!(told(&hands, at), expected, "{at}");
        }
        let status = hands.at(TimeNs(0), [JAW_CLOSED_RAD, 1.0].into_iter());
        let arms = status.unwrap().arms;
        assert_eq!((arms[0].jaw, arms[1].jaw), (1.0, 0.0));
    }

    /// Of a log whose beginning was not kept the first changes tell what was before them; a log
    /// without hands has none.
    #[test]
    fn the_first_notices_tell_the_beginning() {
        let first = |alone, notices: Vec<HandsNotice>| {
            let notices = notices.into_iter().map(|notice| (TimeNs(5), notice));
            LoggedHands::new(1, alone, notices.collect()).map(|hands| told(&hands, 0))
        };
        assert_eq!(first(false, Vec::new()), None);
        let alone = first(true, Vec::new());
        assert_eq!(alone.as_deref(), Some("None 0 open -"));
        let alone = first(true, vec![hand(0, HandNotice::LetGo)]);
        assert_eq!(alone.as_deref(), Some("None 0 engaged -"));
        let beside = first(false, vec![hand(0, HandNotice::Engaged)]);
        assert_eq!(beside.as_deref(), Some("Some(Operator) 0 open -"));
        let beside = first(false, vec![HandsNotice::Driver(Driver::Policy)]);
        assert_eq!(beside.as_deref(), Some("Some(Operator) 0 open -"));
    }
}
