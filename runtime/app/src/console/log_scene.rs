//! The simulated scene of a log: where everything was at each policy step, and what its cameras saw, drawn when a page looks there.

use std::fmt;
use std::sync::{Mutex, MutexGuard, PoisonError};

use axum::body::Bytes;
use hal::config::Source;
use hal::{CameraFrame, TimeNs};
use trocar_control::config::ArmConfig;
use trocar_log::{RunHeader, SceneRecord};
use trocar_tasks::cameras::{SceneCameras, SceneModel};
use trocar_tasks::scene::SceneSnapshot;
use trocar_tasks::task::{TaskConfig, Variation, View};

use super::log_view::States;
use super::path::Lenses;
use super::pictures::{Drawn, Pixels, Plane, Stream};
use super::{encode, scene};
use crate::session::{SessionError, scene_record};

/// The scene of a logged run.
pub(super) struct LogScene {
    task: TaskConfig,
    seed: u64,
    /// Messages by the tick of their time.
    records: States,
    drawing: Mutex<Drawing>,
}

/// What is drawn with.
struct Drawing {
    model: SceneModel,
    cameras: Cameras,
}

/// Draws what the camera of this name sees; none if there is no such camera. It stands for [`SceneCameras`], in whose renderer's types the
/// compiler would look, wherever a log is shared, for what may not be.
type Draw =
    Box<dyn FnMut(&str, &SceneSnapshot) -> Result<Option<CameraFrame>, SessionError> + Send>;

/// The cameras of the task, which are slow to make.
enum Cameras {
    /// No page has looked through one.
    Unopened,
    /// They draw.
    Open(Draw),
    /// There is no device that draws.
    Missing,
}

impl fmt::Debug for LogScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LogScene")
            .field("seed", &self.seed)
            .finish_non_exhaustive()
    }
}

impl LogScene {
    /// That of the run of `header` with these `records`; none of a log without a scene.
    ///
    /// # Errors
    /// In words, if its task can't be made here, say since its patient is elsewhere.
    pub(super) fn new(header: &RunHeader, records: States) -> Result<Option<Self>, String> {
        let Some(text) = header.text("scene.toml").filter(|_| !records.is_empty()) else {
            return Ok(None);
        };
        let task = task(header, text)?;
        let drawing = Mutex::new(Drawing {
            model: SceneModel::new(&task, header.seed),
            cameras: Cameras::Unopened,
        });
        Ok(Some(Self {
            task,
            seed: header.seed,
            records,
            drawing,
        }))
    }

    /// The names of its cameras.
    pub(super) fn cameras(&self) -> Vec<String> {
        let cameras = self.task.cameras.iter();
        cameras.map(|camera| camera.name.clone()).collect()
    }

    /// When its episode is given up, s.
    pub(super) const fn time_limit_s(&self) -> f64 {
        self.task.time_limit_s
    }

    /// The scene of `tick`, or the nearest before it, with its own tick.
    pub(super) fn record(&self, tick: u64) -> Option<(u64, SceneRecord)> {
        let (tick, message) = self.records.at(tick)?;
        Some((tick, SceneRecord::read(message.as_bytes())?))
    }

    /// The tick of what there is to see of `tick`.
    pub(super) fn tick(&self, tick: u64) -> Option<u64> {
        self.records.at(tick).map(|(tick, _)| tick)
    }

    /// The scene's file, with the limits of `arms`.
    pub(super) fn file(&self, arms: &[ArmConfig]) -> Option<Bytes> {
        let (_, start) = self.snapshot(0)?;
        scene::file(&self.drawing().model, &start, arms).ok()
    }

    /// Where everything is at `tick`, as pages are told.
    ///
    /// # Errors
    /// If an arm that carries a camera is not there.
    pub(super) fn places(&self, tick: u64) -> Result<Option<Bytes>, SessionError> {
        let Some((tick, snapshot)) = self.snapshot(tick) else {
            return Ok(None);
        };
        let model = &mut self.drawing().model;
        let message = scene::message(model, &snapshot, TimeNs::from_tick(tick))?;
        Ok(Some(message.into()))
    }

    /// Adds those of the cameras `names` that are of this scene, as they are in `record`, to `lenses`, each in its place among `names`.
    pub(super) fn add_lenses(&self, names: &[String], record: &SceneRecord, lenses: &mut Lenses) {
        let model = &self.drawing().model;
        let snapshot = scene_record::snapshot(record);
        let poses = snapshot.and_then(|snapshot| model.camera_poses(&snapshot).ok());
        for ((camera, lens), pose) in model.cameras().zip(poses.into_iter().flatten()) {
            let place = (0..=u8::MAX).zip(names).find(|(_, name)| *name == camera);
            if let Some((place, _)) = place {
                lenses.entry(place).or_insert((lens, pose));
            }
        }
    }

