//! The guard alone, driven by whatever a test wants, with `verify` as the judge.

use hal::tail::{AxisPoint, AxisTail, SafeTail, TailPhase};
use hal::{ArmState, TimeNs};

use super::super::adversary::eyes::Boundary;
use super::super::adversary::rig::{Scene, obedient, resting};
use crate::control::guard::planted::PlantedGuardFault;
use crate::control::guard::{Guard, Request};
use crate::control::motion::{AXES, Axes, AxisLimits, MotionState};
use crate::control::smoother::Smoother;
use crate::verify::{Stream, Violation};

const TICK_S: f64 = 1e-3;

/// How much more than the limits the smoother makes of velocities and accelerations when it is told to.
const TOO_MUCH: f64 = 1.3;

/// Every so many ticks the stops are followed to rest, and compared at all their times.
const STOPS_EVERY: u64 = 20;

/// A guard with a fault or without, its arms, and the judge.
pub(super) struct Bench<'a, const ARMS: usize> {
    scene: &'a Scene,
    guard: Guard<ARMS>,
    smoothers: [Smoother; ARMS],
    pub(super) states: [MotionState; ARMS],
    measured: [ArmState; ARMS],
    stream: Stream,
    tick: u64,
    /// Ticks of an arm in which the guard did not do what it was asked for.
    pub(super) refused: u64,
    /// Places of two stops, at different times of each, that are too near to one another.
    crossed: bool,
}

impl<'a, const ARMS: usize> Bench<'a, ARMS> {
    /// Arms at rest at `positions`.
    pub(super) fn new(
        scene: &'a Scene,
        positions: &[Axes],
        fault: Option<PlantedGuardFault>,
        too_much: bool,
    ) -> Self {
        let states: [MotionState; ARMS] = core::array::from_fn(|arm| MotionState {
            position: positions[arm],
            ..MotionState::ZERO
        });
        let mut guard = Guard::new(&scene.config, &states, TICK_S).unwrap();
        if let Some(fault) = fault {
            guard.plant(fault);
        }
        let share = if too_much { TOO_MUCH } else { 1.0 };
        let limits = scene.config.axes.map(|axis| AxisLimits {
            velocity: axis.velocity * share,
            acceleration: axis.acceleration * share,
            ..axis
        });
        let stream = Stream::new(scene.control.text(), scene.safety.text()).unwrap();
        let mut bench = Self {
            scene,
            guard,
            smoothers: core::array::from_fn(|_| Smoother::new(&limits, TICK_S)),
            states,
            measured: states.map(|state| resting(TimeNs(0), &state.position)),
            stream,
            tick: 0,
            refused: 0,
            crossed: false,
        };
        bench.judge();
        bench
    }

    /// Where the arms are.
    pub(super) fn positions(&self) -> [Axes; ARMS] {
        self.states.map(|state| state.position)
    }

    /// What the smoother makes of `velocity` for `arm`.
    pub(super) fn candidate(&mut self, arm: usize, velocity: &Axes) -> Option<MotionState> {
        let state = self.states[arm];
        self.smoothers[arm].step(&state, velocity)
    }

    /// One tick of the guard.
    pub(super) fn step(&mut self, requests: &[Request; ARMS]) {
        let decisions = self.guard.next(&self.states, requests);
        for (state, decision) in self.states.iter_mut().zip(&decisions) {
            *state = decision.state;
            self.refused += u64::from(decision.intervened);
        }
        self.judge();
    }

    /// What was broken first, if anything was.
    pub(super) fn violation(&self) -> Option<String> {
        if self.crossed {
            return Some("two stops come too near at different times of each".to_owned());
        }
        let mut violations = self.stream.violations().iter();
        violations.find(|violation| is_clear(violation)).map(ToString::to_string)
    }

    fn judge(&mut self) {
        let now = TimeNs::from_tick(self.tick);
        let commands = self.states.map(|state| state.command(now, true));
        let measured = self.measured.map(Ok);
        let arms: Vec<_> = commands.iter().zip(&measured).collect();
        self.stream.tick(self.tick, &arms);
        if self.tick % STOPS_EVERY == 0 {
            let tails: [SafeTail; ARMS] = core::array::from_fn(|arm| self.tail(arm, now));
            let tails: Vec<&SafeTail> = tails.iter().collect();
            self.stream.tails(&tails);
            self.cross();
        }
        self.tick += 1;
        self.measured = commands.map(|command| obedient(&command, TimeNs::from_tick(self.tick)));
    }

    fn tail(&self, arm: usize, stamp: TimeNs) -> SafeTail {
        let (stop, played_s) = self.guard.held(arm).unwrap();
        let axes = stop.axes().each_ref().map(|axis| {
            let rest = axis.remainder(played_s);
            AxisTail {
                start: AxisPoint {
                    position: rest.position,
                    velocity: rest.velocity,
                    acceleration: rest.acceleration,
                },
                phases: rest.phases.map(|phase| TailPhase {
                    duration_s: phase.duration_s,
                    jerk: phase.jerk,
                }),
            }
        });
        SafeTail {
            stamp,
            axes,
            enabled: true,
        }
    }

    /// Compares the places of two stops at all their times: either arm may be late.
    fn cross(&mut self) {
        const TIMES: u32 = 6;
        if ARMS < 2 {
            return;
        }
        let places: [Vec<Axes>; ARMS] = core::array::from_fn(|arm| {
            let (stop, played_s) = self.guard.held(arm).unwrap();
            let left_s = (stop.duration_s() - played_s).max(0.0);
            (0..=TIMES)
                .map(|time| stop.at(played_s + left_s * f64::from(time) / f64::from(TIMES)).position)
                .collect()
        });
        let config = &self.scene.config;
        let between = [Boundary::Shafts, Boundary::ToShaft { arm: 0, link: 1 }]
            .into_iter()
            .chain([2, 3].map(|link| Boundary::ToShaft { arm: 0, link }))
            .chain([1, 2, 3].map(|link| Boundary::ToShaft { arm: 1, link }));
        let between: Vec<Boundary> = between.collect();
        self.crossed |= places[0].iter().any(|one| {
            places[1].iter().any(|other| {
                let positions: [Axes; 2] = [*one, *other];
                between
                    .iter()
                    .any(|boundary| boundary.clearance(config, &positions) < -1e-6)
            })
        });
    }
}

/// Accelerations and jerks are clearly beyond their bounds, by more than what a smoother that is told too much does to them
/// within a tick.
fn is_clear(violation: &Violation) -> bool {
    let derivative = violation.limit.ends_with("acceleration") || violation.limit.ends_with("jerk");
    !derivative || violation.value.abs() > 1.01 * violation.bound.abs()
}

/// Half of an array of both arms' velocities.
pub(super) fn of_arm(velocity: &[f64; 2 * AXES], arm: usize) -> Axes {
    core::array::from_fn(|axis| velocity[AXES * arm + axis])
}
