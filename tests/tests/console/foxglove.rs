//! A viewer that speaks Foxglove's protocol: it hears what the run does, and moves nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead as _, BufReader};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};

use base64::Engine as _;
use prost::Message as _;
use serde_json::{Value, json};
use tests::{Profile, scratch, trocar};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

use crate::run::PATIENCE;

/// `foxglove.FrameTransforms`, as far as its names go.
#[derive(Clone, PartialEq, prost::Message)]
struct Transforms {
    #[prost(message, repeated, tag = "1")]
    transforms: Vec<Transform>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Transform {
    #[prost(string, tag = "2")]
    parent: String,
    #[prost(string, tag = "3")]
    child: String,
}

/// `foxglove.SceneUpdate`, `CompressedImage`: what they hold at these places.
#[derive(Clone, PartialEq, prost::Message)]
struct Update {
    #[prost(message, repeated, tag = "2")]
    entities: Vec<Entity>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Entity {
    #[prost(string, tag = "2")]
    frame: String,
    #[prost(message, repeated, tag = "14")]
    models: Vec<Model>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Model {
    #[prost(bytes = "vec", tag = "7")]
    data: Vec<u8>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Image {
    #[prost(bytes = "vec", tag = "2")]
    data: Vec<u8>,
    #[prost(string, tag = "3")]
    format: String,
    #[prost(string, tag = "4")]
    frame: String,
}

/// A run with a door for viewers, and its address.
struct Shown {
    process: Child,
    url: String,
}

impl Shown {
    fn start(test: &str) -> Self {
        let sockets = scratch(test);
        let mut command: Command = trocar(Profile::Debug);
        let words = "run --task needle-lift --policy random --seed 7 --foxglove 127.0.0.1:0 --set scene.episode.time_limit_s=300";
        command
            .env("XDG_RUNTIME_DIR", sockets)
            .args(words.split(' '))
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let mut process = command.spawn().unwrap();
        let mut said = BufReader::new(process.stderr.take().unwrap());
        let mut line = String::new();
        while !line.contains("foxglove: ws://") {
            line.clear();
            assert!(said.read_line(&mut line).unwrap() > 0, "no door");
        }
        std::thread::spawn(move || std::io::copy(&mut said, &mut std::io::sink()));
        let url = line.trim().split("foxglove: ").nth(1).unwrap().to_owned();
        Self { process, url }
    }

    /// The WebSocket at `url`, or the status of the answer that refuses it.
    fn open(url: &str, origin: Option<&str>) -> Result<WebSocket<TcpStream>, u16> {
        let mut request = url.into_client_request().unwrap();
        let headers = request.headers_mut();
        headers.insert("Sec-WebSocket-Protocol", "foxglove.sdk.v1".parse().unwrap());
        if let Some(origin) = origin {
            headers.insert("Origin", origin.parse().unwrap());
        }
        let address = url
            .strip_prefix("ws://")
            .unwrap()
            .split('/')
            .next()
            .unwrap();
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        match tungstenite::client(request, stream) {
            Ok((socket, answer)) => {
                assert_eq!(
                    answer.headers()["sec-websocket-protocol"],
                    "foxglove.sdk.v1"
                );
                Ok(socket)
            }
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
                Err(answer.status().as_u16())
            }
            Err(error) => panic!("{error}"),
        }
    }
}

impl Drop for Shown {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
    }
}

fn said(socket: &mut WebSocket<TcpStream>, op: &str) -> Value {
    loop {
        if let Message::Text(text) = socket.read().unwrap() {
            let value: Value = serde_json::from_str(&text).unwrap();
            if value["op"] == op {
                return value;
            }
        }
    }
}

/// The first message of every topic, with its time, s; of frames all that come until then.
fn heard(socket: &mut WebSocket<TcpStream>, topics: &[String]) -> BTreeMap<String, Vec<Vec<u8>>> {
    let mut heard: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
    let frames = |heard: &BTreeMap<String, Vec<Vec<u8>>>| heard.get("/tf").map_or(0, Vec::len);
    while heard.len() < topics.len() || frames(&heard) < 12 {
        let Message::Binary(bytes) = socket.read().unwrap() else {
            continue;
        };
        assert_eq!(bytes[0], 1);
        let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
        let at_ns = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
        assert!(at_ns < 300_000_000_000, "{at_ns}");
        let topic = topics[usize::try_from(id - 100).unwrap()].clone();
        heard.entry(topic).or_default().push(bytes[13..].to_vec());
    }
    heard
}

/// Every frame has one parent, and all lead to the scene.
fn form_one_tree(messages: &[Vec<u8>]) -> BTreeSet<String> {
    let mut parents: BTreeMap<String, String> = BTreeMap::new();
    for message in messages {
        for Transform { parent, child } in Transforms::decode(&message[..]).unwrap().transforms {
            let before = parents.insert(child.clone(), parent.clone());
            assert!(before.is_none_or(|before| before == parent), "{child}");
        }
    }
    for child in parents.keys() {
        let mut frame = child;
        for _ in 0..parents.len() {
            frame = parents.get(frame).unwrap_or(frame);
        }
        assert_eq!(frame, "scene", "{child}");
    }
    parents.into_keys().collect()
}

#[test]
fn foxglove_is_told_what_a_run_does() {
    let _turn = tests::alone();
    let shown = Shown::start("foxglove");
    let bare = shown.url.split("?token=").next().unwrap();
    assert_eq!(Shown::open(bare, None).err(), Some(401));
    assert_eq!(
        Shown::open(&shown.url, Some("https://example.com")).err(),
        Some(403)
    );
    let mut socket = Shown::open(&shown.url, Some("https://app.foxglove.dev")).unwrap();
    assert_eq!(said(&mut socket, "serverInfo")["name"], "trocar");
    let advertised = said(&mut socket, "advertise");
    let channels = advertised["channels"].as_array().unwrap();
    let mut topics = Vec::new();
    let mut subscriptions = Vec::new();
    for (index, channel) in channels.iter().enumerate() {
        if channel["schemaEncoding"] == "protobuf" {
            let schema = base64::engine::general_purpose::STANDARD
                .decode(channel["schema"].as_str().unwrap());
            assert!(!schema.unwrap().is_empty());
        }
        topics.push(channel["topic"].as_str().unwrap().to_owned());
        subscriptions.push(json!({ "id": 100 + index, "channelId": channel["id"] }));
    }
    for wanted in [
        "/psm1/measured_js",
        "/safety",
        "/tf",
        "/scene",
        "/camera/wrist",
    ] {
        assert!(topics.iter().any(|topic| topic == wanted), "{wanted}");
    }
    // Nonsense, and what no viewer may, is passed over.
    for text in [
        "",
        "{}",
        r#"{"op":"setParameters"}"#,
        r#"{"command":"stop"}"#,
    ] {
        socket.send(Message::text(text)).unwrap();
    }
    let subscribe = json!({ "op": "subscribe", "subscriptions": subscriptions });
    socket.send(Message::text(subscribe.to_string())).unwrap();

    let heard = heard(&mut socket, &topics);
    let frames = form_one_tree(&heard["/tf"]);
    for frame in ["psm1_rcm", "psm1_tip", "endoscope", "wrist"] {
        assert!(frames.contains(frame), "{frames:?}");
    }
    let image = Image::decode(&heard["/camera/endoscope"][0][..]).unwrap();
    assert_eq!((&*image.format, &*image.frame), ("jpeg", "endoscope"));
    assert_eq!(image.data[..2], [0xff, 0xd8]);
    let scene = Update::decode(&heard["/scene"][0][..]).unwrap();
    assert!(scene.entities.len() > 3);
    for entity in &scene.entities {
        assert!(frames.contains(&entity.frame), "{}", entity.frame);
        assert_eq!(&entity.models[0].data[..4], b"glTF");
    }
    let safety: Value = serde_json::from_slice(&heard["/safety"][0]).unwrap();
    assert!(["ENABLED", "DISABLED"].contains(&safety["mode"].as_str().unwrap()));
}
