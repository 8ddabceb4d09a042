//! What a page is told of a run once: what it is, its arms, limits and cameras.

use hal::Pose;
use hal::joints::{INSERTION, JOINT_NAMES};
use serde::Serialize;
use serde_json::Value;
use trocar_control::{ControlConfig, rows};

use super::tap::{BUCKETS_US, PERIOD_BUCKETS_US};

/// What does not change while a run goes on.
#[derive(Clone, Debug, Serialize)]
pub struct Facts {
    kind: &'static str,
    /// Whether it is a log.
    log: bool,
    subject: Subject,
    title: String,
    policy: String,
    seed: u64,
    pub(super) arms: Vec<String>,
    axes: Vec<AxisFacts>,
    pub(super) cameras: Vec<String>,
    /// Of a log or a dataset, the cameras that have depth and ids.
    pub(super) depth: Vec<String>,
    /// Of a log, the cameras whose images are not in it but drawn.
    drawn: Vec<String>,
    /// Whether there is a scene in three dimensions.
    pub(super) scene: bool,
    /// Upper ends of the histograms' buckets, us.
    buckets_us: Vec<u64>,
    /// The same of periods.
    period_buckets_us: Vec<u64>,
    time_limit_s: Option<f64>,
    /// The picture in whose axes hands move, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    picture: Option<PictureFacts>,
    /// Of a log, how long it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) seconds: Option<f64>,
    /// Of a log, what happened.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) events: Vec<EventFacts>,
    /// Of a log, how the run ended.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) outcome: Option<EndFacts>,
    /// Of a dataset, its episodes and what they keep.
    #[serde(flatten)]
    dataset: Option<OfDataset>,
    /// Interfaces of the buses that the arms are on, and their bit rate, bit/s.
    #[serde(skip)]
    pub(super) buses: (Vec<String>, u32),
    #[serde(skip)]
    pub(super) rows: Vec<String>,
    /// Where the arms' remote centres are in the scene.
    #[serde(skip)]
    pub(super) rcms_in_scene: Vec<Pose>,
}

/// What is shown, which decides the panels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Subject {
    /// A run, which an operator may steer, or its log.
    Run,
    /// Episodes of a recording, which go on by themselves.
    Recording,
    /// Emulated drives.
    Drives,
    /// Episodes of a dataset.
    Dataset,
}

/// What a page is told of a dataset beside what it is told of a log.
#[derive(Clone, Debug, Serialize)]
pub(super) struct OfDataset {
    /// Frames a second.
    pub(super) fps: u32,
    pub(super) episodes: Vec<EpisodeFacts>,
}

/// One episode.
#[derive(Clone, Debug, Serialize)]
pub(super) struct EpisodeFacts {
    pub(super) frames: usize,
    /// From its first frame to its last.
    pub(super) seconds: f64,
    /// What happened in it.
    pub(super) events: Vec<EventFacts>,
    /// What the recording noted of it.
    pub(super) note: Option<Value>,
}

/// Between what an axis is drawn: rad, rad/s; m, m/s.
#[derive(Clone, Copy, Debug)]
pub(super) struct AxisRange {
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) velocity: f64,
}

impl AxisRange {
    /// The limits of joints and jaw.
    pub(super) fn limits(control: &ControlConfig) -> Vec<Self> {
        let axes = control.axes.iter().map(|limits| Self {
            low: limits.low,
            high: limits.high,
            velocity: limits.velocity,
        });
        axes.collect()
    }
}

/// A joint or the jaw.
#[derive(Clone, Debug, Serialize)]
struct AxisFacts {
    name: &'static str,
    unit: &'static str,
    low: f64,
    high: f64,
    velocity: f64,
}

/// A picture that a person moves the arms in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct PictureFacts {
    /// Its camera, in the order of all.
    pub(crate) camera: usize,
    /// How wide what it shows is, for each metre that it is away.
    pub(crate) wide: f64,
    /// The camera of the right eye, if there are two.
    pub(crate) right: Option<usize>,
}

/// Something that happened at a time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct EventFacts {
    pub(super) seconds: f64,
    pub(super) text: String,
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct EndFacts {
    pub(super) success: Option<bool>,
    pub(super) reason: String,
    /// What a person said of it, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) said: Option<String>,
}

