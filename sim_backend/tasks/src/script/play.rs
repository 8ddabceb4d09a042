//! How a hand plays its part: phases with a motion each, and what leads from one to the next.

use core::fmt::Debug;

use hal::{Pose, TimeNs};
use trocar_world::rng::Rng;

use super::motion::{Motion, Placement};

/// A step's share of following what moves, m and rad.
const FOLLOW_STEP_M: f64 = 0.000_8;
const FOLLOW_STEP_RAD: f64 = 0.04;

/// Distance between the measured tip and where it was meant to be beyond which another attempt begins at the measured one, m;
/// without a disturbance it stays far below.
const OFF_M: f64 = 0.002_5;

/// What a hand does at a time: a state of its part's state machine.
pub(crate) trait Stage: Copy + Debug + PartialEq + Send + 'static {
    /// What a hand begins with.
    const FIRST: Self;

    /// Every transition: from a stage, upon an event, to another stage. Upon any other event a hand stays in its stage.
    const TRANSITIONS: &'static [(Self, Event, Self)];

    /// What it does after `event`.
    fn next(self, event: Event) -> Self {
        let mut transitions = Self::TRANSITIONS.iter();
        let found = transitions.find(|(from, upon, _)| (*from, *upon) == (self, event));
        found.map_or(self, |(_, _, to)| *to)
    }
}

/// What happens to a hand in a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// The motion has ended and the arm is where it was to be, or will not get closer.
    Arrived,
    /// The jaw holds the thing where it should.
    Gripped,
    /// The jaw holds the needle, whose point is in the hole.
    Regripped,
    /// The jaw has closed on nothing or at the wrong place, the thing has slipped out, or is not where it should be.
    Lost,
    /// The thing does not move on.
    Stuck,
    /// The other hand presents the needle.
    Offered,
    /// The other hand holds the needle too.
    Taken,
    /// The other hand has let go and is gone.
    Given,
    /// Nobody holds the needle, and the other hand waits.
    Free,
}

/// What a hand is doing, as far as a disturbance must know.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Activity {
    /// On the way to the thing, in the air, with nothing in the hand.
    Reach,
    /// Going in and closing the jaw.
    Grasp,
    /// Lifting the thing off what it lies on.
    Lift,
    /// Carrying it through the air.
    Carry,
    /// Anything else, where a push may do harm or nothing is to be learned from it.
    #[default]
    Other,
}

/// How one attempt differs from the next: what a person would do a little differently each time.
pub(crate) trait Habits: Clone + Debug + Send + 'static {
    /// The habits of one attempt.
    fn draw(rng: &mut Rng) -> Self;
}

/// What a hand sees of its arm, in the scene frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArmView {
    pub(crate) tip: Pose,
    pub(crate) jaw: f64,
    pub(crate) both_touch: bool,
}

/// What every hand has: its habits, what it is doing, and how that went so far.
#[derive(Clone, Debug)]
pub(crate) struct Hand<H, S> {
    rng: Rng,
    pub(crate) style: H,
    pub(crate) phase: S,
    motion: Option<Motion>,
    attempts: u32,
    untouched_steps: u32,
}

impl<H: Habits, S: Stage> Hand<H, S> {
    /// A hand at the start of an episode.
    pub(crate) fn new(mut rng: Rng) -> Self {
        let style = H::draw(&mut rng);
        Self {
            rng,
            style,
            phase: S::FIRST,
            motion: None,
            attempts: 1,
            untouched_steps: 0,
        }
    }

    /// Attempts begun so far, the present one included.
    pub(crate) const fn attempts(&self) -> u32 {
        self.attempts
    }

    /// Whether, in this phase, not both fingers touched the thing in the last `steps` steps.
    pub(crate) const fn has_lost(&self, steps: u32) -> bool {
        self.untouched_steps >= steps
    }
}

