//! A log as pages see it: states of all its ticks, recomputed by a controller of the logged
//! configuration, its images, its scene, and what happened.
//!
//! The log is read twice. The first pass takes images, scenes, buses and events as they stand in
//! it; the second computes every tick again, since a log holds no state of the page's kind: rows
//! that held the filter, counts and histograms come of the controller. All of it is bounded in
//! memory (`log_states`, `log_images`, `log_messages`); a longer log is shown in coarser steps.

mod recomputed;

use std::path::Path;

use axum::body::Bytes;
use hal::{TICK_NS, TimeNs};
use trocar_log::live;
use trocar_log::replay::ReplayError;
use trocar_log::{LoggedItem, read_items, read_steps};

use super::drawn::{Plane, Stream};
use super::encode;
use super::facts::Facts;
use super::log_images::Images;
use super::log_messages::LogMessages;
use super::log_scene::LogScene;
use super::log_states::States;
use super::viewers::Message;
use crate::session::SessionError;
use crate::session::teleop::HandsNotice;
use recomputed::Recomputed;

/// How a JPEG begins.
const JPEG: &[u8] = &[0xff, 0xd8];

/// A log in memory. It does not change any more: any number of pages look at it at once.
#[derive(Debug)]
pub(super) struct LogView {
    /// What pages are told first, events and outcome included.
    facts: Facts,
    states: States,
    /// The first tick, and when it was.
    first: (u64, TimeNs),
    images: Images,
    has_buses: bool,
    scene: LogScene,
    /// The scene's file; none of a log without a scene.
    scene_file: Option<Bytes>,
    messages: LogMessages,
}

impl LogView {
    /// Reads the log at `path`, with its messages for viewers if `views`. It takes as long as a
    /// replay, all of it before a page is answered.
    ///
    /// # Errors
    /// [`SessionError::Log`] or [`SessionError::Replay`].
    pub(super) fn read(path: &Path, views: bool) -> Result<Self, SessionError> {
        let (mut seen, mut events) = (Seen::default(), Vec::new());
        let mut messages = LogMessages::default();
        read_items(path, |shown| match shown {
            LoggedItem::Image { camera, at, image } => seen.images.keep(camera, at, image),
            LoggedItem::View {
                camera,
                at,
                lens,
                camera_in_scene,
            } => seen.images.keep_view(camera, at, (*lens, *camera_in_scene)),
            LoggedItem::Scene { at, message } => seen.scenes.offer(at.tick(), message),
            LoggedItem::Buses { at, message } => seen.buses.offer(at.tick(), message),
            LoggedItem::Event { at, text } => {
                let notice = HandsNotice::read(text);
                seen.hands.extend(notice.map(|notice| (at, notice)));
                events.push((at, text.to_owned()));
            }
            LoggedItem::Message { topic, at, data }
                if views && live::camera_of(topic).is_none() =>
            {
                messages.keep(topic, at, data);
            }
            LoggedItem::Message { .. } => {}
        })?;
        let mut recomputed = None;
        let (header, end) = read_steps(path, |header, step| -> Result<(), SessionError> {
            let recomputed = match &mut recomputed {
                Some(recomputed) => recomputed,
                None => {
                    let seen = std::mem::take(&mut seen);
                    recomputed.insert(Recomputed::new(header, seen)?)
                }
            };
            Ok(recomputed.step(step)?)
        })?;
        let recomputed = recomputed.ok_or(ReplayError::Empty)?;
        let view = recomputed.view(&header, &end, events);
        Ok(Self { messages, ..view })
    }

    /// How many arms it is of, and the cameras that it has images of.
    pub(super) fn arms_and_cameras(&self) -> (usize, Vec<String>) {
        (self.facts.arms.len(), self.images.cameras())
    }

    /// Whether it says how its buses were.
    pub(super) const fn has_buses(&self) -> bool {
        self.has_buses
    }

    /// How long it is, s.
    pub(super) fn seconds(&self) -> f64 {
        self.facts.seconds.unwrap_or_default()
    }

