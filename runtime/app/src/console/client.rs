//! One page: what it says is checked and done, and it is told what is new when it has room.
//!
//! A page says how many messages have arrived; no more than a few are on their way to it at a time.
//! So whatever lies between (a tunnel, a slow network, a page that draws) holds no queue of old
//! pictures.
//!
//! A page has its place in `seats`, which frees it when the page goes. What a run puts up is
//! watched (`tokio::sync::watch`): of each thing there is the newest alone, so that a slow page
//! misses values and delays nobody. A message that makes no sense is answered and changes nothing.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket, close_code};
use serde::Serialize;
use tokio::sync::watch;
use tokio::time::{interval, timeout};

use super::by_hand;
use super::dataset_view::DatasetView;
use super::drawn::Stream;
use super::log_view::LogView;
use super::request::{Request, TokenBucket, command};
use super::seats::{Seat, Taken};
use super::shared::Shared;
use crate::rt::{MonotonicClock, slow_motion};
use crate::session::operator::Command;
use crate::session::teleop::ReleaseCause;
use hal::TimeNs;
use trocar_control::OperatorEvent;

/// Messages on their way to a page. It bounds how old what a page shows can be.
const ON_THE_WAY_MAX: u32 = 8;

/// Time from one ping to the next, which browsers answer by themselves. Their answers measure the
/// round trip, half of which is added to the latency from hand to command and taken off that from
/// camera to page.
const PING: Duration = Duration::from_secs(2);

/// How long a page that was told of the end has to close.
const FAREWELL: Duration = Duration::from_secs(1);

/// A page of which nothing is heard for this long is gone, ns.
const SILENCE_NS: u64 = 10_000_000_000;

/// Time for one message to leave. A page that takes longer is disconnected.
const SEND: Duration = Duration::from_secs(5);

/// The page has disconnected.
struct Disconnected;

/// What came from a page, if it is still there.
type Incoming = Option<Result<Message, axum::Error>>;

/// What a page gets.
#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum ServerMessage<'a> {
    /// Who steers.
    ///
    /// `taken` is whether anybody steers, this page or another.
    Seat {
        steers: bool,
        taken: bool,
        pages: usize,
    },
    /// What came of a command.
    Answer {
        command: &'a str,
        ok: bool,
        text: &'a str,
    },
    /// A message made no sense.
    Problem { text: &'a str },
}

/// What there is to send.
///
/// `End` is followed by the closing of the socket.
enum Outgoing {
    Text(Utf8Bytes),
    Picture(Bytes),
    End(Utf8Bytes),
}

/// Serves a page until it goes or the console ends. Facts, state and bulletin that are there
/// already come first. Its hands let go when it goes, whatever the cause.
pub(super) async fn attend(mut socket: WebSocket, shared: Arc<Shared>) {
    let Some(seat) = shared.seats.sit() else {
        let _gone = close(&mut socket, close_code::AGAIN, "too many pages are open").await;
        return;
    };
    let clock = MonotonicClock::new();
    let mut page = Page {
        facts: shared.facts.subscribe(),
        state: shared.state.subscribe(),
        bulletin: shared.bulletin.subscribe(),
        taken: shared.seats.watch(),
        pictures: shared.board.watch(),
        over: shared.over.subscribe(),
        streams: Vec::new(),
        seen: BTreeMap::new(),
        turn: 0,
        place: None,
        episode: 0,
        moved: false,
        on_the_way: 0,
        heard: clock.now(),
        allowance: TokenBucket::new(page_time(clock.now())),
        clock,
        shared,
        seat,
    };
    // What there is already is news to this page.
    page.facts.mark_changed();
    page.state.mark_changed();
    page.bulletin.mark_changed();
    page.taken.mark_changed();
    let _gone: Result<(), Disconnected> = page.serve(&mut socket).await;
    page.shared
        .hands
        .release(page.seat.id(), ReleaseCause::PageGone);
}

