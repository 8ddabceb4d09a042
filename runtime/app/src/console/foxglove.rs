//! A live Foxglove server: the log's topics while the run goes on, with cameras, frames and shapes, for Foxglove and whoever speaks its
//! WebSocket protocol (`foxglove.sdk.v1`). It only tells: no message of a viewer reaches the run.
//!
//! Like a page of the console a viewer has a seat, sees the newest of everything, and is told no more than it takes.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use hal::{Pose, TimeNs};
use serde::Deserialize;
use serde_json::json;
use tokio::sync::watch;
use tokio::time::timeout;
use trocar_log::live::{self, Channel};

use super::encode::HEAD;
use super::pictures::{Plane, Stream};
use super::request::Allowance;
use super::scene::{self, Shapes};
use super::seats::Seat;
use super::shared::Shared;
use super::tap::Sample;
use crate::rt::MonotonicClock;

/// What a viewer asks the WebSocket to speak.
pub(super) const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// Subscriptions of one viewer.
const SUBSCRIPTIONS_MAX: usize = 64;

/// Time for one message to leave.
const SEND: Duration = Duration::from_secs(5);

/// A viewer ends here.
struct Gone;

/// What a viewer may say; whatever else it says is passed over.
#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Request {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: usize,
}

/// Tells a viewer until it goes or all is over.
pub(super) async fn attend(mut socket: WebSocket, shared: Arc<Shared>) {
    let Some(seat) = shared.seats.sit() else {
        let _gone = socket.send(Message::Close(None)).await;
        return;
    };
    let clock = MonotonicClock::new();
    let mut viewer = Viewer {
        facts: shared.facts.subscribe(),
        state: shared.state.subscribe(),
        pictures: shared.board.watch(),
        over: shared.over.subscribe(),
        shared,
        seat,
        channels: Vec::new(),
        cameras: Vec::new(),
        shapes: Arc::default(),
        subscriptions: BTreeMap::new(),
        streams: Vec::new(),
        seen: BTreeMap::new(),
        previous: TimeNs(0),
        shown: false,
        allowance: Allowance::new(clock.now()),
        clock,
    };
    viewer.facts.mark_changed();
    let _gone: Result<(), Gone> = viewer.serve(&mut socket).await;
}

struct Viewer {
    shared: Arc<Shared>,
    seat: Seat,
    facts: watch::Receiver<axum::extract::ws::Utf8Bytes>,
    state: watch::Receiver<axum::extract::ws::Utf8Bytes>,
    pictures: watch::Receiver<u64>,
    over: watch::Receiver<Option<axum::extract::ws::Utf8Bytes>>,
    channels: Vec<Channel>,
    cameras: Vec<String>,
    shapes: Arc<Shapes>,
    /// The channel of each subscription.
    subscriptions: BTreeMap<u32, usize>,
    streams: Vec<Stream>,
    /// The number of the picture that it has of each stream.
    seen: BTreeMap<Stream, u64>,
    /// When the tick was that it was told of last.
    previous: TimeNs,
    /// Whether it has the shapes.
    shown: bool,
    allowance: Allowance,
    clock: MonotonicClock,
}

impl Viewer {
    async fn serve(&mut self, socket: &mut WebSocket) -> Result<(), Gone> {
        let info = json!({ "op": "serverInfo", "name": "trocar", "capabilities": [], "supportedEncodings": [], "metadata": {} });
        text(socket, &info).await?;
        loop {
            tokio::select! {
                biased;
                heard = socket.recv() => self.hear(heard)?,
                _ = self.facts.changed() => self.advertise(socket).await?,
                _ = self.over.changed() => {
                    send(socket, Message::Close(None)).await?;
                    return Err(Gone);
                }
                _ = self.state.changed() => self.tell_state(socket).await?,
                _ = self.pictures.changed() => self.tell_pictures(socket).await?,
            }
        }
    }

