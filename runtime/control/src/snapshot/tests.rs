//! A controller that goes on from another one's snapshot does what that one does, to the bit.

use hal::config::Source;
use hal::random::SplitMix64;
use hal::{ArmError, ArmState, Chunk, JointVector, TICK_NS, TimeNs, TipTarget};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::{HELD_MAX, STATE_WORDS_MAX, Snapshot, SnapshotError};
use crate::aggregate::Aggregation;
use crate::config::ControlConfig;
use crate::kinematics::forward;
use crate::{Controller, OperatorEvent, TickInput, TickOutput};

fn one_arm() -> ControlConfig {
    ControlConfig::load(
        &ControlConfig::default_control(),
        &ControlConfig::needle_lift_safety(),
    )
    .unwrap()
}

fn two_arms() -> ControlConfig {
    let text = include_str!("../tests/scenes/handover.toml");
    let safety = Source::embedded("handover.toml", text);
    ControlConfig::load(&ControlConfig::default_control(), &safety).unwrap()
}

/// What all arms are given in one tick.
#[derive(Clone)]
struct Given<const ARMS: usize> {
    now: TimeNs,
    measured: [Result<ArmState, ArmError>; ARMS],
    chunks: [Option<Chunk>; ARMS],
    operator: Option<OperatorEvent>,
}

impl<const ARMS: usize> Given<ARMS> {
    fn to(&self, controller: &mut Controller<ARMS>) -> [TickOutput; ARMS] {
        controller.tick_arms(&core::array::from_fn(|arm| TickInput {
            now: self.now,
            measured: self.measured[arm],
            chunk: self.chunks[arm].as_ref(),
            operator: self.operator,
        }))
    }
}

/// A controller to which all kinds of things happen, and whoever gave it its chunks.
struct Troubled<const ARMS: usize> {
    controller: Controller<ARMS>,
    arms: [ArmState; ARMS],
    now: TimeNs,
    sequence: u64,
    random: SplitMix64,
    seen: Vec<(usize, Chunk)>,
}

impl<const ARMS: usize> Troubled<ARMS> {
    fn new(config: &ControlConfig, seed: u64) -> Self {
        let home = JointVector::new(0.0, 0.0, hal::psm::HOME_INSERTION_M, 0.0, 0.0, 0.0);
        Self {
            controller: Controller::for_arms(config).unwrap(),
            arms: [ArmState::at_rest(TimeNs(0), home, 0.2); ARMS],
            now: TimeNs(0),
            sequence: 0,
            random: SplitMix64::new(seed),
            seen: Vec::new(),
        }
    }

    fn chance(&mut self, one_in: f64) -> bool {
        self.random.between(0.0, one_in) < 1.0
    }

    /// A path that starts at the commanded tip; now and then it is one that the gate refuses.
    fn chunk(&mut self, arm: usize) -> Chunk {
        let start = forward(&self.arms[arm].position);
        let reach = if self.chance(8.0) { 0.2 } else { 0.02 };
        let mut step = || Vector3::from_fn(|_, _| self.random.between(-1.0, 1.0));
        let (way, turn) = (reach * step(), 0.5 * step());
        let length = 5 + self.sequence % 90;
        let targets: Vec<_> = (0..length)
            .map(|index| {
                let share = hal::count::count_u32(hal::count::index(index));
                let share = (f64::from(share) / 20.0).min(1.0);
                let mut pose = Translation3::from(way * share) * start;
                pose.rotation = UnitQuaternion::new(turn * share) * start.rotation;
                TipTarget::new(&pose, 0.1 + 0.5 * share)
            })
            .collect();
        Chunk::new(self.now, self.sequence, 40 * TICK_NS, &targets)
    }

