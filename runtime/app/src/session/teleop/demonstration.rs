//! A demonstration by hand: what the person wants of the episode, and what was seen and done in it.

use std::sync::Arc;

use hal::{ArmObservation, PerArm, TipTarget};
use serde::{Deserialize, Serialize};
use trocar_tasks::scene::SceneSnapshot;

use super::{Driver, Hands};

/// A command on the episode, of the page in control.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EpisodeCommand {
    /// Begin the episode, which waits for it.
    Start,
    /// End it and keep it: it is a success, whatever the judge lacks.
    Keep,
    /// End it, throw it away, and do the same one again.
    Redo,
    /// End it, throw it away, and go on with the next one.
    Discard,
}

impl EpisodeCommand {
    /// Why the episode ended, in words.
    #[must_use]
    pub const fn reason(self) -> &'static str {
        match self {
            Self::Start => "started",
            Self::Keep => "kept by the operator",
            Self::Redo => "to be done again",
            Self::Discard => "discarded by the operator",
        }
    }
}

/// A policy step of a demonstration.
#[derive(Clone, Copy, Debug)]
pub struct DemonstrationStep {
    /// The measured arms.
    pub arms: PerArm<ArmObservation>,
    /// Where whoever drives wants the tips.
    pub targets: PerArm<TipTarget>,
    /// Whether an operator's hands drive.
    pub by_hand: bool,
    /// Where everything is, for pictures that are made later.
    pub scene: SceneSnapshot,
}

/// What became of an episode that a person demonstrated.
#[derive(Clone, Debug, Default)]
pub struct Demonstration {
    /// Its steps, from its start.
    pub moments: Vec<DemonstrationStep>,
    /// How the person ended it; none if the judge did, or something else.
    pub ended: Option<EpisodeCommand>,
}

/// A demonstration while it goes on: it waits for its start, during which time stands still.
pub(crate) struct Demonstrating {
    hands: Arc<Hands>,
    started: bool,
    so_far: Demonstration,
}

impl Demonstrating {
    /// One that waits.
    pub(crate) fn new(hands: Arc<Hands>) -> Self {
        Self {
            hands,
            started: false,
            so_far: Demonstration::default(),
        }
    }

    /// Whether time passes: the person has started the episode.
    pub(crate) fn runs(&mut self) -> bool {
        if !self.started && self.hands.take_episode_command() == Some(EpisodeCommand::Start) {
            self.started = true;
            self.hands.start();
        }
        self.started
    }

    /// Whether the person has ended it.
    pub(crate) fn has_ended(&mut self) -> bool {
        if self.started && self.so_far.ended.is_none() {
            self.so_far.ended = self.hands.take_episode_command();
        }
        self.so_far.ended.is_some()
    }

    /// A policy step, if it is under way: the measured arms, and where whoever drives wants their
    /// tips.
    pub(crate) fn note(
        &mut self,
        arms: &PerArm<ArmObservation>,
        (driver, targets): (Driver, &PerArm<TipTarget>),
        scene: impl FnOnce() -> SceneSnapshot,
    ) {
        if self.started && self.so_far.ended.is_none() {
            self.so_far.moments.push(DemonstrationStep {
                arms: *arms,
                targets: *targets,
                by_hand: driver == Driver::Operator,
                scene: scene(),
            });
        }
    }

    /// What became of it.
    pub(crate) fn end(self) -> Demonstration {
        self.hands.rest();
        self.so_far
    }
}
