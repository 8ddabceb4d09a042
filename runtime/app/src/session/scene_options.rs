//! What of a task's scene the user chooses: the file that describes it, which needle lies there,
//! from where it is seen, and whose frames are kept.

use std::path::PathBuf;

use trocar_tasks::task::{CameraConfig, Mount, Variation, View};

use super::teleop::picture;
use super::{SessionError, Setup};

/// From one eye of an endoscope to the other, m.
pub const BASELINE_M: f64 = 0.005;

/// Cameras whose frames are kept, in a dataset or a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CameraSet {
    /// The task's primary camera, as the paper's policies of a single camera have it.
    Single,
    /// That one and the wrist cameras, as the paper's policies of several cameras have them.
    Multi,
    /// These.
    Named(Vec<String>),
}

/// The choices.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SceneOptions {
    /// The scene file; the built-in one if not given.
    pub file: Option<PathBuf>,
    /// The needle by name; the trained one if not given.
    pub needle: Option<String>,
    /// From where the cameras look.
    pub view: View,
    /// What is drawn anew for each episode.
    pub varied: Vec<Variation>,
    /// Whose frames are kept.
    pub cameras: Option<CameraSet>,
}

impl CameraSet {
    /// Reads `single`, `multi`, or else names with commas between them.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        match text {
            "single" => Self::Single,
            "multi" => Self::Multi,
            names => Self::Named(names.split(',').map(str::to_owned).collect()),
        }
    }

    /// The names of these cameras among `cameras`.
    fn names(&self, cameras: &[CameraConfig]) -> Vec<String> {
        let primary = cameras.iter().find(|camera| camera.primary);
        let primary = primary.or_else(|| cameras.first());
        let wrists = cameras.iter().filter(|camera| camera.mount == Mount::Wrist);
        let named = |camera: &CameraConfig| camera.name.clone();
        match self {
            Self::Single => primary.into_iter().map(named).collect(),
            Self::Multi => primary.into_iter().chain(wrists).map(named).collect(),
            Self::Named(names) => names.clone(),
        }
    }
}

impl Setup {
    /// The same setup with these choices.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] for a needle or a camera that the task has not, for a view
    /// that its cameras can't give, and for what can't be varied; those of
    /// [`Self::with_scene_file`].
    pub fn with_scene(mut self, options: &SceneOptions) -> Result<Self, SessionError> {
        if let Some(path) = &options.file {
            self = self.with_scene_file(path)?;
        }
        self.with_choices(options)
    }

    /// The same setup with what `options` choose of the scene that it has.
    pub(super) fn with_choices(mut self, options: &SceneOptions) -> Result<Self, SessionError> {
        let refused = |reason: String| SessionError::BadArgument(reason);
        if let Some(needle) = &options.needle {
            let changed = self.task.with_needle(needle);
            self.task = changed.map_err(|error| refused(format!("--needle {needle}: {error}")))?;
        }
        self.task = self.task.with_view(options.view).map_err(|error| {
            let view = options.view.name();
            refused(format!("--view {view}: {error}"))
        })?;
        self = self.with_variations(options)?;
        match &options.cameras {
            Some(set) => self.keeping(set),
            None => Ok(self),
        }
    }

    /// The same setup that keeps the frames of these cameras.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] for a camera that the task has not.
    pub fn keeping(mut self, set: &CameraSet) -> Result<Self, SessionError> {
        let refused = |reason: String| SessionError::BadArgument(reason);
        let names = set.names(&self.task.cameras);
        let all = self.camera_names();
        for (index, name) in names.iter().enumerate() {
            if !all.contains(name) {
                return Err(refused(format!(
                    "--cameras {name}: there is no such camera; task {} has {}, and single and multi stand for some of them",
                    self.task_name,
                    all.join(", ")
                )));
            }
            if names[..index].contains(name) {
                return Err(refused(format!("--cameras: {name} is named twice")));
            }
        }
        self.kept_cameras = Some(names);
        Ok(self)
    }

    /// [`Self::with_stereo`], of which both eyes are recorded, as `endoscope` and
    /// `endoscope_right`: after the cameras that are kept anyway.
    ///
    /// # Errors
    /// As there.
    pub fn with_recorded_stereo(self) -> Result<Self, SessionError> {
        let left = picture(&self.task).map(|index| self.task.cameras[index].name.clone());
        let mut setup = self.with_stereo()?;
        let right = setup.task.cameras.last().map(|camera| camera.name.clone());
        let kept = setup.kept_cameras.get_or_insert_default();
        for eye in [left, right].into_iter().flatten() {
            if !kept.contains(&eye) {
                kept.push(eye);
            }
        }
        Ok(setup)
    }