    fn operator(&mut self) -> Option<OperatorEvent> {
        use OperatorEvent::{
            Clear, Disable, Enable, GoOn, HandBack, Pause, Resume, Speed, TakeOver,
        };
        if self.now.0 == 0 {
            return Some(Enable);
        }
        let all = [
            Clear,
            Disable,
            Enable,
            GoOn,
            HandBack,
            Pause,
            Resume,
            TakeOver,
            Speed { percent: 35 },
            Speed { percent: 100 },
        ];
        // What stops the arms is followed by what lets them go on.
        let often = [Clear, Enable, Resume, GoOn];
        if self.chance(90.0) {
            return often
                .get(hal::count::index(self.random.next_u64() % 4))
                .copied();
        }
        let any = hal::count::index(self.random.next_u64() % 10);
        self.chance(120.0).then(|| all[any])
    }

    fn next(&mut self) -> (Given<ARMS>, [TickOutput; ARMS]) {
        let missed = if self.chance(400.0) { 30 } else { 1 };
        self.now = self.now.plus_ns(missed * TICK_NS);
        let gives = self.chance(35.0);
        self.sequence += u64::from(gives);
        let lost = self.chance(900.0);
        let off = if self.chance(60.0) { 2e-3 } else { 1e-5 };
        let given = Given {
            now: self.now,
            measured: core::array::from_fn(|arm| {
                let mut state = self.arms[arm];
                state.stamp = self.now;
                state.position[1] += off * self.random.between(-1.0, 1.0);
                state.jaw_effort = self.random.between(-0.3, 0.3);
                if lost {
                    return Err(ArmError::MeasurementLost { age_ns: 7 });
                }
                Ok(state)
            }),
            chunks: core::array::from_fn(|arm| gives.then(|| self.chunk(arm))),
            operator: self.operator(),
        };
        let chunks = given.chunks.iter().enumerate();
        self.seen
            .extend(chunks.filter_map(|(arm, chunk)| Some((arm, (*chunk)?))));
        let outputs = given.to(&mut self.controller);
        for (arm, output) in self.arms.iter_mut().zip(&outputs) {
            arm.position = output.command.position;
            arm.velocity = output.command.velocity;
            arm.jaw_position = output.command.jaw_position;
        }
        (given, outputs)
    }

    fn snapshot(&self) -> (Snapshot, Vec<Chunk>) {
        let mut snapshot = Snapshot::new();
        self.controller.save(&mut snapshot);
        let find = |held: &super::HeldChunk| {
            let mut newest_first = self.seen.iter().rev();
            let (_, chunk) = newest_first.find(|(arm, chunk)| {
                (*arm, chunk.sequence, chunk.observed_at)
                    == (held.arm, held.sequence, held.observed_at)
            })?;
            Some(*chunk)
        };
        let chunks = snapshot.held().iter().map(|held| find(held).unwrap());
        let chunks = chunks.collect();
        (snapshot, chunks)
    }
}

/// Every bit of what is in them, as text.
fn bits<const ARMS: usize>(outputs: &[TickOutput; ARMS]) -> String {
    format!("{outputs:?}")
}

/// Lets trouble befall a controller, and from time to time another one, newly built, goes on beside
/// it.
fn goes_on<const ARMS: usize>(config: &ControlConfig, seed: u64) -> (usize, usize) {
    let mut troubled = Troubled::<ARMS>::new(config, seed);
    let mut most = (0, 0);
    let mut moving = 0;
    for round in 0..20 {
        for _ in 0..50 + 13 * round {
            troubled.next();
        }
        let (snapshot, chunks) = troubled.snapshot();
        most.0 = most.0.max(snapshot.state().len());
        most.1 = most.1.max(snapshot.held().len());
        let mut other = Controller::<ARMS>::for_arms(config).unwrap();
        other.restore(&snapshot, &chunks).unwrap();
        for tick in 0..200 {
            let (given, expected) = troubled.next();
            let outputs = given.to(&mut other);
            let place = format!("seed {seed}, round {round}, tick {tick}");
            assert_eq!(bits(&outputs), bits(&expected), "{place}");
            moving += usize::from(expected[0].report.mode.busy);
        }
        let mut at_end = Snapshot::new();
        other.save(&mut at_end);
        assert_eq!(at_end, troubled.snapshot().0, "seed {seed}, round {round}");
        assert_eq!(
            other.measured_clearances(),
            troubled.controller.measured_clearances()
        );
    }
    assert!(moving > 400, "the arm moved in {moving} ticks only");
    most
}