    /// The log's own time `seconds` after its first tick. Within the log, whatever `seconds` says.
    pub(super) fn time(&self, seconds: f64) -> TimeNs {
        let (first, at) = self.first;
        let ticks = self.tick(seconds.min(self.seconds())).saturating_sub(first);
        TimeNs(at.0.saturating_add(ticks.saturating_mul(TICK_NS)))
    }

    /// The scene's file, if the log has a scene.
    pub(super) fn scene_file(&self) -> Option<Bytes> {
        self.scene_file.clone()
    }

    /// What `topic` says as the time goes from `before` to `at`: its newest message, or all of a
    /// topic of which each counts.
    pub(super) fn messages(&self, topic: &str, before: Option<TimeNs>, at: TimeNs) -> Vec<Message> {
        let Some(camera) = live::camera_of(topic) else {
            return self.messages.at(topic, before, at);
        };
        let cameras = self.facts.cameras.iter();
        let index = cameras.zip(0..).find(|(name, _)| *name == camera);
        let found = index.and_then(|(_, index)| self.images.at(index, at));
        let image = found.map(|(number, message)| {
            let at = TimeNs(number - 1);
            let image = message.get(encode::HEAD..).unwrap_or_default();
            let format = if image.starts_with(JPEG) {
                "jpeg"
            } else {
                "png"
            };
            Message {
                topic: topic.to_owned().into(),
                at,
                data: live::image(at, camera, format, image).into(),
            }
        });
        image.into_iter().collect()
    }

    /// What a page is told first.
    pub(super) fn facts(&self) -> String {
        self.facts.json()
    }

    /// The state `seconds` after the log's first tick, or the nearest before it.
    pub(super) fn state(&self, seconds: f64) -> Option<String> {
        let tick = self.tick(seconds);
        self.states.at(tick).map(|(_, state)| state.to_owned())
    }

    /// What there is to see of `stream` at that time, by a number that is its own. It changes when
    /// the picture does. Images in the log come before what is drawn.
    pub(super) fn number(&self, stream: Stream, seconds: f64) -> Option<u64> {
        let at = self.time(seconds);
        let image = self.image(stream, at).map(|(number, _)| number);
        image.or_else(|| Some(self.scene.tick(at.tick())? + 1))
    }

    /// That: the image in the log, or what is drawn of its scene.
    ///
    /// # Errors
    /// If it can't be drawn.
    pub(super) fn picture(
        &self,
        stream: Stream,
        seconds: f64,
    ) -> Result<Option<Bytes>, SessionError> {
        let at = self.time(seconds);
        if let Some((_, image)) = self.image(stream, at) {
            return Ok(Some(image));
        }
        if stream == Stream::SCENE {
            let lenses = self.images.lenses(at);
            return self.scene.places(at.tick(), &lenses);
        }
        match self.facts.cameras.get(usize::from(stream.camera)) {
            Some(name) => self.scene.picture(name, stream, at.tick()),
            None => Ok(None),
        }
    }

    /// Of the log itself; depth and ids are in none.
    fn image(&self, stream: Stream, at: TimeNs) -> Option<(u64, Bytes)> {
        let is_kept = stream.plane == Plane::Colour;
        is_kept.then(|| self.images.at(stream.camera, at)).flatten()
    }

    /// The tick at `seconds`, ms being ticks; NaN is the first.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates, which is the log's end or its beginning"
    )]
    fn tick(&self, seconds: f64) -> u64 {
        self.first.0.saturating_add((seconds * 1e3).round() as u64)
    }
}

/// What a log shows beside its ticks: what the first pass takes out of it.
#[derive(Debug, Default)]
struct Seen {
    images: Images,
    /// Messages of the scene, and of the buses.
    scenes: States,
    buses: States,
    /// What an operator's hands did.
    hands: Vec<(TimeNs, HandsNotice)>,
}

#[cfg(test)]
mod tests {
    use hal::Chunk;
    use serde_json::Value;
    use trocar_log::{BusRecord, BusesRecord, Level, Pressure, Recorder, RunLog, TickRecord};
    use trocar_tasks::simulation::{Rendering, Simulation};

    use super::*;
    use crate::session::episode::{Episode, EpisodeObserver, Timing};
    use crate::session::latency::Latency;
    use crate::session::run::run_lockstep;
    use crate::session::scratch::Scratch;
    use crate::session::{Plan, PolicyChoice};

