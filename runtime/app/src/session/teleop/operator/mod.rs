//! A simulated operator: sees the scene late, and moves hands that tremble and go astray. What they
//! do passes through everything that a headset's messages pass through once they are read:
//! [`Hands`], clutch, scale and leash, [`Teleop`].
//!
//! The plan is the scripted expert's, played with
//! [`SettleCriteria`](trocar_tasks::expert::SettleCriteria): where each tip should be next. A hand
//! moves as the plan does and never learns where the tip is but by sight, so its errors add up; a
//! correction takes back what is seen of them ([`OperatorFigures`]). A hand that leaves its
//! comfortable range stops, lets the clutch go, comes back and takes it anew; meanwhile the plan
//! stands still.

mod corrections;
mod figures;
mod hand;
mod noise;
mod sight;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use hal::{ARMS_MAX, ArmObservation, Chunk, PerArm, TICK_S, TimeNs, TipTarget};
use trocar_log::TickRecord;
use trocar_tasks::expert::{Expert, STEP_NS};
use trocar_tasks::scene::SceneState;
use trocar_world::rng::Rng;

use super::message::HandsMessage;
use super::{CHUNK_TICKS, Commanded, Given, Hands, Teleop, TeleopSummary, rcms_from_view};
use crate::session::{SessionError, Setup};
pub use figures::{DELAYS_MS, OperatorFigures, TREMORS_MM};
use hand::{Moment, SimulatedHand};
use sight::Sight;

/// The page that the hands are on.
const SEAT: u64 = 1;

/// Looks from one message of the hands to the next: 62.5 messages a second, about what a headset's
/// page sends.
const LOOKS: u64 = 2;

/// Time between two messages, s.
#[expect(clippy::cast_precision_loss, reason = "a handful of ticks")]
const MESSAGE_S: f64 = (LOOKS * CHUNK_TICKS) as f64 * TICK_S;

/// A source of chunks that is an operator, simulated.
pub struct SimulatedOperator {
    figures: OperatorFigures,
    hands: Arc<Hands>,
    teleop: Teleop,
    sight: Sight,
    plan: Plan,
    arms: Vec<SimulatedHand>,
    looks: u64,
    given: Given,
    commanded: Option<Commanded>,
    /// Whether each arm follows its hand.
    engaged: [bool; ARMS_MAX],
}

impl SimulatedOperator {
    /// One with `figures` before the arms of `setup`, in the episode `seed`.
    pub(crate) fn new(setup: &Setup, figures: &OperatorFigures, seed: u64) -> Self {
        let hands = Arc::new(Hands::new());
        let views = rcms_from_view(&setup.task);
        let arms = views.iter().enumerate().map(|(index, view)| {
            let rng = Rng::stream(seed, &format!("operator's hand {index}"));
            SimulatedHand::new(view, figures, rng)
        });
        let [slowest, fastest] = figures.tempo;
        let tempo = Rng::stream(seed, "operator's tempo").range(slowest, fastest);
        Self {
            figures: *figures,
            arms: arms.collect(),
            teleop: Teleop::new(&views, Arc::clone(&hands), false),
            hands,
            sight: Sight::new(figures.delay_ms),
            plan: Plan {
                expert: Expert::careful(&setup.task, seed, figures.care()),
                tempo,
                pace: 0.0,
                steps: 0,
                share: 0.0,
                way: Vec::new(),
            },
            looks: 0,
            given: Given::nothing(),
            commanded: None,
            engaged: [false; ARMS_MAX],
        }
    }

    /// Grasps tried so far, the present one included.
    pub(crate) fn attempts(&self) -> u32 {
        self.plan.expert.attempts()
    }

    /// What the hands did; their latency is none, since virtual time stands still meanwhile, and so
    /// is their device.
    pub(crate) fn summary(&self) -> TeleopSummary {
        TeleopSummary {
            hand_to_command_ms: None,
            device: None,
            ..self.hands.summary()
        }
    }

