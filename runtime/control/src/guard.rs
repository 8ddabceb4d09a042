//! The guard: a command leaves only if the stop after it is verified. Hot path: bounded, no
//! allocation, no I/O, no lock.
//!
//! It depends neither on the filter, whose rows it does not share, nor on the smoother, and it is
//! right by induction. For each arm it holds a jerk-limited stop and how much of it has been
//! played; the arm is commanded to be there. At every moment
//!
//! 1. along what is left of each held stop every joint range, velocity, acceleration, clearance and
//!    tip speed is kept, with bounds for what lies between the samples (`bounds`, `way`);
//! 2. of two arms, no point of what is left of the one's stop is nearer to any point of what is
//!    left of the other's than they may be, at whatever times they are there (`pair`).
//!
//! *Base.* [`Guard::new`] and [`Guard::seed`] hold an arm where it rests. Its stop is one point,
//! and floors and ranges are set to what that point keeps (`floor`); a pair's floors are moved with
//! what the arm takes from or gives to what is left of the other arm's stop, so that an arm may be
//! seeded while the other moves.
//!
//! *Step.* In [`Guard::next`] each arm does one of two things.
//! * It plays its held stop by one tick. What is left is a part of what was left, so 1 and 2 stay
//!   true, whatever the other arm plays.
//! * It takes a candidate, which must follow from the current state within the jerk limit. The stop
//!   from the candidate has been verified against 1, and against 2 with what the other arm will
//!   hold after this tick: the stop of its own candidate if both are taken together, otherwise what
//!   is left of its held stop.
//!
//! *Floors.* A boundary that an arm was enabled beyond moves to where it is, and comes back behind
//! it. A floor is only ever raised to less than what the stop that is held from then on keeps, so
//! raising it breaks neither 1 nor 2.
//!
//! *Deviation.* The measured arm is not where the commanded one is. A candidate's stop keeps the
//! margin and how far each link is off, or was within about the longest stop (`Guard::observe`);
//! where the stops before it kept less, because the deviation grew, it comes no nearer than they
//! did. Only candidates must keep it: a held stop is played to its end however the deviation grows,
//! so neither 1 nor 2 depends on it.
//!
//! So either arm may stop at any tick, alone or with the other, be late in playing its stop, or be
//! stopped by an operator: nothing has to be checked for it any more. Candidates never need each
//! other: if both together are refused, each is tried alone, first the one and then in the next
//! tick the other, so that neither arm starves.
//!
//! Between two ticks a drive goes straight from one setpoint to the next; both are verified, and
//! what lies between is a tick's way from either at most, which the margin must hold.

mod arm;
mod bounds;
mod clearance;
mod floor;
mod gaps;
mod measured;
mod pair;
#[cfg(test)]
pub(crate) mod planted;
mod sample;
mod sweep;
mod way;

use super::config::{ControlConfig, FORBIDDEN_MAX};
use super::deviation::Deviation;
use super::instrument::Instrument;
use super::motion::MotionState;
use super::snapshot::{Reader, Snapshot, SnapshotError, Stateful, layout, possible};
use super::stop::Stop;
use arm::ArmGuard;
use gaps::{Gaps, KINDS};
use hal::ARMS_MAX;
use measured::gap_allowances;
pub use measured::{MeasuredClearance, beyond};
use pair::Pair;
#[cfg(test)]
use planted::PlantedGuardFault;

/// The guard of one arm or two, with the stops that it holds.
#[derive(Clone, Debug)]
pub struct Guard<const ARMS: usize> {
    arms: [ArmGuard; ARMS],
    pair: Option<Pair>,
    /// Whether the second arm is the first to be tried alone.
    second_first: bool,
}

/// What an arm is to do in a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// Go on to this state; `None` if there is no answer, which counts as an intervention.
    Follow(Option<MotionState>),
    /// Play the stop that is held.
    Stop,
}

/// What an arm does in a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// The state to command.
    pub state: MotionState,
    /// Whether that differs from the request.
    pub intervened: bool,
}

/// Why there is no guard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GuardError {
    /// More arms than the guard can look after, or none.
    #[error("the guard looks after one arm or two, not {0}")]
    Arms(usize),
    /// An arm without workspace and regions.
    #[error("the configuration holds {configured} of {wanted} arms")]
    Missing {
        /// Arms in the configuration.
        configured: usize,
        /// Arms to be guarded.
        wanted: usize,
    },
    /// More regions than are looked at.
    #[error("an arm has {0} forbidden regions, more than {FORBIDDEN_MAX}")]
    Regions(usize),
    /// Two arms that may meet anywhere.
    #[error("the configuration does not say what two arms keep between them")]
    BetweenArms,
}

