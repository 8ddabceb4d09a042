//! The tick does not allocate, whatever happens in it; nor does the CAN arm's cycle.

#[path = "no_alloc/can.rs"]
mod can;
#[path = "no_alloc/console.rs"]
mod console;
#[path = "no_alloc/log.rs"]
mod log;

use std::error::Error;

use hal::config::Source;
use hal::{ArmError, ArmState, Chunk, JointVector, Pose, TimeNs, TipTarget};
use nalgebra::Translation3;
use trocar::rt::{CountingAllocator, thread_allocations};
use trocar_control::kinematics::forward;
use trocar_control::{
    ControlConfig, Controller, Fault, OperatorEvent, QpOutcome, TickInput, TickOutput,
};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// What happens to one arm in one tick, beside its motion.
#[derive(Clone, Copy, Default)]
struct Event<'a> {
    chunk: Option<&'a Chunk>,
    operator: Option<OperatorEvent>,
    error: Option<ArmError>,
    /// How far the arm is from where it was told to be, rad.
    off_rad: f64,
}

/// A controller, arms that are wherever they were told to be, and what the ticks asked of the
/// allocator.
struct Rig<const ARMS: usize> {
    controller: Controller<ARMS>,
    arms: [ArmState; ARMS],
    tick: u64,
    sequence: u64,
}

const HOME: [f64; 6] = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0];

fn one_arm() -> Result<ControlConfig, Box<dyn Error>> {
    Ok(ControlConfig::load(
        &ControlConfig::default_control(),
        &ControlConfig::needle_lift_safety(),
    )?)
}

fn two_arms() -> Result<ControlConfig, Box<dyn Error>> {
    let text = include_str!("../../runtime/control/src/tests/scenes/handover.toml");
    Ok(ControlConfig::load(
        &ControlConfig::default_control(),
        &Source::embedded("handover.toml", text),
    )?)
}

impl<const ARMS: usize> Rig<ARMS> {
    fn new(config: &ControlConfig) -> Result<Self, Box<dyn Error>> {
        let mut rig = Self {
            controller: Controller::for_arms(config)?,
            arms: [ArmState::at_rest(TimeNs(0), JointVector::from(HOME), 0.2); ARMS],
            tick: 0,
            sequence: 0,
        };
        rig.all(Event {
            operator: Some(OperatorEvent::Enable),
            ..Event::default()
        });
        Ok(rig)
    }

    /// One tick in which the same happens to all arms.
    fn all(&mut self, event: Event<'_>) -> ([TickOutput; ARMS], u64) {
        self.tick([event; ARMS])
    }

    /// One tick, and how often it allocated.
    fn tick(&mut self, events: [Event<'_>; ARMS]) -> ([TickOutput; ARMS], u64) {
        let now = TimeNs::from_tick(self.tick);
        let inputs: [TickInput<'_>; ARMS] = core::array::from_fn(|arm| {
            let event = &events[arm];
            let mut state = self.arms[arm];
            state.stamp = now;
            state.position[1] += event.off_rad;
            TickInput {
                now,
                measured: event.error.map_or(Ok(state), Err),
                chunk: event.chunk,
                operator: event.operator,
            }
        });
        let before = thread_allocations();
        let outputs = self.controller.tick_arms(&inputs);
        let requests = thread_allocations() - before;
        self.tick += 1;
        for (arm, output) in self.arms.iter_mut().zip(&outputs) {
            arm.position = output.command.position;
            arm.velocity = output.command.velocity;
            arm.jaw_position = output.command.jaw_position;
        }
        (outputs, requests)
    }

    /// A chunk that wants the tip at `offset_m` from home, observed now.
    fn chunk(&mut self, offset_m: [f64; 3]) -> Chunk {
        self.sequence += 1;
        let home: Pose = forward(&JointVector::from(HOME));
        let target = TipTarget::new(&(Translation3::from(offset_m) * home), 0.3);
        Chunk::new(
            TimeNs::from_tick(self.tick),
            self.sequence,
            40_000_000,
            &[target; 50],
        )
    }

    /// Moves to and fro between two offsets; how many ticks solved the QP, and in how many it
    /// failed.
    fn oscillate(&mut self, offsets_m: [[f64; 3]; 2], rounds: u64) -> (u32, u32) {
        let (mut solved, mut failed) = (0, 0);
        for round in 0..rounds {
            let [one, other] = offsets_m;
            let chunk = self.chunk(if round.is_multiple_of(2) { one } else { other });
            for tick in 0..40 {
                let chunk = (tick == 0).then_some(&chunk);
                let (outputs, requests) = self.all(Event {
                    chunk,
                    ..Event::default()
                });
                assert_eq!(requests, 0, "round {round}, tick {tick}");
                match outputs[0].report.qp {
                    QpOutcome::NotNeeded => {}
                    QpOutcome::Solved { .. } => solved += 1,
                    QpOutcome::Failed => failed += 1,
                }
            }
        }
        (solved, failed)
    }

    /// Periods that nobody called the controller in, in mid-motion.
    fn missed_periods(&mut self) {
        for missed in [1, 10, 300] {
            let chunk = self.chunk([0.01, 0.0, 0.0]);
            for tick in 0..60 {
                let chunk = (tick == 0).then_some(&chunk);
                let (_, requests) = self.all(Event {
                    chunk,
                    ..Event::default()
                });
                assert_eq!(requests, 0, "tick {tick} before {missed} missed ones");
            }
            self.tick += missed;
            let (_, requests) = self.all(Event::default());
            assert_eq!(requests, 0, "{missed} missed periods");
        }
    }

