//! Hands to chunks: where the tips should be, from what the arms were commanded to be at when the
//! hands took the clutch.

use std::sync::Arc;

use hal::{ARMS_MAX, ArmObservation, Chunk, PerArm, Pose, TimeNs, TipTarget};
use nalgebra::{Translation3, UnitQuaternion};
use trocar_control::kinematics::forward;

use super::clutch::ReleaseCause;
use super::hands::{Hands, Look, Moving};
use super::logged::{HandNotice, HandsNotice};
use super::{ArmCommanded, Commanded, Driver};
use crate::session::SessionError;
use crate::session::source::STEP_NS;

/// Angle between the jaw fingers with the trigger let go, and pressed, rad. The latter is below
/// contact: it presses.
pub(super) const JAW_OPEN_RAD: f64 = 0.7;
pub(super) const JAW_CLOSED_RAD: f64 = -0.15;

/// A trigger takes the jaw over where it meets it this closely, rad.
const JAW_MEETS_RAD: f64 = 0.06;

/// How far a target is from the commanded tip at most. What a hand goes beyond that is forgotten,
/// so that an arm never goes on for longer than this after its hand stops.
const LEASH_M: f64 = 0.012;
const LEASH_RAD: f64 = 0.4;

/// An arm that is released goes on for its velocity times this, s: the inverse of the tracking's
/// gain, so that its velocity begins to fall from where it is, and the tip comes to rest without
/// turning back.
const STOP_S: f64 = 0.05;

/// Chunks whose way to the controller is measured at a time.
const MEASURED_MAX: usize = 64;

/// A source of chunks that is an operator's hands.
pub struct Teleop {
    hands: Arc<Hands>,
    arms: Vec<HandledArm>,
    sequence: u64,
    commanded: Option<Commanded>,
    measured: Measured,
    /// The scale that the log has.
    scale: Option<f64>,
    notices: Vec<String>,
}

/// Chunks that are on their way, for what hands were followed.
#[derive(Default)]
struct Measured {
    /// Sequence, and when the hand's message came, by the run's clock.
    waiting: Vec<(u64, TimeNs)>,
    /// The message that was followed last, by the clock of the hands.
    newest: Option<TimeNs>,
}

/// An arm, and what it does.
struct HandledArm {
    rcm_from_view: Pose,
    engaged: Option<Anchor>,
    /// Where it holds while no hand moves it.
    held: Option<(Pose, f64)>,
    /// Why its hand can't engage, as the log has it.
    lost: Option<ReleaseCause>,
}

/// What an engagement starts from.
#[derive(Clone, Copy, Debug)]
struct Anchor {
    engagement: u64,
    scale: f64,
    hand: Pose,
    tip: Pose,
    jaw: f64,
    /// Whether the trigger has met the jaw.
    jaw_taken: bool,
    /// The jaw that the trigger asked for last, rad.
    asked: f64,
}

impl Teleop {
    /// The source for arms of which each sees the view at that pose of `rcms_from_view`, which
    /// `hands` move. With `waits`, they move nothing before the episode is started.
    pub(crate) fn new(rcms_from_view: &[Pose], hands: Arc<Hands>, waits: bool) -> Self {
        let arms = rcms_from_view.iter().map(|view| HandledArm {
            rcm_from_view: *view,
            engaged: None,
            held: None,
            lost: None,
        });
        hands.begin(rcms_from_view.len(), waits);
        Self {
            hands,
            arms: arms.collect(),
            sequence: 0,
            commanded: None,
            measured: Measured::default(),
            scale: None,
            notices: Vec::new(),
        }
    }

    /// What the log is to say, since the last call.
    pub(crate) fn take_notices(&mut self) -> Vec<String> {
        core::mem::take(&mut self.notices)
    }

    /// Releases every clutch: it has to be taken anew.
    pub(crate) fn release(&self) {
        for arm in 0..self.arms.len() {
            self.hands.release_arm(arm, ReleaseCause::NotEnabled);
        }
    }

    /// The hands drive nothing: when one takes its clutch, its arm goes on from where it is
    /// commanded to be then.
    pub(super) fn stand_by(&mut self) {
        for arm in &mut self.arms {
            (arm.engaged, arm.held) = (None, None);
        }
    }

    /// Whether a hand moves its arm, as of the last answer.
    pub(super) fn moves(&self) -> bool {
        self.arms.iter().any(|arm| arm.engaged.is_some())
    }