    /// An episode of the expert in lockstep, with its log but without images, in `folder`.
    fn logged(folder: &Scratch) -> Plan {
        let plan = Plan {
            seed: 7,
            log: Some(folder.0.join("run.mcap")),
            log_frames: false,
            ..Plan::load("needle-lift", PolicyChoice::Expert).unwrap()
        };
        assert!(run_lockstep(&plan).unwrap().ok);
        plan
    }

    fn state(view: &LogView, seconds: f64) -> Value {
        serde_json::from_str(&view.state(seconds).unwrap()).unwrap()
    }

    fn met(state: &Value) -> Vec<bool> {
        let criteria = state["criteria"].as_array().into_iter().flatten();
        criteria.map(|it| it["met"] == true).collect()
    }

    /// A log shows what the page on its run did: criteria as they stood, where chunks led in each
    /// camera's picture, the scene.
    #[test]
    fn a_log_shows_what_its_run_did() {
        let folder = Scratch::folder("log-view");
        let plan = logged(&folder);
        let path = plan.log.as_deref().unwrap();
        let view = LogView::read(path, false).unwrap();
        let facts: Value = serde_json::from_str(&view.facts()).unwrap();
        assert_eq!(
            facts["cameras"],
            serde_json::json!(plan.setup.camera_names())
        );
        assert_eq!(
            (&facts["depth"], &facts["drawn"]),
            (&facts["cameras"], &facts["cameras"])
        );
        assert_eq!(facts["scene"], true);
        assert_eq!(view.arms_and_cameras(), (1, Vec::new()));
        assert!(!view.has_buses());
        assert_eq!(&view.scene_file().unwrap()[..4], b"glTF");

        let (begin, end) = (state(&view, 0.0), state(&view, view.seconds()));
        assert!(!met(&begin).is_empty() && met(&begin).len() == met(&end).len());
        let count = |state: &Value| met(state).iter().filter(|met| **met).count();
        assert!(count(&end) > count(&begin), "{end}");
        assert!(begin["task"].is_string());
        let middle = state(&view, view.seconds() / 2.0);
        let path = &middle["paths"][0];
        let points = path["points"].as_array().unwrap().len();
        assert!(points > 1, "{path}");
        for camera in 0..plan.setup.camera_names().len() {
            let seen = &path["pictures"][camera.to_string()];
            assert!(
                seen.as_array().is_some_and(|seen| seen.len() <= points),
                "{path}"
            );
        }
        assert_eq!(path["pictures"]["0"].as_array().map(Vec::len), Some(points));

        let moved = [0.0, view.seconds()].map(|at| {
            assert!(view.number(Stream::SCENE, at).is_some());
            view.picture(Stream::SCENE, at).unwrap().unwrap()
        });
        assert_eq!(moved[0].len(), moved[1].len());
        assert_ne!(moved[0][encode::HEAD..], moved[1][encode::HEAD..]);
    }

    /// A part that a bound kept shows the states that the run was in, not those of a controller
    /// that begins there.
    #[test]
    fn a_part_of_a_log_shows_the_states_of_its_run() {
        let folder = Scratch::folder("log-view-part");
        let plan = Plan {
            seed: 7,
            log: Some(folder.0.join("run.mcap")),
            log_frames: false,
            log_bytes_max: Some((4 << 20) + 200_000),
            ..Plan::load("needle-lift", PolicyChoice::Expert).unwrap()
        };
        assert!(run_lockstep(&plan).unwrap().ok);
        let path = plan.log.as_deref().unwrap();
        assert!(RunLog::open(path).unwrap().header.left_out > 0);
        let view = LogView::read(path, false).unwrap();
        for at in [0.0, view.seconds()] {
            let state = state(&view, at);
            let arm = &state["arms"][0];
            assert!(arm["state"] == "ENABLED" && arm["fault"].is_null(), "{arm}");
        }
    }

    /// Writes ticks and chunks, as a log of before there were scenes has them.
    struct Bare(Recorder);

    impl EpisodeObserver for Bare {
        fn chunk(&mut self, arm: usize, chunk: &Chunk) {
            self.0.chunk(arm, chunk);
        }

