//! A robot of one's own in real time, with a policy of one's own or a trained one: whatever can be
//! measured and told where to be, once a millisecond.
//!
//! ```sh
//! cargo run --release -p trocar --example own_robot
//! cargo run --release -p trocar --example own_robot -- config/policies/needle-lift/act-compact cameras
//! ```
//!
//! The second is a committed policy, which looks through the endoscope on the topics `cameras`:
//! `own_camera.rs` publishes one, of 512 pixels.
//!
//! This one follows its command with a lag of 5 ms; a real one would talk to its drives in
//! `exchange`. What the policy wants passes the same filter, smoother and guard as anybody's, under
//! the limits of `config/tasks/needle-lift/safety.toml`, and the run is in a log that `trocar
//! verify` and `trocar replay` take.

use std::path::{Path, PathBuf};

use hal::tail::TailPlayer;
use hal::{
    ArmCommand, ArmState, Chunk, JointVector, Observation, PerArm, Period, Policy, PolicyError,
    Rig, Setpoint, TICK_NS, TICK_S, TimeNs, TipTarget,
};
use nalgebra::Translation3;
use trocar::rt::{MonotonicClock, Periodic};
use trocar::session::changes::Changes;
use trocar::session::realtime::{RigCameras, RobotOptions, run_rig, run_rig_seeing};
use trocar::session::run::RunResult;
use trocar::session::source::{ChunkSource, STEP_NS};
use trocar::session::{Plan, PolicyChoice, Robot, SessionError};

/// How much of the way to its command the arm goes in a period: a lag of 5 ms.
const SHARE: f64 = 0.2;

/// Until the threads are up, ns.
const START_NS: u64 = 20_000_000;

/// One arm that lags behind its command.
struct Lagging {
    state: ArmState,
    command: Option<ArmCommand>,
    player: TailPlayer,
    periodic: Periodic,
}

impl Lagging {
    fn new(clock: MonotonicClock) -> Self {
        let home = JointVector::from([0.0, 0.0, 0.12, 0.0, 0.0, 0.0]);
        Self {
            state: ArmState::at_rest(TimeNs(0), home, 0.2),
            command: None,
            player: TailPlayer::new(TICK_NS),
            periodic: Periodic::new(clock, clock.now().plus_ns(START_NS), TICK_NS),
        }
    }

    /// A period of the arm: the command of this period, or what is left of the last one's tail.
    fn step(&mut self) {
        self.command = self.player.next_period().or(self.command);
        if let Some(command) = &self.command {
            let moved = (command.position - self.state.position) * SHARE;
            self.state.position += moved;
            self.state.velocity = moved / TICK_S;
            self.state.jaw_position += (command.jaw_position - self.state.jaw_position) * SHARE;
        }
    }
}

impl Rig for Lagging {
    fn exchange(&mut self, setpoints: Option<&PerArm<Setpoint>>) -> Period {
        if let Some(setpoints) = setpoints {
            let (command, tail) = &setpoints.first;
            self.player.write(command, tail);
            self.command = Some(*command);
        }
        let wake = self.periodic.wait();
        for _ in 0..=wake.skipped {
            self.step();
        }
        self.state.stamp = wake.due;
        wake.period(Some(PerArm::one(Ok(self.state))))
    }
}

/// Moves the tip 1 cm to the side of where it saw it first.
#[derive(Default)]
struct Aside {
    wanted: Option<TipTarget>,
    chunks: u64,
}

impl Policy for Aside {
    fn reset(&mut self, _seed: u64) {
        *self = Self::default();
    }

    fn infer(&mut self, observation: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError> {
        self.chunks += 1;
        let chunks = observation.arms.iter().map(|arm| {
            let wanted = self.wanted.get_or_insert_with(|| {
                let aside = Translation3::new(0.01, 0.0, 0.0) * arm.tip_in_rcm;
                TipTarget::new(&aside, arm.state.jaw_position)
            });
            Chunk::new(arm.state.stamp, self.chunks, STEP_NS, &[*wanted; 20])
        });
        Ok(chunks.collect())
    }
}

/// What a run is asked: to end after 2 s.
const ASKED: RobotOptions = RobotOptions {
    seconds: Some(2.0),
    cameras: Vec::new(),
};

/// A run by `policy`, with a log at `log`; `safety` are the robot's limits.
fn plan(safety: &Path, policy: PolicyChoice, log: PathBuf) -> Result<Plan<Robot>, SessionError> {
    let robot = Robot::load(safety, None, &policy, &Changes::default())?;
    Ok(Plan {
        log: Some(log),
        warn: tell,
        ..Plan::new(robot, policy)
    })
}

/// Runs it with a policy of one's own.
///
/// # Errors
/// From the configuration or the log.
pub fn run(safety: &Path, log: PathBuf) -> Result<RunResult, SessionError> {
    let plan = plan(safety, PolicyChoice::Own("aside".to_owned()), log)?;
    let source = ChunkSource::policy(Box::<Aside>::default(), Vec::new(), 5);
    let clock = MonotonicClock::new();
    run_rig(&plan, (Lagging::new(clock), clock), source, &ASKED)
}

/// Runs it with the trained policy in `folder`, whose cameras are on `topics`.
///
/// # Errors
/// From the configuration, the policy, the cameras or the log.
pub fn run_trained(
    safety: &Path,
    folder: &Path,
    topics: &str,
    log: PathBuf,
) -> Result<RunResult, SessionError> {
    let plan = plan(safety, PolicyChoice::Checkpoint(folder.to_owned()), log)?;
    let source = ChunkSource::network(plan.setup.network(folder, plan.compute)?);
    let cameras = RigCameras::wait(topics, &source, &ASKED, &tell)?;
    let clock = MonotonicClock::new();
    let rig = (Lagging::new(clock), clock);
    run_rig_seeing(&plan, rig, source, &ASKED, cameras)
}

#[expect(clippy::print_stderr, reason = "a warning is for the terminal")]
fn tell(line: &str) {
    eprintln!("{line}");
}

#[expect(clippy::print_stdout, reason = "an example tells what it does")]
fn main() -> Result<(), SessionError> {
    let safety = Path::new("config/tasks/needle-lift/safety.toml");
    let log = "runs/own_robot.mcap".into();
    let mut arguments = std::env::args().skip(1);
    let result = match (arguments.next(), arguments.next()) {
        (None, _) => run(safety, log),
        (Some(policy), Some(topics)) => run_trained(safety, policy.as_ref(), &topics, log),
        (Some(_), None) => Err(SessionError::BadArgument(
            "arguments: POLICY TOPICS, or none".to_owned(),
        )),
    };
    let summary = result?.summary;
    println!(
        "{}: {} after {:.2} s, {} chunks, log in runs/own_robot.mcap",
        summary.policy.name, summary.reason, summary.seconds, summary.policy.queries
    );
    Ok(())
}