/// What one page has been told, and what it asks for.
struct Page {
    shared: Arc<Shared>,
    seat: Seat,
    facts: watch::Receiver<Utf8Bytes>,
    state: watch::Receiver<Utf8Bytes>,
    bulletin: watch::Receiver<Utf8Bytes>,
    taken: watch::Receiver<Taken>,
    pictures: watch::Receiver<u64>,
    over: watch::Receiver<Option<Utf8Bytes>>,
    streams: Vec<Stream>,
    /// The number of the picture that it has of each stream.
    seen: BTreeMap<Stream, u64>,
    /// The place among its streams of the one that is next to get a picture of a log or a dataset.
    /// So streams take turns and none starves.
    turn: usize,
    /// Where in a log, or in an episode of a dataset, it looks.
    place: Option<f64>,
    episode: usize,
    /// Whether it has moved since it was told the state of its place.
    moved: bool,
    /// Messages that were sent and not yet acknowledged by `Seen`.
    on_the_way: u32,
    /// When something was last heard of it.
    heard: TimeNs,
    /// How many messages it may still send at once.
    allowance: TokenBucket,
    clock: MonotonicClock,
}

impl Page {
    /// What the page says comes before what it is told (`biased`), so that a page that is flooded
    /// still steers.
    async fn serve(&mut self, socket: &mut WebSocket) -> Result<(), Disconnected> {
        let mut pings = interval(PING);
        loop {
            tokio::select! {
                biased;
                heard = socket.recv() => self.hear(heard, socket).await?,
                _ = pings.tick() => self.ping(socket).await?,
                news = self.news() => self.tell(news, socket).await?,
            }
        }
    }

    /// The ping has the time of sending in it, which comes back. Ends the page if nothing was heard
    /// of it for `SILENCE_NS`.
    async fn ping(&self, socket: &mut WebSocket) -> Result<(), Disconnected> {
        if self.clock.now().since(self.heard) > SILENCE_NS {
            return Err(Disconnected);
        }
        let sent = self.clock.now().0.to_le_bytes();
        send(socket, Message::Ping(sent.to_vec().into())).await
    }

    /// Sends a piece of news and counts it as on its way.
    async fn tell(&mut self, news: Outgoing, socket: &mut WebSocket) -> Result<(), Disconnected> {
        match news {
            Outgoing::Text(text) => {
                self.on_the_way += 1;
                send(socket, Message::Text(text)).await
            }
            Outgoing::Picture(bytes) => {
                self.on_the_way += 1;
                send(socket, Message::Binary(bytes)).await
            }
            Outgoing::End(text) => {
                send(socket, Message::Text(text)).await?;
                close(socket, close_code::NORMAL, "the run has ended").await?;
                // A socket that goes with words unread resets the connection, and what is on its
                // way is lost.
                let unread = async { while let Some(Ok(_)) = socket.recv().await {} };
                let _silent = timeout(FAREWELL, unread).await;
                Err(Disconnected)
            }
        }
    }

    /// Counts the message against the page's rate, reads it and does what it asks for. Whoever
    /// exceeds the rate is disconnected.
    async fn hear(&mut self, heard: Incoming, socket: &mut WebSocket) -> Result<(), Disconnected> {
        let Some(Ok(message)) = heard else {
            return Err(Disconnected);
        };
        self.heard = self.clock.now();
        if !self.allowance.take(page_time(self.heard)) {
            close(socket, close_code::POLICY, "too many messages").await?;
            return Err(Disconnected);
        }
        let problem = match message {
            Message::Text(text) => match Request::parse(&text) {
                Ok(request) => return self.act(request, socket).await,
                Err(problem) => problem.to_string(),
            },
            Message::Binary(_) => "no message of the console: it is binary".to_owned(),
            Message::Pong(sent) => {
                self.answered(&sent);
                return Ok(());
            }
            Message::Ping(_) => return Ok(()),
            Message::Close(_) => return Err(Disconnected),
        };
        answer(socket, &ServerMessage::Problem { text: &problem }).await
    }