    /// The same setup with a second eye for a person, [`BASELINE_M`] to the right of the picture
    /// that hands move in. It is drawn for who looks through it, and nothing is recorded of it.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if no camera stands in the scene, or each stands elsewhere in
    /// each episode.
    pub fn with_stereo(mut self) -> Result<Self, SessionError> {
        let refused = |reason: &str| SessionError::BadArgument(format!("--stereo: {reason}"));
        if self.task.view == View::View1 || self.task.varied.contains(&Variation::Views) {
            return Err(refused(
                "cameras that are moved by chance are no pair of eyes",
            ));
        }
        let left = picture(&self.task).and_then(|index| self.task.cameras.get(index));
        let left = left.ok_or_else(|| refused("no camera of this task stands in the scene"))?;
        let right = left.right_eye(BASELINE_M);
        self.task.cameras.push(right);
        self.stereo = true;
        Ok(self)
    }

    fn with_variations(mut self, options: &SceneOptions) -> Result<Self, SessionError> {
        let varies = |variation| options.varied.contains(&variation);
        let chosen = [
            (Variation::Needles, "--needle", options.needle.is_some()),
            (Variation::Views, "--view", options.view != View::Train),
        ];
        for (variation, option, is_given) in chosen {
            if is_given && varies(variation) {
                let name = variation.name();
                return Err(SessionError::BadArgument(format!(
                    "--vary {name}: {option} chooses one for all episodes; give either"
                )));
            }
        }
        let varied = self.task.with_variations(&options.varied);
        self.task = varied.map_err(|error| {
            let name = error.variation.name();
            SessionError::BadArgument(format!("--vary {name}: {error}"))
        })?;
        Ok(self)
    }

