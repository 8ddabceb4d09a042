//! A viewer that speaks Foxglove's protocol: it hears what the run does, and moves nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead as _, BufReader};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};

use base64::Engine as _;
use hal::TimeNs;
use prost::Message as _;
use serde_json::{Value, json};
use tests::{scratch, trocar};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

use crate::page::Page;
use crate::run::{PATIENCE, SLOW_MOTION, Served, made_log};

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
    #[prost(message, repeated, tag = "12")]
    triangles: Vec<Triangles>,
    #[prost(message, repeated, tag = "14")]
    models: Vec<Model>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Triangles {
    #[prost(message, repeated, tag = "2")]
    points: Vec<Point>,
    #[prost(fixed32, repeated, tag = "5")]
    indices: Vec<u32>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Point {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
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

/// `foxglove.Log`: its text.
#[derive(Clone, PartialEq, prost::Message)]
struct Line {
    #[prost(string, tag = "3")]
    text: String,
}

/// A run with a door for viewers, and its address.
struct Shown {
    process: Child,
    url: String,
}

impl Shown {
    fn start(test: &str, task: &str, policy: &str) -> Self {
        let sockets = scratch(test);
        let mut command: Command = trocar();
        let words = "--seed 7 --foxglove 127.0.0.1:0 --set scene.episode.time_limit_s=300";
        command
            .args(["run", "--task", task, "--policy", policy])
            .env("XDG_RUNTIME_DIR", sockets)
            .env("TROCAR_SLOW_MOTION", SLOW_MOTION.to_string())
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

/// Subscribes to all that is advertised, as 100 and so on; the topics.
fn subscribe(socket: &mut WebSocket<TcpStream>) -> Vec<String> {
    let advertised = said(socket, "advertise");
    let mut topics = Vec::new();
    let mut subscriptions = Vec::new();
    for (index, channel) in advertised["channels"]
        .as_array()
        .unwrap()
        .iter()
        .enumerate()
    {
        if channel["schemaEncoding"] == "protobuf" {
            let schema = base64::engine::general_purpose::STANDARD
                .decode(channel["schema"].as_str().unwrap());
            assert!(!schema.unwrap().is_empty());
        }
        topics.push(channel["topic"].as_str().unwrap().to_owned());
        subscriptions.push(json!({ "id": 100 + index, "channelId": channel["id"] }));
    }
    let subscribe = json!({ "op": "subscribe", "subscriptions": subscriptions });
    socket.send(Message::text(subscribe.to_string())).unwrap();
    topics
}

/// What a viewer is told.
enum ViewerEvent {
    /// A message of a topic, with its time, ns.
    Message(String, u64, Vec<u8>),
    /// What time it is, ns.
    Time(u64),
}

fn told(socket: &mut WebSocket<TcpStream>, topics: &[String]) -> ViewerEvent {
    loop {
        let Message::Binary(bytes) = socket.read().unwrap() else {
            continue;
        };
        let number = |from: usize| u64::from_le_bytes(bytes[from..from + 8].try_into().unwrap());
        if bytes[0] == 2 {
            return ViewerEvent::Time(number(1));
        }
        assert_eq!(bytes[0], 1);
        let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
        let topic = topics[usize::try_from(id - 100).unwrap()].clone();
        return ViewerEvent::Message(topic, number(5), bytes[13..].to_vec());
    }
}

/// What the log says when the arm is enabled, once.
const ENABLED: &str = "psm1: DISABLED to ENABLED";

/// Messages of every topic until there is one of each, some of frames, and the arm was enabled.
fn heard(socket: &mut WebSocket<TcpStream>, topics: &[String]) -> BTreeMap<String, Vec<Vec<u8>>> {
    let mut heard: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
    let frames = |heard: &BTreeMap<String, Vec<Vec<u8>>>| heard.get("/tf").map_or(0, Vec::len);
    let enabled = |heard: &BTreeMap<String, Vec<Vec<u8>>>| {
        heard.contains_key("/events") && lines(heard).iter().any(|line| line == ENABLED)
    };
    while heard.len() < topics.len() || frames(&heard) < 12 || !enabled(&heard) {
        if let ViewerEvent::Message(topic, at_ns, message) = told(socket, topics) {
            assert!(at_ns < 300_000_000_000, "{at_ns}");
            heard.entry(topic).or_default().push(message);
        }
    }
    heard
}

fn lines(heard: &BTreeMap<String, Vec<Vec<u8>>>) -> Vec<String> {
    let line = |bytes: &Vec<u8>| Line::decode(&bytes[..]).unwrap().text;
    heard["/events"].iter().map(line).collect()
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
    let shown = Shown::start("foxglove", "needle-lift", "random");
    let bare = shown.url.split("?token=").next().unwrap();
    assert_eq!(Shown::open(bare, None).err(), Some(401));
    assert_eq!(
        Shown::open(&shown.url, Some("https://example.com")).err(),
        Some(403)
    );
    let mut socket = Shown::open(&shown.url, Some("https://app.foxglove.dev")).unwrap();
    assert_eq!(said(&mut socket, "serverInfo")["name"], "trocar");
    let topics = subscribe(&mut socket);
    for wanted in [
        "/psm1/measured_js",
        "/safety",
        "/events",
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
    let lines = lines(&heard);
    let enabled = |line: &&String| *line == ENABLED;
    assert_eq!(lines.iter().filter(enabled).count(), 1, "{lines:?}");
}

/// The flap is triangles in its frame, which come again as it bends.
#[test]
fn foxglove_sees_the_flap_bend() {
    let _turn = tests::alone();
    let shown = Shown::start("foxglove-flap", "tissue-retraction", "expert");
    let mut socket = Shown::open(&shown.url, None).unwrap();
    let topics = subscribe(&mut socket);
    let (mut frames, mut flap): (Vec<Vec<u8>>, Vec<Entity>) = (Vec::new(), Vec::new());
    let bends = |flap: &[Entity]| {
        let (first, last) = (flap.first(), flap.last());
        let both = first.zip(last).map(|(first, last)| {
            let [one, other] = [first, last].map(|entity| &entity.triangles[0].points);
            let apart = one.iter().zip(other);
            apart.map(|(a, b)| (a.x - b.x).abs() + (a.y - b.y).abs() + (a.z - b.z).abs())
        });
        both.is_some_and(|mut apart| apart.any(|way| way > 0.005))
    };
    while !bends(&flap) {
        match told(&mut socket, &topics) {
            ViewerEvent::Message(topic, _, message) if topic == "/tf" => frames.push(message),
            ViewerEvent::Message(topic, _, message) if topic == "/scene" => {
                let mut update = Update::decode(&message[..]).unwrap();
                update
                    .entities
                    .retain(|entity| !entity.triangles.is_empty());
                flap.extend(update.entities.into_iter().next());
            }
            ViewerEvent::Message(..) | ViewerEvent::Time(_) => {}
        }
    }
    let frames = form_one_tree(&frames);
    for entity in &flap {
        assert_eq!(entity.frame, flap[0].frame);
        assert!(frames.contains(&entity.frame) && entity.models.is_empty());
        let Triangles { points, indices } = &entity.triangles[0];
        assert!(points.len() > 10 && indices.len() % 3 == 0);
        let most = indices.iter().max().unwrap();
        assert!(usize::try_from(*most).unwrap() < points.len());
    }
}

/// A log is played in its own time, all its topics, until a page looks at a place: from then on it
/// is told of that place.
#[test]
fn foxglove_is_told_a_log_where_a_page_looks() {
    let log = made_log("foxglove-log-made", "needle-lift");
    let words = ["replay", log.to_str().unwrap(), "--foxglove", "127.0.0.1:0"];
    let served = Served::start_slow("foxglove-log", &words, 2);
    let mut socket = Shown::open(served.viewer.as_deref().unwrap(), None).unwrap();
    let topics = subscribe(&mut socket);
    for wanted in ["/psm1/tick", "/policy/chunk", "/camera/endoscope/pose"] {
        assert!(topics.iter().any(|topic| topic == wanted), "{topics:?}");
    }
    let heard = heard(&mut socket, &topics);
    let frames = form_one_tree(&heard["/tf"]);
    assert!(frames.contains("psm1_tip") && frames.contains("endoscope"));
    let image = Image::decode(&heard["/camera/endoscope"][0][..]).unwrap();
    assert_eq!((&*image.format, &image.data[1..4]), ("png", &b"PNG"[..]));

    let mut page = Page::open(&served);
    page.wait_for("facts", |_| true);
    for at in [1.0, 0.4] {
        page.say(&json!({ "at": at }));
        let (mut is_there, mut told_at) = (false, None);
        while told_at.is_none() {
            match told(&mut socket, &topics) {
                ViewerEvent::Time(ns) => is_there = (TimeNs(ns).seconds() - at).abs() < 0.003,
                ViewerEvent::Message(topic, ns, _) if is_there && topic == "/psm1/measured_js" => {
                    told_at = Some(TimeNs(ns).seconds());
                }
                ViewerEvent::Message(..) => {}
            }
        }
        let behind = at - told_at.unwrap();
        assert!((-0.003..0.06).contains(&behind), "{behind} s behind {at} s");
    }
}