#[test]
fn a_controller_goes_on_from_a_snapshot_bit_for_bit() {
    let modes = [
        Aggregation::Newest,
        Aggregation::WholeChunk,
        Aggregation::Ensemble { decay: 0.01 },
    ];
    for (mode, seed) in modes.into_iter().zip(1..) {
        let aggregation = |config| ControlConfig {
            aggregation: mode,
            ..config
        };
        goes_on::<1>(&aggregation(one_arm()), seed);
        let (words, held) = goes_on::<2>(&aggregation(two_arms()), 10 + seed);
        assert!(
            words <= STATE_WORDS_MAX && held <= HELD_MAX,
            "{words}, {held}"
        );
        assert!(words > STATE_WORDS_MAX * 3 / 4, "{words}");
    }
}

/// A snapshot of two arms in motion.
fn in_motion() -> (ControlConfig, Troubled<2>) {
    let config = ControlConfig {
        aggregation: Aggregation::Ensemble { decay: 0.01 },
        ..two_arms()
    };
    let mut troubled = Troubled::new(&config, 5);
    let mut quiet = 0;
    while quiet < 600 || troubled.next().1[0].command.velocity.norm() < 1e-3 {
        troubled.next();
        quiet += 1;
    }
    (config, troubled)
}

#[test]
fn every_word_counts_or_is_refused() {
    let (config, mut troubled) = in_motion();
    let (snapshot, chunks) = troubled.snapshot();
    let given: Vec<_> = (0..5).map(|_| troubled.next().0).collect();
    let mut refused = 0;
    for (index, &word) in snapshot.state().iter().enumerate() {
        let bit = [0, 31, 52, 62, 63][index % 5];
        let mut state = snapshot.state().to_vec();
        state[index] = word ^ (1 << bit);
        let changed = Snapshot::from_parts(snapshot.layout(), state, snapshot.held().to_vec());
        let mut other = Controller::<2>::for_arms(&config).unwrap();
        if other.restore(&changed, &chunks).is_err() {
            refused += 1;
            continue;
        }
        let mut back = Snapshot::new();
        other.save(&mut back);
        assert_eq!(back.state(), changed.state(), "word {index}, bit {bit}");
        // Nonsense makes no sense of what follows, but neither does it end the program.
        for given in &given {
            given.to(&mut other);
        }
    }
    assert!(refused > 20, "{refused}");
}

#[test]
fn what_is_no_snapshot_of_such_a_controller_is_refused() {
    let (config, troubled) = in_motion();
    let (snapshot, chunks) = troubled.snapshot();
    assert!(!chunks.is_empty());
    let mut two = Controller::<2>::for_arms(&config).unwrap();
    let mut one = Controller::<1>::for_arms(&one_arm()).unwrap();
    let layout = SnapshotError::Layout;
    assert_eq!(one.restore(&snapshot, &chunks), Err(layout));
    let (held, state) = (snapshot.held().to_vec(), snapshot.state().to_vec());
    let impossible = Err(SnapshotError::Impossible);
    let mut with = |state: &[u64], chunks: &[Chunk]| {
        let other = Snapshot::from_parts(snapshot.layout(), state.to_vec(), held.clone());
        two.restore(&other, chunks)
    };
    assert_eq!(with(&state[1..], &chunks), impossible);
    assert_eq!(with(&state[..state.len() - 1], &chunks), impossible);
    assert_eq!(with(&[&state[..], &[0]].concat(), &chunks), impossible);
    assert_eq!(with(&state, &chunks[1..]), impossible);
    let mut other = chunks.clone();
    other[0].sequence += 1;
    assert_eq!(with(&state, &other), impossible);
    for spoil in [
        |chunk: &mut Chunk| chunk.targets[0].jaw = f64::NAN,
        |chunk: &mut Chunk| chunk.len = 0,
        |chunk: &mut Chunk| chunk.step_ns = 0,
    ] {
        let mut other = chunks.clone();
        spoil(&mut other[0]);
        assert_eq!(with(&state, &other), impossible);
    }
    assert_eq!(with(&state, &chunks), Ok(()));
}