    /// A tick is over.
    pub(crate) fn ticked(&mut self, record: &TickRecord) {
        self.commanded = Some(Commanded::after(record, &mut self.given));
    }

    /// A target for each arm, for the arms measured as `seen`, with the scene as it is now; to be
    /// asked every 8 ms.
    ///
    /// # Errors
    /// Those of [`Teleop::answer`].
    pub(crate) fn answer(
        &mut self,
        seen: &PerArm<ArmObservation>,
        scene: &SceneState,
    ) -> Result<PerArm<Chunk>, SessionError> {
        let now = seen.first.state.stamp;
        let sight = self.sight.look(now, scene);
        if let (Some(sight), true) = (sight, self.looks.is_multiple_of(LOOKS)) {
            let message = self.move_hands(now, &sight);
            let heard = self.hands.hear_at(SEAT, &message, now);
            heard.map_err(|bad| SessionError::BadArgument(format!("simulated operator: {bad}")))?;
        }
        self.looks += 1;
        let mut look = self.hands.look_at(now);
        look.commanded = self.commanded.take();
        self.engaged = look.moving.map(|moving| moving.is_some());
        let chunks = self.teleop.answer_at(seen, &look);
        // A log in lockstep has no place for them.
        self.teleop.take_notices();
        chunks
    }

    /// What the controllers say after the next step of the hands, which see `scene` as it was then.
    fn move_hands(&mut self, now: TimeNs, (then, scene): &(TimeNs, SceneState)) -> HandsMessage {
        let figures = &self.figures;
        let hands = self.arms.iter().zip(self.engaged);
        let mut ready = hands.map(|(hand, engaged)| hand.goes_on(engaged, figures));
        let goes_on = ready.all(|ready| ready);
        self.plan.go_on(goes_on, scene, figures.slow_s);
        let tips = [
            Some(scene.first.tip_in_rcm),
            scene.second.map(|arm| arm.tip_in_rcm),
        ];
        let arms = self.arms.iter_mut().zip(tips.iter().flatten()).enumerate();
        let arms = arms.map(|(index, (hand, tip))| {
            let moment = Moment {
                now,
                wanted: &self.plan.wanted(index),
                seen: (*then, tip),
                engaged: self.engaged[index],
                stands: self.plan.pace <= 0.0,
            };
            Some(hand.step(&moment, figures))
        });
        HandsMessage {
            t: now.seconds() * 1e3,
            arms: arms.collect(),
        }
    }
}

/// Where the tips should be: the script's way, at the operator's own pace.
struct Plan {
    expert: Expert,
    /// Pace over the script's, when nothing stops the hands, and now.
    tempo: f64,
    pace: f64,
    /// Steps of the script, and what part of the next one is done.
    steps: u64,
    share: f64,
    /// From where to where each tip goes in it.
    way: Vec<[TipTarget; 2]>,
}

impl Plan {
    /// Goes on for the time between two messages, or slows down; the script sees `scene`.
    fn go_on(&mut self, goes_on: bool, scene: &SceneState, slow_s: f64) {
        let wanted = if goes_on { self.tempo } else { 0.0 };
        let change = MESSAGE_S / slow_s;
        self.pace += (wanted - self.pace).clamp(-change, change);
        self.share += self.pace * MESSAGE_S / TimeNs(STEP_NS).seconds();
        if self.share >= 1.0 || self.way.is_empty() {
            self.share = (self.share - 1.0).max(0.0);
            let chunks = self.expert.chunks(TimeNs(self.steps * STEP_NS), scene, 1);
            self.steps += 1;
            let way = |chunk: &Chunk| [chunk.targets[0], chunk.targets[1]];
            self.way = chunks.iter().map(way).collect();
        }
    }

    /// Where the tip of an arm should be.
    fn wanted(&self, arm: usize) -> TipTarget {
        let [from, to] = &self.way[arm];
        let tip = from.tip_in_rcm().lerp_slerp(&to.tip_in_rcm(), self.share);
        TipTarget::new(&tip, from.jaw + (to.jaw - from.jaw) * self.share)
    }
}
