//! Beyond loopback: TLS with a certificate that can be pinned, and nothing but refusals without the
//! token.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use rcgen::{CertificateParams, KeyPair};
use rustls::crypto::ring::default_provider;
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject as _;
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use serde_json::Value;
use sha2::{Digest as _, Sha256};
use tests::{repository, scratch, stderr, trocar};
use trocar::rt::sleep_ns;

use crate::page::{Page, handshake_by};
use crate::run::{PATIENCE, SLOW_MOTION, Served};

type Secured = StreamOwned<ClientConnection, TcpStream>;

/// Needle lift for minutes, at all addresses.
const OPEN: [&str; 9] = [
    "run",
    "--task",
    "needle-lift",
    "--policy",
    "noop",
    "--set",
    "scene.episode.time_limit_s=300",
    "--console",
    "0.0.0.0:0",
];

fn open(test: &str) -> Served {
    Served::start_at(&scratch(test), &OPEN, SLOW_MOTION)
}

/// The certificate that a console has kept in `folder`, PEM.
fn kept(folder: &Path) -> String {
    let text = fs::read_to_string(folder.join("trocar/console.json")).unwrap();
    let kept: Value = serde_json::from_str(&text).unwrap();
    kept["certificate"].as_str().unwrap().to_owned()
}

/// Of a client that trusts this certificate and no other.
fn trusting(pem: &str) -> Arc<ClientConfig> {
    let mut roots = RootCertStore::empty();
    roots
        .add(CertificateDer::from_pem_slice(pem.as_bytes()).unwrap())
        .unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    Arc::new(config)
}

fn secured(served: &Served, client: &Arc<ClientConfig>, name: &'static str) -> Secured {
    let name = name.try_into().unwrap();
    let connection = ClientConnection::new(Arc::clone(client), name).unwrap();
    StreamOwned::new(connection, served.connect())
}

