//! The operator's hands as the console's thread hears of them and the source of chunks looks at
//! them.

use std::sync::{Mutex, MutexGuard, PoisonError};

use hal::{ARMS_MAX, Pose, TimeNs};

use super::clutch::{Clutch, ReleaseCause};
use super::demonstration::EpisodeCommand;
use super::held::Held;
use super::latency::{Counts, TeleopSummary, Transit};
use super::message::{Hand, HandsMessage, HandsMessageError, label};
use super::status::{ArmStatus, Phase, Recording, TeleopStatus, numbers};
use super::{ALIGNS_DEG, Commanded, Driver, SCALES, STALE_NS};
use crate::mailbox::MailboxReader;
use crate::rt::MonotonicClock;

/// A page from which no message came for this long may have slept, its clock too, ns.
const FORGET_NS: u64 = 1_000_000_000;

/// The hands, between the threads.
#[derive(Debug)]
pub(crate) struct Hands {
    clock: MonotonicClock,
    inner: Mutex<Held>,
}

/// A hand that moves its arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moving {
    /// Which engagement this is.
    pub(super) engagement: u64,
    pub(super) hand: Hand,
}

/// What the source sees.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look {
    /// When it looked, by the clock of the hands.
    pub(super) now: TimeNs,
    /// The hands that move their arms.
    pub(super) moving: [Option<Moving>; ARMS_MAX],
    /// Why each other arm was released by force, if it was.
    pub(super) lost: [Option<ReleaseCause>; ARMS_MAX],
    pub(super) scale: f64,
    /// When the newest message came, with what it was late by taken off.
    pub(super) sent: Option<TimeNs>,
    /// The newest command, if there is one that was not seen before.
    pub(super) commanded: Option<Commanded>,
}

