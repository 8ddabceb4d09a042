//! How a hand plays its part: phases with a motion each, and what leads from one to the next.
//!
//! A [`Part`] says what a task's hand does: its phases ([`Stage`], with a table of transitions),
//! the motion of each, what ends it (an [`Event`]), and its [`Habits`]. [`Hand`] is what all of
//! them share. Each step it begins the phase's motion if there is none, lets its end drift after
//! what moves, counts the steps without touch, asks the part for an event, and on a transition
//! begins the next motion from where the last one was to be, not from where the tip is, so that
//! targets never jump. Only after a disturbance, at the start of another attempt, it begins at the
//! measured tip.

use core::fmt::Debug;

use hal::{Pose, TimeNs};
use trocar_world::rng::Rng;

use super::care::{Careful, SettleCriteria};
use super::motion::{Motion, Placement};

/// A step's share of following what moves, m and rad.
const FOLLOW_STEP_M: f64 = 0.000_8;
const FOLLOW_STEP_RAD: f64 = 0.04;

/// Distance between the measured tip and where it was meant to be beyond which another attempt
/// begins at the measured one, m; without a disturbance it stays far below.
const OFF_M: f64 = 0.002_5;

/// A transition: from a stage, upon an event, to another stage.
pub(crate) type Transition<S> = (S, Event, S);

/// What a hand does at a time: a state of its part's state machine.
pub(crate) trait Stage: Copy + Debug + PartialEq + Send + 'static {
    /// What a hand begins with.
    const FIRST: Self;

    /// The transitions of a grasp, which all parts have.
    const GRASP: [Transition<Self>; 5];

    /// All other transitions. Upon any other event a hand stays in its stage.
    const TRANSITIONS: &'static [Transition<Self>];

    /// What it does after `event`.
    fn next(self, event: Event) -> Self {
        let transitions = Self::TRANSITIONS.iter().copied();
        let mut transitions = Self::GRASP.into_iter().chain(transitions);
        let found = transitions.find(|(from, upon, _)| (*from, *upon) == (self, event));
        found.map_or(self, |(_, _, to)| to)
    }
}

/// The stages of a grasp: in to the thing, close, and if that fails open and back to where an
/// attempt begins.
pub(crate) struct Grasp<S> {
    /// Going in, jaw open.
    pub(crate) enter: S,
    /// Closing the jaw and waiting for a grip.
    pub(crate) close: S,
    /// What follows a grip.
    pub(crate) gripped: S,
    /// Opening the jaw after a missed grip.
    pub(crate) open: S,
    /// Going back out.
    pub(crate) retreat: S,
    /// What another attempt begins with.
    pub(crate) again: S,
}

impl<S: Copy> Grasp<S> {
    /// The transitions between them.
    pub(crate) const fn transitions(&self) -> [Transition<S>; 5] {
        [
            (self.enter, Event::Arrived, self.close),
            (self.close, Event::Gripped, self.gripped),
            (self.close, Event::Lost, self.open),
            (self.open, Event::Arrived, self.retreat),
            (self.retreat, Event::Arrived, self.again),
        ]
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
    /// The jaw has closed on nothing or at the wrong place, the thing has slipped out, or is not
    /// where it should be.
    Lost,
    /// The thing does not move on.
    Stuck,
    /// The other hand presents the needle.
    Offered,
    /// The other hand holds the needle too.
    Taken,
    /// The other hand has let go and is gone.
    Given,
    /// No hand holds the needle, and the other hand waits.
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
    /// The measured control point.
    pub(crate) tip: Pose,
    /// The measured angle between the fingers, rad.
    pub(crate) jaw: f64,
    /// Whether both fingers press on the thing, or the jaw holds the flap.
    pub(crate) both_touch: bool,
}

/// What a hand looks at: at its arm among other things.
pub(crate) trait Looks {
    /// Its own arm.
    fn arm(&self) -> &ArmView;
}

/// A hand that plays a part, with its habits, what it is doing, and how that went so far.
#[derive(Clone, Debug)]
pub(crate) struct Hand<P: Part> {
    /// What the part knows of its task.
    pub(crate) part: P,
    /// Draws the habits of each attempt.
    rng: Rng,
    /// Drawn anew with each attempt.
    pub(crate) style: P::Habits,
    pub(crate) phase: P::Stage,
    /// Of the present phase; none before the first step.
    motion: Option<Motion>,
    attempts: u32,
    /// Steps in a row without touch by both fingers, from 0 in each phase.
    untouched_steps: u32,
    /// Of an operator.
    careful: Option<Careful>,
}

/// What one hand does in the script of a task.
pub(crate) trait Part: Clone + Debug + Send + Sized + 'static {
    /// Its habits.
    type Habits: Habits;
    /// Its phases.
    type Stage: Stage;
    /// What it looks at.
    type View: Looks;

    /// Whether the thing is meant to be in the jaw.
    fn carries(hand: &Hand<Self>) -> bool;

    /// What the present phase amounts to.
    fn activity(hand: &Hand<Self>) -> Activity;

    /// Whether going on to `next` is another attempt. Then habits are drawn anew and the attempt is
    /// counted.
    fn tries_again(hand: &Hand<Self>, next: Self::Stage) -> bool;