/// The answer to `GET path` with these headers over `stream`.
fn get(mut stream: impl Read + Write, path: &str, headers: &[(&str, &str)]) -> String {
    let mut request = format!("GET {path} HTTP/1.1\r\nConnection: close\r\n");
    for (name, value) in headers {
        request += &format!("{name}: {value}\r\n");
    }
    stream.write_all((request + "\r\n").as_bytes()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn other_machines_come_by_tls_with_the_token() {
    let served = open("console-secure");
    let pem = kept(&served.folder);
    let hash = Sha256::digest(CertificateDer::from_pem_slice(pem.as_bytes()).unwrap());
    let hash: Vec<String> = hash.iter().map(|byte| format!("{byte:02X}")).collect();
    assert_eq!(served.fingerprint.as_deref(), Some(hash.join(":").as_str()));
    let client = trusting(&pem);
    let host = format!("localhost:{}", served.port);
    let (cookie, origin) = (served.cookie(), format!("https://{host}"));
    let (host, cookie) = (host.as_str(), cookie.as_str());
    let with_token = format!("/?token={}", served.token);
    let wrong = cookie.replace(&served.token, &"0".repeat(served.token.len()));
    for (path, headers, status) in [
        ("/", vec![("Host", host)], 401),
        ("/?token=0", vec![("Host", host)], 401),
        ("/scene.glb", vec![("Host", host)], 401),
        ("/", vec![("Host", host), ("Cookie", &wrong)], 401),
        (&with_token, vec![("Host", "evil.example")], 421),
        (&with_token, vec![("Host", "192.0.2.99")], 421),
        (&with_token, vec![("Host", host)], 200),
        ("/main.js", vec![("Host", host), ("Cookie", cookie)], 200),
    ] {
        let answer = get(secured(&served, &client, "localhost"), path, &headers);
        let begin = format!("HTTP/1.1 {status} ");
        assert!(answer.starts_with(&begin), "{path} {headers:?}: {answer}");
        let sets = answer.contains("; HttpOnly; SameSite=Strict; Secure");
        assert_eq!(sets, path == with_token && status == 200, "{answer}");
    }
    let plain = origin.replace("https", "http");
    for (origin, cookie, status) in [
        (None, Some(cookie), 403),
        (Some(plain.as_str()), Some(cookie), 403),
        (Some("https://evil.example"), Some(cookie), 403),
        (Some(origin.as_str()), None, 401),
        (Some(origin.as_str()), Some(wrong.as_str()), 401),
    ] {
        let stream = secured(&served, &client, "127.0.0.1");
        let refused = handshake_by(host, stream, origin, cookie).err();
        assert_eq!(refused, Some(status), "{origin:?} {cookie:?}");
    }
    let stream = secured(&served, &client, "127.0.0.1");
    let socket = handshake_by(host, stream, Some(&origin), Some(cookie));
    Page::of(socket.unwrap()).wait_for_state("ENABLED");
}

/// Whoever speaks plain HTTP is told why that fails, and not the token; whoever trusts another
/// certificate leaves.
#[test]
fn plaintext_and_other_certificates_are_refused() {
    let served = open("console-plaintext");
    let host = format!("localhost:{}", served.port);
    let path = format!("/?token={}", served.token);
    let answer = get(served.connect(), &path, &[("Host", &host)]);
    assert!(answer.starts_with("HTTP/1.1 400 "), "{answer}");
    assert!(answer.contains("this port speaks TLS alone"), "{answer}");
    let names = ["localhost".to_owned()];
    let other = CertificateParams::new(names).unwrap();
    let other = other.self_signed(&KeyPair::generate().unwrap()).unwrap();
    let mut stream = secured(&served, &trusting(&other.pem()), "localhost");
    assert!(stream.write_all(b"GET / HTTP/1.1\r\n\r\n").is_err());
}

/// A headset that has accepted the certificate once knows it the next time.
#[test]
fn a_certificate_is_kept_until_it_lacks_a_name() {
    let first = open("console-kept");
    let folder = first.folder.clone();
    let file = folder.join("trocar/console.json");
    let mode = fs::metadata(&file).unwrap().permissions().mode() & 0o777;
    assert_eq!(mode, 0o600);
    let known = first.fingerprint.clone();
    drop(first);
    let again = Served::start_at(&folder, &OPEN, SLOW_MOTION);
    assert_eq!(again.fingerprint, known);
    drop(again);
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replace("\"localhost\"", "\"elsewhere\"")).unwrap();
    let renewed = Served::start_at(&folder, &OPEN, SLOW_MOTION);
    assert!(renewed.fingerprint.is_some() && renewed.fingerprint != known);
}

/// Connections that never finish their handshake lose their places, and the page opens though they
/// hold on.
#[test]
fn silent_handshakes_are_given_up() {
    let served = open("console-silent");
    let mut held: Vec<TcpStream> = (0..100).map(|_| served.connect()).collect();
    for stream in held.iter_mut().skip(50) {
        // The head of a handshake that never comes.
        let _closed = stream.write_all(&[0x16, 3, 1, 2, 0]);
    }
    let mut nothing = Vec::new();
    let _reset = held[0].read_to_end(&mut nothing);
    assert!(nothing.is_empty());
    let client = trusting(&kept(&served.folder));
    let host = format!("localhost:{}", served.port);
    let page = || {
        let mut stream = secured(&served, &client, "localhost");
        let request = format!(
            "GET / HTTP/1.1\r\nHost: {host}\r\nCookie: {}\r\nConnection: close\r\n\r\n",
            served.cookie()
        );
        let mut answer = Vec::new();
        let done = stream.write_all(request.as_bytes());
        let _cut = done.and_then(|()| stream.read_to_end(&mut answer));
        answer.starts_with(b"HTTP/1.1 200 ")
    };
    let mut rounds = 0..PATIENCE.as_millis() / 50;
    let free = rounds.any(|_| {
        sleep_ns(50_000_000);
        page()
    });
    assert!(free, "no place becomes free");
    drop(held);
}

/// A certificate of one's own is served at loopback too, and the console answers to its names
/// alone.
#[test]
fn a_certificate_of_ones_own_is_served() {
    let folder = scratch("console-own-certificate");
    let names = ["robot.example".to_owned()];
    let key = KeyPair::generate().unwrap();
    let own = CertificateParams::new(names).unwrap();
    let own = own.self_signed(&key).unwrap().pem();
    let [cert, private, empty] = ["cert.pem", "key.pem", "empty.pem"].map(|name| folder.join(name));
    fs::write(&cert, &own).unwrap();
    fs::write(&private, key.serialize_pem()).unwrap();
    fs::write(&empty, "").unwrap();
    let [cert, private, empty] =
        [&cert, &private, &empty].map(|path| path.to_str().unwrap().to_owned());
    let mut words = OPEN.to_vec();
    words[8] = "127.0.0.1:0";
    words.extend(["--console-cert", &cert, "--console-key", &private]);
    let served = Served::start_at(&folder, &words, SLOW_MOTION);
    assert!(served.fingerprint.is_some());
    let made = folder.join("trocar/console.json");
    assert!(!made.exists(), "none is made beside it");
    let client = trusting(&own);
    let path = format!("/?token={}", served.token);
    for (host, status) in [("robot.example", 200), ("localhost", 421)] {
        let stream = secured(&served, &client, "robot.example");
        let answer = get(stream, &path, &[("Host", host)]);
        assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")));
    }
    for (cert, key, reason) in [
        (&empty, &private, "empty.pem: no PEM of a certificate"),
        (&cert, &empty, "empty.pem: no PEM of a certificate"),
        (&private, &private, "key.pem: no PEM of a certificate"),
    ] {
        let mut command = trocar();
        command.args(&OPEN[..5]).args(["--console", "127.0.0.1:0"]);
        command.args(["--console-cert", cert, "--console-key", key]);
        let output = command.output().unwrap();
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(
            said.contains("--console-cert") && said.contains(reason),
            "{said}"
        );
    }
}

/// From another host, which is another network namespace: `tests/scripts/console_from_elsewhere.py`
/// asks for everything, without the token, with a wrong one, and with the right one.
#[test]
#[ignore = "needs network namespaces: `make test-console` runs it"]
fn another_host_gets_nothing_without_the_token() {
    let folder = scratch("console-elsewhere");
    // Who is root needs no user namespace, which may be forbidden.
    let root = fs::metadata("/proc/self").unwrap().uid() == 0;
    let user = ["--user", "--map-root-user"];
    let output = Command::new("unshare")
        .args(user.iter().filter(|_| !root))
        .args(["--net", "--fork", "--kill-child", "python3", "-B"])
        .arg(repository().join("tests/scripts/console_from_elsewhere.py"))
        .arg(trocar().get_program())
        .arg(&folder)
        .current_dir(repository())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", stderr(&output));
    assert!(said.contains("refused: 14, served: 3"), "{said}");
}
