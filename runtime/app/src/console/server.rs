//! The server: the page's files and its WebSocket, on a thread of its own at normal priority. It is
//! a tokio runtime of one thread, so that nothing of it needs a lock against itself; what would
//! block (the run's answer to a command) waits on a few threads beside it.

use std::io;
use std::net::TcpListener;
use std::ops::Deref;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse as _, Response};
use axum::routing::get;
use axum::{Extension, Router};
use tokio::runtime::{Builder, Runtime};
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval, timeout};

use super::access::{Refusal, check_host, check_origin, check_viewer_origin};
use super::client::attend;
use super::connection::{ConnectionPermit, admit};
use super::foxglove;
use super::request::MESSAGE_BYTES_MAX;
use super::shared::Shared;
use super::tls::Tls;

/// Time from one state to the next.
const STATE_EVERY: Duration = Duration::from_millis(50);

/// Time that pages have to take leave.
const LEAVE: Duration = Duration::from_millis(1500);

/// Bytes that a message of a viewer may have: subscriptions to all there is.
const VIEWER_BYTES_MAX: usize = 16 << 10;

/// Threads that wait for the run's answers to commands.
const WAITING_MAX: usize = 4;

/// The page's files: path, type, text. They are in the binary, so that the page is always of the
/// program's version.
const FILES: [(&str, &str, &str); 20] = [
    (
        "/",
        "text/html; charset=utf-8",
        include_str!("page/index.html"),
    ),
    (
        "/spacemouse.js",
        "text/javascript; charset=utf-8",
        include_str!("page/spacemouse.js"),
    ),
    (
        "/console.css",
        "text/css; charset=utf-8",
        include_str!("page/console.css"),
    ),
    ("/main.js", SCRIPT, include_str!("page/main.js")),
    ("/connection.js", SCRIPT, include_str!("page/connection.js")),
    ("/dom.js", SCRIPT, include_str!("page/dom.js")),
    ("/panels.js", SCRIPT, include_str!("page/panels.js")),
    ("/criteria.js", SCRIPT, include_str!("page/criteria.js")),
    ("/cameras.js", SCRIPT, include_str!("page/cameras.js")),
    ("/drives.js", SCRIPT, include_str!("page/drives.js")),
    ("/recording.js", SCRIPT, include_str!("page/recording.js")),
    ("/operator.js", SCRIPT, include_str!("page/operator.js")),
    ("/teleop.js", SCRIPT, include_str!("page/teleop.js")),
    ("/hands.js", SCRIPT, include_str!("page/hands.js")),
    ("/headset.js", SCRIPT, include_str!("page/headset.js")),
    ("/dataset.js", SCRIPT, include_str!("page/dataset.js")),
    ("/timeline.js", SCRIPT, include_str!("page/timeline.js")),
    ("/scene.js", SCRIPT, include_str!("page/scene.js")),
    ("/scene_draw.js", SCRIPT, include_str!("page/scene_draw.js")),
    ("/scene_file.js", SCRIPT, include_str!("page/scene_file.js")),
];

const SCRIPT: &str = "text/javascript; charset=utf-8";

/// What a browser may not do with any answer: load from elsewhere, guess types, tell where it came
/// from, show it in another page.
const HEADERS: [(HeaderName, &str); 6] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-store"),
    (
        HeaderName::from_static("cross-origin-opener-policy"),
        "same-origin",
    ),
    (
        HeaderName::from_static("cross-origin-resource-policy"),
        "same-origin",
    ),
];

/// Everything that a server needs.
///
/// # Errors
/// If the system gives no event queue.
pub(super) fn runtime() -> io::Result<Runtime> {
    Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(WAITING_MAX)
        .build()
}

/// What a listener serves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ListenerKind {
    /// Pages of the console.
    Pages,
    /// Foxglove, and whoever speaks its protocol.
    Viewers,
}

/// A listener: whom it is for, and its TLS if other machines reach it.
pub(super) struct Opened {
    pub(super) listener: TcpListener,
    pub(super) door: ListenerKind,
    pub(super) tls: Option<Tls>,
}

/// What a request's handler knows.
#[derive(Clone)]
struct ServerState {
    shared: Arc<Shared>,
    tls: Option<Tls>,
}

impl Deref for ServerState {
    type Target = Shared;

    fn deref(&self) -> &Shared {
        &self.shared
    }
}

