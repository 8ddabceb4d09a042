//! Checks the stop that travels with a command, by playing it.
//!
//! A tail is three phases of constant jerk an axis, as `hal::SafeTail` has them. It is played in
//! steps of a millisecond, which end early where a phase ends. Derivatives are checked after each
//! step and where the speed peaks, places and the tip's speeds once a millisecond. A stop of 0.4 s
//! is 400 steps. A log holds no tails, so they are checked only where the controller runs.

use hal::SafeTail;
use hal::tail::{AxisTail, TailPhase};

use super::arm::{Arm, Newest, positions, velocities};
use super::axis::{DERIVATIVES, PERIOD_S, REST, SHARE};
use super::boundary::Moment;
use super::differences::AXES;
use super::ledger::{Ledger, LimitId};
use super::limits::{AxisLimits, Limits};
use super::pair::Pair;
use super::tip::Tip;

/// What a tail may differ by from its command, and at the end from rest: rounding.
const SAME: f64 = REST;

/// The checks of tails.
#[derive(Clone, Debug)]
pub(super) struct Tails {
    /// For each arm its axes.
    ///
    /// Joint order, then the jaw.
    axes: Vec<Vec<TailAxis>>,
    stamps: Vec<LimitId>,
    enabled: Vec<LimitId>,
    /// An arm has a command and no tail, or a tail and no command.
    missing: LimitId,
}

/// The limits of one axis's tail.
///
/// Opened once for each axis, under names such as `tail.yaw.jerk`, `tail.yaw.start_velocity`,
/// `tail.yaw.rest_velocity` and `tail.yaw.duration`.
#[derive(Clone, Debug)]
struct TailAxis {
    bounds: [f64; 3],
    /// No stop within the limits takes longer, s.
    duration_s_max: f64,
    derivatives: [LimitId; 3],
    /// Position, velocity and acceleration of the command.
    start: [LimitId; 3],
    /// Velocity and acceleration at the end.
    rest: [LimitId; 2],
    duration: LimitId,
}

impl TailAxis {
    fn new(ledger: &mut Ledger, arm: &str, limits: &AxisLimits) -> Self {
        let name = |what: &str| format!("tail.{}.{what}", limits.name);
        let [velocity, acceleration, jerk] = limits.derivatives;
        Self {
            bounds: limits.derivatives,
            // At worst the acceleration speeds the axis up and goes first; then the brake comes,
            // holds and goes.
            duration_s_max: velocity / acceleration + 3.0 * acceleration / jerk,
            derivatives: DERIVATIVES.map(|what| ledger.open(arm, name(what))),
            start: ["position", "velocity", "acceleration"]
                .map(|what| ledger.open(arm, name(&format!("start_{what}")))),
            rest: ["velocity", "acceleration"]
                .map(|what| ledger.open(arm, name(&format!("rest_{what}")))),
            duration: ledger.open(arm, name("duration")),
        }
    }

    /// `order` 0 is the velocity, 1 the acceleration, 2 the jerk.
    fn derivative(&self, ledger: &mut Ledger, order: usize, value: f64) {
        let bound = self.bounds[order];
        let excess = value.abs() - bound;
        ledger.judge(self.derivatives[order], excess, SHARE * bound, value, bound);
    }
}

/// One axis that plays its tail.
///
/// Phases are used up as it plays: their durations are what is left.
#[derive(Clone, Copy, Debug)]
struct Player {
    /// Position, velocity and acceleration.
    state: [f64; 3],
    phases: [TailPhase; 3],
    /// The end was checked, and what follows is rest.
    rests: bool,
}

/// An arm's place, its newest command, and its axes.
type Playing = (usize, Newest, [Player; AXES]);

impl Player {
    fn new(tail: &AxisTail) -> Self {
        let start = &tail.start;
        Self {
            state: [start.position, start.velocity, start.acceleration],
            phases: tail.phases,
            rests: false,
        }
    }

    /// How long the tail still lasts, s.
    fn left_s(&self) -> f64 {
        self.phases.iter().map(duration_s).sum()
    }