    /// What the camera `name` saw at `tick`, the plane of `stream`; none if there is no such camera, or nothing that draws, which is an error once.
    /// It is drawn here, in the server's thread: nothing runs beside it.
    ///
    /// # Errors
    /// From the renderer.
    pub(super) fn picture(
        &self,
        name: &str,
        stream: Stream,
        tick: u64,
    ) -> Result<Option<Bytes>, SessionError> {
        let Some((tick, snapshot)) = self.snapshot(tick) else {
            return Ok(None);
        };
        let drawing = &mut *self.drawing();
        let draw = drawing.cameras.open(&self.task, self.seed)?;
        let frame = draw.map_or(Ok(None), |draw| draw(name, &snapshot))?;
        let Some(frame) = frame else {
            return Ok(None);
        };
        let drawn = Drawn {
            stream,
            stamp: TimeNs::from_tick(tick),
            width: frame.intrinsics.width,
            height: frame.intrinsics.height,
            pixels: match stream.plane {
                Plane::Colour => Pixels::Colour(frame.colour),
                Plane::Depth => Pixels::Depth(frame.depth_m),
                Plane::Ids => Pixels::Ids(frame.instance),
            },
        };
        Ok(encode::message(&drawn).map(Bytes::from))
    }

    fn snapshot(&self, tick: u64) -> Option<(u64, SceneSnapshot)> {
        let (tick, record) = self.record(tick)?;
        Some((tick, scene_record::snapshot(&record)?))
    }