/// Serves whoever comes to `listeners` until all is over and they have taken leave.
pub(super) fn serve(
    runtime: &Runtime,
    listeners: Vec<Opened>,
    shared: &Arc<Shared>,
) -> io::Result<()> {
    runtime.block_on(async {
        let mut doors = JoinSet::new();
        for Opened {
            listener,
            door,
            tls,
        } in listeners
        {
            let listener = tokio::net::TcpListener::from_std(listener)?;
            let desk = ServerState {
                shared: Arc::clone(shared),
                tls: tls.clone(),
            };
            doors.spawn(admit(listener, tls, desk.router(door)));
        }
        refresh(shared).await;
        Ok(())
    })
}

/// Puts up states; ends when all is over and nobody looks on any more.
async fn refresh(shared: &Shared) {
    let mut ticks = interval(STATE_EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut over = shared.over.subscribe();
    let mut seats = shared.seats.watch();
    loop {
        tokio::select! {
            _ = ticks.tick() => shared.refresh(),
            _ = over.wait_for(Option::is_some) => break,
        }
    }
    let empty = seats.wait_for(|taken| taken.pages == 0);
    let _late = timeout(LEAVE, empty).await;
    // The last messages are on their way.
    tokio::time::sleep(STATE_EVERY).await;
}

impl ServerState {
    /// The routes of a door. Every answer passes `guard`.
    fn router(self, door: ListenerKind) -> Router {
        let routes = match door {
            ListenerKind::Pages => Router::new()
                .route("/socket", get(socket))
                .fallback(get(file)),
            ListenerKind::Viewers => Router::new().route("/", get(viewer)),
        };
        routes
            .layer(middleware::from_fn_with_state(self.clone(), guard))
            .with_state(self)
    }
}

/// Checks the host of every request, and tells the browser what it may do with every answer.
async fn guard(State(desk): State<ServerState>, request: Request, next: Next) -> Response {
    let mut response = match check_host(request.headers(), desk.tls.as_ref()) {
        Ok(()) => next.run(request).await,
        Err(refusal) => refused(refusal),
    };
    for (name, value) in HEADERS {
        response
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    }
    response
}

/// A file of the page, for whoever has the token in the URL or the cookie. With the URL's the
/// cookie is set, which all other requests of the page carry.
async fn file(State(desk): State<ServerState>, uri: Uri, headers: HeaderMap) -> Response {
    let access = &desk.access;
    let by_query = access.is_in_query(uri.query());
    if !by_query && let Err(refusal) = access.check_cookie(&headers) {
        return refused(refusal);
    }
    if uri.path() == "/scene.glb" {
        return desk.scene().map_or_else(
            || (StatusCode::NOT_FOUND, "there is no scene\n").into_response(),
            |file| ([(header::CONTENT_TYPE, "model/gltf-binary")], file).into_response(),
        );
    }
    let found = FILES.iter().find(|(path, ..)| *path == uri.path());
    let Some((_, kind, text)) = found else {
        return (StatusCode::NOT_FOUND, "there is no such page\n").into_response();
    };
    let mut response = ([(header::CONTENT_TYPE, *kind)], *text).into_response();
    if by_query && let Ok(cookie) = HeaderValue::from_str(&access.set_cookie(desk.tls.is_some())) {
        response.headers_mut().insert(header::SET_COOKIE, cookie);
    }
    response
}

/// The page's WebSocket: the origin must be the page's own, the cookie must have the token.
async fn socket(
    State(desk): State<ServerState>,
    Extension(place): Extension<ConnectionPermit>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    let known = check_origin(&headers, desk.tls.is_some());
    let known = known.and_then(|()| desk.access.check_cookie(&headers));
    if let Err(refusal) = known {
        return refused(refusal);
    }
    upgrade
        .max_message_size(MESSAGE_BYTES_MAX)
        .max_frame_size(MESSAGE_BYTES_MAX)
        .on_upgrade(async move |socket| {
            attend(socket, desk.shared).await;
            place.leave();
        })
}

/// A viewer has the token in its address, as the run prints it.
async fn viewer(
    State(desk): State<ServerState>,
    Extension(place): Extension<ConnectionPermit>,
    uri: Uri,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if let Err(refusal) = check_viewer_origin(&headers) {
        return refused(refusal);
    }
    if !desk.access.is_viewer_in_query(uri.query()) {
        return refused(Refusal::Token);
    }
    upgrade
        .protocols(foxglove::PROTOCOLS)
        .max_message_size(VIEWER_BYTES_MAX)
        .max_frame_size(VIEWER_BYTES_MAX)
        .on_upgrade(async move |socket| {
            foxglove::attend(socket, desk.shared).await;
            place.leave();
        })
}

fn refused(refusal: Refusal) -> Response {
    // Whoever is refused holds no connection.
    ([(header::CONNECTION, "close")], refusal.answer()).into_response()
}
