//! A page as a test plays it: the other end of the console's WebSocket.

use std::io::{Read, Write};
use std::net::TcpStream;

use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

use crate::run::Served;

/// What a page hears.
pub(crate) enum PageEvent {
    /// JSON.
    Text(Value),
    /// A picture with its head.
    Picture(Vec<u8>),
    /// The end, with its code.
    Closed(u16),
}

/// A page that acknowledges each message.
pub(crate) struct Page<S = TcpStream> {
    pub(crate) socket: WebSocket<S>,
    /// Messages that came and were not acknowledged.
    pub(crate) unacknowledged: u32,
}

impl Page {
    /// Opens the WebSocket as the console's own page does.
    pub(crate) fn open(served: &Served) -> Self {
        let origin = format!("http://{}", served.host());
        Self::of(handshake(served, Some(&origin), Some(&served.cookie())).unwrap())
    }
}

impl<S: Read + Write> Page<S> {
    /// A page that has this WebSocket.
    pub(crate) fn of(socket: WebSocket<S>) -> Self {
        Self {
            socket,
            unacknowledged: 0,
        }
    }

    pub(crate) fn say(&mut self, message: &Value) {
        self.socket
            .send(Message::text(message.to_string()))
            .unwrap();
    }

    /// The next message; those that are counted are not acknowledged.
    pub(crate) fn hear(&mut self) -> PageEvent {
        loop {
            match self.socket.read() {
                Ok(Message::Text(text)) => {
                    let value: Value = serde_json::from_str(&text).unwrap();
                    let uncounted = ["answer", "problem", "end"];
                    let counted = !uncounted.contains(&value["kind"].as_str().unwrap());
                    self.unacknowledged += u32::from(counted);
                    return PageEvent::Text(value);
                }
                Ok(Message::Binary(bytes)) => {
                    self.unacknowledged += 1;
                    return PageEvent::Picture(bytes.to_vec());
                }
                Ok(Message::Close(frame)) => {
                    return PageEvent::Closed(frame.map_or(1005, |frame| frame.code.into()));
                }
                Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_)) => {}
                Err(tungstenite::Error::ConnectionClosed | tungstenite::Error::AlreadyClosed) => {
                    return PageEvent::Closed(1005);
                }
                Err(tungstenite::Error::Io(_) | tungstenite::Error::Protocol(_)) => {
                    return PageEvent::Closed(1006);
                }
                Err(error) => panic!("{error}"),
            }
        }
    }

    pub(crate) fn acknowledge(&mut self) {
        let seen = std::mem::take(&mut self.unacknowledged);
        let message = json!({ "seen": seen }).to_string();
        // One that comes too late for the end is no failure; a socket that is closed shows when it
        // is read.
        let _closed = self.socket.send(Message::text(message));
    }

    /// The next text of this kind that fits.
    pub(crate) fn wait_for(&mut self, kind: &str, fits: impl Fn(&Value) -> bool) -> Value {
        for _ in 0..20_000 {
            match self.hear() {
                PageEvent::Text(value) => {
                    self.acknowledge();
                    if value["kind"] == kind && fits(&value) {
                        return value;
                    }
                }
                PageEvent::Picture(_) => self.acknowledge(),
                PageEvent::Closed(code) => panic!("closed with {code} before a {kind} that fits"),
            }
        }
        panic!("no {kind} that fits");
    }

    /// The next picture.
    pub(crate) fn wait_for_picture(&mut self) -> Vec<u8> {
        loop {
            match self.hear() {
                PageEvent::Picture(bytes) => {
                    self.acknowledge();
                    return bytes;
                }
                PageEvent::Text(_) => self.acknowledge(),
                PageEvent::Closed(code) => panic!("closed with {code} before a picture"),
            }
        }
    }

    /// The answer to a command.
    pub(crate) fn command(&mut self, text: &str) -> (bool, String) {
        self.say(&json!({ "command": text }));
        let answer = self.wait_for("answer", |_| true);
        let said = answer["text"].as_str().unwrap().to_owned();
        (answer["ok"].as_bool().unwrap(), said)
    }

    pub(crate) fn wait_for_state(&mut self, state: &str) -> Value {
        self.wait_for("state", |told| told["arms"][0]["state"] == state)
    }
}

/// The WebSocket, or the status of the answer that refuses it.
pub(crate) fn handshake(
    served: &Served,
    origin: Option<&str>,
    cookie: Option<&str>,
) -> Result<WebSocket<TcpStream>, u16> {
    handshake_by(&served.host(), served.connect(), origin, cookie)
}

/// The same over `stream`, for `host`.
pub(crate) fn handshake_by<S: Read + Write>(
    host: &str,
    stream: S,
    origin: Option<&str>,
    cookie: Option<&str>,
) -> Result<WebSocket<S>, u16> {
    let url = format!("ws://{host}/socket");
    let mut request = url.into_client_request().unwrap();
    let headers = request.headers_mut();
    if let Some(origin) = origin {
        headers.insert("Origin", origin.parse().unwrap());
    }
    if let Some(cookie) = cookie {
        headers.insert("Cookie", cookie.parse().unwrap());
    }
    match tungstenite::client(request, stream) {
        Ok((socket, _)) => Ok(socket),
        Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
            Err(answer.status().as_u16())
        }
        Err(error) => panic!("{error}"),
    }
}
