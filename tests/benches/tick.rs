//! The controller's tick, that is filter, smoother, guard and a little more: of one arm and of two,
//! with the safety QP inactive and with it active; and how long it takes to hand over its state.

mod support;

use core::f64::consts::TAU;
use std::error::Error;

use criterion::Criterion;
use hal::config::Source;
use hal::{ArmState, Chunk, JointVector, Pose, TICK_NS, TimeNs, TipTarget};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use trocar::histogram::Histogram;
use trocar::rt::{Grant, MonotonicClock, RtOptions, configure_thread};
use trocar_control::aggregate::Aggregation;
use trocar_control::kinematics::forward;
use trocar_control::{
    ControlConfig, Controller, OperatorEvent, QpOutcome, Snapshot, TickInput, TickOutput,
};

/// Two arms that reach towards each other.
const HANDOVER: &str = include_str!("../../runtime/control/src/tests/scenes/handover.toml");
/// Ticks from one chunk to the next.
const STEP_TICKS: u64 = 40;
/// Steps in a chunk; with one every step, as many chunks cover each instant.
const CHUNK_STEPS: usize = 100;
/// Ticks after which the chunks overlap in full and the arm is where the path is.
const WARM_UP_TICKS: u32 = 5_000;
/// Ticks that percentiles are taken over.
const TICKS: u32 = 30_000;
/// The same scheduling as the control thread's, so that neighbours do not count where the system
/// allows it.
const REAL_TIME: RtOptions = RtOptions {
    priority: Some(80),
    cpu: None,
    lock_stack: false,
    strict: false,
};

/// A controller with arms that are wherever they were told to be, and a policy that answers every
/// step.
struct Rig<const ARMS: usize> {
    controller: Controller<ARMS>,
    path: fn(f64) -> TipTarget,
    chunk: Option<Chunk>,
    arms: [ArmState; ARMS],
    tick: u64,
    clock: MonotonicClock,
}

impl<const ARMS: usize> Rig<ARMS> {
    fn new(config: &ControlConfig, path: fn(f64) -> TipTarget) -> Result<Self, Box<dyn Error>> {
        let mut rig = Self {
            controller: Controller::for_arms(config)?,
            path,
            chunk: None,
            arms: [ArmState::at_rest(TimeNs(0), home(), 0.2); ARMS],
            tick: 0,
            clock: MonotonicClock::new(),
        };
        for _ in 0..WARM_UP_TICKS {
            rig.step();
        }
        Ok(rig)
    }

    /// One tick, and the time that the controller took for it, ns.
    fn step(&mut self) -> (u64, TickOutput) {
        let now = TimeNs::from_tick(self.tick);
        if self.tick.is_multiple_of(STEP_TICKS) {
            self.chunk = Some(self.chunk_from(now));
        }
        let inputs: [TickInput<'_>; ARMS] = self.arms.map(|arm| TickInput {
            now,
            measured: Ok(arm),
            chunk: self.chunk.as_ref(),
            operator: (self.tick == 0).then_some(OperatorEvent::Enable),
        });
        let before = self.clock.now();
        let outputs = self.controller.tick_arms(&inputs);
        let took_ns = self.clock.now().since(before);
        self.tick += 1;
        for (arm, output) in self.arms.iter_mut().zip(&outputs) {
            let command = &output.command;
            *arm = ArmState {
                velocity: command.velocity,
                jaw_velocity: command.jaw_velocity,
                ..ArmState::at_rest(
                    TimeNs::from_tick(self.tick),
                    command.position,
                    command.jaw_position,
                )
            };
        }
        let [output, ..] = outputs.as_slice() else {
            unreachable!("a controller has an arm");
        };
        (took_ns, *output)
    }

    fn chunk_from(&self, now: TimeNs) -> Chunk {
        let blank = (self.path)(0.0);
        let step_ns = STEP_TICKS * TICK_NS;
        let mut chunk = Chunk::new(now, self.tick + 1, step_ns, &[blank; CHUNK_STEPS]);
        for index in 0..CHUNK_STEPS {
            chunk.targets[index] = (self.path)(chunk.due(index).seconds());
        }
        chunk
    }
}

fn home() -> JointVector {
    JointVector::new(0.0, 0.0, hal::psm::HOME_INSERTION_M, 0.0, 0.0, 0.0)
}

fn target(x: f64, y: f64, z: f64, turn: Vector3<f64>, jaw: f64) -> TipTarget {
    let rotation = UnitQuaternion::new(turn) * forward(&home()).rotation;
    let tip_in_rcm = Pose::from_parts(Translation3::new(x, y, z), rotation);
    TipTarget::new(&tip_in_rcm, jaw)
}

/// A circle at 40 mm/s with a slow turn of the tool and the jaw, away from every boundary.
fn circle(time_s: f64) -> TipTarget {
    let blend = (time_s / 0.5).min(1.0).powi(2);
    let angle = 2.0 * time_s;
    let (x, y) = (
        0.02 * blend * angle.sin(),
        0.02 * blend * (angle.cos() - 1.0),
    );
    let half = (0.5 * angle).sin() * blend;
    let whole = angle.sin() * blend;
    let turn = Vector3::new(0.3 * half, 0.2 * half, 0.4 * whole);
    target(x, y, -0.12, turn, 0.2 + 0.2 * whole)
}

/// To and fro along the workspace's floor, 20 mm below it.
fn below_the_floor(time_s: f64) -> TipTarget {
    let down_m = 0.06 * (time_s / 2.0).min(1.0);
    let x = 0.02 * (TAU * time_s / 4.0).sin();
    target(x, 0.0, -0.1135 - down_m, Vector3::zeros(), 0.2)
}

