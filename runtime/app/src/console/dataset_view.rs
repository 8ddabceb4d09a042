//! A dataset as pages see it, episode by episode: numbers are in memory, images are read from disk
//! and decoded as they are looked at.

use std::path::Path;

use axum::body::Bytes;
use hal::joints::ROLL;
use hal::{JointVector, TimeNs, arm_names};
use serde::Serialize;
use serde_json::Value;
use trocar_control::ControlConfig;
use trocar_control::kinematics::inverse;
use trocar_data::dataset::{
    ACTION_WIDTH, CameraSpec, Dataset, Episode, Notes, STATE_WIDTH, TIP_POSE_WIDTH,
};
use trocar_data::relative_action::pose_from_numbers;
use trocar_tasks::task::TaskFiles;

use super::dataset_scene::DatasetScene;
use super::drawn::{Drawn, Pixels, Plane, Stream};
use super::facts::{AxisRange, EpisodeFacts, EventFacts, Facts, OfDataset};
use super::{encode, path};
use crate::session::{PolicyChoice, SessionError, Setup};

/// How far ahead a path shows the actions, s.
const PATH_S: u32 = 1;

/// Frames that it has at most, whatever rate a dataset says it has.
const PATH_FRAMES_MAX: usize = 1000;

/// Room at either end of a range that values alone tell, rad and m.
const ROOM: f64 = 1e-3;

/// A dataset that is looked through.
#[derive(Debug)]
pub(super) struct DatasetView {
    facts: Facts,
    dataset: Dataset,
    /// Of each episode, whether an operator drove in each frame; empty if the dataset does not say.
    by_hand: Vec<Vec<bool>>,
    /// None of arms of which it is not known how they stand to one another.
    scene: Option<DatasetScene>,
}

/// Where a page looks: an episode, and a time in it, s.
pub(super) type Place = (usize, f64);

/// One frame, without images.
#[derive(Serialize)]
struct Frame {
    kind: &'static str,
    episode: usize,
    /// Of the episode, from 0.
    frame: usize,
    seconds: f64,
    /// Whether an operator drove, if the dataset says so.
    by_hand: Option<bool>,
    arms: Vec<ArmOfFrame>,
    /// Where the actions from here on lead, arm by arm.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    paths: Vec<path::Path>,
}

/// One arm; joint angles rad, insertion m, the jaw last.
#[derive(Serialize)]
struct ArmOfFrame {
    name: &'static str,
    measured: [f64; STATE_WIDTH],
    /// Against the frame before; rad/s, m/s.
    measured_velocity: [f64; STATE_WIDTH],
    /// What the action asks for, by inverse kinematics; none where there is no solution.
    wanted: Option<[f64; STATE_WIDTH]>,
    /// Measured, in the RCM frame: x, y, z, m; quaternion x, y, z, w.
    tip: [f64; TIP_POSE_WIDTH],
    /// The same of the command, and the jaw, rad.
    action: [f64; ACTION_WIDTH],
}

impl DatasetView {
    /// Reads the dataset in the folder `dir`.
    ///
    /// # Errors
    /// [`SessionError::Dataset`] if it is none or is damaged.
    pub(super) fn read(dir: &Path) -> Result<Self, SessionError> {
        let dataset = Dataset::open(dir)?;
        let notes = Notes::read(dir)?;
        let by_hand: Vec<Vec<bool>> = if dataset.spec().intervention {
            let episodes = dataset.episodes().iter();
            let read = episodes.map(|episode| dataset.interventions(*episode));
            read.collect::<Result<_, _>>()?
        } else {
            Vec::new()
        };
        let setup = setup(&dataset);
        let scene = DatasetScene::new(&dataset, &notes, setup.as_ref());
        let limits = setup.map(|setup| setup.robot.control);
        let facts = facts(&dataset, (&notes, limits.as_ref()), &by_hand);
        Ok(Self {
            facts: match &scene {
                Some(_) => facts.with_scene(),
                None => facts,
            },
            dataset,
            by_hand,
            scene,
        })
    }

    /// The scene's file, if there is a scene.
    pub(super) fn scene_file(&self) -> Option<Bytes> {
        let first = self.dataset.episodes().first()?;
        self.scene.as_ref()?.file(&self.dataset, first.start)
    }

    /// What a page is told first.
    pub(super) fn facts(&self) -> String {
        self.facts.json()
    }

    /// How many episodes there are.
    pub(super) fn episodes(&self) -> usize {
        self.dataset.episodes().len()
    }