    /// Does what a page may always ask for here, and hands the rest on: commands to the run, what
    /// is of hands to `by_hand`.
    async fn act(&mut self, request: Request, socket: &mut WebSocket) -> Result<(), Disconnected> {
        match request {
            Request::Seen(count) => self.on_the_way = self.on_the_way.saturating_sub(count),
            Request::Steer(true) => {
                self.seat.steer();
            }
            Request::Steer(false) => {
                self.shared
                    .hands
                    .release(self.seat.id(), ReleaseCause::Seat);
                self.seat.let_go();
            }
            Request::Show(streams) => {
                self.seat.look_at(&streams);
                // What is looked at anew is to be told anew.
                self.seen.retain(|stream, _| streams.contains(stream));
                self.streams = streams;
            }
            Request::At(seconds) => {
                (self.place, self.moved) = (Some(seconds), true);
                self.shared.place.send_replace(self.place);
            }
            Request::Open(episode) => {
                let dataset = self.shared.dataset();
                let episodes = dataset.map_or(0, |dataset| dataset.episodes());
                if episode >= episodes {
                    let text = &format!("episode {episode}: there are {episodes}");
                    return answer(socket, &ServerMessage::Problem { text }).await;
                }
                (self.episode, self.moved) = (episode, self.place.is_some());
            }
            Request::Shown(_) if !self.seat.steers() => {}
            Request::Command(text) => return self.command(&text, socket).await,
            Request::Shown(_)
            | Request::Hands(_)
            | Request::HandsOff(_)
            | Request::Scale(_)
            | Request::Align(_)
            | Request::HandBack(_)
            | Request::Episode(_)
            | Request::Label(_)
            | Request::Mark(_) => {
                if let Err(problem) = by_hand::heard(&self.shared, &self.seat, request) {
                    let text = &problem.to_string();
                    return answer(socket, &ServerMessage::Problem { text }).await;
                }
            }
        }
        Ok(())
    }

    /// A ping came back, with the time when it was sent.
    fn answered(&self, sent: &[u8]) {
        if let Ok(sent) = sent.try_into() {
            let sent = TimeNs(u64::from_le_bytes(sent));
            let round_trip_ns = self.heard.since(sent);
            self.shared.hands.round_trip(self.seat.id(), round_trip_ns);
        }
    }

    /// Does what the operator's verb does, if this page steers or the verb brings the arms to rest.
    /// Any page may `stop` and `pause`. The page waits for the answer; others do not.
    async fn command(&mut self, text: &str, socket: &mut WebSocket) -> Result<(), Disconnected> {
        let (ok, said) = match command(text) {
            Err(reason) => (false, reason),
            Ok(command) if !brings_to_rest(&command) && !self.seat.steers() => (
                false,
                "another page steers this run, or none: take control first".to_owned(),
            ),
            Ok(command) => self.shared.say(command).await,
        };
        let told = ServerMessage::Answer {
            command: text,
            ok,
            text: &said,
        };
        answer(socket, &told).await
    }

    /// Waits for something new; the most important first. With too much on its way only the end is
    /// waited for: until the page acknowledges.
    async fn news(&mut self) -> Outgoing {
        if self.on_the_way >= ON_THE_WAY_MAX {
            // A page that lags behind is told of the end all the same: nobody is here to tell it
            // later.
            drop(self.over.wait_for(Option::is_some).await);
        }
        loop {
            if let Some(news) = self.newest() {
                return news;
            }
            // A change that was waited for counts as seen; the next look has to see it.
            tokio::select! {
                _ = self.over.changed() => self.over.mark_changed(),
                _ = self.facts.changed() => self.facts.mark_changed(),
                _ = self.taken.changed() => self.taken.mark_changed(),
                _ = self.state.changed() => self.state.mark_changed(),
                _ = self.bulletin.changed() => self.bulletin.mark_changed(),
                _ = self.pictures.changed() => {}
            }
        }
    }

    /// What this page has not been told of. In the order of weight: the end, what is shown, who
    /// steers, the bulletin, the state, pictures.
    fn newest(&mut self) -> Option<Outgoing> {
        let last = self.over.borrow_and_update().clone();
        if let Some(last) = last {
            // How far a recording came is sent before its end.
            return Some(changed(&mut self.bulletin).map_or(Outgoing::End(last), Outgoing::Text));
        }
        if let Some(facts) = changed(&mut self.facts) {
            return Some(Outgoing::Text(facts));
        }
        if self.taken.has_changed().unwrap_or(false) {
            let taken = *self.taken.borrow_and_update();
            let told = ServerMessage::Seat {
                steers: taken.steers == Some(self.seat.id()),
                taken: taken.steers.is_some(),
                pages: taken.pages,
            };
            let text = serde_json::to_string(&told).ok()?;
            return Some(Outgoing::Text(text.into()));
        }
        if let Some(log) = self.shared.log() {
            return self.of_log(&log);
        }
        if let Some(dataset) = self.shared.dataset() {
            return self.of_dataset(&dataset);
        }
        let texts = [&mut self.bulletin, &mut self.state];
        if let Some(text) = texts.into_iter().find_map(changed) {
            return Some(Outgoing::Text(text));
        }
        let (stream, picture) = self.shared.board.newer(&self.streams, &self.seen)?;
        self.seen.insert(stream, picture.number);
        Some(Outgoing::Picture(picture.message))
    }

