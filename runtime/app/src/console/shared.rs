//! What the server's thread shares with the run. Each field has a lock of its own that is held for
//! a copy, or is a watched value; the server's thread never holds one over an `await`.

use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Bytes;
use axum::extract::ws::Utf8Bytes;
use tokio::sync::watch;
use tokio::task::spawn_blocking;

use super::access::Access;
use super::dataset_view::DatasetView;
use super::live::Live;
use super::log_view::LogView;
use super::pictures::Board;
use super::scene::Shapes;
use super::seats::Seats;
use super::viewers::Viewers;
use crate::session::operator::Command;
use crate::session::teleop::Hands;
use trocar_log::live as log_form;

/// What pages see.
#[derive(Debug)]
enum Shown {
    /// Nothing yet.
    Nothing,
    /// A run in real time.
    Live(Arc<Live>),
    /// A log.
    Log(Arc<LogView>),
    /// A dataset.
    Dataset(Arc<DatasetView>),
}

#[derive(Debug)]
pub(super) struct Shared {
    pub(super) access: Access,
    pub(super) seats: Arc<Seats>,
    pub(super) board: Arc<Board>,
    /// What is said once; empty until there is a run.
    pub(super) facts: watch::Sender<Utf8Bytes>,
    /// The newest state.
    pub(super) state: watch::Sender<Utf8Bytes>,
    /// The newest of whatever else there is to show; empty if there is nothing.
    pub(super) bulletin: watch::Sender<Utf8Bytes>,
    /// The last words, when all is over.
    pub(super) over: watch::Sender<Option<Utf8Bytes>>,
    /// What viewers are told.
    pub(super) viewers: Arc<Viewers>,
    /// Where in a log a page looked last, s from its first tick.
    pub(super) place: watch::Sender<Option<f64>>,
    /// The operator's hands, if they move the arms.
    pub(super) hands: Arc<Hands>,
    shown: Mutex<Shown>,
    /// The scene's file; empty if there is none.
    scene: Mutex<Bytes>,
    /// Its shapes one by one, for viewers; empty if there can be none.
    shapes: Mutex<Arc<Shapes>>,
}

impl Shared {
    pub(super) fn new(access: Access) -> Self {
        let board = Arc::new(Board::new());
        Self {
            access,
            seats: Arc::new(Seats::new(Arc::clone(&board))),
            board,
            facts: watch::Sender::new(Utf8Bytes::default()),
            state: watch::Sender::new(Utf8Bytes::default()),
            bulletin: watch::Sender::new(Utf8Bytes::default()),
            over: watch::Sender::new(None),
            viewers: Arc::default(),
            place: watch::Sender::new(None),
            hands: Arc::new(Hands::new()),
            shown: Mutex::new(Shown::Nothing),
            scene: Mutex::default(),
            shapes: Mutex::default(),
        }
    }

    /// From now on pages see a run.
    pub(super) fn show_run(&self, live: Arc<Live>) {
        let facts = live.facts();
        let (arms, cameras) = live.arms_and_cameras();
        let channels = log_form::of_run(arms, &cameras);
        // Whoever hears of the facts looks for the run.
        self.show(Shown::Live(live));
        self.viewers.offer(channels, cameras);
        self.facts.send_replace(facts.into());
    }

    /// Tells of the run that is shown, which has a scene from now on.
    pub(super) fn tell_scene(&self) {
        if let Some(live) = self.live() {
            live.has_scene();
            self.show_run(live);
        }
    }

    /// From now on pages see a log.
    pub(super) fn show_log(&self, log: LogView) {
        let facts = log.facts();
        let (arms, cameras) = log.arms_and_cameras();
        let channels = log_form::of_log(arms, &cameras, log.has_buses());
        // Pages that are told of the scene ask for its file.
        self.show_scene(log.scene_file().unwrap_or_default());
        self.show(Shown::Log(Arc::new(log)));
        self.viewers.offer(channels, cameras);
        self.facts.send_replace(facts.into());
    }

    /// From now on pages see a dataset.
    pub(super) fn show_dataset(&self, dataset: DatasetView) {
        let facts = dataset.facts();
        // Pages that are told of the scene ask for its file.
        self.show_scene(dataset.scene_file().unwrap_or_default());
        self.show(Shown::Dataset(Arc::new(dataset)));
        self.facts.send_replace(facts.into());
    }

    /// From now on this is the scene's file.
    pub(super) fn show_scene(&self, file: Bytes) {
        *self.scene.lock().unwrap_or_else(PoisonError::into_inner) = file;
    }

    /// From now on these are the scene's shapes.
    pub(super) fn show_shapes(&self, shapes: Shapes) {
        *self.shapes.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(shapes);
    }

    /// The scene's shapes.
    pub(super) fn shapes(&self) -> Arc<Shapes> {
        let shapes = self.shapes.lock().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(&shapes)
    }

    /// The scene's file, if there is one.
    pub(super) fn scene(&self) -> Option<Bytes> {
        let file = self.scene.lock().unwrap_or_else(PoisonError::into_inner);
        (!file.is_empty()).then(|| file.clone())
    }

    /// What was shown before goes once the last page that reads it is done.
    fn show(&self, shown: Shown) {
        *self.shown.lock().unwrap_or_else(PoisonError::into_inner) = shown;
    }

    /// The run that is shown, if it is one.
    pub(super) fn live(&self) -> Option<Arc<Live>> {
        match &*self.shown.lock().unwrap_or_else(PoisonError::into_inner) {
            Shown::Live(live) => Some(Arc::clone(live)),
            Shown::Nothing | Shown::Log(_) | Shown::Dataset(_) => None,
        }
    }

    /// The log that is shown, if it is one.
    pub(super) fn log(&self) -> Option<Arc<LogView>> {
        match &*self.shown.lock().unwrap_or_else(PoisonError::into_inner) {
            Shown::Log(log) => Some(Arc::clone(log)),
            Shown::Nothing | Shown::Live(_) | Shown::Dataset(_) => None,
        }
    }

    /// The dataset that is shown, if it is one.
    pub(super) fn dataset(&self) -> Option<Arc<DatasetView>> {
        match &*self.shown.lock().unwrap_or_else(PoisonError::into_inner) {
            Shown::Dataset(dataset) => Some(Arc::clone(dataset)),
            Shown::Nothing | Shown::Live(_) | Shown::Log(_) => None,
        }
    }

    /// Puts up the newest state.
    pub(super) fn refresh(&self) {
        let Some(live) = self.live() else {
            return;
        };
        if let Some(state) = live.state() {
            self.state.send_replace(state.into());
        }
        self.viewers.happened(live.happened());
        if self.viewers.any() {
            self.viewers.tell(live.messages());
        }
    }

    /// Says `command` to the run; whether it is a yes, and its answer.
    pub(super) async fn say(&self, command: Command) -> (bool, String) {
        let Some(live) = self.live() else {
            return (false, "there is no run to steer".to_owned());
        };
        let said = spawn_blocking(move || live.say(&command)).await;
        said.unwrap_or_else(|error| (false, error.to_string()))
    }
}