    /// The motion of the present phase. `from` is where the last motion has come to, or the
    /// measured tip of a new episode or after a disturbance.
    fn begin(hand: &mut Hand<Self>, now: TimeNs, from: Placement, view: &Self::View) -> Motion;

    /// The goal of a phase that follows something. The motion's end drifts towards it by at most
    /// 0.8 mm and 0.04 rad a step; none leaves the end as it is.
    fn moving_goal(hand: &Hand<Self>, view: &Self::View) -> Option<Pose>;

    /// What has happened at this step, if anything.
    fn event(hand: &Hand<Self>, now: TimeNs, motion: &Motion, view: &Self::View) -> Option<Event>;
}

impl<P: Part> Hand<P> {
    /// A hand at the start of an episode.
    pub(crate) fn new(part: P, mut rng: Rng) -> Self {
        let style = P::Habits::draw(&mut rng);
        Self {
            part,
            rng,
            style,
            phase: P::Stage::FIRST,
            motion: None,
            attempts: 1,
            untouched_steps: 0,
            careful: None,
        }
    }

    /// From now on it waits at the end of each motion as `care` says.
    pub(crate) fn take_care(&mut self, care: SettleCriteria, rng: Rng) {
        self.careful = Some(Careful::new(care, rng));
    }

    /// Attempts begun so far, the present one included.
    pub(crate) const fn attempts(&self) -> u32 {
        self.attempts
    }

    /// Whether, in this phase, not both fingers touched the thing in the last `steps` steps.
    pub(crate) const fn has_lost(&self, steps: u32) -> bool {
        self.untouched_steps >= steps
    }

    /// As [`Part::carries`].
    pub(crate) fn carries(&self) -> bool {
        P::carries(self)
    }

    /// As [`Part::activity`].
    pub(crate) fn activity(&self) -> Activity {
        P::activity(self)
    }

    /// Where the tip should be at `now`; to be asked every step.
    pub(crate) fn play(&mut self, now: TimeNs, view: &P::View) -> Placement {
        let own = view.arm();
        let start = Placement {
            tip_in_scene: own.tip,
            jaw: own.jaw,
        };
        let mut motion = match self.motion {
            Some(motion) => motion,
            None => self.begin(now, start, view),
        };
        if let Some(goal) = P::moving_goal(self, view) {
            motion.drift_end(&goal, FOLLOW_STEP_M, FOLLOW_STEP_RAD);
        }
        self.untouched_steps = if own.both_touch {
            0
        } else {
            self.untouched_steps + 1
        };
        if let Some(careful) = &mut self.careful {
            careful.wait(&mut motion, now, &own.tip);
        }
        if let Some(event) = P::event(self, now, &motion, view) {
            let next = self.phase.next(event);
            if next != self.phase {
                let mut from = motion.at(now);
                if P::tries_again(self, next) && is_off(&from, &own.tip) {
                    from.tip_in_scene = own.tip;
                }
                self.enter(next);
                motion = self.begin(now, from, view);
            }
        }
        self.motion = Some(motion);
        motion.at(now)
    }

    /// The motion of the present phase.
    fn begin(&mut self, now: TimeNs, from: Placement, view: &P::View) -> Motion {
        let mut motion = P::begin(self, now, from, view);
        if let Some(careful) = &mut self.careful {
            careful.begin(&mut motion);
        }
        motion
    }

    /// Book-keeping on entering a phase.
    fn enter(&mut self, next: P::Stage) {
        if P::tries_again(self, next) {
            // A person does not repeat a failed attempt exactly.
            self.style = P::Habits::draw(&mut self.rng);
            self.attempts += 1;
        }
        self.phase = next;
        self.untouched_steps = 0;
    }
}

/// Whether the hand at `tip` was kept from where it was meant to be.
fn is_off(meant: &Placement, tip: &Pose) -> bool {
    let gap = meant.tip_in_scene.translation.vector - tip.translation.vector;
    gap.norm() > OFF_M
}

/// Checks a state machine: no event leads two ways, none stays where it is, and each stage is
/// reached and has a way on, but for `last`.
#[cfg(test)]
pub(crate) fn check_transitions<S: Stage>(last: Option<S>) {
    let transitions = [S::GRASP.as_slice(), S::TRANSITIONS].concat();
    let mut reached = vec![S::FIRST];
    // In whatever order they are listed.
    for _ in &transitions {
        for &(from, _, to) in &transitions {
            if reached.contains(&from) && !reached.contains(&to) {
                reached.push(to);
            }
        }
    }
    for (index, &(from, event, to)) in transitions.iter().enumerate() {
        assert_ne!(from, to, "{from:?} upon {event:?}");
        let others = transitions[index + 1..].iter();
        let mut others = others.map(|&(from, event, _)| (from, event));
        assert!(
            others.all(|other| other != (from, event)),
            "{from:?} upon {event:?} leads two ways"
        );
        assert_eq!(from.next(event), to);
        assert!(reached.contains(&from), "{from:?} is never reached");
    }
    for stage in reached {
        let goes_on = transitions.iter().any(|&(from, ..)| from == stage);
        assert_eq!(goes_on, Some(stage) != last, "{stage:?}");
    }
}
