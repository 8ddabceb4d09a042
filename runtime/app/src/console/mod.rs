//! The web console: one page in the browser that shows a run as it goes on, or a log, and from
//! which the operator steers.
//!
//! ```text
//!  control thread ── newest tick, counts (mailbox) ──> server thread ── JSON, 20 a second ──> pages
//!  camera thread ── planes ──> compressing thread ── JPEG, PNG, newest only ──> server thread ──^  │
//!                    the run's socket for operators <── verbs, of the one page that steers ────────┘
//! ```
//!
//! `address` and `doors` say where it listens, `connection` how many connections it holds and for
//! how long, `tls` and `certificate` how other machines reach it, `access` who may open it;
//! `server` serves the page's files, `client` one page; `request` is what a page may say, `seats`
//! who steers. `tap` is the control thread's end, `pictures` and `encode` are what cameras show,
//! `scene` the scene in three dimensions; `by_hand` takes the operator's hands (`session/teleop`);
//! `facts`, `live` and `state` make what a run says, `path` where its chunks lead, `log_view` what
//! a log says, `log_scene` where everything was in it, `dataset_view` what a dataset does,
//! `dataset_scene` what is known of its scene. The page itself is in `page/`. `foxglove` tells
//! other programs the same in the log's form, at a door of its own, what stands in `viewers`, of a
//! log in `log_messages`.
//!
//! The page has exactly the operator's verbs, and they go the same way: over the run's own socket
//! (`session/operator`). What its hands ask for are chunks, as a policy's (`session/teleop`).
//! Nothing of it reaches the controller in another way, so it can't weaken a limit.

mod access;
mod address;
mod by_hand;
mod certificate;
mod client;
mod connection;
mod dataset_scene;
mod dataset_view;
mod doors;
mod drawn;
mod encode;
mod facts;
mod foxglove;
mod live;
mod log_images;
mod log_messages;
mod log_scene;
mod log_states;
mod log_view;
mod path;
mod pictures;
mod request;
mod scene;
mod seats;
mod server;
mod shared;
mod state;
mod tap;
mod tls;
mod viewers;

use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use hal::TimeNs;
use serde::Serialize;
use trocar_control::config::ArmConfig;
use trocar_log::{Level, live as log_form, pre_faulted_queue};
use trocar_tasks::cameras::SceneModel;
use trocar_tasks::scene::SceneSnapshot;
use trocar_topics::TaskReport;

pub use address::{Address, BadAddress, DEFAULT_ADDRESS, FOXGLOVE_ADDRESS};
pub use doors::ListenAddresses;
pub use facts::Facts;
pub(crate) use facts::PictureFacts;
pub(crate) use pictures::{BETWEEN_NS, FramePlanes, FrameTap};
pub(crate) use scene::{SceneTap, is_placed, of_arms};
pub use tap::ControlTap;

use crate::mailbox::{MailboxWriter, mailbox};
use crate::rt::MonotonicClock;
use crate::session::SessionError;
use crate::session::teleop::{self, Hands};
use access::Access;
use dataset_view::DatasetView;
use doors::{Listening, Reached};
use live::{Live, RunMailboxes};
use log_view::LogView;
use pictures::Board;
use shared::Shared;
use viewers::Message;

/// Ticks in which something happened that may wait to be told: they are looked for twenty times a
/// second.
const NOTED: usize = 32;

/// A console that listens. Clones are the same one.
#[derive(Clone, Debug)]
pub struct Console {
    shared: Arc<Shared>,
    page: Option<Reached>,
    viewers: Option<Reached>,
    /// Of the certificate, if there is one.
    fingerprint: Option<String>,
    threads: Arc<Mutex<Vec<JoinHandle<()>>>>,
}

/// The ends of a run that say what it does.
#[derive(Debug)]
pub struct RunTaps {
    /// For the control thread.
    pub control: ControlTap,
    /// For whoever knows how the task stands.
    pub task: MailboxWriter<TaskReport>,
    /// For whoever asks what the run does.
    pub(crate) view: RunView,
}

/// A run as whoever asks sees it: what pages are told, as JSON.
#[derive(Clone, Debug)]
pub(crate) struct RunView(Arc<Live>);

impl RunView {
    /// What does not change.
    pub(crate) fn facts(&self) -> String {
        self.0.facts()
    }

    /// The newest state; none before the first tick.
    pub(crate) fn state(&self) -> Option<String> {
        self.0.state()
    }

    /// The operator's hands, which say how it went too.
    pub(crate) fn hands(&self) -> &Arc<Hands> {
        self.0.hands()
    }
}

