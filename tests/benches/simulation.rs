//! The simulator: every task's physics and whole lockstep against real time, one physics step, and
//! every task's cameras.

#![expect(
    clippy::expect_used,
    reason = "a bench can't go on without its subject"
)]

mod support;

use std::error::Error;

use criterion::Criterion;
use hal::{Arm, ArmCommand, CameraFrame, SafeTail, TimeNs};
use tch::Device;
use trocar::histogram::Histogram;
use trocar::rt::{Grant, MonotonicClock, RtOptions, configure_thread};
use trocar::session::episode::{Episode, EpisodeEnd, EpisodeObserver, NoObserver, Timing};
use trocar::session::source::STEP_NS;
use trocar::session::{PolicyChoice, SessionError, Setup, tasks};
use trocar_log::TickRecord;
use trocar_render::Shading;
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::simulation::{Rendering, Simulation};
use trocar_tasks::task::Outcome;
use trocar_tasks::task::needle_lift::NeedleLift;

const SEED: u64 = 1;
const STEPS: u32 = 20_000;
const EPISODES: u64 = 3;
const REPLAYS: u32 = 3;
const FRAMES: u32 = 10;
/// What the simulation of a rigid task must be faster than real time on one core, and of the
/// tissue.
const RIGID: f64 = 20.0;
const SOFT: f64 = 3.0;
const SIDE_PIXELS: u32 = 512;
/// Frames a second that an accelerator draws at least, in any shading.
const ACCELERATED: f64 = 1000.0;
/// A core for the physics alone where the system allows it, so that neighbours do not count.
const REAL_TIME: RtOptions = RtOptions {
    priority: Some(80),
    cpu: None,
    lock_stack: false,
    strict: false,
};

/// Lets the expert work in lockstep on the seed and for the ticks of `plan`, or until the verdict.
fn run_expert(
    setup: &Setup,
    simulation: &mut Simulation,
    (seed, tick_limit): (u64, u64),
    watcher: &mut dyn EpisodeObserver,
) -> Result<EpisodeEnd, SessionError> {
    let episode = Episode {
        simulation,
        controller: &mut setup.controller()?,
        source: &mut setup.source(&PolicyChoice::Expert, seed, Device::Cpu)?,
    };
    let timing = Timing {
        latency: trocar::session::latency::Latency::fixed(0),
        tick_limit,
    };
    episode.run(&timing, watcher)
}

/// The setup with a verdict so late that steps are judged to the end of the bench.
fn unending(setup: &Setup) -> Setup {
    let mut patient = setup.clone();
    patient.task.time_limit_s = 1e6;
    if let Some(lift) = patient.task.scene_mut::<NeedleLift>() {
        lift.success.hold_s = 1e6;
    }
    patient
}

fn steps(criterion: &mut Criterion, name: &str, simulation: &mut Simulation) -> Histogram {
    let clock = MonotonicClock::new();
    support::measure(criterion, name, STEPS, || {
        let before = clock.now();
        simulation.step();
        clock.now().since(before)
    })
}

/// The step's time while the needle lies on the organ, and while the instrument holds it up.
fn physics(criterion: &mut Criterion, setup: &Setup) -> Result<(), Box<dyn Error>> {
    let patient = unending(setup);
    let mut simulation = Simulation::new(&patient.task, SEED, Rendering::Off)?;
    let resting = steps(
        criterion,
        "simulation/step, needle resting",
        &mut simulation,
    );

    let mut lifting = Simulation::new(&setup.task, SEED, Rendering::Off)?;
    let plan = (SEED, setup.tick_limit());
    let lifted = run_expert(setup, &mut lifting, plan, &mut NoObserver)?;
    if lifted.outcome != Outcome::Success {
        return Err(format!("the expert did not lift the needle: {}", lifted.reason()).into());
    }
    let mut simulation = Simulation::new(&patient.task, SEED, Rendering::Off)?;
    let plan = (SEED, lifted.tally.ticks());
    run_expert(&patient, &mut simulation, plan, &mut NoObserver)?;
    let held = steps(criterion, "simulation/step, needle held", &mut simulation);
    if !simulation.scene_state().first.grasp.both_touch || simulation.outcome() != Outcome::Running
    {
        return Err("the needle was lost while it was held".into());
    }

    for (name, times) in [("needle resting", resting), ("needle held", held)] {
        let us = |fraction| TimeNs(times.percentile(fraction)).seconds() * 1e6;
        let figure = format!(
            "physics step, {name}: p50 {:.1} us, p99 {:.1} us of {} steps",
            us(0.5),
            us(0.99),
            times.count()
        );
        let target = "mean at most 100 us, a tenth of the time it simulates";
        let mean_us = TimeNs(times.mean()).seconds() * 1e6;
        support::report(
            &format!("{figure}, mean {mean_us:.1} us"),
            target,
            100.0 / mean_us,
        );
    }
    Ok(())
}

/// Keeps every command of an episode.
#[derive(Default)]
struct Recorder(Vec<Vec<ArmCommand>>);

impl EpisodeObserver for Recorder {
    fn tick(&mut self, record: &TickRecord) {
        self.0
            .push(record.arms.iter().map(|arm| arm.command).collect());
    }
}

