//! The scene of a log: where everything was at each policy step, if a simulation said so, and what
//! its cameras saw, drawn when a page looks there. Of other logs what is known: the instruments
//! where the arms were measured, and of a task what does not move.

use std::fmt;
use std::sync::{Mutex, MutexGuard, PoisonError};

use axum::body::Bytes;
use hal::config::Source;
use hal::{CameraFrame, TimeNs};
use trocar_control::config::ArmConfig;
use trocar_control::motion::{AXES, MotionState};
use trocar_log::{RunHeader, SceneRecord, TaskRecord, TickRecord};
use trocar_tasks::cameras::{SceneCameras, SceneModel};
use trocar_tasks::scene::SceneSnapshot;
use trocar_tasks::task::{TaskConfig, Variation, View};

use super::drawn::{Drawn, Pixels, Plane, Stream};
use super::log_states::States;
use super::path::Lenses;
use super::scene::is_placed;
use super::{encode, scene};
use crate::session::{SessionError, scene_record};

/// The scene of a logged run.
pub(super) struct LogScene {
    task: Option<TaskConfig>,
    seed: u64,
    arms: Vec<ArmConfig>,
    /// Whether the log says where everything was.
    is_whole: bool,
    /// By the tick of their time: messages that say where everything was, or else joints and jaw of
    /// each arm, as they were measured.
    records: States,
    /// The places, among the cameras of the log, of those that the scene of a robot has.
    seen_by: Vec<u8>,
    drawing: Mutex<Drawing>,
}

/// What is drawn with.
struct Drawing {
    model: SceneModel,
    cameras: Cameras,
}

