//! The scene of a dataset: the instruments where its arms were measured, and of its task what does
//! not move, as far as that is known.
//!
//! A dataset holds no scene. If it was recorded by this program with the very scene file that is
//! built in, ground and cameras are that file's; of another recording of a built-in task the arms
//! stand as the task has them, with its limits; a single arm of another task hangs above the middle
//! of what is shown.

use std::fmt;
use std::sync::{Mutex, MutexGuard, PoisonError};

use axum::body::Bytes;
use hal::config::Source;
use hal::{Pose, TimeNs};
use nalgebra::Point3;
use serde_json::Value;
use trocar_control::config::ArmConfig;
use trocar_data::dataset::{Dataset, Notes};
use trocar_tasks::cameras::SceneModel;
use trocar_tasks::scene::SceneSnapshot;
use trocar_tasks::task::{Variation, View};

use super::path::{self, Lenses, Path};
use super::scene;
use crate::digest::hash_text;
use crate::session::changes::{Change, Changes, ConfigFile};
use crate::session::{SessionError, Setup};

/// Height of the remote centre of an arm of which it is not known where it stands, m: about as far
/// as instruments reach.
const RCM_M: f64 = 0.12;

/// What is known of the scene of a dataset.
pub(super) struct DatasetScene {
    /// Where the arms' remote centres are in the scene.
    rcms_in_scene: Vec<Pose>,
    /// Their limits, if they are known.
    arms: Vec<ArmConfig>,
    model: Mutex<SceneModel>,
}

impl fmt::Debug for DatasetScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DatasetScene")
            .field("rcms_in_scene", &self.rcms_in_scene)
            .finish_non_exhaustive()
    }
}

impl DatasetScene {
    /// That of `dataset` with its `notes`, whose task is that of `setup` if it is a built-in one;
    /// none of two arms of another.
    pub(super) fn new(dataset: &Dataset, notes: &Notes, setup: Option<&Setup>) -> Option<Self> {
        let count = dataset.arms();
        let arms = setup.map_or_else(Vec::new, |setup| setup.robot.control.arms.clone());
        let rcms_in_scene: Vec<Pose> = match setup {
            Some(_) => arms.iter().map(|arm| arm.scene_from_rcm).collect(),
            None if count == 1 => vec![Pose::translation(0.0, 0.0, RCM_M)],
            None => return None,
        };
        let model = setup.and_then(|setup| at_rest(notes, setup));
        Some(Self {
            rcms_in_scene,
            arms,
            model: Mutex::new(model.unwrap_or_else(|| SceneModel::of_arms(count))),
        })
    }

    /// The scene's file, with everything as it is in a frame, counted from the dataset's first.
    pub(super) fn file(&self, dataset: &Dataset, frame: usize) -> Option<Bytes> {
        let start = self.snapshot(dataset, frame);
        scene::file(&self.model(), &start, &self.arms).ok()
    }

    /// Where everything is in a frame, at `stamp`, as pages are told.
    ///
    /// # Errors
    /// If an arm that carries a camera is not there.
    pub(super) fn places(
        &self,
        dataset: &Dataset,
        frame: usize,
        stamp: TimeNs,
    ) -> Result<Bytes, SessionError> {
        let snapshot = self.snapshot(dataset, frame);
        let message = scene::message(&mut self.model(), &snapshot, stamp)?;
        Ok(message.into())
    }

    /// Where the actions from the frame `first` to `last` lead, arm by arm, in the scene and in
    /// those pictures of the cameras `names` that are known.
    pub(super) fn paths(
        &self,
        dataset: &Dataset,
        (first, last): (usize, usize),
        names: &[String],
    ) -> Vec<Path> {
        let mut lenses = Lenses::new();
        let snapshot = self.snapshot(dataset, first);
        scene::add_lenses(&self.model(), &snapshot, names, &mut lenses);
        let arms = self.rcms_in_scene.iter().enumerate();
        let paths = arms.map(|(arm, base)| {
            let points: Vec<_> = (first..=last)
                .map(|frame| {
                    let [x, y, z, ..] = dataset.action(frame, arm);
                    base * Point3::new(x, y, z)
                })
                .collect();
            path::through(&points, &lenses)
        });
        paths.collect()
    }