impl<const ARMS: usize> Stateful for Guard<ARMS> {
    const LAYOUT: u64 = layout(
        "Guard second_first arms pair",
        &[
            ARMS as u64,
            <ArmGuard as Stateful>::LAYOUT,
            <Pair as Stateful>::LAYOUT,
        ],
    );
    const WORDS_MAX: usize =
        1 + ARMS * <ArmGuard as Stateful>::WORDS_MAX + <Pair as Stateful>::WORDS_MAX;

    fn save(&self, to: &mut Snapshot) {
        let Self {
            arms,
            pair,
            second_first,
        } = self;
        second_first.save(to);
        for arm in arms {
            arm.save(to);
        }
        if let Some(pair) = pair {
            pair.save(to);
        }
    }

    fn restore(&mut self, from: &mut Reader<'_>) -> Result<(), SnapshotError> {
        let Self {
            arms,
            pair,
            second_first,
        } = self;
        second_first.restore(from)?;
        for arm in arms {
            arm.restore(from)?;
        }
        if let Some(pair) = pair {
            pair.restore(from)?;
            possible(pair.nearest.is_of(KINDS.len()))?;
        }
        Ok(())
    }
}

impl<const ARMS: usize> Guard<ARMS> {
    /// A guard that holds the first `ARMS` arms of `config` at `states`, at rest. Further arms are
    /// left out.
    ///
    /// # Errors
    /// [`GuardError`] if the configuration has fewer arms, too many regions, or two arms and
    /// nothing between them, or if `ARMS` is not 1 or 2.
    pub fn new(
        config: &ControlConfig,
        states: &[MotionState; ARMS],
        tick_s: f64,
    ) -> Result<Self, GuardError> {
        if !(1..=ARMS_MAX).contains(&ARMS) {
            return Err(GuardError::Arms(ARMS));
        }
        let arms = config
            .arms
            .first_chunk::<ARMS>()
            .ok_or(GuardError::Missing {
                configured: config.arms.len(),
                wanted: ARMS,
            })?;
        for arm in arms {
            let count = arm.forbidden.len();
            if count > FORBIDDEN_MAX {
                return Err(GuardError::Regions(count));
            }
        }
        let pair = match (&config.between_arms, ARMS) {
            (_, 1) => None,
            (Some(between), _) => Some(Pair::new(between, &config.margins)),
            (None, _) => return Err(GuardError::BetweenArms),
        };
        let arms = core::array::from_fn(|arm| {
            ArmGuard::new(config, &arms[arm], &states[arm], tick_s, pair.is_some())
        });
        let mut guard = Self {
            arms,
            pair,
            second_first: false,
        };
        guard.seed_pair();
        Ok(guard)
    }

    /// Starts anew for one arm from where `state` is, at rest.
    ///
    /// An arm that is within a boundary stays within it, even if it starts without the margin.
    /// Where the arm is beyond a boundary already, that boundary moves behind the arm by the margin
    /// for recovery. Either comes back with the arm. What two arms keep between them moves by as
    /// much as the arm was moved, and so a seed gives the other arm no way.
    ///
    /// # Panics
    /// If there is no such arm.
    pub fn seed(&mut self, arm: usize, state: &MotionState) {
        let before = self.gaps();
        self.arms[arm].seed(state);
        if let (Some(pair), Some(before), [first, second]) =
            (&mut self.pair, before, self.arms.as_slice())
        {
            pair.put(&before, &first.held_rest(), &second.held_rest());
        }
    }

    /// Stores the deviation of each measured arm from the commanded one, and the pose of those that
    /// hold torque.
    ///
    /// Until the next call a candidate's stop keeps that much more than the margin from each
    /// boundary and from the other arm, or as much of it as the stops before it kept.
    pub fn observe(&mut self, arms: &[(Deviation, Option<Instrument>); ARMS]) {
        for (arm, (deviation, measured)) in self.arms.iter_mut().zip(arms) {
            arm.observe(deviation, measured.as_ref());
        }
        let (Some(pair), [first, second]) = (&mut self.pair, self.arms.as_slice()) else {
            return;
        };
        if let [(_, Some(its)), (_, Some(others))] = arms.as_slice()
            && let (Some(its), Some(others)) = (first.in_scene(its), second.in_scene(others))
        {
            pair.observe(&its, &others);
        }
    }

    /// The deviations that [`Self::observe`] was given last.
    #[must_use]
    pub fn deviations(&self) -> [Deviation; ARMS] {
        self.arms.each_ref().map(|arm| arm.deviation)
    }

    /// How near each measured arm came to its boundaries, and both to one another, while they held
    /// torque. Allocates.
    #[must_use]
    pub fn measured(&self, config: &ControlConfig) -> Vec<MeasuredClearance> {
        let arms = self.arms.iter().enumerate();
        let arms = arms.flat_map(|(index, arm)| arm.nearest.named(config, index));
        let pair = self.pair.iter();
        arms.chain(pair.filter_map(|pair| pair.nearest.between(config)))
            .collect()
    }

