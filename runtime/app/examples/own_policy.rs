//! A policy of one's own in the simulator, in one episode and in an evaluation: anything that
//! answers an observation with a chunk.
//!
//! ```sh
//! cargo run --release --example own_policy
//! ```
//!
//! This one moves the tip on a circle of 1 cm and looks at no camera. It lifts no needle; what it
//! wants passes the same filter, smoother and guard as anybody's.

use hal::count::{count_u32, index};
use hal::{Chunk, Observation, Policy, PolicyError, TipTarget};
use nalgebra::Translation3;
use trocar::session::eval::{EvalOptions, evaluate_with};
use trocar::session::run::{RunResult, run_lockstep_with};
use trocar::session::source::{ChunkSource, STEP_NS};
use trocar::session::summary::EvalSummary;
use trocar::session::{Plan, PolicyChoice, SessionError};

/// Radius of the circle, m, and policy steps of 40 ms for a round.
const RADIUS_M: f64 = 0.01;
const ROUND_STEPS: u32 = 50;

/// Policy steps of a chunk, and from one query to the next.
const CHUNK_STEPS: u32 = 10;
const QUERY_EVERY_STEPS: u64 = 5;

/// Moves each arm's tip on a circle through where it saw it first.
#[derive(Debug, Default)]
struct Circles {
    home: Vec<TipTarget>,
    chunks: u64,
}

impl Policy for Circles {
    fn reset(&mut self, _seed: u64) {
        *self = Self::default();
    }

    fn infer(&mut self, observation: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError> {
        if self.home.is_empty() {
            self.home = observation.arms.iter().map(|arm| arm.here()).collect();
        }
        let begun = count_u32(index(self.chunks * QUERY_EVERY_STEPS));
        self.chunks += 1;
        let on_circle = |home: &TipTarget, step: u32| {
            let share = f64::from(begun + step) / f64::from(ROUND_STEPS);
            let (sine, cosine) = (core::f64::consts::TAU * share).sin_cos();
            let away = Translation3::new(RADIUS_M * (cosine - 1.0), RADIUS_M * sine, 0.0);
            TipTarget::new(&(away * home.tip_in_rcm()), home.jaw)
        };
        let arms = observation.arms.iter().zip(&self.home);
        let chunks = arms.map(|(arm, home)| {
            let targets: Vec<TipTarget> =
                (0..CHUNK_STEPS).map(|step| on_circle(home, step)).collect();
            Chunk::new(arm.state.stamp, self.chunks, STEP_NS, &targets)
        });
        Ok(chunks.collect())
    }
}

/// Needle lift from seed 7 on, with a chunk 40 ms after its observation.
fn plan() -> Result<Plan, SessionError> {
    let policy = PolicyChoice::Own("circles".to_owned());
    Ok(Plan {
        seed: 7,
        latency_ms: Some(40),
        warn: tell,
        ..Plan::load("needle-lift", policy)?
    })
}

/// The policy, which looks through no camera.
fn circles() -> ChunkSource {
    ChunkSource::policy(Box::<Circles>::default(), Vec::new(), QUERY_EVERY_STEPS)
}

/// Runs an episode in lockstep.
///
/// # Errors
/// From the configuration or the simulation.
pub fn run() -> Result<RunResult, SessionError> {
    run_lockstep_with(&plan()?, circles())
}

/// Runs `trials` episodes in lockstep, `jobs` at a time, each job with a policy of its own.
///
/// # Errors
/// From the configuration or the simulation.
pub fn evaluate(trials: usize, jobs: usize) -> Result<EvalSummary, SessionError> {
    let options = EvalOptions {
        trials,
        jobs,
        keep: None,
    };
    evaluate_with(
        &plan()?,
        &options,
        &|| Ok(circles()),
        &|| false,
        &mut |_| {},
    )
}

#[expect(clippy::print_stderr, reason = "a warning is for the terminal")]
fn tell(line: &str) {
    eprintln!("{line}");
}

#[expect(clippy::print_stdout, reason = "an example tells what it does")]
fn main() -> Result<(), SessionError> {
    let summary = run()?.summary;
    println!(
        "{}: {} after {:.2} s, {} chunks, {} refused",
        summary.policy.name,
        summary.reason,
        summary.seconds,
        summary.policy.queries,
        summary.policy.refused
    );
    let evaluated = evaluate(4, 2)?;
    println!("{} of {} trials", evaluated.successes, evaluated.trials);
    Ok(())
}