    fn snapshot(&self, dataset: &Dataset, frame: usize) -> SceneSnapshot {
        let bases = self.rcms_in_scene.iter().copied().enumerate();
        let state = |arm| dataset.state(frame, arm).map(f64::from);
        scene::of_arms(bases.map(|(arm, base)| (base, state(arm))))
    }

    fn model(&self) -> MutexGuard<'_, SceneModel> {
        self.model.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What does not move in the scene of `setup`, if the options of the recording in `notes` say that
/// it was recorded with this very file; with its cameras if these were the same in all episodes.
fn at_rest(notes: &Notes, setup: &Setup) -> Option<SceneModel> {
    let options = notes.options.as_ref()?;
    let scene = setup.robot.texts.scene.as_deref()?;
    // Neither shading changes a shape.
    let plain: Change = "scene.rendering.shading=plain".parse().ok()?;
    let source = Source::embedded("scene.toml", scene);
    let plain = Changes(vec![plain]).apply(ConfigFile::Scene, source).ok()?;
    let hash = options["files"]["scene.toml"].as_str()?;
    if ![scene, plain.text()]
        .map(hash_text)
        .contains(&hash.to_owned())
    {
        return None;
    }
    let fixed = [View::Train, View::View2];
    let view = fixed
        .into_iter()
        .find(|view| options["view"] == view.name());
    let task = setup.task.clone().with_view(view.unwrap_or_default());
    let model = SceneModel::at_rest(&task.ok()?, 0);
    let varied = options["varied"].as_array();
    let moves = |name: &Value| {
        let moves = [Variation::Views, Variation::Lens, Variation::Distortion];
        moves.iter().any(|it| name == it.name())
    };
    let is_fixed = varied.is_some_and(|names| !names.iter().any(moves)) && view.is_some();
    Some(if is_fixed {
        model
    } else {
        model.without_cameras()
    })
}

#[cfg(test)]
mod tests {
    use hal::JointVector;
    use serde_json::json;
    use trocar_control::kinematics::forward;
    use trocar_data::dataset::{ArmFrame, DatasetSpec, DatasetWriter, FrameRecord};

    use super::*;
    use crate::session::PolicyChoice;
    use crate::session::scratch::Scratch;

    const FRAMES: u8 = 30;

    /// The joints of the arm `arm` in a frame, as they are stored.
    fn joints(frame: u8, arm: u8) -> [f32; 7] {
        let way = 0.01 * f32::from(frame) + 0.05 * f32::from(arm);
        [way, -way, 0.12, 0.3, 0.2, -0.1, 0.4]
    }

    fn dataset(folder: &Scratch, task: &str, arms: u8) -> Dataset {
        let spec = DatasetSpec {
            fps: 25,
            robot_type: "psm".to_owned(),
            arms: usize::from(arms),
            task: task.to_owned(),
            cameras: Vec::new(),
            intervention: false,
        };
        let mut writer = DatasetWriter::create(&folder.0, &spec).unwrap();
        for frame in 0..FRAMES {
            let arm = |arm| ArmFrame {
                state: joints(frame, arm),
                tip_pose: [0.0, 0.0, -0.12, 0.0, 0.0, 0.0, 1.0],
                action: [
                    0.001 * f64::from(frame),
                    0.0,
                    -0.12,
                    0.0,
                    0.0,
                    0.0,
                    1.0,
                    0.5,
                ],
            };
            let arms: Vec<_> = (0..arms).map(arm).collect();
            let record = FrameRecord {
                arms: &arms,
                images: &[],
                depth: &[],
            };
            writer.push_frame(&record).unwrap();
        }
        writer.end_episode().unwrap();
        writer.finish().unwrap();
        Dataset::open(&folder.0).unwrap()
    }

    /// Options of a recording with the scene file of `setup`.
    fn notes(setup: &Setup, view: &str, varied: &[&str]) -> Notes {
        let scene = setup.robot.texts.scene.as_deref().unwrap();
        let files = json!({ "scene.toml": hash_text(scene) });
        Notes {
            options: Some(json!({ "files": files, "view": view, "varied": varied })),
            ..Notes::default()
        }
    }

    fn has(scene: &DatasetScene, dataset: &Dataset, name: &str) -> bool {
        let file = scene.file(dataset, 0).unwrap();
        String::from_utf8_lossy(&file).contains(&format!("\"name\":\"{name}\""))
    }

