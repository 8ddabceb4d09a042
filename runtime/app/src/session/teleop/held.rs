//! What is known of the operator's hands: who sends them, when, and what each arm's clutch does.

use hal::{ARMS_MAX, Pose, TimeNs};
use trocar_log::{RunMark, RunNote};

use super::alignment::{DEFAULT_ALIGN_DEG, misaligned_deg};
use super::clutch::{Clutch, Grip, ReleaseCause};
use super::demonstration::EpisodeCommand;
use super::latency::{Counts, HandDevice, Transit};
use super::message::Hand;
use super::status::Recording;
use super::{Commanded, DEFAULT_SCALE, Driver, STALE_NS};
use crate::mailbox::MailboxReader;

/// What a hand moves and turns at most from one message to the next.
const STEP_M_MAX: f64 = 0.1;
const STEP_RAD_MAX: f64 = 0.8;

/// All of it; nothing at first.
#[derive(Debug, Default)]
pub(super) struct Held {
    /// Whether the hands are devices at the run's own computer.
    pub(super) desk: bool,
    /// How many arms are moved by hand; 0 as long as the policy is another.
    pub(super) arms: usize,
    /// The page that sends.
    pub(super) seat: Option<u64>,
    /// When anything last came from it, however old.
    pub(super) arrived: Option<TimeNs>,
    /// How long its newest answer to a ping took, ns.
    pub(super) round_trip_ns: u64,
    /// When its last message came, and at which time of its own, ms.
    pub(super) received: Option<(TimeNs, f64)>,
    pub(super) transit: Transit,
    pub(super) scale: Option<f64>,
    /// Within which angle of its instrument a tracked controller engages, degrees.
    pub(super) align_deg: Option<f64>,
    /// Who drives, if there is a policy beside the hands.
    pub(super) driver: Option<Driver>,
    /// Whether no episode is under way.
    pub(super) waits: bool,
    pub(super) hands: [ArmHand; ARMS_MAX],
    pub(super) engagements: u64,
    pub(super) commanded: Option<MailboxReader<Commanded>>,
    pub(super) wish: Option<EpisodeCommand>,
    pub(super) recording: Option<Recording>,
    /// What the demonstration under way is called.
    pub(super) label: String,
    /// What a person says of the run, if it asks; and their newest mark until it is told.
    pub(super) said: Option<RunNote>,
    pub(super) marked: Option<Option<RunMark>>,
    pub(super) tips: [Option<(Pose, f64)>; ARMS_MAX],
    pub(super) counts: Counts,
}

/// One arm's.
#[derive(Clone, Copy, Debug)]
pub(super) struct ArmHand {
    pub(super) clutch: Clutch,
    pub(super) hand: Option<Hand>,
    /// By how much it is held otherwise than its instrument points, degrees, if that keeps it from
    /// engaging.
    pub(super) misaligned_deg: Option<f64>,
}

impl Default for ArmHand {
    fn default() -> Self {
        Self {
            clutch: Clutch::Released(ReleaseCause::NotYet),
            hand: None,
            misaligned_deg: None,
        }
    }
}

impl Held {
    pub(super) fn lose(&mut self, why: ReleaseCause) {
        for arm in 0..ARMS_MAX {
            self.lose_one(arm, why);
        }
    }

    pub(super) fn lose_one(&mut self, arm: usize, why: ReleaseCause) {
        if let Some(hand) = self.hands.get_mut(arm) {
            let engaged = hand.clutch.is_engaged();
            hand.clutch = hand.clutch.lost(why);
            hand.misaligned_deg = None;
            // An episode that ends, or who hands back, takes nothing from anybody.
            let forced = !matches!(why, ReleaseCause::NoEpisode | ReleaseCause::HandedBack);
            self.counts.losses += u64::from(engaged && forced);
        }
    }

    /// Releases what has sent no message for too long.
    pub(super) fn check_age(&mut self, now: TimeNs) {
        let fresh = self
            .received
            .is_some_and(|(at, _)| now.since(at) <= STALE_NS);
        if !fresh {
            self.lose(ReleaseCause::Stale);
        }
    }

    /// Takes in the hands of a message.
    pub(super) fn take(&mut self, hands: &[Option<Hand>; ARMS_MAX]) {
        for (index, new) in hands.iter().enumerate().take(self.arms) {
            let Some(mut arm) = self.hands.get(index).copied() else {
                continue;
            };
            let Some(new) = new else {
                self.lose_one(index, ReleaseCause::NoDevice);
                continue;
            };
            if arm.clutch.is_engaged() && arm.hand.is_some_and(|old| jumped(&old.pose, &new.pose)) {
                self.lose_one(index, ReleaseCause::Jump);
                arm.clutch = self.hands[index].clutch;
            }
            let before = self.engagements;
            let (grip, misaligned_deg) = self.grip(index, new);
            arm.clutch = arm.clutch.after(grip, &mut self.engagements);
            arm.misaligned_deg = misaligned_deg.filter(|_| arm.clutch == Clutch::Open);
            if self.engagements > before {
                self.counts.engagements += 1;
                self.counts.device = Some(self.device(new));
            }
            arm.hand = Some(*new);
            self.hands[index] = arm;
        }
        if self.waits {
            self.lose(ReleaseCause::NoEpisode);
        }
    }
}

impl Held {
    /// What moves this `hand`.
    const fn device(&self, hand: &Hand) -> HandDevice {
        match (self.desk, hand.tracked) {
            (true, _) => HandDevice::InputDevice,
            (false, true) => HandDevice::Headset,
            (false, false) => HandDevice::Page,
        }
    }

    /// What the `hand` of an arm does with its clutch, and the angle that keeps it from engaging,
    /// degrees.
    fn grip(&self, arm: usize, hand: &Hand) -> (Grip, Option<f64>) {
        if !hand.clutch {
            return (Grip::Open, None);
        }
        let Some((tip_in_view, _)) = self.tips.get(arm).and_then(Option::as_ref) else {
            // How the instrument points is not known yet.
            let grip = if hand.tracked {
                Grip::Misaligned
            } else {
                Grip::Held
            };
            return (grip, None);
        };
        let outside = |angle: &f64| *angle > self.align_deg();
        match misaligned_deg(hand, tip_in_view).filter(outside) {
            Some(angle) => (Grip::Misaligned, Some(angle)),
            None => (Grip::Held, None),
        }
    }
}

fn jumped(old: &Pose, new: &Pose) -> bool {
    let way = (new.translation.vector - old.translation.vector).norm();
    way > STEP_M_MAX || old.rotation.angle_to(&new.rotation) > STEP_RAD_MAX
}

impl Held {
    /// The policy drives, until a hand takes its clutch anew.
    pub(super) fn give_back(&mut self) {
        self.driver = Some(Driver::Policy);
        self.lose(ReleaseCause::HandedBack);
    }

    pub(super) fn scale(&self) -> f64 {
        self.scale.unwrap_or(DEFAULT_SCALE)
    }

    pub(super) fn align_deg(&self) -> f64 {
        self.align_deg.unwrap_or(DEFAULT_ALIGN_DEG)
    }
}
