//! The simulator: one physics step, a whole episode against real time, and one rendered frame.

#![expect(
    clippy::expect_used,
    reason = "a bench can't go on without its subject"
)]

mod support;

use std::error::Error;

use criterion::Criterion;
use hal::TimeNs;
use runtime::histogram::Histogram;
use runtime::rt::{Grant, MonotonicClock, RtOptions, configure_thread};
use runtime::session::episode::{Episode, EpisodeEnd, Nobody, Plan};
use runtime::session::source::STEP_NS;
use runtime::session::{PolicyChoice, SessionError, Setup};
use sim_backend::cameras::SceneCameras;
use sim_backend::simulation::{Rendering, Simulation};
use sim_backend::task::{Outcome, Scene};
use tch::Device;

const SEED: u64 = 1;
const STEPS: u32 = 20_000;
const EPISODES: u32 = 5;
const FRAMES: u32 = 20;
/// A core for the physics alone where the system allows it, so that neighbours do not count.
const REAL_TIME: RtOptions = RtOptions {
    priority: Some(80),
    cpu: None,
    lock_memory: false,
    strict: false,
};

/// Lets the expert work in lockstep, until the verdict or for `tick_limit`.
fn run_expert(
    setup: &Setup,
    simulation: &mut Simulation,
    seed: u64,
    tick_limit: u64,
) -> Result<EpisodeEnd, SessionError> {
    let episode = Episode {
        simulation,
        controller: &mut setup.controller()?,
        source: &mut setup.source(&PolicyChoice::Expert, seed, Device::Cpu)?,
    };
    let plan = Plan {
        latency_ticks: 0,
        tick_limit,
    };
    episode.run(&plan, &mut Nobody)
}

/// The setup with a verdict so late that steps are judged to the end of the bench.
fn unending(setup: &Setup) -> Setup {
    let mut patient = setup.clone();
    patient.task.time_limit_s = 1e6;
    if let Scene::NeedleLift(lift) = &mut patient.task.scene {
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
    let lifted = run_expert(setup, &mut lifting, SEED, setup.tick_limit())?;
    if lifted.outcome != Outcome::Success {
        return Err(format!("the expert did not lift the needle: {}", lifted.reason()).into());
    }
    let mut simulation = Simulation::new(&patient.task, SEED, Rendering::Off)?;
    run_expert(&patient, &mut simulation, SEED, lifted.tally.ticks())?;
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

/// Whole episodes, their making and the controller included.
fn episodes(criterion: &mut Criterion, setup: &Setup, fifo: &Grant) {
    let clock = MonotonicClock::new();
    let mut factors = Vec::new();
    let mut seed = SEED;
    let name = "simulation/expert episode in lockstep, no cameras";
    support::measure(criterion, name, EPISODES, || {
        seed += 1;
        let before = clock.now();
        let mut simulation =
            Simulation::new(&setup.task, seed, Rendering::Off).expect("nothing is rendered");
        let end = run_expert(setup, &mut simulation, seed, setup.tick_limit()).expect("it runs");
        let took_ns = clock.now().since(before);
        let simulated_s = TimeNs::from_tick(end.tally.ticks()).seconds();
        factors.push(simulated_s / TimeNs(took_ns).seconds());
        took_ns
    });
    factors.sort_by(f64::total_cmp);
    let (slowest, median) = (factors[0], factors[factors.len() / 2]);
    let figure = format!(
        "expert episodes without cameras: {median:.1} times real time in the median of {}, {slowest:.1} at worst, SCHED_FIFO {fifo}",
        factors.len()
    );
    support::report(&figure, "at least 10 times", median / 10.0);
}

/// One frame of the first camera: colour, depth and instance ids.
fn frame(criterion: &mut Criterion, setup: &Setup) -> Result<(), Box<dyn Error>> {
    let clock = MonotonicClock::new();
    let simulation = Simulation::new(&setup.task, SEED, Rendering::Off)?;
    let snapshot = simulation.snapshot();
    let mut cameras = SceneCameras::new(&setup.task)?;
    let mut frame = cameras.blank_frame(0)?;
    let size = format!("{}x{}", frame.intrinsics.width, frame.intrinsics.height);
    let name = format!("simulation/{size} frame");
    let times = support::measure(criterion, &name, FRAMES, || {
        let before = clock.now();
        cameras
            .render(0, &snapshot, &mut frame)
            .expect("it renders");
        clock.now().since(before)
    });
    if frame.instance.iter().all(|&id| id == 0) {
        return Err("the frame shows nothing".into());
    }
    let step_ms = TimeNs(STEP_NS).seconds() * 1e3;
    let median_ms = TimeNs(times.percentile(0.5)).seconds() * 1e3;
    let figure = format!(
        "{size} frame on {}: p50 {median_ms:.2} ms",
        cameras.adapter_name()
    );
    let target = format!("within a policy step of {step_ms} ms");
    support::report(&figure, &target, step_ms / median_ms);
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut criterion = support::criterion();
    let setup = Setup::load("needle-lift", None, &PolicyChoice::Expert)?;
    // First, since a software renderer's threads would inherit the physics' scheduling.
    frame(&mut criterion, &setup)?;
    let scheduling = configure_thread(&REAL_TIME)?;
    physics(&mut criterion, &setup)?;
    episodes(&mut criterion, &setup, &scheduling.fifo);
    criterion.final_summary();
    Ok(())
}