impl Facts {
    /// Those of a run of `title` (its task, or what its limits are for) under `control`, which
    /// shows `cameras`.
    #[must_use]
    pub fn new(
        title: &str,
        policy: &str,
        seed: u64,
        control: &ControlConfig,
        cameras: Vec<String>,
    ) -> Self {
        let arms = control.arms.iter().map(|arm| arm.name.clone());
        Self {
            axes: axes(AxisRange::limits(control)),
            rows: rows::names(control),
            rcms_in_scene: control.arms.iter().map(|arm| arm.scene_from_rcm).collect(),
            ..Self::of(Subject::Run, (title, policy, seed), arms.collect(), cameras)
        }
    }

    /// Those of the drives of `arms`, in the world of `title` if they have one, which shows
    /// `cameras`.
    pub(crate) fn of_drives(title: &str, seed: u64, arms: &[&str], cameras: Vec<String>) -> Self {
        let arms = arms.iter().map(|&name| name.to_owned());
        Self::of(Subject::Drives, (title, "", seed), arms.collect(), cameras)
    }

    /// Those of a dataset of `title` (its task, and who made it) with these `arms`, whose axes are
    /// drawn in these ranges, and cameras, some of which keep depth and ids.
    pub(super) fn of_dataset(
        title: (&str, &str),
        arms: impl Iterator<Item = &'static str>,
        ranges: Vec<AxisRange>,
        (cameras, depth): (Vec<String>, Vec<String>),
        dataset: OfDataset,
    ) -> Self {
        let arms = arms.map(str::to_owned).collect();
        Self {
            axes: axes(ranges),
            log: true,
            depth,
            dataset: Some(dataset),
            ..Self::of(Subject::Dataset, (title.0, title.1, 0), arms, cameras)
        }
    }

    /// Those of `arms` without axes, filter and scene.
    fn of(
        subject: Subject,
        (title, policy, seed): (&str, &str, u64),
        arms: Vec<String>,
        cameras: Vec<String>,
    ) -> Self {
        Self {
            kind: "facts",
            log: false,
            subject,
            title: title.to_owned(),
            policy: policy.to_owned(),
            seed,
            arms,
            axes: Vec::new(),
            cameras,
            depth: Vec::new(),
            drawn: Vec::new(),
            scene: false,
            buckets_us: BUCKETS_US.to_vec(),
            period_buckets_us: PERIOD_BUCKETS_US.to_vec(),
            time_limit_s: None,
            picture: None,
            seconds: None,
            events: Vec::new(),
            outcome: None,
            dataset: None,
            buses: (Vec::new(), 0),
            rows: Vec::new(),
            rcms_in_scene: Vec::new(),
        }
    }

    /// The same of an episode that is recorded.
    pub(crate) const fn of_recording(mut self) -> Self {
        self.subject = Subject::Recording;
        self
    }

    /// The same of a task that is given up after so long.
    #[must_use]
    pub fn within_s(mut self, time_limit_s: f64) -> Self {
        self.time_limit_s = Some(time_limit_s);
        self
    }

    /// The same of arms on these CAN interfaces, whose buses have this bit rate, bit/s.
    pub(crate) fn on_buses(mut self, interfaces: Vec<String>, bit_rate: u32) -> Self {
        self.buses = (interfaces, bit_rate);
        self
    }

    /// The same with the picture in whose axes hands move.
    pub(crate) const fn moved_in(mut self, picture: Option<PictureFacts>) -> Self {
        self.picture = picture;
        self
    }

    /// The same with a scene to look at.
    #[must_use]
    pub fn with_scene(mut self) -> Self {
        self.scene = true;
        self
    }

    /// The same of a log in whose scene these cameras are: what they saw is drawn from there, but
    /// for images in the log.
    pub(super) fn drawn(mut self, cameras: Vec<String>) -> Self {
        let others = cameras.iter();
        let others = others.filter(|name| !self.cameras.contains(name));
        self.drawn = others.cloned().collect();
        self.cameras.extend(self.drawn.iter().cloned());
        self.depth = cameras;
        self
    }

    /// The same of a log.
    pub(super) fn of_log(mut self, seconds: f64) -> Self {
        self.log = true;
        self.seconds = Some(seconds);
        self
    }

    /// As a page and the monitor get it.
    pub(super) fn json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// Joints and jaw in these ranges.
fn axes(ranges: Vec<AxisRange>) -> Vec<AxisFacts> {
    let names = JOINT_NAMES.into_iter().chain(["jaw"]);
    let axes = names.zip(ranges).enumerate();
    let axes = axes.map(|(index, (name, range))| AxisFacts {
        name,
        unit: if index == INSERTION { "m" } else { "rad" },
        low: range.low,
        high: range.high,
        velocity: range.velocity,
    });
    axes.collect()
}