    /// The frame at `place`, counted from the dataset's first; none if there is no such episode.
    pub(super) fn frame(&self, (episode, seconds): Place) -> Option<usize> {
        let episode = self.dataset.episodes().get(episode)?;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates, which is the episode's end or its beginning"
        )]
        let within = (seconds * f64::from(self.dataset.fps())).round() as usize;
        Some(episode.start + within.min(episode.len - 1))
    }

    /// What a page is told of the frame at `place`.
    pub(super) fn state(&self, place: Place) -> Option<String> {
        let frame = self.frame(place)?;
        let (index, _) = place;
        let episode = self.dataset.episodes().get(index)?;
        let within = frame - episode.start;
        let by_hand = self.by_hand.get(index).and_then(|flags| flags.get(within));
        let arms = arm_names(self.dataset.arms()).enumerate();
        let last = episode.start + episode.len - 1;
        let paths = self.scene.as_ref().map(|scene| {
            let end = last.min(frame + self.path_frames());
            scene.paths(&self.dataset, (frame, end), &self.facts.cameras)
        });
        let told = Frame {
            kind: "frame",
            episode: index,
            frame: within,
            seconds: seconds_of(within, self.dataset.fps()),
            by_hand: by_hand.copied(),
            arms: arms
                .map(|(arm, name)| self.arm(name, *episode, frame, arm))
                .collect(),
            paths: paths.unwrap_or_default(),
        };
        serde_json::to_string(&told).ok()
    }

    /// How many frames a path is long: some chunk's time.
    fn path_frames(&self) -> usize {
        ((PATH_S * self.dataset.fps()) as usize).min(PATH_FRAMES_MAX)
    }

    /// One arm in a frame; velocities are differences, 0 in an episode's first frame.
    fn arm(&self, name: &'static str, episode: Episode, frame: usize, arm: usize) -> ArmOfFrame {
        let state = |frame| self.dataset.state(frame, arm).map(f64::from);
        let (measured, fps) = (state(frame), f64::from(self.dataset.fps()));
        let before = state(frame.saturating_sub(1).max(episode.start));
        let action = self.dataset.action(frame, arm);
        ArmOfFrame {
            name,
            measured,
            measured_velocity: std::array::from_fn(|axis| (measured[axis] - before[axis]) * fps),
            wanted: joints_of(&action, measured[ROLL]),
            tip: self.dataset.tip_pose(frame, arm),
            action,
        }
    }

    /// The image of `stream` in a frame as pages get it, or where everything is in it; none if the
    /// dataset does not keep it.
    ///
    /// # Errors
    /// [`SessionError`] if the file that holds it is damaged.
    pub(super) fn picture(
        &self,
        stream: Stream,
        frame: usize,
    ) -> Result<Option<Bytes>, SessionError> {
        let [_, within] = self.dataset.place(frame);
        let stamp = TimeNs(within as u64 * 1_000_000_000 / u64::from(self.dataset.fps()));
        if stream == Stream::SCENE {
            let scene = self.scene.as_ref();
            let places = scene.map(|scene| scene.places(&self.dataset, frame, stamp));
            return places.transpose();
        }
        let camera = usize::from(stream.camera);
        let Some(spec) = self.dataset.spec().cameras.get(camera) else {
            return Ok(None);
        };
        let pixels = match (stream.plane, spec.depth) {
            (Plane::Colour, _) => Pixels::Colour(self.dataset.image_rgb(frame, camera)?.into_raw()),
            (Plane::Depth | Plane::Ids, None) => return Ok(None),
            (Plane::Depth, Some(_)) => {
                Pixels::Depth(self.dataset.depth(frame, camera)?.into_frame().depth_m)
            }
            (Plane::Ids, Some(_)) => Pixels::Ids(self.dataset.depth(frame, camera)?.instance),
        };
        let drawn = Drawn {
            stream,
            stamp,
            width: spec.width,
            height: spec.height,
            pixels,
        };
        Ok(encode::message(&drawn).map(Bytes::from))
    }
}