    /// Plays `time_s` further and checks the derivatives on the way.
    fn play(&mut self, ledger: &mut Ledger, axis: &TailAxis, time_s: f64) {
        let mut left_s = time_s;
        for phase in &mut self.phases {
            let step_s = duration_s(phase).min(left_s);
            if step_s > 0.0 {
                let [_, velocity, acceleration] = self.state;
                // The speed peaks where the acceleration changes its sign.
                let turn_s = -acceleration / phase.jerk;
                if turn_s > 0.0 && turn_s < step_s {
                    axis.derivative(ledger, 0, velocity + acceleration * turn_s / 2.0);
                }
                self.state = moved(&self.state, phase.jerk, step_s);
                phase.duration_s -= step_s;
                left_s -= step_s;
                axis.derivative(ledger, 0, self.state[1]);
                axis.derivative(ledger, 1, self.state[2]);
                axis.derivative(ledger, 2, phase.jerk);
            }
        }
        if left_s > 0.0 && !self.rests {
            self.rest(ledger, axis);
        }
    }

    /// Checks that the axis is at rest when its tail is over.
    fn rest(&mut self, ledger: &mut Ledger, axis: &TailAxis) {
        self.rests = true;
        let [_, velocity, acceleration] = &mut self.state;
        for (limit, value) in axis.rest.into_iter().zip([velocity, acceleration]) {
            ledger.judge(limit, value.abs(), SAME, *value, 0.0);
            *value = 0.0;
        }
    }
}

/// How long a phase lasts; below zero counts as zero, NaN stays.
fn duration_s(phase: &TailPhase) -> f64 {
    if phase.duration_s < 0.0 {
        0.0
    } else {
        phase.duration_s
    }
}

/// Constant jerk, integrated three times.
fn moved([position, velocity, acceleration]: &[f64; 3], jerk: f64, t: f64) -> [f64; 3] {
    [
        position + velocity * t + acceleration * t * t / 2.0 + jerk * t * t * t / 6.0,
        velocity + acceleration * t + jerk * t * t / 2.0,
        acceleration + jerk * t,
    ]
}

impl Tails {
    pub(super) fn new(ledger: &mut Ledger, limits: &Limits) -> Self {
        let mut tails = Self {
            axes: Vec::new(),
            stamps: Vec::new(),
            enabled: Vec::new(),
            missing: ledger.open("", "tail.missing".to_owned()),
        };
        for arm in &limits.arms {
            let axes = limits.axes.iter();
            let axes = axes.map(|axis| TailAxis::new(ledger, &arm.name, axis));
            tails.axes.push(axes.collect());
            tails
                .stamps
                .push(ledger.open(&arm.name, "tail.stamp".to_owned()));
            tails
                .enabled
                .push(ledger.open(&arm.name, "tail.enabled".to_owned()));
        }
        tails
    }

    /// Checks the tails of the newest commands, one for each arm in their order.
    pub(super) fn check(
        &self,
        ledger: &mut Ledger,
        arms: &mut [Arm],
        mut pair: Option<&mut Pair>,
        tails: &[&SafeTail],
    ) {
        let mut playing = self.begin_all(ledger, arms, tails);
        let players = playing.iter().flat_map(|(_, _, players)| players);
        let longest_s = players.map(Player::left_s).fold(0.0, f64::max);
        if playing.len() < arms.iter().filter(|arm| arm.newest.is_some()).count()
            || playing.len() < tails.len()
        {
            ledger.judge(self.missing, 1.0, 0.0, 1.0, 0.0);
        }
        let mut played_s = 0.0;
        // One step further than the end, where everything rests.
        while played_s <= longest_s + PERIOD_S {
            played_s += PERIOD_S;
            self.step_all(ledger, arms, pair.as_deref_mut(), &mut playing);
        }
    }

    /// Plays the tails of all arms for a period and checks where the arms are then, each and beside
    /// each other.
    fn step_all(
        &self,
        ledger: &mut Ledger,
        arms: &mut [Arm],
        pair: Option<&mut Pair>,
        playing: &mut [Playing],
    ) {
        for (index, newest, players) in &mut *playing {
            if let Some(arm) = arms.get_mut(*index) {
                self.step(ledger, *index, arm, newest, players);
            }
        }
        if let [(_, first, _), (_, second, _)] = playing
            && (first.powered || second.powered)
            && let Some(pair) = pair
        {
            pair.check(ledger, Moment::Tail, &[first.at, second.at]);
        }
    }