/// The ends of a run that no page shows, which says what it does to whoever asks at `operator`.
pub(crate) fn unseen_run(facts: Facts, operator: Option<PathBuf>) -> RunTaps {
    let (hands, board) = (Arc::new(Hands::new()), Arc::new(Board::new()));
    tapped(facts, operator, (hands, board))
}

fn tapped(
    facts: Facts,
    operator: Option<PathBuf>,
    (hands, board): (Arc<Hands>, Arc<Board>),
) -> RunTaps {
    let (to, from) = mailbox();
    let (task_to, task_from) = mailbox();
    let (commanded, commanded_from) = mailbox();
    let (chunks_to, chunks) = mailbox();
    let (noted_to, noted) = pre_faulted_queue(NOTED);
    hands.follow(commanded_from);
    let said = RunMailboxes {
        samples: from,
        task: task_from,
        chunks,
        noted,
    };
    let live = Live::new(facts, said, operator, (hands, board));
    RunTaps {
        control: ControlTap::new(to, commanded, chunks_to, noted_to),
        task: task_to,
        view: RunView(Arc::new(live)),
    }
}

/// The last words of a run.
#[derive(Serialize)]
struct LastWords<'a> {
    kind: &'static str,
    success: Option<bool>,
    reason: &'a str,
}

impl Console {
    /// Listens at `address` for pages.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if nobody can listen there.
    pub fn open(address: Address) -> Result<Self, SessionError> {
        Self::listen_on(&ListenAddresses {
            page: Some(address),
            ..ListenAddresses::default()
        })
    }

    /// Listens at `doors`.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if nobody can listen there, or a certificate is none.
    pub fn listen_on(doors: &ListenAddresses) -> Result<Self, SessionError> {
        let Listening {
            page,
            viewers,
            fingerprint,
            listeners,
        } = doors.listen()?;
        let failed = |error: io::Error| {
            SessionError::BadArgument(format!("the console's server can't be started: {error}"))
        };
        let access = Access::new(page.map_or(0, |page| page.address.port())).map_err(failed)?;
        let shared = Arc::new(Shared::new(access));
        let runtime = server::runtime().map_err(failed)?;
        let mut threads = Vec::new();
        let own = Arc::clone(&shared);
        threads.push(
            spawn("console", move || {
                // Without a server pages see that the connection is lost; the run goes on.
                let _failed = server::serve(&runtime, listeners, &own);
                runtime.shutdown_background();
            })
            .map_err(failed)?,
        );
        let board = Arc::clone(&shared.board);
        threads.push(spawn("console-pictures", move || board.compress()).map_err(failed)?);
        Ok(Self {
            shared,
            page,
            viewers,
            fingerprint,
            threads: Arc::new(Mutex::new(threads)),
        })
    }

    /// From now on the devices at `paths`, under `/dev/input`, are the operator's hands, and those
    /// of no page; `warn` hears of those that go.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if one can't be read or is no input device.
    pub fn take_hands(&self, paths: &[PathBuf], warn: fn(&str)) -> Result<(), SessionError> {
        teleop::attend(paths, self.hands(), warn)
    }

    /// What opens it in a browser, with its token; none if it listens for no page.
    #[must_use]
    pub fn url(&self) -> Option<String> {
        let url = |page: Reached| self.shared.access.url(page.address, page.secure);
        self.page.map(url)
    }

    /// SHA-256 of the certificate, if there is TLS: what a browser on another machine has to show.
    #[must_use]
    pub fn fingerprint(&self) -> Option<&str> {
        self.fingerprint.as_deref()
    }

    /// What opens it in Foxglove, with its token; none if it does not listen for that.
    #[must_use]
    pub fn viewer_url(&self) -> Option<String> {
        let url = |it: Reached| self.shared.access.viewer_url(it.address, it.secure);
        self.viewers.map(url)
    }

    /// Whether an operator may take over: on a page, which can be opened, or by devices here.
    pub(crate) fn has_operator(&self) -> bool {
        self.page.is_some() || self.shared.hands.are_at_desk()
    }

    /// Shows the log at `path` from now on.
    ///
    /// # Errors
    /// [`SessionError::Log`] or [`SessionError::Replay`] if it can't be read.
    pub fn show_log(&self, path: &Path) -> Result<(), SessionError> {
        self.shared
            .show_log(LogView::read(path, self.viewers.is_some())?);
        Ok(())
    }

    /// Shows the dataset in the folder `dir` from now on, episode by episode.
    ///
    /// # Errors
    /// [`SessionError::Dataset`] if it is none or is damaged.
    pub fn show_dataset(&self, dir: &Path) -> Result<(), SessionError> {
        self.shared.show_dataset(DatasetView::read(dir)?);
        Ok(())
    }