/// What one hand does in the script of a task.
pub(crate) trait Part: Clone + Debug + Send + 'static {
    /// Its habits.
    type Habits: Habits;
    /// Its phases.
    type Stage: Stage;
    /// What it looks at.
    type View;

    /// The hand.
    fn hand(&self) -> &Hand<Self::Habits, Self::Stage>;

    /// The hand.
    fn hand_mut(&mut self) -> &mut Hand<Self::Habits, Self::Stage>;

    /// Its own arm in `view`.
    fn own(view: &Self::View) -> &ArmView;

    /// Whether the thing is meant to be in the jaw.
    fn carries(&self) -> bool;

    /// What the present phase amounts to.
    fn activity(&self) -> Activity;

    /// Whether going on to `next` is another attempt.
    fn tries_again(&self, next: Self::Stage) -> bool;

    /// The motion of the present phase.
    fn begin(&mut self, now: TimeNs, from: Placement, view: &Self::View) -> Motion;

    /// The goal of a phase that follows something.
    fn moving_goal(&self, view: &Self::View) -> Option<Pose>;

    /// What has happened at this step, if anything.
    fn event(&self, now: TimeNs, motion: &Motion, view: &Self::View) -> Option<Event>;

    /// Where the tip should be at `now`; to be asked every step.
    fn play(&mut self, now: TimeNs, view: &Self::View) -> Placement {
        let own = Self::own(view);
        let start = Placement {
            tip_in_scene: own.tip,
            jaw: own.jaw,
        };
        let mut motion = match self.hand().motion {
            Some(motion) => motion,
            None => self.begin(now, start, view),
        };
        if let Some(goal) = self.moving_goal(view) {
            motion.drift_end(&goal, FOLLOW_STEP_M, FOLLOW_STEP_RAD);
        }
        let untouched = &mut self.hand_mut().untouched_steps;
        *untouched = if own.both_touch { 0 } else { *untouched + 1 };
        if let Some(event) = self.event(now, &motion, view) {
            let next = self.hand().phase.next(event);
            if next != self.hand().phase {
                let mut from = motion.at(now);
                if self.tries_again(next) && is_off(&from, &own.tip) {
                    from.tip_in_scene = own.tip;
                }
                self.enter(next);
                motion = self.begin(now, from, view);
            }
        }
        self.hand_mut().motion = Some(motion);
        motion.at(now)
    }

    /// Book-keeping on entering a phase.
    fn enter(&mut self, next: Self::Stage) {
        let again = self.tries_again(next);
        let hand = self.hand_mut();
        if again {
            // A person does not repeat a failed attempt exactly.
            hand.style = Self::Habits::draw(&mut hand.rng);
            hand.attempts += 1;
        }
        hand.phase = next;
        hand.untouched_steps = 0;
    }
}

/// Whether the hand at `tip` was kept from where it was meant to be.
fn is_off(meant: &Placement, tip: &Pose) -> bool {
    let gap = meant.tip_in_scene.translation.vector - tip.translation.vector;
    gap.norm() > OFF_M
}

/// Checks a state machine: no event leads two ways, none stays where it is, and each stage is reached and has a way on, but for
/// `last`.
#[cfg(test)]
pub(crate) fn check_transitions<S: Stage>(last: Option<S>) {
    let mut reached = vec![S::FIRST];
    for (index, &(from, event, to)) in S::TRANSITIONS.iter().enumerate() {
        assert_ne!(from, to, "{from:?} upon {event:?}");
        let others = S::TRANSITIONS[index + 1..].iter();
        let mut others = others.map(|&(from, event, _)| (from, event));
        assert!(
            others.all(|other| other != (from, event)),
            "{from:?} upon {event:?} leads two ways"
        );
        assert_eq!(from.next(event), to);
        if !reached.contains(&to) {
            reached.push(to);
        }
    }
    for &(from, ..) in S::TRANSITIONS {
        assert!(reached.contains(&from), "{from:?} is never reached");
    }
    for stage in reached {
        let goes_on = S::TRANSITIONS.iter().any(|&(from, ..)| from == stage);
        assert_eq!(goes_on, Some(stage) != last, "{stage:?}");
    }
}