    /// What a log says of the place that this page looks at.
    fn of_log(&mut self, log: &LogView) -> Option<Outgoing> {
        let seconds = self.place?;
        if std::mem::take(&mut self.moved) {
            return Some(Outgoing::Text(log.state(seconds)?.into()));
        }
        self.picture(
            |stream| log.number(stream, seconds),
            |stream| log.picture(stream, seconds),
        )
    }

    /// What a dataset says of the place that this page looks at. Images are decoded here, in the
    /// server's thread: nothing runs beside it.
    fn of_dataset(&mut self, dataset: &DatasetView) -> Option<Outgoing> {
        let place = (self.episode, self.place?);
        if std::mem::take(&mut self.moved) {
            return Some(Outgoing::Text(dataset.state(place)?.into()));
        }
        let frame = dataset.frame(place)?;
        self.picture(
            |_| Some(frame as u64 + 1),
            |stream| dataset.picture(stream, frame),
        )
    }

    /// A picture that this page lacks, of its streams in turn: `number` says which there is of a
    /// stream, `picture` makes it.
    fn picture<E: Display>(
        &mut self,
        number: impl Fn(Stream) -> Option<u64>,
        picture: impl Fn(Stream) -> Result<Option<Bytes>, E>,
    ) -> Option<Outgoing> {
        let count = self.streams.len();
        for place in (self.turn..self.turn + count).map(|place| place % count) {
            let stream = self.streams[place];
            let Some(number) = number(stream) else {
                continue;
            };
            if self.seen.insert(stream, number) == Some(number) {
                continue;
            }
            self.turn = place + 1;
            match picture(stream) {
                Ok(Some(message)) => return Some(Outgoing::Picture(message)),
                Ok(None) => {}
                Err(damaged) => {
                    let text = &damaged.to_string();
                    let told = serde_json::to_string(&ServerMessage::Problem { text }).ok()?;
                    return Some(Outgoing::Text(told.into()));
                }
            }
        }
        None
    }
}

/// The time of a page, whose messages are bounded by it: browsers are not slowed down where the
/// clocks of this process are.
fn page_time(now: TimeNs) -> TimeNs {
    TimeNs(now.0.saturating_mul(slow_motion()))
}

/// What `receiver` holds if that is new and not empty.
fn changed(receiver: &mut watch::Receiver<Utf8Bytes>) -> Option<Utf8Bytes> {
    if !receiver.has_changed().unwrap_or(false) {
        return None;
    }
    let text = receiver.borrow_and_update().clone();
    (!text.is_empty()).then_some(text)
}

async fn answer(socket: &mut WebSocket, told: &ServerMessage<'_>) -> Result<(), Disconnected> {
    let text = serde_json::to_string(told).map_err(|_| Disconnected)?;
    send(socket, Message::Text(text.into())).await
}

/// Says why, as code and text of the WebSocket (RFC 6455, 7.4).
async fn close(
    socket: &mut WebSocket,
    code: u16,
    reason: &'static str,
) -> Result<(), Disconnected> {
    let reason = Utf8Bytes::from_static(reason);
    send(socket, Message::Close(Some(CloseFrame { code, reason }))).await
}

/// Gives up after `SEND`.
async fn send(socket: &mut WebSocket, message: Message) -> Result<(), Disconnected> {
    match timeout(SEND, socket.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) | Err(_) => Err(Disconnected),
    }
}

/// Whether `command` does no more than bring the arms to rest: any page may say so, also while the
/// one that steers is frozen.
const fn brings_to_rest(command: &Command) -> bool {
    matches!(
        command,
        Command::Stop | Command::Event(OperatorEvent::Pause)
    )
}