    fn hear(&mut self, heard: Option<Result<Message, axum::Error>>) -> Result<(), Gone> {
        let Some(Ok(message)) = heard else {
            return Err(Gone);
        };
        if !self.allowance.take(self.clock.now()) {
            return Err(Gone);
        }
        let request = match &message {
            Message::Text(text) => serde_json::from_str(text).unwrap_or(Request::Other),
            Message::Close(_) => return Err(Gone),
            Message::Binary(_) | Message::Ping(_) | Message::Pong(_) => Request::Other,
        };
        match request {
            Request::Subscribe { subscriptions } => {
                for Subscription { id, channel_id } in subscriptions {
                    if channel_id < self.channels.len()
                        && self.subscriptions.len() < SUBSCRIPTIONS_MAX
                    {
                        self.subscriptions.insert(id, channel_id);
                    }
                }
                self.shown = false;
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
        let cameras = self.cameras.iter().zip(0_u8..);
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
        let fits =
            move |channel: usize| self.channels.get(channel).map(|it| &*it.topic) == Some(topic);
        subscriptions.filter_map(move |(id, channel)| fits(*channel).then_some(*id))
    }

    /// Says which topics there are; those of a run before are no more.
    async fn advertise(&mut self, socket: &mut WebSocket) -> Result<(), Gone> {
        let Some((arms, cameras)) = self.shared.live().map(|live| live.arms_and_cameras()) else {
            return Ok(());
        };
        self.shapes = self.shared.shapes();
        self.shown = false;
        let channels = live::channels(arms, &cameras);
        if channels == self.channels {
            return Ok(());
        }
        let gone: Vec<usize> = (0..self.channels.len()).collect();
        self.subscriptions.clear();
        (self.channels, self.cameras) = (channels, cameras);
        self.look();
        if !gone.is_empty() {
            text(socket, &json!({ "op": "unadvertise", "channelIds": gone })).await?;
        }
        let channels = self.channels.iter().enumerate().map(|(id, channel)| {
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

    async fn tell_state(&mut self, socket: &mut WebSocket) -> Result<(), Gone> {
        let Some((Sample { record, .. }, rcms_in_scene)) =
            self.shared.live().and_then(|live| live.sample())
        else {
            return Ok(());
        };
        let previous = std::mem::replace(&mut self.previous, record.now);
        for (topic, bytes) in live::tick(&record, previous, &rcms_in_scene) {
            self.publish(socket, topic, record.now, &bytes).await?;
        }
        Ok(())
    }

    async fn tell_pictures(&mut self, socket: &mut WebSocket) -> Result<(), Gone> {
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

    async fn tell_camera(
        &mut self,
        socket: &mut WebSocket,
        at: TimeNs,
        stream: Stream,
        message: &Bytes,
    ) -> Result<(), Gone> {
        let Some(camera) = self.cameras.get(usize::from(stream.camera)).cloned() else {
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

    async fn tell_scene(
        &mut self,
        socket: &mut WebSocket,
        at: TimeNs,
        message: &Bytes,
    ) -> Result<(), Gone> {
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
        Ok(())
    }

    /// Sends a message to each subscription to `topic`: code, subscription, time, and the message itself.
    async fn publish(
        &self,
        socket: &mut WebSocket,
        topic: &str,
        at: TimeNs,
        message: &[u8],
    ) -> Result<(), Gone> {
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

/// When a picture was taken.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "seconds of a run, not negative"
)]
fn stamp(message: &Bytes) -> TimeNs {
    let seconds = message.get(8..HEAD).and_then(|bytes| bytes.try_into().ok());
    TimeNs((seconds.map_or(0.0, f64::from_le_bytes) * 1e9).round() as u64)
}

async fn text(socket: &mut WebSocket, message: &serde_json::Value) -> Result<(), Gone> {
    send(socket, Message::Text(message.to_string().into())).await
}

async fn send(socket: &mut WebSocket, message: Message) -> Result<(), Gone> {
    match timeout(SEND, socket.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) | Err(_) => Err(Gone),
    }
}
