//! Rows of the fault table: cameras that fail while an arm moves, each for real; times are those of
//! the run's log.

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;

use hal::tail::TailPlayer;
use hal::{
    ArmState, Chunk, Intrinsics, JointVector, Observation, PerArm, Period, Policy, PolicyError,
    Pose, Rig, Setpoint, TICK_NS, TimeNs, TipTarget,
};
use nalgebra::Translation3;
use trocar_control::OperatorEvent;
use trocar_log::RunLog;
use trocar_log::replay::replay;
use trocar_log::verify::verify;
use trocar_topics::{CameraTopic, FrameHeader, FramePublisher, TopicNode};

use super::{RigCameras, RobotOptions, run_rig_seeing};
use crate::rt::{self, MonotonicClock, Periodic, RtOptions, RtProfile};
use crate::session::changes::Changes;
use crate::session::source::{ChunkSource, STEP_NS};
use crate::session::{Plan, PolicyChoice, Robot};

const CAMERA: &str = "scope";
/// Names the topics to a camera in a process of its own.
const TOPICS: &str = "TROCAR_TEST_CAMERA_TOPICS";
const MS_NS: u64 = 1_000_000;
/// For how many frames a camera is well, and the time between two.
const GOOD_FRAMES: u64 = 50;
const FRAME_NS: u64 = 20 * MS_NS;
/// Ticks that an arm may take to rest after a fault is detected: what a run gives its arms at its
/// end, more than twice the longest stop.
const STOP_TICKS_MAX: usize = 500;
/// How often a run that a busy machine ends is tried.
const RUNS_MAX: usize = 4;

/// One arm that is where its command was a period before.
struct Follows {
    state: ArmState,
    player: TailPlayer,
    periodic: Periodic,
}

impl Follows {
    fn new(clock: MonotonicClock) -> Self {
        let home = JointVector::from([0.0, 0.0, 0.12, 0.0, 0.0, 0.0]);
        Self {
            state: ArmState::at_rest(TimeNs(0), home, 0.2),
            player: TailPlayer::new(TICK_NS),
            periodic: Periodic::new(clock, clock.now().plus_ns(20 * MS_NS), TICK_NS),
        }
    }
}

impl Rig for Follows {
    fn exchange(&mut self, setpoints: Option<&PerArm<Setpoint>>) -> Period {
        if let Some(setpoints) = setpoints {
            let (command, tail) = &setpoints.first;
            self.player.write(command, tail);
        }
        let wake = self.periodic.wait();
        for _ in 0..=wake.skipped {
            if let Some(command) = self.player.next_period() {
                self.state.position = command.position;
                self.state.velocity = command.velocity;
                self.state.jaw_position = command.jaw_position;
            }
        }
        self.state.stamp = wake.due;
        wake.period(Some(PerArm::one(Ok(self.state))))
    }
}

/// Swings the tip by 2 mm to either side of where it saw it first, once in 1.6 s: so slowly that
/// periods which a busy machine skips lose little way.
#[derive(Default)]
struct Swings {
    first: Option<(Pose, TimeNs)>,
    chunks: u64,
}

impl Policy for Swings {
    fn reset(&mut self, _seed: u64) {
        *self = Self::default();
    }

    fn infer(&mut self, observation: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError> {
        self.chunks += 1;
        let chunks = observation.arms.iter().map(|arm| {
            let stamp = arm.state.stamp;
            let (home, begun) = *self.first.get_or_insert((arm.tip_in_rcm, stamp));
            let targets: Vec<TipTarget> = (0..25)
                .map(|step| {
                    let since_s = TimeNs(stamp.since(begun) + step * STEP_NS).seconds();
                    let aside = 0.002 * (core::f64::consts::TAU * since_s / 1.6).sin();
                    let tip = Translation3::new(aside, 0.0, 0.0) * home;
                    TipTarget::new(&tip, arm.state.jaw_position)
                })
                .collect();
            Chunk::new(stamp, self.chunks, STEP_NS, &targets)
        });
        Ok(chunks.collect())
    }
}

/// What becomes of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fails {
    /// It shows one exposure again and again.
    Freezes,
    /// It stamps the same pixels anew.
    Repeats,
    /// It shows frames of another size.
    Grows,
    /// Its process is killed while it writes a frame.
    Killed,
}

