//! A live Foxglove server: the log's topics while a run or drives go on, with cameras, frames and
//! shapes, or a log as its time line is played, for Foxglove and whoever speaks its WebSocket
//! protocol (`foxglove.sdk.v1`). It only tells: no message of a viewer reaches the run.
//!
//! Like a page of the console a viewer has a seat, sees the newest of everything, and is told no
//! more than it takes; only of what happened it misses nothing.

mod played;
mod wire;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use hal::{Pose, TimeNs};
use serde_json::json;
use tokio::sync::watch;
use tokio::time::interval;
use trocar_log::live;

use super::drawn::{Plane, Stream};
use super::encode::HEAD;
use super::request::TokenBucket;
use super::scene::{self, Shapes};
use super::seats::Seat;
use super::shared::Shared;
use super::viewers::{Advertised, Message as ViewerMessage, ViewerReceivers};
use crate::rt::MonotonicClock;
use played::Played;
use wire::{Disconnected, Request, Subscription, send, stamp, tell_time, text};

/// What a viewer asks the WebSocket to speak.
pub(super) const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// Subscriptions of one viewer.
const SUBSCRIPTIONS_MAX: usize = 64;

/// Time from one message of the shapes that bend to the next, ns.
const BENT_EVERY_NS: u64 = 200_000_000;

/// Time from one look at a log's time line to the next.
const PLAY_EVERY: Duration = Duration::from_millis(50);

/// Tells a viewer until it goes or all is over.
pub(super) async fn attend(mut socket: WebSocket, shared: Arc<Shared>) {
    let Some(seat) = shared.seats.sit() else {
        let _gone = socket.send(Message::Close(None)).await;
        return;
    };
    let clock = MonotonicClock::new();
    let mut viewer = Viewer {
        told: shared.viewers.join(),
        pictures: shared.board.watch(),
        over: shared.over.subscribe(),
        shared,
        seat,
        offer: Arc::default(),
        shapes: Arc::default(),
        subscriptions: BTreeMap::new(),
        streams: Vec::new(),
        seen: BTreeMap::new(),
        happened: 0,
        played: Played::default(),
        shown: false,
        bent_at: None,
        allowance: TokenBucket::new(clock.now()),
        clock,
    };
    let _gone: Result<(), Disconnected> = viewer.serve(&mut socket).await;
}

/// What one viewer has been told, and what it has subscribed to.
struct Viewer {
    shared: Arc<Shared>,
    seat: Seat,
    told: ViewerReceivers,
    pictures: watch::Receiver<u64>,
    over: watch::Receiver<Option<axum::extract::ws::Utf8Bytes>>,
    offer: Arc<Advertised>,
    shapes: Arc<Shapes>,
    /// The channel of each subscription.
    subscriptions: BTreeMap<u32, usize>,
    streams: Vec<Stream>,
    /// The number of the picture that it has of each stream.
    seen: BTreeMap<Stream, u64>,
    /// How much of what happened it has been told.
    happened: u64,
    /// Where in a log it is.
    played: Played,
    /// Whether it has the shapes.
    shown: bool,
    /// When it was told of the shapes that bend, if it was.
    bent_at: Option<TimeNs>,
    allowance: TokenBucket,
    clock: MonotonicClock,
}

impl Viewer {
    /// What has to be in order comes first (`biased`): requests, topics, then what happened.
    async fn serve(&mut self, socket: &mut WebSocket) -> Result<(), Disconnected> {
        // The time is that of the run, or of the log, where it may jump.
        let info = json!({ "op": "serverInfo", "name": "trocar", "capabilities": ["time"], "supportedEncodings": [], "metadata": {} });
        text(socket, &info).await?;
        let mut plays = interval(PLAY_EVERY);
        loop {
            tokio::select! {
                biased;
                heard = socket.recv() => self.hear(heard)?,
                _ = self.told.offer.changed() => self.advertise(socket).await?,
                _ = self.told.happened.changed() => self.tell_happened(socket).await?,
                _ = self.over.changed() => {
                    send(socket, Message::Close(None)).await?;
                    return Err(Disconnected);
                }
                _ = self.told.newest.changed() => self.tell_newest(socket).await?,
                _ = self.pictures.changed() => self.tell_pictures(socket).await?,
                _ = plays.tick() => self.play(socket).await?,
            }
        }
    }