/// Draws what the camera of this name sees; none if there is no such camera. It stands for
/// [`SceneCameras`], in whose renderer's types the compiler would look, wherever a log is shared,
/// for what may not be.
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
    /// That of the run of `header` with `arms`, these messages of its scene and the cameras of
    /// these names, as each is at first; also why its task can't be made here, in words, if it
    /// can't, say since its patient is elsewhere: then the arms are seen alone, with cameras that
    /// say where they are.
    pub(super) fn new(
        header: &RunHeader,
        messages: States,
        arms: &[ArmConfig],
        (names, lenses): (&[String], &Lenses),
    ) -> (Self, Option<String>) {
        let text = header.text("scene.toml");
        let made = text.map(|text| task(header, text)).transpose();
        let (task, problem) = made.map_or_else(|problem| (None, Some(problem)), |it| (it, None));
        let is_whole = task.is_some() && !messages.is_empty();
        let model = match &task {
            Some(task) if is_whole => SceneModel::new(task, header.seed),
            Some(task) => SceneModel::at_rest(task, header.seed),
            None => SceneModel::of_arms(arms.len()),
        };
        let lenses = lenses.iter().filter(|_| task.is_none());
        let placed = lenses.filter(|(_, (lens, pose))| is_placed(lens, pose));
        let placed = placed.filter_map(|(place, view)| {
            let name = names.get(usize::from(*place))?.clone();
            Some((*place, (name, view.0, view.1)))
        });
        let (seen_by, cameras): (Vec<u8>, Vec<_>) = placed.unzip();
        let model = model.seen_by(cameras);
        let drawing = Mutex::new(Drawing {
            model,
            cameras: Cameras::Unopened,
        });
        let scene = Self {
            task,
            seed: header.seed,
            arms: arms.to_vec(),
            is_whole,
            records: if is_whole {
                messages
            } else {
                States::default()
            },
            seen_by,
            drawing,
        };
        (scene, problem)
    }

    /// Takes in where the arms were measured in a tick, which is the scene where nothing says more.
    pub(super) fn measure(&mut self, record: &TickRecord) {
        if self.is_whole {
            return;
        }
        let measured = record.arms.iter().map(|arm| arm.measured.as_ref().ok());
        let finite = measured.map(|arm| arm.filter(|state| state.is_finite()));
        let axes: Option<Vec<_>> = finite
            .map(|arm| arm.map(|state| MotionState::at_rest(state).position))
            .collect();
        let text = axes.and_then(|axes| serde_json::to_string(&axes).ok());
        if let Some(text) = text {
            self.records.keep(record.now.tick(), text.into());
        }
    }

    /// The names of the cameras that saw it, as far as a simulation drew what they saw.
    pub(super) fn cameras(&self) -> Vec<String> {
        let task = self.task.iter().filter(|_| self.is_whole);
        let cameras = task.flat_map(|task| &task.cameras);
        cameras.map(|camera| camera.name.clone()).collect()
    }

    /// When its episode is given up, s, if it is of a task.
    pub(super) fn time_limit_s(&self) -> Option<f64> {
        self.task.as_ref().map(|task| task.time_limit_s)
    }

    /// The tick of what there is to see of `tick`.
    pub(super) fn tick(&self, tick: u64) -> Option<u64> {
        self.records.at(tick).map(|(tick, _)| tick)
    }

    /// The scene's file, with the limits of its arms; none if nothing is known of where they were.
    pub(super) fn file(&self) -> Option<Bytes> {
        let (_, start) = self.snapshot(0)?;
        scene::file(&self.drawing().model, &start, &self.arms).ok()
    }

    /// Where everything is at `tick`, as pages are told; the cameras of a robot are where `lenses`
    /// have them.
    ///
    /// # Errors
    /// If an arm that carries a camera is not there.
    pub(super) fn places(&self, tick: u64, lenses: &Lenses) -> Result<Option<Bytes>, SessionError> {
        let Some((tick, snapshot)) = self.snapshot(tick) else {
            return Ok(None);
        };
        let model = &mut self.drawing().model;
        for (index, place) in self.seen_by.iter().enumerate() {
            if let Some((lens, pose)) = lenses.get(place)
                && is_placed(lens, pose)
            {
                model.move_camera(index, pose);
            }
        }
        let message = scene::message(model, &snapshot, TimeNs::from_tick(tick))?;
        Ok(Some(message.into()))
    }

    /// How its task stood at `tick`, or the nearest before it, if the log says so; adds those of
    /// the cameras `names` that are of this scene, as they are then, to `lenses`, each in its place
    /// among `names`.
    pub(super) fn stood(
        &self,
        tick: u64,
        names: &[String],
        lenses: &mut Lenses,
    ) -> Option<TaskRecord> {
        let (_, snapshot, task) = self.known(tick)?;
        scene::add_lenses(&self.drawing().model, &snapshot, names, lenses);
        task
    }

    /// What the camera `name` saw at `tick`, the plane of `stream`; none if there is no such
    /// camera, or nothing that draws, which is an error once. It is drawn here, in the server's
    /// thread: nothing runs beside it.
    ///
    /// # Errors
    /// From the renderer.
    pub(super) fn picture(
        &self,
        name: &str,
        stream: Stream,
        tick: u64,
    ) -> Result<Option<Bytes>, SessionError> {
        let Some(task) = self.task.as_ref().filter(|_| self.is_whole) else {
            return Ok(None);
        };
        let Some((tick, snapshot)) = self.snapshot(tick) else {
            return Ok(None);
        };
        let drawing = &mut *self.drawing();
        let draw = drawing.cameras.open(task, self.seed)?;
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
        self.known(tick).map(|(of, snapshot, _)| (of, snapshot))
    }

    /// The tick of what is known of `tick`, where everything was, and how the task stood if the log
    /// says so.
    fn known(&self, tick: u64) -> Option<(u64, SceneSnapshot, Option<TaskRecord>)> {
        let (of, message) = self.records.at(tick)?;
        if self.is_whole {
            let record = SceneRecord::read(message.as_bytes())?;
            let snapshot = scene_record::snapshot(&record)?;
            return Some((of, snapshot, Some(record.task)));
        }
        let axes: Vec<[f64; AXES]> = serde_json::from_str(message).ok()?;
        let arms = self.arms.iter().map(|arm| arm.scene_from_rcm).zip(axes);
        Some((of, scene::of_arms(arms), None))
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
    use hal::{ArmError, ArmState, Intrinsics, JointVector, PerArm, Pose};
    use trocar_control::TickInput;
    use trocar_control::kinematics::forward;
    use trocar_log::TickTiming;
    use trocar_tasks::simulation::{Rendering, Simulation};

    use super::*;
    use crate::session::TaskState;
    use crate::session::{PolicyChoice, Setup};

    const SEED: u64 = 5;

    /// Of a log without images.
    const NO_CAMERAS: (&[String], &Lenses) = (&[], &Lenses::new());

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
                let arms = &setup.robot.control.arms;
                let (scene, problem) = LogScene::new(&header, records, arms, NO_CAMERAS);
                assert_eq!(problem, None);
                let mut model = SceneModel::new(&task, SEED);
                let file = scene::file(&model, &scenes[0], arms).unwrap();
                assert!(scene.file() == Some(file), "{}", task.name);
                for (tick, step) in [(0, 0), (39, 0), (40, 1), (1000, 2)] {
                    let at = TimeNs::from_tick(40 * step);
                    let now = &scenes[usize::try_from(step).unwrap()];
                    let told = scene::message(&mut model, now, at).unwrap();
                    let places = scene.places(tick, &Lenses::new()).unwrap();
                    assert!(places == Some(told.into()), "{tick}");
                    assert_eq!(scene.tick(tick), Some(40 * step));
                }
                let names = ["elsewhere".to_owned(), scene.cameras().remove(0)];
                let mut lenses = Lenses::new();
                assert!(scene.stood(40, &names, &mut lenses).is_some());
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
        let arms = &setup.robot.control.arms;
        let (scene, _) = LogScene::new(&header, records, arms, NO_CAMERAS);
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

    /// A tick in which the arms of `setup` were measured at `joints`.
    fn measured(setup: &Setup, tick: u64, joints: JointVector) -> TickRecord {
        let now = TimeNs::from_tick(tick);
        let state = ArmState::at_rest(now, joints, 0.3);
        let input = TickInput {
            now,
            measured: Ok(state),
            chunk: None,
            operator: None,
        };
        let inputs = setup.robot.control.arms.iter().map(|_| input);
        let inputs = PerArm::collect(inputs).unwrap();
        let outputs = setup.controller().unwrap().tick(&inputs);
        TickRecord::new(tick, inputs, outputs, TickTiming::default())
    }

    /// The arms that `scene` tells of `tick`: the poses of what is drawn but for cameras.
    fn told(scene: &LogScene, tick: u64) -> Vec<Pose> {
        let places = scene.places(tick, &Lenses::new()).unwrap();
        scene::places(&places.unwrap()).unwrap().0
    }

    /// Without a simulation that says more, the instruments are where the arms were measured, with
    /// what of the task does not move, and with the limits. What its cameras saw is not drawn: the
    /// needle is not known.
    #[test]
    fn a_log_without_a_scene_has_the_measured_arms() {
        for (name, rests) in [("needle-lift", "organ"), ("needle-handover", "liver")] {
            let setup = setup(name);
            let arms = &setup.robot.control.arms;
            let start = JointVector::new(0.1, -0.1, 0.12, 0.2, 0.3, -0.1);
            let end = JointVector::new(0.2, 0.1, 0.14, -0.2, 0.1, 0.2);
            let ticks = [(0, start), (40, end)].map(|(tick, at)| measured(&setup, tick, at));
            let of_task = header(&setup, &setup.task);
            for (header, own) in [(of_task, 1), (RunHeader::default(), 0)] {
                let (mut scene, problem) =
                    LogScene::new(&header, States::default(), arms, NO_CAMERAS);
                assert_eq!((problem, scene.tick(0), scene.file()), (None, None, None));
                ticks.iter().for_each(|tick| scene.measure(tick));
                let file = String::from_utf8_lossy(&scene.file().unwrap()).into_owned();
                assert!(file.contains("left finger") && file.contains("\"workspace\""));
                assert_eq!(file.contains("\"region\""), name == "needle-lift");
                assert_eq!(file.contains(&format!("\"name\":\"{rests}\"")), own > 0);
                assert!(!file.contains("\"name\":\"needle\""));
                for (at, joints) in [(0, start), (39, start), (40, end), (900, end)] {
                    let places = told(&scene, at);
                    assert_eq!(places.len(), own + 4 * arms.len());
                    for (arm, parts) in arms.iter().zip(places[own..].chunks(4)) {
                        let tip = arm.scene_from_rcm * forward(&joints);
                        let finger = parts[2].translation.vector;
                        assert!((finger - tip.translation.vector).norm() < 1e-6, "{at}");
                    }
                }
                let colour = Stream {
                    camera: 0,
                    plane: Plane::Colour,
                };
                assert!(scene.picture("endoscope", colour, 0).unwrap().is_none());
                let stood = scene.stood(0, &[], &mut Lenses::new());
                assert!(stood.is_none() && scene.cameras().is_empty());
            }
        }
    }

    /// The scene of a robot has those of its cameras that say where they are, where they are then.
    #[test]
    fn cameras_of_a_robot_are_where_they_say() {
        let setup = setup("needle-lift");
        let lens = Intrinsics::from_vertical_fov(64, 48, 1.0);
        let there = |x: f64| (lens, Pose::translation(x, 0.0, 0.2));
        let at_first = Lenses::from([
            (0, (lens, Pose::identity())),
            (1, (Intrinsics::default(), Pose::translation(0.1, 0.0, 0.2))),
            (2, there(0.3)),
            (3, there(f64::NAN)),
        ]);
        let names = ["origin", "lensless", "room", "lost"].map(str::to_owned);
        let arms = &setup.robot.control.arms;
        let (mut scene, _) = LogScene::new(
            &RunHeader::default(),
            States::default(),
            arms,
            (&names, &at_first),
        );
        scene.measure(&measured(&setup, 0, JointVector::zeros()));
        let file = String::from_utf8_lossy(&scene.file().unwrap()).into_owned();
        let has = |name: &String| file.contains(&format!("\"name\":\"{name}\""));
        assert_eq!(
            [0, 1, 2, 3].map(|it| has(&names[it])),
            [false, false, true, false]
        );
        for lenses in [at_first, Lenses::from([(2, there(0.4))]), Lenses::new()] {
            let places = scene.places(0, &lenses).unwrap().unwrap();
            let (_, cameras) = scene::places(&places).unwrap();
            let x = lenses.get(&2).map_or(0.4, |(_, pose)| pose.translation.x);
            assert_eq!(cameras.len(), 1);
            assert!((cameras[0].translation.x - x).abs() < 1e-6, "{x}");
        }
    }

    /// A task that can't be made here leaves the arms; a measurement that is lost, where they were
    /// before.
    #[test]
    fn arms_are_seen_where_their_task_is_unknown() {
        let setup = setup("needle-lift");
        let arms = &setup.robot.control.arms;
        let elsewhere = RunHeader {
            needle: Some("N9".to_owned()),
            ..header(&setup, &setup.task)
        };
        let (mut scene, problem) =
            LogScene::new(&elsewhere, steps(&setup.task).1, arms, NO_CAMERAS);
        assert!(problem.is_some_and(|problem| problem.contains("N9")));
        let joints = JointVector::new(0.1, -0.1, 0.12, 0.2, 0.3, -0.1);
        let mut tick = measured(&setup, 0, joints);
        scene.measure(&tick);
        let before = told(&scene, 0);
        assert_eq!(before.len(), 4);
        for lost in [Err(ArmError::EndOfRecording), Ok(f64::NAN)] {
            (tick.tick, tick.now) = (tick.tick + 40, tick.now.plus_ns(40_000_000));
            tick.arms.first.measured = lost.map(|joint| {
                let joints = JointVector::repeat(joint);
                ArmState::at_rest(tick.now, joints, 0.3)
            });
            scene.measure(&tick);
            assert_eq!(told(&scene, tick.tick), before);
        }
    }
}