/// A frame of `side` by `side` pixels in `grey` that was exposed at `stamp`.
fn show(camera: &mut FramePublisher, side: u32, stamp: TimeNs, grey: u8) {
    let lens = Intrinsics::from_vertical_fov(side, side, 0.9);
    let header = FrameHeader::new(stamp, 1, lens, &Pose::identity());
    let grey = |colour: &mut [u8], depth_m: &mut [f32], instance: &mut [u8]| {
        colour.fill(grey);
        depth_m.fill(0.1);
        instance.fill(0);
    };
    camera.publish_with(&header, grey).unwrap();
}

/// Is well for a while, writes half a frame and waits to be killed.
#[test]
fn plays_a_camera_that_is_killed_in_mid_sample() {
    let Ok(topics) = std::env::var(TOPICS) else {
        return;
    };
    let node = TopicNode::join(&topics).unwrap();
    let mut camera = CameraTopic::publisher(&node, CAMERA, 64).unwrap();
    let clock = MonotonicClock::new();
    for frame in 0..GOOD_FRAMES {
        let [grey, ..] = frame.to_le_bytes();
        show(&mut camera, 4, clock.to_system(clock.now()), grey);
        rt::sleep_ns(FRAME_NS);
    }
    let lens = Intrinsics::from_vertical_fov(4, 4, 0.9);
    let stamp = clock.to_system(clock.now());
    let header = FrameHeader::new(stamp, 2, lens, &Pose::identity());
    let mut half = camera.loan(&header).unwrap();
    half.planes().0[..24].fill(255);
    #[expect(clippy::print_stdout, reason = "whoever kills it reads it")]
    {
        println!("\nhalf");
    }
    let _until_killed = std::io::stdin().lock().lines().next();
}

/// Shows frames until `ends`, from some on in that manner; sets `failed` to when that began, ns.
fn plays(
    fails: Fails,
    topics: &str,
    clock: MonotonicClock,
    (failed, ends): (&AtomicU64, &AtomicBool),
) {
    if fails == Fails::Killed {
        let mut camera = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "--nocapture"])
            .arg("session::realtime::robot::tests::plays_a_camera_that_is_killed_in_mid_sample")
            .env(TOPICS, topics)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let said = BufReader::new(camera.stdout.take().unwrap()).lines();
        let half = said.map_while(Result::ok).any(|line| line == "half");
        assert!(half, "it ended before");
        camera.kill().unwrap();
        camera.wait().unwrap();
        failed.store(clock.now().0, Ordering::Release);
        return;
    }
    let node = TopicNode::join(topics).unwrap();
    let mut camera = CameraTopic::publisher(&node, CAMERA, 64).unwrap();
    let mut last = clock.to_system(clock.now());
    for frame in 0_u64.. {
        let now = clock.to_system(clock.now());
        let [grey, ..] = frame.to_le_bytes();
        let well = frame < GOOD_FRAMES;
        if frame == GOOD_FRAMES {
            failed.store(clock.now().0, Ordering::Release);
        }
        match fails {
            Fails::Freezes if !well => show(&mut camera, 4, last, grey),
            Fails::Repeats if !well => show(&mut camera, 4, now, 255),
            Fails::Grows if !well => show(&mut camera, 8, now, grey),
            Fails::Freezes | Fails::Repeats | Fails::Grows | Fails::Killed => {
                last = now;
                show(&mut camera, 4, now, grey);
            }
        }
        if ends.load(Ordering::Acquire) {
            return;
        }
        rt::sleep_ns(FRAME_NS);
    }
}