impl Hands {
    /// Hands of which no message has come, and that move nothing.
    pub(crate) fn new() -> Self {
        Self {
            clock: MonotonicClock::new(),
            inner: Mutex::default(),
        }
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Held> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// From now on `arms` arms are moved by hand. What was counted is forgotten, and a new clutch
    /// is needed.
    pub(crate) fn begin(&self, arms: usize, waits: bool) {
        let mut inner = self.lock();
        inner.lose(ReleaseCause::NoEpisode);
        inner.arms = arms.min(ARMS_MAX);
        inner.waits = waits;
        inner.driver = None;
        inner.wish = None;
        inner.tips = [None; ARMS_MAX];
        inner.counts = Counts::default();
    }

    /// There is a policy beside the hands; until an episode that waits is started, the hands hold
    /// the arms.
    pub(super) fn beside_policy(&self) {
        let mut inner = self.lock();
        inner.driver = Some(if inner.waits {
            Driver::Operator
        } else {
            Driver::Policy
        });
    }

    /// Who drives a run with a policy, now that a hand `moves` its arm or none does: one that does
    /// takes over.
    pub(super) fn driver(&self, moves: bool) -> Option<Driver> {
        let mut inner = self.lock();
        // Whoever has just handed back holds no clutch.
        let engaged = moves && inner.hands.iter().any(|arm| arm.clutch.is_engaged());
        if engaged && inner.driver == Some(Driver::Policy) {
            inner.driver = Some(Driver::Operator);
            inner.counts.interventions.taken_over += 1;
        }
        inner.driver
    }

    /// Whether the episode has not been started yet.
    pub(super) fn waits(&self) -> bool {
        self.lock().waits
    }

    /// The hands have driven for so long beside a policy, s; not counted before the episode's
    /// start. Whether it was.
    pub(super) fn drove_s(&self, seconds: f64) -> bool {
        let mut inner = self.lock();
        let counts = !inner.waits;
        if counts {
            inner.counts.interventions.operator_s += seconds;
        }
        counts
    }

    /// The page that steers gives the arms back to the policy.
    ///
    /// # Errors
    /// [`HandsMessageError::NoPolicy`] if there is none, [`HandsMessageError::NotNow`] before the
    /// episode is started.
    pub(crate) fn hand_back(&self) -> Result<(), HandsMessageError> {
        let mut inner = self.lock();
        let driver = inner.driver.ok_or(HandsMessageError::NoPolicy)?;
        if inner.waits {
            return Err(HandsMessageError::NotNow);
        }
        if driver == Driver::Operator {
            inner.give_back();
            inner.counts.interventions.handed_back += 1;
        }
        Ok(())
    }

    /// From now on the hands are devices at the run's own computer, and no page's.
    pub(super) fn take_desk(&self) {
        self.lock().desk = true;
    }

    /// Whether they are.
    pub(crate) fn are_at_desk(&self) -> bool {
        self.lock().desk
    }

    /// The end of the control thread's mailbox, of the run that begins.
    pub(crate) fn follow(&self, commanded: MailboxReader<Commanded>) {
        self.lock().commanded = Some(commanded);
    }

    /// The operator's hands from the page in `seat`, which steers.
    ///
    /// # Errors
    /// [`HandsMessageError`]; what was engaged is released.
    pub(crate) fn hear(&self, seat: u64, message: &HandsMessage) -> Result<(), HandsMessageError> {
        self.hear_at(seat, message, self.clock.now())
    }

    pub(super) fn hear_at(
        &self,
        seat: u64,
        message: &HandsMessage,
        now: TimeNs,
    ) -> Result<(), HandsMessageError> {
        let mut inner = self.lock();
        if inner.arms == 0 {
            return Err(HandsMessageError::NoTeleop);
        }
        if inner.seat != Some(seat) {
            inner.lose(ReleaseCause::Seat);
            (inner.seat, inner.received) = (Some(seat), None);
            (inner.arrived, inner.round_trip_ns) = (None, 0);
        }
        let back = |(_, before): (TimeNs, f64)| message.t < before;
        let hands = if inner.received.is_some_and(back) {
            Err(HandsMessageError::Time)
        } else {
            message.hands(inner.arms)
        };
        let hands = match hands {
            Ok(hands) => hands,
            Err(bad) => {
                inner.lose(ReleaseCause::Nonsense);
                return Err(bad);
            }
        };
        let before = inner.arrived.replace(now);
        if before.is_none_or(|at| now.since(at) > FORGET_NS) {
            inner.transit = Transit::default();
        }
        let late_ns = inner.transit.excess_ns(message.t, now);
        inner.check_age(now);
        // Lateness that all messages have alike shows in pings alone.
        if late_ns > STALE_NS || inner.round_trip_ns / 2 > STALE_NS {
            inner.lose(ReleaseCause::Stale);
            return Ok(());
        }
        inner.received = Some((TimeNs(now.0.saturating_sub(late_ns)), message.t));
        inner.counts.messages += 1;
        inner.take(&hands);
        Ok(())
    }

    /// Releases what the page in `seat` holds.
    pub(crate) fn release(&self, seat: u64, why: ReleaseCause) {
        let mut inner = self.lock();
        if inner.seat == Some(seat) {
            inner.lose(why);
        }
    }

    /// Releases an arm that does not follow.
    pub(super) fn release_arm(&self, arm: usize, why: ReleaseCause) {
        self.lock().lose_one(arm, why);
    }

    /// The tip makes this part of the hand's way from now on.
    ///
    /// # Errors
    /// [`HandsMessageError::Scale`].
    pub(crate) fn set_scale(&self, scale: f64) -> Result<(), HandsMessageError> {
        if !SCALES.contains(&scale) {
            return Err(HandsMessageError::Scale);
        }
        self.lock().scale = Some(scale);
        Ok(())
    }

    /// A tracked controller engages within this angle of its instrument from now on, degrees.
    ///
    /// # Errors
    /// [`HandsMessageError::Align`].
    pub(crate) fn set_align_deg(&self, degrees: f64) -> Result<(), HandsMessageError> {
        if !ALIGNS_DEG.contains(&degrees) {
            return Err(HandsMessageError::Align);
        }
        self.lock().align_deg = Some(degrees);
        Ok(())
    }

    /// The page in `seat` answered a ping after so long.
    pub(crate) fn round_trip(&self, seat: u64, ns: u64) {
        let mut inner = self.lock();
        if inner.seat == Some(seat) {
            inner.round_trip_ns = ns;
            inner.counts.round_trip.record(ns);
        }
    }

    /// Whoever steers has a picture before their eyes that was taken so long ago.
    pub(crate) fn seen(&self, age_ns: u64) {
        self.lock().counts.picture.record(age_ns);
    }

    /// What moves now.
    pub(super) fn look(&self) -> Look {
        self.look_at(self.clock.now())
    }

    pub(super) fn look_at(&self, now: TimeNs) -> Look {
        let mut inner = self.lock();
        inner.check_age(now);
        let moving = inner.hands.map(|arm| match (arm.clutch, arm.hand) {
            (Clutch::Engaged(engagement), Some(hand)) => Some(Moving { engagement, hand }),
            (Clutch::Engaged(_) | Clutch::Released(_) | Clutch::Open, _) => None,
        });
        Look {
            now,
            moving,
            lost: inner.hands.map(|arm| arm.clutch.why()),
            scale: inner.scale(),
            sent: inner.received.map(|(at, _)| at),
            commanded: inner.commanded.as_mut().and_then(MailboxReader::take),
        }
    }

    /// A command has followed a hand, so long after it.
    pub(super) fn followed(&self, latency_ns: u64) {
        self.lock().counts.command.record(latency_ns);
    }

    /// Where the tip of an arm is commanded to be in the picture's axes, and how far its jaw is
    /// closed.
    pub(super) fn show(&self, arm: usize, tip_in_view: &Pose, closed: f64) {
        if let Some(tip) = self.lock().tips.get_mut(arm) {
            *tip = Some((*tip_in_view, closed));
        }
    }

    /// A command on the episode, of the page in control.
    ///
    /// # Errors
    /// [`HandsMessageError::NoRecording`] if nothing is recorded, [`HandsMessageError::NotNow`] if
    /// it does not apply.
    pub(crate) fn wish(&self, wish: EpisodeCommand) -> Result<(), HandsMessageError> {
        if self.mark_by(wish) {
            return Ok(());
        }
        let mut inner = self.lock();
        let recording = inner.recording.ok_or(HandsMessageError::NoRecording)?;
        let applies = match recording.phase {
            Phase::Waiting => wish == EpisodeCommand::Start,
            Phase::Running => wish != EpisodeCommand::Start,
            Phase::Writing => false,
        };
        if !applies {
            return Err(HandsMessageError::NotNow);
        }
        inner.wish = Some(wish);
        Ok(())
    }

    /// The demonstration under way is called `text` in the dataset, or the run that asks for a mark
    /// in its log.
    ///
    /// # Errors
    /// [`HandsMessageError::Label`] if `text` is none, [`HandsMessageError::NoRecording`] if
    /// nothing is recorded.
    pub(crate) fn set_label(&self, text: &str) -> Result<(), HandsMessageError> {
        let label = label(text)?;
        let mut inner = self.lock();
        if let Some(said) = &mut inner.said {
            label.clone_into(&mut said.label);
            return Ok(());
        }
        if inner.recording.is_none() {
            return Err(HandsMessageError::NoRecording);
        }
        label.clone_into(&mut inner.label);
        Ok(())
    }

    /// What the demonstration that has ended is called, if it is; the next one has no label.
    pub(crate) fn take_label(&self) -> Option<String> {
        Some(std::mem::take(&mut self.lock().label)).filter(|label| !label.is_empty())
    }

    /// The newest wish, if there is one.
    pub(crate) fn take_episode_command(&self) -> Option<EpisodeCommand> {
        self.lock().wish.take()
    }

    /// The episode begins: hands may move their arms.
    pub(crate) fn start(&self) {
        let mut inner = self.lock();
        inner.waits = false;
        if inner.driver.is_some() {
            inner.give_back();
        }
        if let Some(recording) = &mut inner.recording {
            recording.phase = Phase::Running;
        }
    }

    /// The episode is over, or is not yet: hands move nothing.
    pub(crate) fn rest(&self) {
        let mut inner = self.lock();
        inner.waits = true;
        inner.lose(ReleaseCause::NoEpisode);
    }

    /// How the recording stands.
    pub(crate) fn tell_recording(&self, recording: Recording) {
        self.lock().recording = Some(recording);
    }

    /// What pages are told; nothing if the policy is another.
    pub(crate) fn status(&self) -> Option<TeleopStatus> {
        let inner = self.lock();
        let arms = inner.hands.iter().zip(&inner.tips).take(inner.arms);
        let arms = arms.map(|(arm, tip)| ArmStatus {
            engaged: arm.clutch.is_engaged(),
            lost: arm.clutch.why().map(|why| why.to_string()),
            misaligned_deg: arm.misaligned_deg.map(f64::ceil),
            tip: tip.as_ref().map(|(tip, _)| numbers(tip)),
            jaw: tip.map_or(0.0, |(_, closed)| closed),
        });
        (inner.arms > 0).then(|| TeleopStatus {
            desk: inner.desk,
            scale: Some(inner.scale()),
            align_deg: Some(inner.align_deg()),
            driver: inner.driver,
            arms: arms.collect(),
            recording: inner.recording,
            label: inner.label.clone(),
            camera_to_page_ms: inner.counts.camera_to_page_ms(),
        })
    }

    /// What was counted since the run began.
    pub(crate) fn summary(&self) -> TeleopSummary {
        let inner = self.lock();
        let chosen = (inner.scale(), inner.align_deg());
        inner.counts.summary(chosen, inner.driver.is_some())
    }
}