    /// Who asked the arms last, and where they were asked to be, or are commanded to be if they
    /// were not; none before the first command.
    pub(super) fn asked(&self) -> Option<(Driver, PerArm<TipTarget>)> {
        let commanded = self.commanded.as_ref()?;
        let targets = commanded.arms.map(|arm| {
            let here = || TipTarget::new(&forward(&arm.position), arm.jaw);
            arm.target.unwrap_or_else(here)
        });
        Some((commanded.driver, targets))
    }

    /// A target for each arm, for the arms measured as `seen` at its stamp; it holds for two policy
    /// steps.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if there are other arms than the task has.
    pub(crate) fn answer(
        &mut self,
        seen: &PerArm<ArmObservation>,
    ) -> Result<PerArm<Chunk>, SessionError> {
        let look = self.hands.look();
        self.answer_at(seen, &look)
    }

    pub(super) fn answer_at(
        &mut self,
        seen: &PerArm<ArmObservation>,
        look: &Look,
    ) -> Result<PerArm<Chunk>, SessionError> {
        let now = seen.first.state.stamp;
        self.sequence += 1;
        if let Some(commanded) = look.commanded {
            self.measured.arrived(&commanded, &self.hands);
            self.commanded = Some(commanded);
        }
        let moves = look.moving.iter().any(Option::is_some);
        if moves && self.scale != Some(look.scale) {
            self.scale = Some(look.scale);
            let notice = HandsNotice::Scale(look.scale);
            self.notices.push(notice.to_string());
        }
        let mut targets = Vec::with_capacity(ARMS_MAX);
        for (index, (arm, seen)) in self.arms.iter_mut().zip(seen.iter()).enumerate() {
            let commanded = self.commanded.as_ref().and_then(|all| all.arms.get(index));
            let commanded = commanded.copied().unwrap_or_else(|| at_rest(seen));
            let moving = look.moving.get(index).copied().flatten();
            if moving.is_some() && !commanded.follows {
                self.hands.release_arm(index, ReleaseCause::NotEnabled);
            }
            let moving = moving.filter(|_| commanded.follows);
            let lost = look.lost.get(index).copied().flatten();
            if let Some(event) = arm.event(moving.is_some(), lost) {
                let notice = HandsNotice::Hand(index, event);
                self.notices.push(notice.to_string());
            }
            let (tip, jaw) = arm.target(moving, look.scale, &commanded);
            let tip_in_view = arm.rcm_from_view.inverse() * forward(&commanded.position);
            self.hands.show(index, &tip_in_view, closed(commanded.jaw));
            targets.push(TipTarget::new(&tip, jaw));
        }
        if moves {
            self.measured.sent(self.sequence, look, now);
        }
        let chunks = targets
            .iter()
            .map(|target| Chunk::new(now, self.sequence, STEP_NS, &[*target; 3]));
        PerArm::collect(chunks)
            .ok_or_else(|| SessionError::BadArgument("policy teleop: there is no arm".to_owned()))
    }
}

/// What an arm is commanded before anything is known of its commands: to be where it is.
fn at_rest(seen: &ArmObservation) -> ArmCommanded {
    ArmCommanded {
        position: seen.state.position,
        velocity: hal::JointVector::zeros(),
        jaw: seen.state.jaw_position,
        target: None,
        follows: false,
    }
}

impl Measured {
    /// A chunk follows the hands of `look`, at `now` by the run's clock.
    fn sent(&mut self, sequence: u64, look: &Look, now: TimeNs) {
        let fresh = look.sent.filter(|_| look.sent != self.newest);
        if let (Some(sent), true) = (fresh, self.waiting.len() < MEASURED_MAX) {
            self.newest = Some(sent);
            let age_ns = look.now.since(sent);
            self.waiting
                .push((sequence, TimeNs(now.0.saturating_sub(age_ns))));
        }
    }

    /// Counts those that the controller has commanded.
    fn arrived(&mut self, commanded: &Commanded, hands: &Hands) {
        self.waiting.retain(|(sequence, sent)| {
            let there = *sequence <= commanded.sequence;
            if there {
                hands.followed(commanded.at.since(*sent));
            }
            !there
        });
    }
}

impl HandledArm {
    /// What the log says of a change, if there is one. While a policy drives, why its hand can't
    /// engage is of no account.
    fn event(&mut self, moves: bool, lost: Option<ReleaseCause>) -> Option<HandNotice> {
        let other = self.held.is_some() && lost != self.lost;
        let event = match (self.engaged.is_some(), moves, lost) {
            (false, true, _) => HandNotice::Engaged,
            (true, false, None) => HandNotice::LetGo,
            (true, false, Some(why)) => HandNotice::Released(why.to_string()),
            (false, false, Some(why)) if other => HandNotice::Blocked(why.to_string()),
            (false, false, None) if other => HandNotice::Free,
            (false, false, _) | (true, true, _) => return None,
        };
        self.lost = lost;
        Some(event)
    }

