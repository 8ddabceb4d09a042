//! An external policy that swings the tip to and fro, and misbehaves when it is told to.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::thread::{self, JoinHandle};

use hal::{Chunk, TICK_NS, TimeNs, TipTarget};
use nalgebra::Translation3;
use trocar::rt::{MonotonicClock, sleep_ns};
use trocar::session::source::STEP_NS;
use trocar_topics::{
    ArmReport, ArmStateTopic, ChunkTopic, Line, PolicyHello, PolicyHelloTopic, PolicyStage,
    PolicyStatus, PolicyStatusTopic, Publisher, RunCommand, RunControlTopic, Subscriber, TopicNode,
};

const ARM: &str = "psm1";
/// Policy steps from one answer to the next, and of a chunk.
const EVERY_STEPS: u64 = 5;
const CHUNK_STEPS: u64 = 25;
/// Ticks that a chunk lasts.
pub(crate) const CHUNK_TICKS: usize = 1000;
const _: () = assert!(CHUNK_TICKS as u64 * TICK_NS == CHUNK_STEPS * STEP_NS);
/// How far it swings, m, and how long that takes, s.
const SWING_M: f64 = 0.01;
const PERIOD_S: f64 = 1.6;
/// How far another place is, m.
const ELSEWHERE_M: f64 = 0.03;
/// Longer than the gate lets an observation be old.
const SLOW_NS: u64 = 2_500 * TICK_NS;
const STATUS_EVERY_NS: u64 = 50 * TICK_NS;

/// What it does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Manner {
    /// It answers.
    Good,
    /// It answers with NaN.
    NotFinite,
    /// It says its first answer again and again.
    Replays,
    /// It takes longer to answer than an observation may be old.
    Slow,
    /// What it asks for is 30 mm from where it was.
    Elsewhere,
}

/// What it says that it is for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asks {
    pub(crate) arms: u64,
    pub(crate) camera: Option<&'static str>,
    pub(crate) every_steps: u64,
}

impl Asks {
    /// One arm, no camera.
    pub(crate) const fn usual() -> Self {
        Self {
            arms: 1,
            camera: None,
            every_steps: EVERY_STEPS,
        }
    }
}

/// The policy in a thread of its own, which leaves the topics when this is dropped.
pub(crate) struct Performer {
    manner: Arc<AtomicU8>,
    leaves: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Performer {
    pub(crate) fn appear(topics: &str) -> Self {
        Self::asking(topics, Asks::usual())
    }

    pub(crate) fn asking(topics: &str, asks: Asks) -> Self {
        let (manner, leaves) = (Arc::new(AtomicU8::new(0)), Arc::new(AtomicBool::new(false)));
        let stage = Stage::open(topics, asks, Arc::clone(&manner), Arc::clone(&leaves));
        Self {
            manner,
            leaves,
            thread: Some(thread::spawn(move || stage.perform())),
        }
    }

    pub(crate) fn behave(&self, manner: Manner) {
        self.manner.store(manner as u8, Ordering::Release);
    }
}

impl Drop for Performer {
    fn drop(&mut self) {
        self.leaves.store(true, Ordering::Release);
        let _ended = self.thread.take().map(JoinHandle::join);
    }
}

struct Stage {
    _node: TopicNode,
    control: Subscriber<trocar_topics::RunControl>,
    reports: Subscriber<ArmReport>,
    hello: Publisher<PolicyHello>,
    status: Publisher<PolicyStatus>,
    chunks: Publisher<Chunk>,
    manner: Arc<AtomicU8>,
    leaves: Arc<AtomicBool>,
    home: Option<TipTarget>,
    /// When it first saw the arm, there.
    begun: Option<TimeNs>,
    first: Option<Chunk>,
    sequence: u64,
    turn: Option<u64>,
}

impl Stage {
    fn open(topics: &str, asks: Asks, manner: Arc<AtomicU8>, leaves: Arc<AtomicBool>) -> Self {
        let node = TopicNode::join(topics).unwrap();
        let hello = PolicyHelloTopic::publisher(&node, ARM).unwrap();
        let mut said = PolicyHello {
            pid: u64::from(std::process::id()),
            arm_count: asks.arms,
            query_every_steps: asks.every_steps,
            camera_count: u64::from(asks.camera.is_some()),
            name: Line::new("swings"),
            ..PolicyHello::default()
        };
        said.cameras[0] = asks.camera.map_or_else(Line::default, Line::new);
        hello.publish(&said).unwrap();
        Self {
            control: RunControlTopic::subscriber(&node, ARM).unwrap(),
            reports: ArmStateTopic::subscriber(&node, ARM).unwrap(),
            status: PolicyStatusTopic::publisher(&node, ARM).unwrap(),
            chunks: ChunkTopic::publisher(&node, ARM).unwrap(),
            hello,
            _node: node,
            manner,
            leaves,
            home: None,
            begun: None,
            first: None,
            sequence: 0,
            turn: None,
        }
    }

    fn perform(mut self) {
        let clock = MonotonicClock::new();
        let (mut episode, mut said, mut count) = (0, TimeNs(0), 0);
        while !self.leaves.load(Ordering::Acquire) {
            self.hello.keep_alive().unwrap();
            if let Some(control) = self.control.newest().unwrap()
                && matches!(control.command(), Some(RunCommand::Run { .. }))
            {
                episode = control.episode;
            }
            if episode > 0 && clock.now().since(said) > STATUS_EVERY_NS {
                (said, count) = (clock.now(), count + 1);
                let ready = PolicyStage::Ready;
                let status = PolicyStatus::new(count, episode, ready, self.sequence, 1);
                self.status.publish(&status).unwrap();
            }
            if let Some(report) = self.reports.newest().unwrap()
                && episode > 0
                && self.turn != Some(report.sequence / EVERY_STEPS)
            {
                self.turn = Some(report.sequence / EVERY_STEPS);
                self.answer(&report);
            }
            sleep_ns(TICK_NS);
        }
    }

    fn answer(&mut self, report: &ArmReport) {
        let manner = self.manner.load(Ordering::Acquire);
        if manner == Manner::Slow as u8 {
            sleep_ns(SLOW_NS);
        }
        let jaw = report.jaw_position;
        let here = TipTarget::new(&report.tip_in_rcm(), jaw);
        let home = self.home.get_or_insert(here).tip_in_rcm();
        let begun = self.begun.get_or_insert(report.stamp).seconds();
        let elsewhere = if manner == Manner::Elsewhere as u8 {
            ELSEWHERE_M
        } else {
            0.0
        };
        let at = |step: u64| {
            let seconds = TimeNs(report.stamp.0 + step * STEP_NS).seconds();
            let aside = SWING_M * (core::f64::consts::TAU * (seconds - begun) / PERIOD_S).sin();
            let aside = aside + elsewhere;
            let jaw = if manner == Manner::NotFinite as u8 {
                f64::NAN
            } else {
                jaw
            };
            TipTarget::new(&(Translation3::new(aside, 0.0, 0.0) * home), jaw)
        };
        self.sequence += 1;
        let targets: Vec<TipTarget> = (0..CHUNK_STEPS).map(at).collect();
        let fresh = Chunk::new(report.stamp, self.sequence, STEP_NS, &targets);
        let first = *self.first.get_or_insert(fresh);
        let said = if manner == Manner::Replays as u8 {
            first
        } else {
            fresh
        };
        self.chunks.publish(&said).unwrap();
    }
}