    /// The tails of all arms that have a command.
    fn begin_all(&self, ledger: &mut Ledger, arms: &[Arm], tails: &[&SafeTail]) -> Vec<Playing> {
        let mut playing = Vec::with_capacity(arms.len());
        for (index, (arm, tail)) in arms.iter().zip(tails).enumerate() {
            if let Some(newest) = arm.newest {
                let players = self.begin(ledger, index, &newest, tail);
                playing.push((index, newest, players));
            }
        }
        playing
    }

    /// Checks that a tail begins with its command, and winds it to there.
    fn begin(
        &self,
        ledger: &mut Ledger,
        index: usize,
        newest: &Newest,
        tail: &SafeTail,
    ) -> [Player; AXES] {
        let command = &newest.command;
        // A tail may have begun before its command, which is then a part of it.
        let late_ns = command.stamp.0.saturating_sub(tail.stamp.0);
        let early_ns = tail.stamp.0.saturating_sub(command.stamp.0);
        #[expect(clippy::cast_precision_loss, reason = "a stop is short")]
        let (late_s, early_s) = (late_ns as f64 * 1e-9, early_ns as f64 * 1e-9);
        ledger.judge(self.stamps[index], early_s, 0.0, early_s, 0.0);
        let same = command.enabled == tail.enabled;
        let difference = if same { 0.0 } else { 1.0 };
        ledger.judge(self.enabled[index], difference, 0.0, difference, 0.0);
        let expected = expected(newest);
        core::array::from_fn(|axis| {
            let limits = &self.axes[index][axis];
            let given = &tail.axes[axis];
            let total_s: f64 = given.phases.iter().map(duration_s).sum();
            let bound = if newest.powered {
                limits.duration_s_max
            } else {
                0.0
            };
            ledger.judge(limits.duration, total_s - bound, SAME, total_s, bound);
            let mut player = Player::new(given);
            // NaN and what is far too long are not played.
            let playable = total_s <= bound + SAME;
            if !playable {
                player.phases = [TailPhase::default(); 3];
            } else if late_s > 0.0 {
                player.play(ledger, limits, late_s);
            }
            for order in 0..3 {
                let (value, Some(expected)) = (player.state[order], expected[axis][order]) else {
                    continue;
                };
                let excess = (value - expected).abs();
                ledger.judge(limits.start[order], excess, SAME, value, expected);
            }
            player
        })
    }

    /// Plays one arm's tail for a period and checks where the arm is then.
    ///
    /// Of an arm without torque no place is checked: its tail must have no length.
    fn step(
        &self,
        ledger: &mut Ledger,
        index: usize,
        arm: &mut Arm,
        newest: &mut Newest,
        players: &mut [Player; AXES],
    ) {
        for (player, axis) in players.iter_mut().zip(&self.axes[index]) {
            player.play(ledger, axis, PERIOD_S);
        }
        if !newest.powered {
            return;
        }
        let before = Tip::place(&newest.at);
        let positions = players.each_ref().map(|player| player.state[0]);
        newest.at = arm.instrument(&positions);
        arm.places(ledger, Moment::Tail, &positions, &newest.at);
        let after = Tip::place(&newest.at);
        arm.tip
            .check(ledger, Moment::Tail, &before, &after, PERIOD_S);
    }
}

/// Position, velocity and acceleration of each axis as commanded; a command has no acceleration of
/// the jaw.
///
/// Joint order, then the jaw.
fn expected(newest: &Newest) -> [[Option<f64>; 3]; AXES] {
    let command = &newest.command;
    let (positions, velocities) = (positions(command), velocities(command));
    core::array::from_fn(|axis| {
        [
            Some(positions[axis]),
            Some(velocities[axis]),
            command.acceleration.get(axis).copied(),
        ]
    })
}