    /// What the stops of two arms leave of the gaps between them.
    fn gaps(&self) -> Option<Gaps> {
        match (&self.pair, self.arms.as_slice()) {
            (Some(pair), [first, second]) => {
                Some(pair.gaps(&first.held_rest(), &second.held_rest()))
            }
            _ => None,
        }
    }

    fn seed_pair(&mut self) {
        if let (Some(pair), [first, second]) = (&mut self.pair, self.arms.as_slice()) {
            pair.seed(&first.held_rest(), &second.held_rest());
        }
    }

    /// The stop that is held for each arm, and how much of it has been played, s.
    #[must_use]
    pub fn held(&self) -> [(&Stop, f64); ARMS] {
        self.arms.each_ref().map(ArmGuard::held)
    }

    /// The next states: for each arm the one that it asks for, if it follows from its `current` one
    /// within the limits and its stop is verified, otherwise the next one of the stop that is held.
    ///
    /// `current` is what the last call decided or, after that, [`Self::seed`] was given.
    pub fn next(
        &mut self,
        current: &[MotionState; ARMS],
        requests: &[Request; ARMS],
    ) -> [Decision; ARMS] {
        #[cfg(test)]
        if let Some(skipped) = self.skipped(requests) {
            return skipped;
        }
        let verified = core::array::from_fn(|arm| match &requests[arm] {
            Request::Follow(Some(candidate)) => self.arms[arm].verify(&current[arm], candidate),
            Request::Follow(None) | Request::Stop => false,
        });
        let taken = self.take(verified);
        core::array::from_fn(|arm| {
            let guard = &mut self.arms[arm];
            match (&requests[arm], taken[arm]) {
                (Request::Follow(Some(candidate)), true) => {
                    guard.commit();
                    Decision {
                        state: *candidate,
                        intervened: false,
                    }
                }
                (request, _) => Decision {
                    state: guard.play(),
                    intervened: matches!(request, Request::Follow(_)),
                },
            }
        })
    }

    /// Which of the candidates whose own stops are verified may be taken together with what the
    /// other arm does then.
    fn take(&mut self, verified: [bool; ARMS]) -> [bool; ARMS] {
        let (Some(pair), [first, second]) = (&mut self.pair, self.arms.as_slice()) else {
            return verified;
        };
        let one = |wanted: usize| core::array::from_fn(|arm| arm == wanted && verified[arm]);
        let (lead, other) = if self.second_first { (1, 0) } else { (0, 1) };
        self.second_first = !self.second_first;
        let allowances = gap_allowances(&first.deviation, &second.deviation);
        let mut tried = [false; ARMS];
        for attempt in [verified, one(lead), one(other)] {
            if attempt == [false; ARMS] || attempt == tried {
                continue;
            }
            tried = attempt;
            #[cfg(test)]
            if pair.planted == Some(PlantedGuardFault::HeldStopsForgotten)
                && attempt.contains(&false)
            {
                return attempt;
            }
            let rests = [(first, attempt.first()), (second, attempt.last())].map(|(arm, takes)| {
                if takes == Some(&true) {
                    arm.fresh_rest()
                } else {
                    arm.held_rest()
                }
            });
            if let Some(gaps) = pair.verify(&rests[0], &rests[1], &allowances) {
                pair.tighten(&gaps, &allowances);
                return attempt;
            }
        }
        [false; ARMS]
    }

    /// The output of a guard that is skipped.
    #[cfg(test)]
    fn skipped(&mut self, requests: &[Request; ARMS]) -> Option<[Decision; ARMS]> {
        let skip = |arm: &ArmGuard| arm.planted == Some(PlantedGuardFault::GuardSkipped);
        self.arms.iter().all(skip).then(|| {
            core::array::from_fn(|arm| match &requests[arm] {
                Request::Follow(Some(candidate)) if candidate.is_finite() => {
                    self.arms[arm].skip(candidate);
                    Decision {
                        state: *candidate,
                        intervened: false,
                    }
                }
                Request::Follow(_) => Decision {
                    state: self.arms[arm].play(),
                    intervened: true,
                },
                Request::Stop => Decision {
                    state: self.arms[arm].play(),
                    intervened: false,
                },
            })
        })
    }

    /// Plants a fault.
    #[cfg(test)]
    pub(crate) fn plant(&mut self, fault: PlantedGuardFault) {
        for arm in &mut self.arms {
            arm.planted = Some(fault);
        }
        if let Some(pair) = &mut self.pair {
            pair.planted = Some(fault);
        }
    }
}

#[cfg(test)]
mod tests;
