//! Logs of arms that do as a formula says, and of cameras whose pixels say which frame they are.

use std::path::{Path, PathBuf};

use hal::psm::HOME_INSERTION_M;
use hal::{
    ArmCommand, ArmState, CameraFrame, Intrinsics, JointVector, PerArm, TICK_NS, TimeNs, TipTarget,
};
use trocar_control::kinematics::forward;
use trocar_control::{Mode, OperatingState, OperatorEvent, QpOutcome, TickReport};
use trocar_log::{
    ArmRecord, Pressure, Recorder, RunHeader, RunNote, RunOutcome, TickRecord, TickTiming, Writing,
};

use super::super::LogImportOptions;

/// A camera of a log.
pub(super) struct Feed {
    pub(super) name: &'static str,
    /// Width and height, pixels.
    pub(super) side: u32,
    pub(super) stamps_ns: Vec<u64>,
}

impl Feed {
    pub(super) fn new(name: &'static str, stamps_ns: Vec<u64>) -> Self {
        Self {
            name,
            side: 8,
            stamps_ns,
        }
    }
}

/// What a log is of; as it stands a robot of one arm and one camera, run for a second.
pub(super) struct HandMade {
    pub(super) arms: usize,
    pub(super) ticks: u64,
    pub(super) task: &'static str,
    pub(super) success: Option<bool>,
    pub(super) cameras: Vec<Feed>,
    /// What the operator asks for, and in which tick.
    pub(super) events: Vec<(u64, OperatorEvent)>,
    /// Changes the record of a tick before it is written.
    pub(super) change: fn(&mut TickRecord),
    /// Whether the log has a bound, which leaves nothing but its end.
    pub(super) bounded: bool,
    /// Whether the run says how it ended.
    pub(super) ends: bool,
    /// What the operator said of it.
    pub(super) said: RunNote,
    /// What the log calls its policy.
    pub(super) policy: &'static str,
    /// What the operator's hands did.
    pub(super) teleop: Option<&'static str>,
}

impl Default for HandMade {
    fn default() -> Self {
        Self {
            arms: 1,
            ticks: 1200,
            task: "",
            success: None,
            cameras: vec![Feed::new("endoscope", jittered(30, 1200, 0))],
            events: Vec::new(),
            change: |_| {},
            bounded: false,
            ends: true,
            said: RunNote::default(),
            policy: "runs/act",
            teleop: None,
        }
    }
}

/// Stamps of `rate_hz` over so many milliseconds, ns, each up to 4 ms early or late, and never
/// halfway between two ticks.
pub(super) fn jittered(rate_hz: u64, long_ms: u64, from: u64) -> Vec<u64> {
    let count = rate_hz * long_ms / 1000;
    let stamps = (0..count).map(|index| {
        let even = 5_000_000 + index * 1_000_000_000 / rate_hz;
        let jitter = (index + from) * 7919 % 81;
        even / 100_000 * 100_000 + 30_000 + 100_000 * jitter - 4_000_000
    });
    stamps.collect()
}

/// The colour of the frame at this place among those of its camera.
pub(super) fn colour_of(camera: usize, place: usize) -> [u8; 3] {
    [place % 256, place / 256, camera].map(|value| u8::try_from(value).unwrap())
}

fn small(tick: u64) -> f64 {
    f64::from(u32::try_from(tick).unwrap()) * 1e-5
}

/// Where the arm is measured in a tick, and its jaw: rad, m.
pub(super) fn measured(arm: usize, tick: u64) -> (JointVector, f64) {
    let side = if arm == 0 { 1.0 } else { -1.0 };
    let moved = small(tick);
    let position = JointVector::new(
        side * moved,
        -0.5 * moved,
        HOME_INSERTION_M,
        moved,
        0.0,
        0.1,
    );
    (position, 0.3 + moved)
}

/// Where it is commanded to be in the same tick.
pub(super) fn commanded(arm: usize, tick: u64) -> TipTarget {
    let (position, jaw) = measured(arm, tick + 3);
    TipTarget::new(&forward(&position), jaw)
}

/// Where its chunks want it to be.
pub(super) fn target(arm: usize, tick: u64) -> TipTarget {
    let (position, jaw) = measured(arm, tick + 50);
    TipTarget::new(&forward(&position), jaw)
}

