//! One adversary an arm, trouble besides, a filter that lies now and then, and a judge who knows
//! nothing of any of them.

use super::figures::Figures;
use super::judge::Oracle;
use super::kinds::{Kind, View, below};
use super::rig::{Rig, Scene};
use super::trouble::Trouble;
use crate::sabotage::Garbage;
use crate::{QpOutcome, TickOutput, second_opinion};
use hal::random::SplitMix64;

/// Every so many commands the tail is followed to rest, more seldom in a long attack; primes, so
/// that they meet every phase of what is periodic.
const TAIL_EVERY: u64 = 37;
const TAIL_EVERY_LONG: u64 = 997;

/// From so many ticks on an attack is long.
const LONG: u64 = 1_000_000;

/// An attack.
#[derive(Clone, Copy, Debug)]
pub(super) struct Attack {
    pub(super) kind: Kind,
    pub(super) seed: u64,
    pub(super) ticks: u64,
    /// Whether the gate lets every finite chunk through.
    pub(super) open_gate: bool,
    /// Share of the filter's answers that are replaced.
    pub(super) garbage: f64,
    /// Whether each candidate goes out as it is.
    pub(super) guard_removed: bool,
    /// Whether operator and measurements make trouble.
    pub(super) trouble: bool,
    /// The share of the way to its setpoint that each arm goes in a tick.
    pub(super) follows: f64,
    /// How far each arm's yaw is off, rad.
    pub(super) off_rad: f64,
    /// Whether yaw and pitch are as quick as the margins allow; of one arm.
    pub(super) quick: bool,
    /// Whether the guard takes no note of how far the arms lag behind.
    pub(super) lag_ignored: bool,
    /// Whether Clarabel solves each of the filter's problems again.
    pub(super) second_opinion: bool,
}

impl Attack {
    /// The attack of `kind` with the gate open.
    pub(super) fn new(kind: Kind, seed: u64) -> Self {
        Self {
            kind,
            seed,
            ticks: ticks(),
            open_gate: true,
            garbage: 0.05,
            guard_removed: false,
            trouble: true,
            follows: 1.0,
            off_rad: 0.0,
            quick: false,
            lag_ignored: false,
            second_opinion: false,
        }
    }

    /// Plays it on one arm or two; gives the figures and the violations that the judge found.
    pub(super) fn play<const ARMS: usize>(&self) -> (Figures, Vec<String>) {
        let mut scene = if self.quick {
            Scene::quick()
        } else {
            Scene::of_arms(ARMS)
        };
        if self.open_gate {
            scene = scene.open_gate();
        }
        let mut random = SplitMix64::new(self.seed);
        let mut rig = Rig::<ARMS>::enabled(&scene.config);
        self.sabotage(&mut rig, &mut random);
        let mut judge = Oracle::new(&scene);
        let mut figures = Figures::default();
        let mut adversaries: [_; ARMS] = core::array::from_fn(|_| self.kind.adversary());
        let mut troubles: [Trouble; ARMS] = core::array::from_fn(|_| Trouble::default());
        let tail_every = if self.ticks < LONG {
            TAIL_EVERY
        } else {
            TAIL_EVERY_LONG
        };
        let first_tail = below(&mut random, 37) as u64;
        for tick in 0..self.ticks {
            for (arm, adversary) in adversaries.iter_mut().enumerate() {
                let view = View {
                    now: rig.now(),
                    arm,
                    arms: &rig.arms,
                    config: &scene.config,
                };
                if let Some(chunk) = adversary.next(&mut random, &view) {
                    rig.chunks[arm] = Some(Box::new(chunk));
                }
            }
            if self.trouble && random.happens(3e-4) {
                let periods = [1, 2, 7, 60, 400][below(&mut random, 5)];
                rig.miss(periods);
                figures.missed += periods;
            }
            let mut measured = rig.arms.map(Ok);
            let mut operator = [None; ARMS];
            if self.trouble {
                for (arm, trouble) in troubles.iter_mut().enumerate() {
                    measured[arm] = trouble.measured(&mut random, &rig.arms[arm], rig.powered[arm]);
                    let state = rig.controller.arms[arm].mode().state;
                    operator[arm] = trouble.operator(&mut random, state);
                }
            }
            let outputs = rig.step(measured, operator);
            judge.look(&measured, &outputs);
            figures.count(&outputs);
            let solved = |output: &TickOutput| matches!(output.report.qp, QpOutcome::Solved { .. });
            if self.second_opinion && outputs.iter().any(solved) {
                let controller = &rig.controller;
                let found = second_opinion::compare(controller.problem(), controller.solution());
                figures.opinions.add(found);
            }
            if !self.guard_removed && (tick + first_tail).is_multiple_of(tail_every) {
                judge.follow_tails(&outputs);
            }
        }
        self.sum_up(&mut figures, &rig, &judge);
        (figures, judge.violations(self.trouble))
    }

    /// Breaks what is to be broken.
    fn sabotage<const ARMS: usize>(&self, rig: &mut Rig<ARMS>, random: &mut SplitMix64) {
        rig.controller.sabotage.garbage = Some(Garbage::new(random.next_u64(), self.garbage));
        rig.controller.sabotage.guard_removed = self.guard_removed;
        rig.controller.sabotage.lag_ignored = self.lag_ignored;
        rig.follows = self.follows;
        rig.off_rad = self.off_rad;
    }

    /// Takes into `figures` what is known at the end.
    fn sum_up<const ARMS: usize>(&self, figures: &mut Figures, rig: &Rig<ARMS>, judge: &Oracle) {
        for arm in &rig.controller.arms {
            figures.accepted += arm.gate.accepted_count();
            figures.refused += arm.gate.refused_count();
        }
        figures.tails = judge.tails;
        figures.nearest = Some(judge.nearest());
        figures.measured_mm = 1e3 * judge.measured_m();
        let said = rig.controller.measured_clearances();
        let said_m = said
            .iter()
            .fold(f64::INFINITY, |least, found| least.min(found.clearance_m));
        assert!(
            (1e3 * said_m - figures.measured_mm).abs() < 1e-3 || self.trouble,
            "{said:?}"
        );
        let garbage = rig.controller.sabotage.garbage.as_ref();
        figures.garbage = garbage.map_or(0, |garbage| garbage.count);
    }
}

/// How long an attack lasts: `TROCAR_ADVERSARY_TICKS`, or 20 000 ticks; `make adversary` has ten
/// million.
pub(super) fn ticks() -> u64 {
    std::env::var("TROCAR_ADVERSARY_TICKS").map_or(20_000, |text| text.parse().unwrap())
}