    /// Where the tip should be, in the RCM frame, and the jaw's angle.
    fn target(
        &mut self,
        moving: Option<Moving>,
        scale: f64,
        commanded: &ArmCommanded,
    ) -> (Pose, f64) {
        let Some(moving) = moving else {
            return self.hold(commanded);
        };
        let hand = moving.hand.pose;
        let same = self
            .engaged
            .filter(|anchor| anchor.engagement == moving.engagement);
        let mut anchor = same.unwrap_or_else(|| {
            let (tip, jaw) = self.hold(commanded);
            Anchor {
                engagement: moving.engagement,
                scale,
                hand,
                tip,
                jaw,
                jaw_taken: false,
                asked: jaw_rad(moving.hand.jaw),
            }
        });
        if (anchor.scale - scale).abs() > 1e-9 {
            let tip = anchor.tip_for(&hand, &self.rcm_from_view);
            (anchor.scale, anchor.hand, anchor.tip) = (scale, hand, tip);
        }
        let wanted = anchor.tip_for(&hand, &self.rcm_from_view);
        let tip = leashed(&wanted, &forward(&commanded.position));
        // Where the hand has run ahead, it starts anew from where the target is.
        if tip != wanted {
            (anchor.hand, anchor.tip) = (hand, tip);
        }
        anchor.follow_trigger(jaw_rad(moving.hand.jaw));
        self.engaged = Some(anchor);
        (tip, anchor.jaw)
    }

    /// Where the arm holds: where it stops as its hand lets go, or is as long as it follows
    /// nothing.
    fn hold(&mut self, commanded: &ArmCommanded) -> (Pose, f64) {
        let released = self.engaged.take();
        let stale = released.is_some() || !commanded.follows;
        let held = self.held.filter(|_| !stale).unwrap_or_else(|| {
            let stop = commanded.position + commanded.velocity * STOP_S;
            let jaw = released.map_or(commanded.jaw, |anchor| anchor.jaw);
            (forward(&stop), jaw)
        });
        self.held = Some(held);
        held
    }
}

impl Anchor {
    /// Where the tip belongs with the hand at `hand`.
    fn tip_for(&self, hand: &Pose, rcm_from_view: &Pose) -> Pose {
        let turn = rcm_from_view.rotation;
        let way = turn * (hand.translation.vector - self.hand.translation.vector) * self.scale;
        let turned = turn * (hand.rotation * self.hand.rotation.inverse()) * turn.inverse();
        let mut rotation = turned * self.tip.rotation;
        rotation.renormalize();
        Pose::from_parts(
            Translation3::from(self.tip.translation.vector + way),
            rotation,
        )
    }

    /// The jaw stays as it is until the trigger has met it: a needle is not dropped because the
    /// hand took the clutch with its trigger let go.
    fn follow_trigger(&mut self, asked: f64) {
        let meets = (asked - self.jaw).abs() < JAW_MEETS_RAD;
        let passes = (self.asked - self.jaw) * (asked - self.jaw) < 0.0;
        self.jaw_taken |= meets || passes;
        self.asked = asked;
        if self.jaw_taken {
            self.jaw = asked;
        }
    }
}

/// How far a jaw of this angle is closed, 0 to 1 as the trigger says it.
pub(super) fn closed(jaw_rad: f64) -> f64 {
    let closed = (JAW_OPEN_RAD - jaw_rad) / (JAW_OPEN_RAD - JAW_CLOSED_RAD);
    closed.clamp(0.0, 1.0)
}

fn jaw_rad(closed: f64) -> f64 {
    JAW_OPEN_RAD + (JAW_CLOSED_RAD - JAW_OPEN_RAD) * closed
}

/// `wanted`, no further from `tip` than the leash.
fn leashed(wanted: &Pose, tip: &Pose) -> Pose {
    let way = wanted.translation.vector - tip.translation.vector;
    let angle = tip.rotation.angle_to(&wanted.rotation);
    if way.norm() <= LEASH_M && angle <= LEASH_RAD {
        return *wanted;
    }
    let translation = tip.translation.vector + way * (LEASH_M / way.norm().max(LEASH_M));
    let rotation = if angle > LEASH_RAD {
        let turn: UnitQuaternion<f64> = tip.rotation.inverse() * wanted.rotation;
        tip.rotation * turn.powf(LEASH_RAD / angle)
    } else {
        wanted.rotation
    };
    Pose::from_parts(Translation3::from(translation), rotation)
}