impl HandMade {
    /// Writes the log at `path`.
    pub(super) fn write(&self, path: &Path) -> PathBuf {
        let versions = [("commit", "c0ffee"), ("weights_sha256", "5a")];
        let header = RunHeader {
            task: self.task.to_owned(),
            policy: self.policy.to_owned(),
            versions: versions
                .map(|(name, it)| (name.to_owned(), it.to_owned()))
                .into(),
            ..RunHeader::default()
        };
        let writing = Writing {
            bytes_max: self.bounded.then_some(1),
            ..Writing::new(Pressure::Block)
        };
        let mut recorder = Recorder::create_with(path, &header, writing).unwrap();
        for tick in 0..self.ticks {
            let mut record = self.tick(tick);
            (self.change)(&mut record);
            recorder.tick(&record);
            self.frames(tick, &mut recorder);
        }
        let outcome = RunOutcome {
            success: self.success,
            reason: "the 1 s are over".to_owned(),
            command_hash: "0123456789abcdef".to_owned(),
            said: self.said.clone(),
            teleop: self.teleop.map(str::to_owned),
        };
        recorder.finish(self.ends.then_some(&outcome)).unwrap();
        path.to_owned()
    }

    /// Hands over the frames that come 20 ms after they were taken in this tick.
    fn frames(&self, tick: u64, recorder: &mut Recorder) {
        let due = (tick * TICK_NS)..((tick + 1) * TICK_NS);
        for (index, camera) in self.cameras.iter().enumerate() {
            for (place, stamp) in camera.stamps_ns.iter().enumerate() {
                if !due.contains(&(stamp + 20 * TICK_NS)) {
                    continue;
                }
                let lens = Intrinsics::from_vertical_fov(camera.side, camera.side, 0.9);
                let mut frame = CameraFrame::blank(lens);
                frame.stamp = TimeNs(*stamp);
                let pixels = frame.colour.chunks_exact_mut(3);
                pixels.for_each(|pixel| pixel.copy_from_slice(&colour_of(index, place)));
                recorder.frame(camera.name, &frame);
            }
        }
    }

    fn tick(&self, tick: u64) -> TickRecord {
        let arms = (0..self.arms).map(|arm| self.arm(arm, tick));
        TickRecord {
            tick,
            now: TimeNs::from_tick(tick),
            arms: PerArm::collect(arms).unwrap(),
            timing: TickTiming::default(),
        }
    }

    fn arm(&self, arm: usize, tick: u64) -> ArmRecord {
        let now = TimeNs::from_tick(tick);
        let (position, jaw) = measured(arm, tick);
        let (sent, jaw_sent) = measured(arm, tick + 3);
        // The run's last half second: the arms rest.
        let state = match tick {
            0..200 => OperatingState::Disabled,
            _ if tick + 500 >= self.ticks && self.ticks > 2000 => OperatingState::Paused,
            _ => OperatingState::Enabled,
        };
        let asked_from = if arm == 0 { 300 } else { 340 };
        let asked = tick >= asked_from && state == OperatingState::Enabled;
        let mut events = self.events.iter();
        ArmRecord {
            measured: Ok(ArmState::at_rest(now, position, jaw)),
            operator: events.find(|it| it.0 == tick).map(|it| it.1),
            chunk_sequence: None,
            command: ArmCommand {
                stamp: now.plus_ns(TICK_NS),
                position: sent,
                velocity: JointVector::zeros(),
                acceleration: JointVector::zeros(),
                jaw_position: jaw_sent,
                jaw_velocity: 0.0,
                enabled: state != OperatingState::Disabled,
            },
            report: TickReport {
                mode: Mode {
                    state,
                    homed: true,
                    busy: true,
                },
                gate: None,
                qp: QpOutcome::NotNeeded,
                rows_active: 0,
                correction: 0.0,
                guard_intervened: false,
                target: asked.then(|| target(arm, tick)),
                fault: None,
            },
        }
    }
}

/// The import of `logs` into the folder `demos` in `folder`.
pub(super) fn options(folder: &Path, logs: &[&PathBuf]) -> LogImportOptions {
    LogImportOptions {
        logs: logs.iter().map(|log| (*log).clone()).collect(),
        out: folder.join("demos"),
        task: "Lift the needle".to_owned(),
        fps: 25,
        cameras: Vec::new(),
        size: None,
        video: None,
        failures: false,
    }
}