/// A small circle far up, where two arms and all regions are apart.
fn apart(time_s: f64) -> TipTarget {
    let blend = (time_s / 2.0).min(1.0).powi(2);
    let angle = 2.0 * time_s;
    let (x, y) = (
        0.008 * blend * angle.sin(),
        0.008 * blend * (angle.cos() - 1.0),
    );
    target(x, y, -0.1135 + 0.023 * blend, Vector3::zeros(), 0.2)
}

/// To and fro across the place where the other arm's tip goes to and fro as well.
fn across(time_s: f64) -> TipTarget {
    let x = 0.03 * (TAU * time_s / 4.0).sin();
    target(x, 0.0, -0.13, Vector3::zeros(), 0.2)
}

fn report(name: &str, ticks: &Histogram, limit_us: f64, fifo: &Grant) {
    let us = |fraction| TimeNs(ticks.percentile(fraction)).seconds() * 1e6;
    let figure = format!(
        "{name}: p50 {:.1} us, p99 {:.1} us, max {:.1} us of {} ticks, SCHED_FIFO {fifo}",
        us(0.5),
        us(0.99),
        us(1.0),
        ticks.count()
    );
    support::report(
        &figure,
        &format!("p99 at most {limit_us} us"),
        limit_us / us(0.99),
    );
}

/// No row of the QP is touched on the way.
fn inactive<const ARMS: usize>(
    criterion: &mut Criterion,
    name: &str,
    config: &ControlConfig,
    path: fn(f64) -> TipTarget,
) -> Result<Histogram, Box<dyn Error>> {
    let mut rig = Rig::<ARMS>::new(config, path)?;
    let mut solved = 0;
    let ticks = support::measure(criterion, name, TICKS, || {
        let (took_ns, output) = rig.step();
        solved += u32::from(output.report.qp != QpOutcome::NotNeeded);
        took_ns
    });
    if solved > 0 {
        return Err(format!("{name}: the QP took part in {solved} ticks").into());
    }
    Ok(ticks)
}

/// Every tick that is counted has solved the QP with rows active.
fn active<const ARMS: usize>(
    criterion: &mut Criterion,
    name: &str,
    config: &ControlConfig,
    path: fn(f64) -> TipTarget,
    share: f64,
) -> Result<Histogram, Box<dyn Error>> {
    let mut rig = Rig::<ARMS>::new(config, path)?;
    let (mut all, mut counted) = (0_u32, 0_u32);
    let ticks = support::measure(criterion, name, TICKS, || {
        // Only ticks that solve are counted; their share is checked below.
        loop {
            let (took_ns, output) = rig.step();
            all += 1;
            let solved = matches!(output.report.qp, QpOutcome::Solved { .. });
            if solved && output.report.rows_active > 0 || all > 100 * (counted + 1) {
                counted += 1;
                return took_ns;
            }
        }
    });
    if f64::from(counted) < share * f64::from(all) {
        return Err(format!("{name}: rows were active in {counted} of {all} ticks only").into());
    }
    Ok(ticks)
}

/// What a log with a bound takes of the control thread, once in 250 ticks: the controller's state.
fn state<const ARMS: usize>(
    criterion: &mut Criterion,
    name: &str,
    config: &ControlConfig,
    path: fn(f64) -> TipTarget,
) -> Result<Histogram, Box<dyn Error>> {
    let mut rig = Rig::<ARMS>::new(config, path)?;
    let mut snapshot = Snapshot::new();
    Ok(support::measure(criterion, name, TICKS, || {
        rig.step();
        let before = rig.clock.now();
        rig.controller.save(&mut snapshot);
        rig.clock.now().since(before)
    }))
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut criterion = support::criterion();
    let scheduling = configure_thread(&REAL_TIME)?;
    let ensemble = ControlConfig::load(
        &ControlConfig::default_control(),
        &ControlConfig::needle_lift_safety(),
    )?;
    let whole_chunk = ControlConfig {
        aggregation: Aggregation::WholeChunk,
        ..ensemble.clone()
    };
    let two_arms = ControlConfig::load(
        &ControlConfig::default_control(),
        &Source::embedded("handover.toml", HANDOVER),
    )?;
    let two_arms = ControlConfig {
        aggregation: Aggregation::WholeChunk,
        ..two_arms
    };
    let names = [
        "tick/qp inactive, ensemble of 100",
        "tick/qp inactive, whole chunk",
        "tick/qp active, whole chunk",
        "tick/two arms, qp inactive, whole chunk",
        "tick/two arms, qp active, whole chunk",
        "state/ensemble of 100",
        "state/two arms, whole chunk",
    ];
    let results = [
        inactive::<1>(&mut criterion, names[0], &ensemble, circle)?,
        inactive::<1>(&mut criterion, names[1], &whole_chunk, circle)?,
        active::<1>(&mut criterion, names[2], &whole_chunk, below_the_floor, 0.9)?,
        inactive::<2>(&mut criterion, names[3], &two_arms, apart)?,
        active::<2>(&mut criterion, names[4], &two_arms, across, 0.5)?,
        state::<1>(&mut criterion, names[5], &ensemble, circle)?,
        state::<2>(&mut criterion, names[6], &two_arms, across)?,
    ];
    let limits_us = [60.0, 60.0, 250.0, 500.0, 500.0, 60.0, 60.0];
    for ((name, ticks), limit_us) in names.iter().zip(&results).zip(limits_us) {
        report(name, ticks, limit_us, &scheduling.fifo);
    }
    criterion.final_summary();
    Ok(())
}