/// The episode `seed` under `commands`, from its making to the end.
fn replay(setup: &Setup, seed: u64, commands: &[Vec<ArmCommand>]) -> Simulation {
    let mut simulation =
        Simulation::new(&setup.task, seed, Rendering::Off).expect("nothing is rendered");
    for arms in commands {
        for (index, command) in arms.iter().enumerate() {
            let mut arm = simulation.arm(index).expect("the task has this arm");
            arm.write(command, &SafeTail::hold(command))
                .expect("it is simulated");
        }
        simulation.step();
    }
    simulation
}

/// A task's share of real time, simulation alone and with expert and controller, over whole
/// episodes, their making included.
fn against_real_time(
    criterion: &mut Criterion,
    setup: &Setup,
    fifo: &Grant,
) -> Result<(), Box<dyn Error>> {
    let name = &setup.task_name;
    let clock = MonotonicClock::new();
    let (mut alone, mut whole) = (Vec::new(), Vec::new());
    for seed in SEED..SEED + EPISODES {
        let mut recorder = Recorder::default();
        let before = clock.now();
        let mut simulation = Simulation::new(&setup.task, seed, Rendering::Off)?;
        let plan = (seed, setup.tick_limit());
        let end = run_expert(setup, &mut simulation, plan, &mut recorder)?;
        let whole_ns = clock.now().since(before);
        let simulated_s = TimeNs::from_tick(end.tally.ticks()).seconds();
        whole.push(simulated_s / TimeNs(whole_ns).seconds());
        let took = support::measure(
            criterion,
            &format!("simulation/{name}, expert episode {seed} replayed"),
            REPLAYS,
            || {
                let before = clock.now();
                let again = replay(setup, seed, &recorder.0);
                let took_ns = clock.now().since(before);
                assert_eq!(again.state_hash(), simulation.state_hash());
                took_ns
            },
        );
        alone.push(simulated_s / TimeNs(took.percentile(0.5)).seconds());
    }
    let least = if name == "tissue-retraction" {
        SOFT
    } else {
        RIGID
    };
    for (what, factors) in [
        ("simulation", &mut alone),
        ("lockstep with expert and controller", &mut whole),
    ] {
        factors.sort_by(f64::total_cmp);
        let (slowest, median) = (factors[0], factors[factors.len() / 2]);
        let figure = format!(
            "{name}, {what}, no cameras: {median:.1} times real time in the median of {} episodes, {slowest:.1} at worst, SCHED_FIFO {fifo}",
            factors.len()
        );
        support::report(&figure, &format!("at least {least} times"), median / least);
    }
    Ok(())
}

/// Frames of all cameras of a task at one instant, with `shading`: colour, depth and instance ids.
fn frames(
    criterion: &mut Criterion,
    setup: &Setup,
    shading: Shading,
) -> Result<(), Box<dyn Error>> {
    let clock = MonotonicClock::new();
    let mut task = setup.task.clone();
    task.shading = shading;
    for camera in &mut task.cameras {
        (camera.width, camera.height) = (SIDE_PIXELS, SIDE_PIXELS);
    }
    let snapshot = Simulation::new(&task, SEED, Rendering::Off)?.snapshot();
    let mut cameras = SceneCameras::new(&task)?;
    let count = u32::try_from(cameras.count())?;
    let mut images: Vec<CameraFrame> = (0..cameras.count())
        .map(|camera| cameras.blank_frame(camera))
        .collect::<Result<_, _>>()?;
    let all: Vec<usize> = (0..cameras.count()).collect();
    let name = &setup.task_name;
    let bench = format!("simulation/{name}, a frame of each of {count} cameras, {shading:?}");
    let times = support::measure(criterion, &bench, FRAMES, || {
        let before = clock.now();
        cameras
            .render_all(&all, &snapshot, &mut images)
            .expect("it renders");
        clock.now().since(before)
    });
    if images
        .iter()
        .any(|image| image.instance.iter().all(|&id| id == 0))
    {
        return Err("a frame shows nothing".into());
    }
    let round_s = TimeNs(times.percentile(0.5)).seconds();
    let (rate, adapter) = (f64::from(count) / round_s, cameras.adapter_name());
    let names: Vec<&str> = cameras.names().collect();
    let figure = format!(
        "{name}, {count} cameras ({}) of {SIDE_PIXELS}x{SIDE_PIXELS}, shading {shading:?}, on {adapter}: {rate:.1} frames a second, {:.2} ms a frame",
        names.join(", "),
        1e3 / rate
    );
    let software = adapter.contains("llvmpipe");
    let (target, least) = if software {
        // What a policy looks at every 40 ms: all cameras within a step.
        (
            "every camera once a policy step of 40 ms",
            f64::from(count) / TimeNs(STEP_NS).seconds(),
        )
    } else {
        (
            "at least 1000 frames a second on an accelerator",
            ACCELERATED,
        )
    };
    support::report(&figure, target, rate / least);
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut criterion = support::criterion();
    let setups: Vec<Setup> = tasks::names()
        .map(|task| Setup::load(task, None, &PolicyChoice::Expert))
        .collect::<Result<_, _>>()?;
    // First, since a software renderer's threads would inherit the physics' scheduling.
    for setup in &setups {
        for shading in [Shading::Plain, Shading::Full, Shading::Fine] {
            frames(&mut criterion, setup, shading)?;
        }
    }
    let scheduling = configure_thread(&REAL_TIME)?;
    for setup in &setups {
        against_real_time(&mut criterion, setup, &scheduling.fifo)?;
    }
    let lift = Setup::load("needle-lift", None, &PolicyChoice::Expert)?;
    physics(&mut criterion, &lift)?;
    criterion.final_summary();
    Ok(())
}