    /// The cameras whose frames a session takes whose policy looks through `seen`: these first,
    /// then the ones that were asked for. If there is neither, the first camera of the task.
    #[must_use]
    pub fn cameras_with(&self, seen: Vec<String>) -> Vec<String> {
        let mut names = seen;
        for name in self.kept_cameras.iter().flatten() {
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
        if names.is_empty() {
            names.extend(self.camera_names().into_iter().take(1));
        }
        names
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::PolicyChoice;

    fn setup(task: &str, options: &SceneOptions) -> Result<Setup, SessionError> {
        Setup::load(task, None, &PolicyChoice::Expert)
            .unwrap()
            .with_scene(options)
    }

    fn kept(task: &str, cameras: &str) -> Vec<String> {
        let options = SceneOptions {
            cameras: Some(CameraSet::parse(cameras)),
            ..SceneOptions::default()
        };
        setup(task, &options).unwrap().cameras_with(Vec::new())
    }

    /// The second eye is beside the endoscope, sees the same point in the middle, and is none of
    /// the cameras that are kept.
    #[test]
    fn two_eyes_stand_beside_each_other() {
        let load = |view| {
            let options = SceneOptions {
                view,
                ..SceneOptions::default()
            };
            let changes = crate::session::changes::Changes::default();
            Setup::load_with("needle-lift", None, &PolicyChoice::Noop, &options, changes).unwrap()
        };
        let setup = load(View::Train).with_stereo().unwrap();
        let [left, .., right] = &setup.task.cameras[..] else {
            panic!("one camera")
        };
        assert_eq!(right.name, "endoscope_right");
        assert_eq!((left.target_m, left.up), (right.target_m, right.up));
        let [eye, other, target] =
            [left.eye_m, right.eye_m, left.target_m].map(nalgebra::Vector3::from);
        let apart = other - eye;
        assert!((apart.norm() - BASELINE_M).abs() < 1e-9, "{apart}");
        // In the picture right is about the scene's x.
        assert!(apart.x > 0.9 * BASELINE_M && apart.dot(&(target - eye)).abs() < 1e-9);
        assert_eq!(setup.cameras_with(Vec::new()), ["endoscope"]);
        let recorded = load(View::Train).with_recorded_stereo().unwrap();
        assert_eq!(
            recorded.cameras_with(Vec::new()),
            ["endoscope", "endoscope_right"]
        );
        let options = SceneOptions {
            cameras: Some(CameraSet::parse("side,wrist")),
            ..SceneOptions::default()
        };
        let changes = crate::session::changes::Changes::default();
        let expert = PolicyChoice::Expert;
        let task = Setup::load_with("suture-pad", None, &expert, &options, changes);
        let recorded = task.unwrap().with_recorded_stereo().unwrap();
        assert_eq!(
            recorded.cameras_with(Vec::new()),
            ["side", "wrist", "endoscope", "endoscope_right"]
        );
        let moved = load(View::View1).with_stereo();
        assert!(moved.is_err_and(|error| error.to_string().contains("--stereo")));
    }

    #[test]
    fn single_and_multi_are_the_papers() {
        assert_eq!(kept("needle-lift", "single"), ["endoscope"]);
        assert_eq!(kept("needle-lift", "multi"), ["endoscope", "wrist"]);
        assert_eq!(kept("suture-pad", "single"), ["side"]);
        assert_eq!(kept("block-transfer", "multi"), ["side", "wrist"]);
        assert_eq!(
            kept("needle-handover", "multi"),
            ["endoscope", "wrist_right", "wrist_left"]
        );
        assert_eq!(
            kept("suture-pad", "wrist,endoscope"),
            ["wrist", "endoscope"]
        );
    }

    /// A policy's cameras come first and only without any the first of the task.
    #[test]
    fn cameras_of_the_policy_come_first() {
        let plain = setup("needle-lift", &SceneOptions::default()).unwrap();
        assert_eq!(plain.cameras_with(Vec::new()), ["endoscope"]);
        assert_eq!(plain.cameras_with(vec!["wrist".to_owned()]), ["wrist"]);
        let options = SceneOptions {
            cameras: Some(CameraSet::parse("side,wrist")),
            ..SceneOptions::default()
        };
        let asked = setup("needle-lift", &options).unwrap();
        assert_eq!(
            asked.cameras_with(vec!["wrist".to_owned()]),
            ["wrist", "side"]
        );
    }

    #[test]
    fn what_a_task_has_not_is_refused_with_what_it_has() {
        let mut options = SceneOptions {
            needle: Some("N6".to_owned()),
            ..SceneOptions::default()
        };
        let error = setup("needle-lift", &options).unwrap_err();
        assert!(error.is_bad_input());
        assert_eq!(
            error.to_string(),
            "--needle N6: needle-lift has no needle \"N6\"; it has N1, N2, N3, N4, N5"
        );
        let error = setup("block-transfer", &options).unwrap_err().to_string();
        assert!(error.ends_with("it has no choice of needles"), "{error}");
        options = SceneOptions {
            cameras: Some(CameraSet::parse("endoscope,laparoscope")),
            ..SceneOptions::default()
        };
        let error = setup("needle-lift", &options).unwrap_err().to_string();
        assert!(
            error.contains("--cameras laparoscope") && error.contains("endoscope, side, wrist"),
            "{error}"
        );
        options.cameras = Some(CameraSet::parse("side,side"));
        assert!(setup("needle-lift", &options).unwrap_err().is_bad_input());
    }

    #[test]
    fn what_a_task_cannot_vary_is_refused_with_what_it_can() {
        let vary = |task: &str, varied: &[Variation], view, needle: Option<&str>| {
            let options = SceneOptions {
                varied: varied.to_vec(),
                view,
                needle: needle.map(str::to_owned),
                ..SceneOptions::default()
            };
            setup(task, &options).map_err(|error| {
                assert!(error.is_bad_input());
                error.to_string()
            })
        };
        let all = Variation::ALL;
        let varied = vary("needle-lift", &all, View::Train, None).unwrap();
        assert_eq!(
            (varied.task.varied, varied.task.view),
            (all.to_vec(), View::View1)
        );
        assert_eq!(
            vary("suture-pad", &all, View::Train, None).unwrap_err(),
            "--vary needles: suture-pad has no choice of needles; it can vary views, light, lens"
        );
        assert_eq!(
            vary("needle-lift", &all, View::View2, None).unwrap_err(),
            "--vary views: --view chooses one for all episodes; give either"
        );
        assert_eq!(
            vary("needle-lift", &all, View::Train, Some("N2")).unwrap_err(),
            "--vary needles: --needle chooses one for all episodes; give either"
        );
    }
}