    /// Shows a run from now on, whose operator's socket is `operator`; what it says comes from the
    /// ends that this gives.
    pub fn show_run(&self, facts: Facts, operator: Option<PathBuf>) -> RunTaps {
        let hands = Arc::clone(&self.shared.hands);
        let board = Arc::clone(&self.shared.board);
        let taps = tapped(facts, operator, (hands, board));
        self.shared.show_run(Arc::clone(&taps.view.0));
        taps
    }

    /// From now on shows what `facts` say of drives; news of them come by [`Self::tell`] and
    /// [`Self::tell_axes`].
    pub(crate) fn show_drives(&self, facts: &Facts) {
        let channels = log_form::of_drives(facts.arms.len(), &facts.cameras);
        self.shared.viewers.offer(channels, facts.cameras.clone());
        self.shared.facts.send_replace(facts.json().into());
    }

    /// Shows the newest of what is no run, or stands beside it.
    pub(crate) fn tell(&self, news: &impl Serialize) {
        let text = serde_json::to_string(news).unwrap_or_default();
        self.shared.bulletin.send_replace(text.into());
    }

    /// Tells viewers, if there are any, where the axes of each arm are and are wanted, as
    /// [`log_form::axes`] does.
    pub(crate) fn tell_axes<'a, I>(&self, at: TimeNs, arms: impl Iterator<Item = I>)
    where
        I: Iterator<Item = log_form::Axis<'a>> + Clone,
    {
        if self.shared.viewers.any() {
            let arms = arms.enumerate();
            let messages = arms.flat_map(|(arm, axes)| log_form::axes(at, arm, axes));
            let messages = messages.map(|(topic, data)| Message::new(topic, at, data));
            self.shared.viewers.tell(messages.collect());
        }
    }

    /// Tells viewers what has happened, in words.
    pub(crate) fn happened(&self, at: TimeNs, level: Level, text: &str) {
        let event = Message::event(at, level, text);
        self.shared.viewers.happened(vec![event]);
    }

    /// Shows the scene of `model` from now on, as it is in `start`, with the limits of `arms`: the
    /// end for what moves.
    ///
    /// # Errors
    /// [`SessionError::Simulation`] if an arm that carries a camera is not in `start`.
    pub(crate) fn show_scene(
        &self,
        mut model: SceneModel,
        start: &SceneSnapshot,
        arms: &[ArmConfig],
    ) -> Result<SceneTap, SessionError> {
        let file = scene::file(&model, start, arms)?;
        self.shared.show_scene(file);
        if self.viewers.is_some() {
            let bent: Vec<usize> = model.bent(start).iter().map(|(index, _)| *index).collect();
            self.shared.show_shapes(scene::Shapes::new(&model, &bent));
        }
        Ok(SceneTap::new(model, Arc::clone(&self.shared.board)))
    }

    /// Shows the scene of `model` in the run that is shown, which had none until now.
    ///
    /// # Errors
    /// Those of [`Self::show_scene`].
    pub(crate) fn add_scene(
        &self,
        model: SceneModel,
        start: &SceneSnapshot,
        arms: &[ArmConfig],
    ) -> Result<SceneTap, SessionError> {
        let tap = self.show_scene(model, start, arms)?;
        self.shared.tell_scene();
        Ok(tap)
    }

    /// From now on the pictures' time is by `clock`, of a run in real time.
    pub(crate) fn follow(&self, clock: MonotonicClock) {
        self.shared.board.follow(clock);
    }

    /// The end for frames.
    pub(crate) fn frames(&self) -> FrameTap {
        FrameTap(Arc::clone(&self.shared.board))
    }

    /// The operator's hands.
    pub(crate) fn hands(&self) -> Arc<Hands> {
        Arc::clone(&self.shared.hands)
    }

    /// Tells the pages how the run ended, and closes when they have heard it, or after a second and
    /// a half.
    pub fn close(&self, success: Option<bool>, reason: &str) {
        let words = LastWords {
            kind: "end",
            success,
            reason,
        };
        let text = serde_json::to_string(&words).unwrap_or_default();
        self.shared.refresh();
        if let Some(live) = self.shared.live() {
            self.happened(live.now(), Level::Info, &format!("the run ended: {reason}"));
        }
        self.shared.over.send_replace(Some(text.into()));
        self.shared.board.close();
        let mut threads = self.threads.lock().unwrap_or_else(PoisonError::into_inner);
        for thread in threads.drain(..) {
            let _panicked = thread.join();
        }
    }
}

fn spawn(name: &str, body: impl FnOnce() + Send + 'static) -> io::Result<JoinHandle<()>> {
    thread::Builder::new().name(name.to_owned()).spawn(body)
}