        fn tick(&mut self, record: &TickRecord) {
            self.0.tick(record);
        }
    }

    /// A log of that kind at `path`, of 400 ticks, that is not finished.
    fn bare(folder: &Scratch, path: &Path) -> Bare {
        let plan = logged(folder);
        let mut bare = Bare(recorder(&plan, path));
        run_ticks(&plan, &mut bare);
        bare
    }

    /// A log at `path` with the header of that of `plan`.
    fn recorder(plan: &Plan, path: &Path) -> Recorder {
        let header = RunLog::open(plan.log.as_deref().unwrap()).unwrap().header;
        Recorder::create(path, &header, Pressure::Block).unwrap()
    }

    /// Runs the first 400 ticks of `plan` before `observer`.
    fn run_ticks(plan: &Plan, observer: &mut dyn EpisodeObserver) {
        let task = &plan.setup.task;
        let source = plan.setup.source(&plan.policy, plan.seed, plan.compute);
        let episode = Episode {
            simulation: &mut Simulation::new(task, plan.seed, Rendering::Off).unwrap(),
            controller: &mut plan.setup.controller().unwrap(),
            source: &mut source.unwrap(),
        };
        let timing = Timing {
            latency: Latency::fixed(40),
            tick_limit: 400,
        };
        episode.run(&timing, observer).unwrap();
    }

    /// The same as [`Bare`] of a run that begins at tick 1000 and whose ticks go back to 200 after
    /// 1199. Chunks are observed as if they went on.
    struct GoesBack(Bare);

    impl GoesBack {
        const AHEAD_TICKS: u64 = 1000;
    }

    impl EpisodeObserver for GoesBack {
        fn chunk(&mut self, arm: usize, chunk: &Chunk) {
            let observed_at = chunk.observed_at.plus_ns(Self::AHEAD_TICKS * TICK_NS);
            let chunk = Chunk {
                observed_at,
                ..*chunk
            };
            self.0.chunk(arm, &chunk);
        }

        fn tick(&mut self, record: &TickRecord) {
            let is_before = record.tick < 200;
            let tick = record.tick + if is_before { Self::AHEAD_TICKS } else { 0 };
            self.0.tick(&TickRecord {
                tick,
                now: TimeNs::from_tick(tick),
                ..*record
            });
        }
    }

    /// A log whose ticks go back has no length: what comes before its first tick is at its
    /// beginning, and no time leads out of it.
    #[test]
    fn a_log_whose_ticks_go_back_is_shown() {
        let folder = Scratch::folder("log-view-back");
        let path = folder.0.join("back.mcap");
        let plan = logged(&folder);
        let mut back = GoesBack(Bare(recorder(&plan, &path)));
        run_ticks(&plan, &mut back);
        back.0.0.finish(None).unwrap();

        let view = LogView::read(&path, true).unwrap();
        let facts: Value = serde_json::from_str(&view.facts()).unwrap();
        assert_eq!(facts["seconds"].as_f64(), Some(0.0));
        let mut refused = 0;
        for event in facts["events"].as_array().unwrap() {
            let at = event["seconds"].as_f64().unwrap();
            assert!((0.0..0.2).contains(&at), "{event}");
            if event["text"] == "psm1: a chunk is refused: its observation lies ahead" {
                assert!(at <= 0.0, "{event}");
                refused += 1;
            }
        }
        assert!(refused > 0, "{facts}");
        for at in [0.0, 0.1, 1e9, f64::INFINITY, f64::NAN] {
            assert_eq!(view.time(at), TimeNs::from_tick(GoesBack::AHEAD_TICKS));
            assert!(view.number(Stream::SCENE, at).is_some(), "{at}");
        }
        let [begin, end] = [0.0, 1e9].map(|at| state(&view, at));
        assert_eq!(begin["seconds"].as_f64(), Some(1.0));
        assert!(end["seconds"].as_f64().is_some_and(|at| at <= 1.2), "{end}");
    }

