//! What goes over the WebSocket of a viewer, either way. The binary messages begin with a code: 1
//! is data of a subscription, 2 the time; numbers are little endian.

use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket};
use hal::TimeNs;
use serde::Deserialize;
use tokio::time::timeout;

use super::super::encode::HEAD;

/// Time for one message to leave.
const SEND: Duration = Duration::from_secs(5);

/// The viewer has disconnected.
pub(super) struct Disconnected;

/// What a viewer may say; whatever else it says is passed over.
#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub(super) enum Request {
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

/// `id` is the viewer's choice and stands in each message of data; `channel_id` is that of
/// `advertise`.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Subscription {
    pub(super) id: u32,
    pub(super) channel_id: usize,
}

/// Says what time it is.
pub(super) async fn tell_time(socket: &mut WebSocket, at: TimeNs) -> Result<(), Disconnected> {
    let mut bytes = vec![2];
    bytes.extend(at.0.to_le_bytes());
    send(socket, Message::Binary(bytes.into())).await
}

/// When a picture was taken.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "seconds of a run, not negative"
)]
pub(super) fn stamp(message: &Bytes) -> TimeNs {
    let seconds = message.get(8..HEAD).and_then(|bytes| bytes.try_into().ok());
    TimeNs((seconds.map_or(0.0, f64::from_le_bytes) * 1e9).round() as u64)
}

/// A message as JSON, as most of the protocol's are.
pub(super) async fn text(
    socket: &mut WebSocket,
    message: &serde_json::Value,
) -> Result<(), Disconnected> {
    send(socket, Message::Text(message.to_string().into())).await
}

/// Gives up after `SEND`.
pub(super) async fn send(socket: &mut WebSocket, message: Message) -> Result<(), Disconnected> {
    match timeout(SEND, socket.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) | Err(_) => Err(Disconnected),
    }
}