    fn drawing(&self) -> MutexGuard<'_, Drawing> {
        self.drawing.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Cameras {
    fn open(&mut self, task: &TaskConfig, seed: u64) -> Result<Option<&mut Draw>, SessionError> {
        if matches!(self, Self::Unopened) {
            *self = Self::Missing;
            let mut cameras = SceneCameras::new(task)?;
            cameras.begin_episode(task, seed);
            *self = Self::Open(Box::new(move |name, scene| {
                let Some(camera) = cameras.find(name) else {
                    return Ok(None);
                };
                let mut frame = cameras.blank_frame(camera)?;
                cameras.render(camera, scene, &mut frame)?;
                Ok(Some(frame))
            }));
        }
        Ok(match self {
            Self::Open(draw) => Some(draw),
            Self::Unopened | Self::Missing => None,
        })
    }
}

/// The task of a logged run, whose scene file is `text`.
fn task(header: &RunHeader, text: &str) -> Result<TaskConfig, String> {
    let source = Source::embedded("scene.toml", text);
    let mut task = TaskConfig::parse(&header.task, &source).map_err(|error| error.to_string())?;
    if let Some(needle) = &header.needle {
        task = task
            .with_needle(needle)
            .map_err(|error| error.to_string())?;
    }
    let known = || Variation::ALL.into_iter().chain(Variation::EFFECTS);
    let varied = header.varied.iter().map(|name| {
        let found = known().find(|it| it.name() == name);
        found.ok_or_else(|| format!("there is no variation {name:?}"))
    });
    let varied = varied.collect::<Result<Vec<_>, _>>()?;
    // Views that are drawn anew are a view of their own, which the header names.
    let view = View::ALL.into_iter().find(|it| it.name() == header.view);
    let view = view.filter(|_| !varied.contains(&Variation::Views));
    let task = task.with_view(view.unwrap_or_default());
    let task = task.map_err(|error| error.to_string())?;
    task.with_variations(&varied)
        .map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use trocar_tasks::simulation::{Rendering, Simulation};

    use super::*;
    use crate::session::TaskState;
    use crate::session::{PolicyChoice, Setup};

    const SEED: u64 = 5;

    fn setup(task: &str) -> Setup {
        Setup::load(task, None, &PolicyChoice::Noop).unwrap()
    }

    /// What a log says of a run of `task`, which `setup` was made into.
    fn header(setup: &Setup, task: &TaskConfig) -> RunHeader {
        RunHeader {
            task: task.name.clone(),
            seed: SEED,
            view: task.view.name().to_owned(),
            needle: task.needle().map(str::to_owned),
            varied: task.varied.iter().map(|it| it.name().to_owned()).collect(),
            texts: setup.robot.texts.by_name(),
            ..RunHeader::default()
        }
    }

    /// The scenes of the first three policy steps of `task`, and the same as a log has them.
    fn steps(task: &TaskConfig) -> (Vec<SceneSnapshot>, States) {
        let mut simulation = Simulation::new(task, SEED, Rendering::Off).unwrap();
        let (mut scenes, mut records) = (Vec::new(), States::default());
        for step in 0..3 {
            let (scene, stands) = (simulation.snapshot(), TaskState::of(&simulation));
            let record = scene_record::record(&scene, &stands.report(TimeNs(0), 0));
            records.keep(40 * step, serde_json::to_string(&record).unwrap().into());
            scenes.push(scene);
            for _ in 0..40 {
                simulation.step();
            }
        }
        (scenes, records)
    }

    /// Pages of a log are told of its scene what pages of the run were, whatever varied in it.
    #[test]
    fn a_logs_scene_is_that_of_its_run() {
        for setup in TaskConfig::names().map(setup) {
            let shipped = &setup.task;
            let moved = [Variation::Views, Variation::Lens];
            let moved = shipped.clone().with_variations(&moved).unwrap();
            let bent = [Variation::Distortion, Variation::Smoke];
            let bent = shipped.clone().with_variations(&bent).unwrap();
            let needles = shipped.clone().with_variations(&[Variation::Needles]);
            let swapped = shipped.clone().with_view(View::View2);
            let others = [Some(moved), Some(bent), needles.ok(), swapped.ok()];
            for task in others.into_iter().flatten().chain([shipped.clone()]) {
                let (scenes, records) = steps(&task);
                let header = header(&setup, &task);
                let scene = LogScene::new(&header, records).unwrap().unwrap();
                let mut model = SceneModel::new(&task, SEED);
                let arms = &setup.robot.control.arms;
                let file = scene::file(&model, &scenes[0], arms).unwrap();
                assert!(scene.file(arms) == Some(file), "{}", task.name);
                for (tick, step) in [(0, 0), (39, 0), (40, 1), (1000, 2)] {
                    let at = TimeNs::from_tick(40 * step);
                    let now = &scenes[usize::try_from(step).unwrap()];
                    let told = scene::message(&mut model, now, at).unwrap();
                    assert!(scene.places(tick).unwrap() == Some(told.into()), "{tick}");
                    assert_eq!(scene.tick(tick), Some(40 * step));
                }
                let names = ["elsewhere".to_owned(), scene.cameras().remove(0)];
                let mut lenses = Lenses::new();
                let (_, record) = scene.record(40).unwrap();
                scene.add_lenses(&names, &record, &mut lenses);
                let (_, lens) = model.cameras().next().unwrap();
                let pose = model.camera_poses(&scenes[1]).unwrap()[0];
                assert_eq!(lenses, Lenses::from([(1, (lens, pose))]), "{}", task.name);
            }
        }
    }

    /// Depth and ids, which no log has, are those that the run's cameras would have given.
    #[test]
    fn planes_are_drawn_as_the_run_would_have() {
        let setup = setup("needle-lift");
        let (scenes, records) = steps(&setup.task);
        let header = header(&setup, &setup.task);
        let scene = LogScene::new(&header, records).unwrap().unwrap();
        let mut cameras = SceneCameras::new(&setup.task).unwrap();
        cameras.begin_episode(&setup.task, SEED);
        let mut frame = cameras.blank_frame(0).unwrap();
        cameras.render(0, &scenes[1], &mut frame).unwrap();
        let name = cameras.name(0).unwrap();
        for plane in Plane::ALL {
            let stream = Stream { camera: 7, plane };
            let drawn = Drawn {
                stream,
                stamp: TimeNs::from_tick(40),
                width: frame.intrinsics.width,
                height: frame.intrinsics.height,
                pixels: match plane {
                    Plane::Colour => Pixels::Colour(frame.colour.clone()),
                    Plane::Depth => Pixels::Depth(frame.depth_m.clone()),
                    Plane::Ids => Pixels::Ids(frame.instance.clone()),
                },
            };
            let expected = encode::message(&drawn).map(Bytes::from);
            assert!(
                scene.picture(name, stream, 45).unwrap() == expected,
                "{plane:?}"
            );
            assert!(scene.picture("elsewhere", stream, 45).unwrap().is_none());
        }
    }

    #[test]
    fn a_log_without_a_scene_has_none() {
        let setup = setup("needle-lift");
        let header = header(&setup, &setup.task);
        let none = LogScene::new(&header, States::default());
        assert!(none.is_ok_and(|scene| scene.is_none()));
        let robot = LogScene::new(&RunHeader::default(), steps(&setup.task).1);
        assert!(robot.is_ok_and(|scene| scene.is_none()));
        let elsewhere = RunHeader {
            needle: Some("N9".to_owned()),
            ..header
        };
        let error = LogScene::new(&elsewhere, steps(&setup.task).1).err();
        assert!(error.is_some_and(|error| error.contains("N9")));
    }
}