    /// Takes in subscriptions, up to `SUBSCRIPTIONS_MAX`, to channels that there are. Nothing is
    /// answered; too many messages end it.
    fn hear(&mut self, heard: Option<Result<Message, axum::Error>>) -> Result<(), Disconnected> {
        let Some(Ok(message)) = heard else {
            return Err(Disconnected);
        };
        if !self.allowance.take(self.clock.now()) {
            return Err(Disconnected);
        }
        let request = match &message {
            Message::Text(text) => serde_json::from_str(text).unwrap_or(Request::Other),
            Message::Close(_) => return Err(Disconnected),
            Message::Binary(_) | Message::Ping(_) | Message::Pong(_) => Request::Other,
        };
        match request {
            Request::Subscribe { subscriptions } => {
                let heard = self.subscribed(live::EVENTS).next().is_some();
                for Subscription { id, channel_id } in subscriptions {
                    if channel_id < self.offer.channels.len()
                        && self.subscriptions.len() < SUBSCRIPTIONS_MAX
                    {
                        self.subscriptions.insert(id, channel_id);
                    }
                }
                (self.shown, self.bent_at) = (false, None);
                if !heard {
                    self.happened = 0;
                    self.told.happened.mark_changed();
                }
            }
            Request::Unsubscribe { subscription_ids } => {
                self.subscriptions
                    .retain(|id, _| !subscription_ids.contains(id));
            }
            Request::Other => return Ok(()),
        }
        self.look();
        Ok(())
    }

    /// Looks at what the subscriptions need.
    fn look(&mut self) {
        let wants = |topic: &str| self.subscribed(topic).next().is_some();
        let cameras = self.offer.cameras.iter().zip(0_u8..);
        let cameras = cameras.filter(|(camera, _)| {
            wants(&live::image_topic(camera)) || wants(&live::lens_topic(camera))
        });
        let mut streams: Vec<Stream> = cameras
            .map(|(_, camera)| Stream::from((camera, Plane::Colour)))
            .collect();
        if wants(live::TRANSFORMS) || wants(live::SHAPES) {
            streams.push(Stream::SCENE);
        }
        self.seat.look_at(&streams);
        self.streams = streams;
    }

    /// The subscriptions to `topic`.
    fn subscribed<'a>(&'a self, topic: &'a str) -> impl Iterator<Item = u32> + 'a {
        let subscriptions = self.subscriptions.iter();
        let channels = &self.offer.channels;
        let fits = move |channel: usize| channels.get(channel).map(|it| &*it.topic) == Some(topic);
        subscriptions.filter_map(move |(id, channel)| fits(*channel).then_some(*id))
    }

    /// Says which topics there are; those of a run before are no more.
    async fn advertise(&mut self, socket: &mut WebSocket) -> Result<(), Disconnected> {
        let offer = Arc::clone(&self.told.offer.borrow_and_update());
        self.shapes = self.shared.shapes();
        (self.shown, self.bent_at) = (false, None);
        if offer.channels == self.offer.channels {
            return Ok(());
        }
        let gone: Vec<usize> = (0..self.offer.channels.len()).collect();
        self.subscriptions.clear();
        self.offer = offer;
        self.look();
        if !gone.is_empty() {
            text(socket, &json!({ "op": "unadvertise", "channelIds": gone })).await?;
        }
        let channels = self.offer.channels.iter().enumerate().map(|(id, channel)| {
            let schema = match channel.schema_encoding {
                "protobuf" => STANDARD.encode(&channel.schema),
                _ => String::from_utf8_lossy(&channel.schema).into_owned(),
            };
            json!({
                "id": id, "topic": channel.topic, "encoding": channel.encoding,
                "schemaName": channel.schema_name, "schema": schema, "schemaEncoding": channel.schema_encoding,
            })
        });
        let channels: Vec<_> = channels.collect();
        text(socket, &json!({ "op": "advertise", "channels": channels })).await
    }

    /// The newest tick, with its time before it.
    async fn tell_newest(&mut self, socket: &mut WebSocket) -> Result<(), Disconnected> {
        let newest = Arc::clone(&self.told.newest.borrow_and_update());
        if let Some(first) = newest.first() {
            tell_time(socket, first.at).await?;
        }
        self.tell(socket, &newest).await
    }

    /// Every line since the last call; whoever comes late has the last `KEPT_MAX`.
    async fn tell_happened(&mut self, socket: &mut WebSocket) -> Result<(), Disconnected> {
        let (fresh, all) = self.shared.viewers.since(self.happened);
        self.happened = all;
        self.tell(socket, &fresh).await
    }

    /// Goes on with a log, if that is what is shown: what its messages say, and what time it is in
    /// it.
    async fn play(&mut self, socket: &mut WebSocket) -> Result<(), Disconnected> {
        let Some(log) = self.shared.log() else {
            return Ok(());
        };
        let place = *self.shared.place.borrow();
        let channels = self.subscriptions.values();
        let channels = channels.filter_map(|channel| self.offer.channels.get(*channel));
        let topics: Vec<&str> = channels.map(|channel| &*channel.topic).collect();
        let Some((at, fresh)) = self.played.go_on(&log, (place, self.clock.now()), &topics) else {
            return Ok(());
        };
        tell_time(socket, at).await?;
        self.tell(socket, &fresh).await
    }