    /// The instruments are where the joints of each frame have them, from each arm's place in the
    /// task.
    #[test]
    fn instruments_are_where_the_arms_were_measured() {
        let folder = Scratch::new("dataset-scene-two");
        let dataset = dataset(&folder, "needle-handover", 2);
        let setup = Setup::load("needle-handover", None, &PolicyChoice::Noop).unwrap();
        let scene = DatasetScene::new(&dataset, &Notes::default(), Some(&setup)).unwrap();
        for frame in [0, 7, FRAMES - 1] {
            let message = scene.places(&dataset, frame.into(), TimeNs(0)).unwrap();
            let (places, cameras) = scene::places(&message).unwrap();
            assert_eq!((places.len(), cameras.len()), (8, 0));
            for (arm, parts) in (0..).zip(places.chunks(4)) {
                let joints = joints(frame, arm).map(f64::from);
                let tip = forward(&JointVector::from_column_slice(&joints[..6]));
                let tip = setup.robot.control.arms[usize::from(arm)].scene_from_rcm * tip;
                let apart = parts[2].translation.vector - tip.translation.vector;
                assert!(apart.norm() < 1e-6, "frame {frame}, arm {arm}: {apart}");
            }
        }
        let [first, second] = &scene.paths(&dataset, (3, 28), &[])[..] else {
            panic!("a path an arm");
        };
        assert_ne!(first, second);
        assert!(has(&scene, &dataset, "psm2") && !has(&scene, &dataset, "liver"));
    }

    /// Ground and cameras are those of the scene file that the recording names by its hash, cameras
    /// only if no episode moved them.
    #[test]
    fn ground_and_cameras_are_those_of_the_recording() {
        let folder = Scratch::new("dataset-scene-one");
        let dataset = dataset(&folder, "needle-lift", 1);
        let setup = Setup::load("needle-lift", None, &PolicyChoice::Noop).unwrap();
        let mut other = notes(&setup, "train", &[]);
        other.options.as_mut().unwrap()["files"]["scene.toml"] = json!(hash_text("other"));
        for (notes, ground, cameras) in [
            (Notes::default(), false, false),
            (other, false, false),
            (notes(&setup, "train", &["light", "needles"]), true, true),
            (notes(&setup, "view2", &[]), true, true),
            (notes(&setup, "view1", &[]), true, false),
            (notes(&setup, "train", &["views"]), true, false),
        ] {
            let scene = DatasetScene::new(&dataset, &notes, Some(&setup)).unwrap();
            let options = &notes.options;
            let found = ["organ", "endoscope"].map(|name| has(&scene, &dataset, name));
            assert_eq!(found, [ground, cameras], "{options:?}");
            assert!(!has(&scene, &dataset, "needle"), "its place is not known");
            let names = ["other".to_owned(), "endoscope".to_owned()];
            let paths = scene.paths(&dataset, (0, 20), &names);
            let told = serde_json::to_value(&paths[0]).unwrap();
            assert_eq!(told["points"].as_array().unwrap().len(), 21);
            assert_eq!(told["pictures"]["1"].is_array(), cameras, "{options:?}");
        }
    }

    /// Without a known task a single arm hangs from its remote centre, and of two it is not known
    /// how they stand.
    #[test]
    fn arms_of_an_unknown_task_stand_alone() {
        let folder = Scratch::new("dataset-scene-unknown");
        let one = dataset(&folder, "Lift the needle", 1);
        let scene = DatasetScene::new(&one, &Notes::default(), None).unwrap();
        let message = scene.places(&one, 4, TimeNs(0)).unwrap();
        let (places, _) = scene::places(&message).unwrap();
        let joints = joints(4, 0).map(f64::from);
        let tip = forward(&JointVector::from_column_slice(&joints[..6]));
        let tip = Pose::translation(0.0, 0.0, RCM_M) * tip;
        let apart = places[2].translation.vector - tip.translation.vector;
        assert!(apart.norm() < 1e-6, "{apart}");
        assert!(!has(&scene, &one, "psm1"), "no limits are known");
        let folder = Scratch::new("dataset-scene-unknown-two");
        let two = dataset(&folder, "Hand it over", 2);
        assert!(DatasetScene::new(&two, &Notes::default(), None).is_none());
    }
}