/// Why the run of an arm ended that moved while its camera failed, and when that began, by the
/// log's clock.
fn run_with(fails: Fails, log: &Path) -> (String, TimeNs) {
    let policy = PolicyChoice::Own("swings".to_owned());
    let safety =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/tasks/needle-lift/safety.toml");
    let changes = Changes(vec!["control.policy.frozen_s=0.5".parse().unwrap()]);
    let robot = Robot::load(&safety, None, &policy, &changes).unwrap();
    // Of the process nothing that other tests would feel.
    let ordinary = RtOptions {
        priority: None,
        lock_stack: false,
        ..RtProfile::default().control
    };
    let plan = Plan {
        log: Some(log.to_owned()),
        real_time: RtProfile {
            control: ordinary,
            lock_memory: false,
            hold_cpu_dma_latency: false,
            ..RtProfile::default()
        },
        ..Plan::new(robot, policy)
    };
    let clock = MonotonicClock::new();
    let topics = format!("test-{}-live-{fails:?}", std::process::id());
    let (failed, ends) = (AtomicU64::new(0), AtomicBool::new(false));
    let result = thread::scope(|scope| {
        scope.spawn(|| plays(fails, &topics, clock, (&failed, &ends)));
        let source = ChunkSource::policy(Box::<Swings>::default(), vec![CAMERA.to_owned()], 5);
        let asked = RobotOptions::default();
        let cameras = RigCameras::wait(&topics, &source, &asked, &|_| ());
        let result = cameras.and_then(|cameras| {
            let rig = (Follows::new(clock), clock);
            run_rig_seeing(&plan, rig, source, &asked, cameras)
        });
        ends.store(true, Ordering::Release);
        result.unwrap()
    });
    assert!(!result.ok);
    (result.summary.reason, TimeNs(failed.into_inner()))
}

/// Ticks from `failed` until the arm, which moved, was paused, and from then on until it was at
/// rest; no limit is broken.
fn stops(log: &Path, failed: TimeNs) -> (u64, usize) {
    let log = RunLog::open(log).unwrap();
    assert!(replay(&log).unwrap().identical);
    let verified = verify(&log).unwrap();
    assert!(verified.ok, "{:?}", verified.violations);
    let fastest = |tick: &trocar_log::LoggedTick| tick.arms.first.command.velocity.amax();
    let before = log.ticks().filter(|(tick, _)| tick.now < failed);
    let moved = before.map(|(tick, _)| fastest(tick)).fold(0.0, f64::max);
    assert!(moved > 0.01, "{moved}");
    let paused =
        |tick: &trocar_log::LoggedTick| tick.arms.first.operator == Some(OperatorEvent::Pause);
    let mut after = log.ticks().skip_while(|(tick, _)| !paused(tick));
    let (paused, _) = after.next().unwrap();
    let mut after = after.zip(1..);
    let (_, rests) = after.find(|((tick, _), _)| fastest(tick) <= 0.0).unwrap();
    assert!(rests <= STOP_TICKS_MAX, "at rest after {rests} ticks");
    (paused.now.since(failed) / TICK_NS, rests)
}

/// Keeps and prints a row of the fault matrix.
#[expect(clippy::print_stdout, reason = "the rows are printed too")]
fn row(name: &str, fault: &str, said: &str, (paused, rests): (u64, usize)) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/scratch/fault-matrix");
    fs::create_dir_all(&folder).unwrap();
    let row = format!(
        "| a camera of a robot {fault} | `{said}` | {paused} | {rests} of {STOP_TICKS_MAX} | held | the run ends, exit code 1 |\n"
    );
    print!("{row}");
    fs::write(folder.join(name), row).unwrap();
}

struct Log(PathBuf);

impl Drop for Log {
    fn drop(&mut self) {
        let _gone = fs::remove_file(&self.0);
    }
}

/// Each keeps its row of the fault matrix (`tests/scripts/fault_matrix.py`).
#[test]
fn an_arm_whose_camera_fails_while_it_moves_comes_to_rest() {
    let silent = "camera scope has published no frame for 2 s";
    let cases = [
        (
            Fails::Freezes,
            "camera-freezes",
            "shows one exposure again and again",
            silent,
        ),
        (
            Fails::Repeats,
            "camera-repeats",
            "stamps the same pixels anew, `frozen_s = 0.5`",
            "camera scope has shown the very same pixels for 0.5 s",
        ),
        (
            Fails::Grows,
            "camera-grows",
            "shows frames of another size",
            "camera scope shows other frames than at first: 8 x 8 pixels",
        ),
        (
            Fails::Killed,
            "camera-killed",
            "is killed while it writes a frame",
            silent,
        ),
    ];
    for (fails, name, fault, said) in cases {
        let log = format!("trocar-{}-{fails:?}.mcap", std::process::id());
        let log = Log(std::env::temp_dir().join(log));
        // A machine that leaves the loop without the processor for long is a fault of its own.
        let mut runs = (0..RUNS_MAX).map(|_| run_with(fails, &log.0));
        let (reason, failed) = runs
            .find(|(reason, _)| !reason.starts_with("fault: "))
            .unwrap_or_default();
        assert_eq!(reason, said, "{fails:?}");
        row(name, fault, said, stops(&log.0, failed));
    }
}