    async fn tell(
        &self,
        socket: &mut WebSocket,
        messages: &[ViewerMessage],
    ) -> Result<(), Disconnected> {
        for ViewerMessage { topic, at, data } in messages {
            self.publish(socket, topic, *at, data).await?;
        }
        Ok(())
    }

    /// All pictures of its streams that it has not had.
    async fn tell_pictures(&mut self, socket: &mut WebSocket) -> Result<(), Disconnected> {
        while let Some((stream, picture)) = self.shared.board.newer(&self.streams, &self.seen) {
            self.seen.insert(stream, picture.number);
            let at = stamp(&picture.message);
            if stream == Stream::SCENE {
                self.tell_scene(socket, at, &picture.message).await?;
            } else {
                self.tell_camera(socket, at, stream, &picture.message)
                    .await?;
            }
        }
        Ok(())
    }

    /// A camera's calibration and its image, of the same time.
    async fn tell_camera(
        &mut self,
        socket: &mut WebSocket,
        at: TimeNs,
        stream: Stream,
        message: &Bytes,
    ) -> Result<(), Disconnected> {
        let cameras = &self.offer.cameras;
        let Some(camera) = cameras.get(usize::from(stream.camera)).cloned() else {
            return Ok(());
        };
        if let Some(intrinsics) = self.shapes.lens(&camera) {
            let lens = live::lens(at, &camera, intrinsics);
            self.publish(socket, &live::lens_topic(&camera), at, &lens)
                .await?;
        }
        let image = live::image(at, &camera, "jpeg", message.get(HEAD..).unwrap_or_default());
        self.publish(socket, &live::image_topic(&camera), at, &image)
            .await
    }

    /// Where everything is, as transforms; the shapes once, and those that bend at most every
    /// `BENT_EVERY_NS`.
    async fn tell_scene(
        &mut self,
        socket: &mut WebSocket,
        at: TimeNs,
        message: &Bytes,
    ) -> Result<(), Disconnected> {
        let shapes = Arc::clone(&self.shapes);
        let Some((visuals, cameras)) = scene::places(message) else {
            return Ok(());
        };
        let visuals = shapes.frames().zip(visuals);
        let cameras = shapes.cameras().zip(cameras);
        let frames: Vec<(&str, Pose)> = visuals.chain(cameras).collect();
        let transforms = live::transforms(at, frames.into_iter());
        self.publish(socket, live::TRANSFORMS, at, &transforms)
            .await?;
        if !std::mem::replace(&mut self.shown, true) {
            let files = live::shapes(at, shapes.files());
            self.publish(socket, live::SHAPES, at, &files).await?;
        }
        let now = self.clock.now();
        if self.subscribed(live::SHAPES).next().is_some() && is_due(self.bent_at, now) {
            let bent = shapes.bent(message);
            if !bent.is_empty() {
                self.bent_at = Some(now);
                let bent = live::bent(at, bent.into_iter());
                self.publish(socket, live::SHAPES, at, &bent).await?;
            }
        }
        Ok(())
    }

    /// Sends a message to each subscription to `topic`: code, subscription, time, and the message
    /// itself.
    async fn publish(
        &self,
        socket: &mut WebSocket,
        topic: &str,
        at: TimeNs,
        message: &[u8],
    ) -> Result<(), Disconnected> {
        let ids: Vec<u32> = self.subscribed(topic).collect();
        for id in ids {
            let mut bytes = vec![1];
            bytes.extend(id.to_le_bytes());
            bytes.extend(at.0.to_le_bytes());
            bytes.extend(message);
            send(socket, Message::Binary(bytes.into())).await?;
        }
        Ok(())
    }
}

/// Whether a viewer that was told of the shapes that bend at `before`, if it was, is told `now`.
fn is_due(before: Option<TimeNs>, now: TimeNs) -> bool {
    before.is_none_or(|before| now.since(before) >= BENT_EVERY_NS)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// However often the scene is drawn, its shapes that bend come five times a second.
    #[test]
    fn bent_shapes_come_five_times_a_second() {
        let mut before = None;
        let drawn = (0..3000).step_by(33).map(|ms| TimeNs(ms * 1_000_000));
        let told = drawn.filter(|now| {
            let due = is_due(before, *now);
            before = if due { Some(*now) } else { before };
            due
        });
        let told: Vec<u64> = told.map(|at| at.0).collect();
        let apart = told.windows(2).map(|pair| pair[1] - pair[0]);
        assert!(apart.min() >= Some(BENT_EVERY_NS), "{told:?}");
        assert!((12..=15).contains(&told.len()), "{told:?}");
    }
}
