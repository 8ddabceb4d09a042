//! The console's page of drives on a real bus.

use std::io::{BufRead as _, BufReader};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};

use serde_json::{Value, json};
use tests::trocar;
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

use crate::PATIENCE;
use crate::peer::alone;

/// Ends the drives with the test.
struct Drives(Child);

impl Drop for Drives {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _reaped = self.0.wait();
    }
}

/// `trocar drives WORDS`, and their page's socket.
fn open(words: &[&str]) -> (Drives, WebSocket<TcpStream>) {
    let (drives, socket, _) = open_with_viewer(words);
    (drives, socket)
}

/// The same, and what opens them in Foxglove if `words` ask for it.
fn open_with_viewer(words: &[&str]) -> (Drives, WebSocket<TcpStream>, Option<String>) {
    let mut process = trocar()
        .args(["drives", "--console", "127.0.0.1:0"])
        .args(words)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(process.stderr.take().unwrap());
    let drives = Drives(process);
    let (mut line, mut viewer) = (String::new(), None);
    while !line.contains("console: http://") {
        line.clear();
        assert!(said.read_line(&mut line).unwrap() > 0, "no console");
        let found = line.trim().split("foxglove: ").nth(1);
        viewer = found.map(str::to_owned).or(viewer);
    }
    std::thread::spawn(move || std::io::copy(&mut said, &mut std::io::sink()));
    let (_, address) = line.trim().split_once("http://").unwrap();
    let (host, token) = address.split_once("/?token=").unwrap();
    let (_, port) = host.split_once(':').unwrap();
    let mut request = format!("ws://{host}/socket").into_client_request().unwrap();
    let headers = request.headers_mut();
    let cookie = format!("trocar_console_{port}={token}");
    headers.insert("Cookie", cookie.parse().unwrap());
    headers.insert("Origin", format!("http://{host}").parse().unwrap());
    let socket = tungstenite::client(request, connect(host)).unwrap().0;
    (drives, socket, viewer)
}

fn connect(host: &str) -> TcpStream {
    let stream = TcpStream::connect(host).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

/// The next news of the drives in which every axis's `key` is `value`.
fn await_all(socket: &mut WebSocket<TcpStream>, key: &str, value: &str) -> Value {
    for _ in 0..4000 {
        let Message::Text(text) = socket.read().unwrap() else {
            continue;
        };
        let seen = json!({ "seen": 1 }).to_string();
        socket.send(Message::text(seen)).unwrap();
        let news: Value = serde_json::from_str(&text).unwrap();
        let axes = news["arms"][0]["axes"].as_array();
        if news["kind"] == "drives" && axes.unwrap().iter().all(|axis| axis[key] == value) {
            return news;
        }
    }
    panic!("never is {key} {value} of all axes");
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn the_page_follows_drives_on_a_bus() {
    let _turn = alone();
    let (_drives, mut socket) = open(&["--no-world"]);
    let news = await_all(&mut socket, "nmt", "pre-operational");
    assert_eq!(news["arms"][0]["axes"].as_array().unwrap().len(), 7);
    assert_eq!(news["arms"][0]["axes"][0]["state"], "switch on disabled");
    assert_eq!(news["buses"][0]["interface"], "vcan0");
    assert!(news["episode_s"].is_null());
    let sent = Command::new("cansend")
        .args(["vcan0", "000#0100"])
        .status()
        .unwrap();
    assert!(sent.success());
    let news = await_all(&mut socket, "nmt", "operational");
    assert!(news["buses"][0]["frames"].as_u64().unwrap() > 7, "{news}");
}

/// Drives of a task show their world too: the scene, and whatever camera a page looks at.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn the_page_shows_the_world_of_drives() {
    let _turn = alone();
    let topics = ["--task", "needle-lift", "--topics", "can_bus_page"];
    let (_drives, mut socket) = open(&topics);
    let show = json!({ "show": [[0, "colour"], [255, "colour"]] }).to_string();
    socket.send(Message::text(show)).unwrap();
    let mut streams = Vec::new();
    while !(streams.contains(&0) && streams.contains(&255)) {
        let message = socket.read().unwrap();
        match &message {
            Message::Binary(bytes) => streams.push(bytes[0]),
            Message::Text(_) => {}
            Message::Ping(_) | Message::Pong(_) | Message::Close(_) | Message::Frame(_) => continue,
        }
        let seen = json!({ "seen": 1 }).to_string();
        socket.send(Message::text(seen)).unwrap();
    }
}

/// Foxglove is told of drives and their world: axes, frames, shapes and cameras.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn foxglove_is_told_of_drives_and_their_world() {
    let _turn = alone();
    let words = "--task needle-lift --topics can_bus_foxglove --foxglove 127.0.0.1:0";
    let (_drives, _page, viewer) = open_with_viewer(&words.split(' ').collect::<Vec<_>>());
    let url = viewer.unwrap();
    let (_, address) = url.split_once("ws://").unwrap();
    let mut request = url.as_str().into_client_request().unwrap();
    let protocol = "foxglove.sdk.v1".parse().unwrap();
    request
        .headers_mut()
        .insert("Sec-WebSocket-Protocol", protocol);
    let stream = connect(address.split('/').next().unwrap());
    let (mut socket, _) = tungstenite::client(request, stream).unwrap();
    let channels = loop {
        if let Message::Text(text) = socket.read().unwrap() {
            let mut said: Value = serde_json::from_str(&text).unwrap();
            if said["op"] == "advertise" {
                break said["channels"].take();
            }
        }
    };
    let channels = channels.as_array().unwrap();
    let wanted = [
        "/psm1/measured_js",
        "/psm1/setpoint_js",
        "/tf",
        "/scene",
        "/camera/endoscope",
    ];
    let ids = wanted.map(|topic| channels.iter().position(|it| it["topic"] == topic).unwrap());
    let subscriptions = ids.map(|id| json!({ "id": id, "channelId": id }));
    let subscribe = json!({ "op": "subscribe", "subscriptions": subscriptions });
    socket.send(Message::text(subscribe.to_string())).unwrap();
    let mut heard = std::collections::BTreeSet::new();
    while heard.len() < wanted.len() {
        // The time comes too, as 2.
        if let Message::Binary(bytes) = socket.read().unwrap()
            && bytes[0] == 1
        {
            assert!(bytes.len() > 13);
            heard.insert(u32::from_le_bytes(bytes[1..5].try_into().unwrap()));
        }
    }
    assert!(channels.iter().any(|it| it["topic"] == "/events"));
    assert!(!channels.iter().any(|it| it["topic"] == "/safety"));
}