/// What does not change, of arms with these `limits` if they are known.
fn facts(
    dataset: &Dataset,
    (notes, limits): (&Notes, Option<&ControlConfig>),
    by_hand: &[Vec<bool>],
) -> Facts {
    let noted = |index: usize| {
        let is_of = |note: &&Value| note["episode_index"] == index;
        notes.episodes.iter().find(is_of).cloned()
    };
    let episodes = dataset.episodes().iter().enumerate();
    let episodes = episodes.map(|(index, episode)| EpisodeFacts {
        frames: episode.len,
        seconds: seconds_of(episode.len - 1, dataset.fps()),
        events: by_hand
            .get(index)
            .map_or_else(Vec::new, |flags| changes(flags, dataset.fps())),
        note: noted(index),
    });
    let keeps_depth = |camera: &&CameraSpec| camera.depth.is_some();
    let cameras = dataset.spec().cameras.iter();
    let depth = cameras
        .filter(keeps_depth)
        .map(|camera| camera.name.clone())
        .collect();
    let told = OfDataset {
        fps: dataset.fps(),
        episodes: episodes.collect(),
    };
    let recorded = |key: &str| notes.recording.as_ref().and_then(|note| note[key].as_str());
    let source = recorded("source").unwrap_or_default();
    let arms = arm_names(dataset.arms());
    let ranges = || (0..STATE_WIDTH).map(|axis| range(dataset, axis)).collect();
    let axes = limits.map_or_else(ranges, AxisRange::limits);
    let title = (dataset.task(), source);
    let cameras = (dataset.camera_names().to_vec(), depth);
    Facts::of_dataset(title, arms, axes, cameras, told)
}

/// The dataset's task with the limits of its arms, if it is a built-in one.
fn setup(dataset: &Dataset) -> Option<Setup> {
    // A dataset's word for its task is no path to look into.
    let _built_in = TaskFiles::built_in(dataset.task())?;
    let setup = Setup::load(dataset.task(), None, &PolicyChoice::Noop).ok()?;
    (setup.robot.control.arms.len() == dataset.arms()).then_some(setup)
}

/// Between which values an axis is in all frames, widened by `ROOM`, and 1 rad/s or m/s: what is
/// shown of arms whose limits are not known.
fn range(dataset: &Dataset, axis: usize) -> AxisRange {
    let frames = 0..dataset.len();
    let arms = 0..dataset.arms();
    let all = frames.flat_map(|frame| arms.clone().map(move |arm| (frame, arm)));
    let values = || {
        all.clone()
            .map(|(frame, arm)| f64::from(dataset.state(frame, arm)[axis]))
    };
    AxisRange {
        low: values().fold(f64::INFINITY, f64::min) - ROOM,
        high: values().fold(f64::NEG_INFINITY, f64::max) + ROOM,
        velocity: 1.0,
    }
}

/// When another began to drive.
fn changes(by_hand: &[bool], fps: u32) -> Vec<EventFacts> {
    let mut before = None;
    let mut events = Vec::new();
    for (frame, drives) in by_hand.iter().enumerate() {
        if before.replace(*drives) != Some(*drives) {
            let who = if *drives { "operator" } else { "policy" };
            events.push(EventFacts {
                seconds: seconds_of(frame, fps),
                text: format!("the {who} drives"),
            });
        }
    }
    events
}

/// The joints with the jaw that put the tip where `action` wants it, the roll near `roll`.
fn joints_of(action: &[f64; ACTION_WIDTH], roll: f64) -> Option<[f64; STATE_WIDTH]> {
    let [x, y, z, a, b, c, w, jaw] = *action;
    let joints: JointVector = inverse(&pose_from_numbers(&[x, y, z, a, b, c, w]), roll).ok()?;
    let value = |axis: usize| joints.get(axis).copied().unwrap_or(jaw);
    Some(std::array::from_fn(value))
}

/// From an episode's first frame.
#[expect(clippy::cast_precision_loss, reason = "frames of an episode")]
fn seconds_of(frame: usize, fps: u32) -> f64 {
    frame as f64 / f64::from(fps)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_drives_is_told_where_it_changes() {
        let changes = changes(&[false, false, true, true, false], 25);
        let told: Vec<_> = changes
            .iter()
            .map(|event| (event.seconds, event.text.as_str()))
            .collect();
        let [policy, operator] = ["the policy drives", "the operator drives"];
        assert_eq!(told, [(0.0, policy), (0.08, operator), (0.16, policy)]);
    }

    /// Joints that the inverse kinematics finds reach the action's tip; what is at the remote
    /// centre has none.
    #[test]
    fn an_action_has_joints_or_none() {
        let joints = JointVector::new(0.1, -0.2, 0.12, 0.4, 0.2, -0.3);
        let target = hal::TipTarget::new(&trocar_control::kinematics::forward(&joints), 0.25);
        let [x, y, z, a, b, c, w] = target.pose_numbers();
        let found = joints_of(&[x, y, z, a, b, c, w, 0.25], 0.35).unwrap();
        for (found, joint) in found.iter().zip(joints.iter().chain([&0.25])) {
            assert!((found - joint).abs() < 1e-6, "{found} {joint}");
        }
        assert_eq!(
            joints_of(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0], 0.0),
            None
        );
    }
}