    /// Of a run in which an operator took over from its policy, the page has who drove and what the
    /// hand did, as it was at each time.
    #[test]
    fn a_log_shows_the_operators_hands() {
        let folder = Scratch::folder("log-view-hands");
        let path = folder.0.join("hands.mcap");
        let mut bare = bare(&folder, &path);
        let released = "psm1: the operator's hand was released: the hand jumped";
        for (tick, line) in [
            (100, "the scale of the operator's hands is 0.5"),
            (100, "psm1: the operator's hand engaged"),
            (100, "the operator drives"),
            (200, released),
            (300, "the policy drives"),
        ] {
            let at = TimeNs::from_tick(tick);
            bare.0.event(at, Level::Info, line);
        }
        bare.0.finish(None).unwrap();

        let view = LogView::read(&path, false).unwrap();
        let jumped = Some("the hand jumped");
        for (seconds, driver, engaged, lost) in [
            (0.05, "policy", false, None),
            (0.15, "operator", true, None),
            (0.25, "operator", false, jumped),
            (0.35, "policy", false, jumped),
        ] {
            let state = state(&view, seconds);
            let teleop = &state["teleop"];
            assert_eq!(
                (teleop["driver"].as_str(), teleop["scale"].as_f64()),
                (Some(driver), Some(0.5))
            );
            let [arm] = &teleop["arms"].as_array().unwrap()[..] else {
                panic!("{teleop}");
            };
            assert_eq!(
                (arm["engaged"].as_bool(), arm["lost"].as_str()),
                (Some(engaged), lost)
            );
        }
    }

    /// Of such a log the instruments are seen where they were measured, over what does not move,
    /// and the load of the buses if it says so.
    #[test]
    fn a_log_without_scenes_shows_the_arms() {
        let folder = Scratch::folder("log-view-bare");
        let path = folder.0.join("bare.mcap");
        let mut bare = bare(&folder, &path);
        for (tick, load, errors) in [(100, 0.25, 0), (300, 0.5, 3)] {
            let bus = BusRecord {
                interface: "can0".to_owned(),
                frames_per_s: 4000.0,
                load,
                errors,
            };
            let buses = vec![bus];
            bare.0.buses(TimeNs::from_tick(tick), BusesRecord { buses });
        }
        bare.0.finish(None).unwrap();

        let view = LogView::read(&path, false).unwrap();
        let facts: Value = serde_json::from_str(&view.facts()).unwrap();
        let none = serde_json::json!([]);
        assert_eq!((&facts["cameras"], &facts["depth"]), (&none, &none));
        assert_eq!(
            (&facts["scene"], view.has_buses()),
            (&Value::Bool(true), true)
        );
        let file = view.scene_file().unwrap();
        let file = String::from_utf8_lossy(&file);
        for (part, is_there) in [("organ", true), ("left finger", true), ("needle", false)] {
            let named = format!("\"name\":\"{part}\"");
            assert_eq!(file.contains(&named), is_there, "{part}");
        }
        let at = state(&view, 0.3);
        assert!(at["arms"][0]["measured"].is_array() && met(&at).is_empty());
        assert!(at["task"].is_null() && at["teleop"].is_null(), "{at}");
        let loads = [0.0, 0.11, 0.3, 0.31].map(|seconds| {
            let state = state(&view, seconds);
            let buses = state["buses"].as_array().cloned().unwrap_or_default();
            let told = buses.into_iter().map(|bus| {
                assert_eq!(bus["interface"], "can0");
                bus["load"].as_f64().zip(bus["errors"].as_u64())
            });
            told.collect::<Option<Vec<_>>>().unwrap()
        });
        let none = Vec::new();
        assert_eq!(
            loads,
            [none, vec![(0.25, 0)], vec![(0.5, 3)], vec![(0.5, 3)]]
        );
        let moved = [0.0, view.seconds()].map(|at| {
            assert!(view.number(Stream::SCENE, at).is_some());
            view.picture(Stream::SCENE, at).unwrap().unwrap()
        });
        assert_ne!(moved[0][encode::HEAD..], moved[1][encode::HEAD..]);
        // Without a camera there is still where the chunk leads in the scene.
        assert!(!at["paths"][0]["points"].as_array().unwrap().is_empty());
        let depth = Stream {
            camera: 0,
            plane: Plane::Depth,
        };
        assert!(view.picture(depth, 0.3).unwrap().is_none());
    }
}