    /// The last arm loses its torque and is pushed about while another one moves.
    fn a_limp_arm(&mut self) {
        let mut events = [Event::default(); ARMS];
        if let Some(last) = events.last_mut() {
            last.operator = Some(OperatorEvent::Disable);
        }
        for tick in 0..1_000 {
            if tick % 40 == 0 {
                let chunk = self.chunk([if tick % 80 == 0 { 0.02 } else { -0.02 }, 0.0, -0.03]);
                let mut events = [Event::default(); ARMS];
                if let Some(first) = events.first_mut() {
                    first.chunk = Some(&chunk);
                }
                let (_, requests) = self.tick(events);
                assert_eq!(requests, 0, "tick {tick}");
            }
            if let Some(arm) = self.arms.last_mut() {
                arm.position[0] += if tick % 2 == 0 { 1e-5 } else { -1e-5 };
            }
            let (_, requests) = self.tick(events);
            assert_eq!(requests, 0, "tick {tick}");
            events = [Event::default(); ARMS];
        }
        let (outputs, _) = self.all(Event {
            operator: Some(OperatorEvent::Enable),
            ..Event::default()
        });
        assert!(outputs.iter().all(|output| output.command.enabled));
    }

    /// What goes wrong in an operating room.
    fn accidents(&mut self) {
        let mut nonsense = self.chunk([0.005, 0.0, 0.0]);
        nonsense.targets[3].position_m[1] = f64::NAN;
        let chunk = Some(&nonsense);
        let (outputs, requests) = self.all(Event {
            chunk,
            ..Event::default()
        });
        let verdict = outputs[0].report.gate;
        assert!(verdict.is_some_and(|verdict| !verdict.is_accepted()));
        assert_eq!(requests, 0, "a refused chunk");
        for operator in [
            OperatorEvent::Speed { percent: 30 },
            OperatorEvent::Pause,
            OperatorEvent::Resume,
            OperatorEvent::GoOn,
        ] {
            let (_, requests) = self.all(Event {
                operator: Some(operator),
                ..Event::default()
            });
            assert_eq!(requests, 0, "{operator:?}");
        }
        let accidents = [
            Event {
                off_rad: 0.3,
                ..Event::default()
            },
            Event {
                off_rad: 3.0,
                ..Event::default()
            },
            Event {
                error: Some(ArmError::MeasurementLost { age_ns: 1 }),
                ..Event::default()
            },
            Event {
                error: Some(ArmError::DriveFault { axis: 2, code: 7 }),
                ..Event::default()
            },
        ];
        for accident in accidents {
            // Only the first arm has the accident; another one is paused by it.
            let events =
                core::array::from_fn(|arm| if arm == 0 { accident } else { Event::default() });
            let (outputs, requests) = self.tick(events);
            let fault: Option<Fault> = outputs[0].report.fault;
            assert!(fault.is_some());
            assert_eq!(requests, 0, "{fault:?}");
            for operator in [
                None,
                Some(OperatorEvent::Clear),
                Some(OperatorEvent::Disable),
            ] {
                for _ in 0..400 {
                    let (_, requests) = self.all(Event::default());
                    assert_eq!(requests, 0, "after {fault:?}");
                }
                let (_, requests) = self.all(Event {
                    operator,
                    ..Event::default()
                });
                assert_eq!(requests, 0, "{operator:?} after {fault:?}");
            }
            let (outputs, _) = self.all(Event {
                operator: Some(OperatorEvent::Enable),
                ..Event::default()
            });
            assert_eq!(outputs[0].report.fault, None);
        }
    }
}

#[test]
fn one_arm_allocates_nothing() {
    let mut rig = Rig::<1>::new(&one_arm().unwrap()).unwrap();
    let (solved, _) = rig.oscillate([[0.01, 0.0, 0.0], [-0.01, 0.0, 0.0]], 200);
    assert_eq!(solved, 0);
    // Far below the floor of the workspace.
    let (solved, failed) = rig.oscillate([[0.0, 0.0, -0.058], [0.01, 0.0, -0.058]], 200);
    assert!(solved > 1000 && failed == 0, "{solved} {failed}");
    rig.missed_periods();
    rig.accidents();
}

#[test]
fn two_arms_allocate_nothing() {
    let mut rig = Rig::<2>::new(&two_arms().unwrap()).unwrap();
    let (solved, failed) = rig.oscillate([[0.03, 0.0, -0.05], [-0.03, 0.0, -0.05]], 200);
    assert!(solved > 1000 && failed == 0, "{solved} {failed}");
    rig.missed_periods();
    rig.a_limp_arm();
    rig.accidents();
}

#[test]
fn failing_filter_allocates_nothing() {
    let mut config = one_arm().unwrap();
    config.filter.iterations_max = 1;
    let mut rig = Rig::<1>::new(&config).unwrap();
    let (_, failed) = rig.oscillate([[0.01, 0.0, -0.058], [-0.01, 0.0, -0.058]], 50);
    assert!(failed > 10, "{failed}");
}
