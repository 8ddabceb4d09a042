//! Who may open it, and where it may listen.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};

use tests::{stderr, trocar};

use crate::page::{Page, handshake};
use crate::run::Served;

#[test]
fn only_who_has_the_token_gets_the_page_or_its_socket() {
    let served = Served::run("console-access", "noop");
    let host = served.host();
    let host = host.as_str();
    let with_token = format!("/?token={}", served.token);
    let with_token = with_token.as_str();
    let cookie = served.cookie();
    let wrong = cookie.replace(&served.token, &"0".repeat(served.token.len()));
    let (cookie, wrong) = (cookie.as_str(), wrong.as_str());
    for (path, headers, status) in [
        ("/", vec![("Host", host)], 401),
        ("/?token=0", vec![("Host", host)], 401),
        ("/main.js", vec![("Host", host)], 401),
        ("/scene.glb", vec![("Host", host)], 401),
        ("/", vec![("Host", host), ("Cookie", wrong)], 401),
        (with_token, vec![("Host", "evil.example")], 421),
        ("/", vec![("Host", "evil.example"), ("Cookie", cookie)], 421),
        (with_token, vec![("Host", host)], 200),
        (with_token, vec![("Host", "localhost:9")], 200),
        ("/", vec![("Host", host), ("Cookie", cookie)], 200),
        ("/main.js", vec![("Host", host), ("Cookie", cookie)], 200),
        (
            "/../Cargo.toml",
            vec![("Host", host), ("Cookie", cookie)],
            404,
        ),
    ] {
        let answer = served.get(path, &headers);
        assert!(
            answer.starts_with(&format!("HTTP/1.1 {status} ")),
            "{path}: {answer}"
        );
        let head = answer.split("\r\n\r\n").next().unwrap().to_lowercase();
        for header in [
            "content-security-policy: default-src 'none'; script-src 'self'",
            "x-content-type-options: nosniff",
            "referrer-policy: no-referrer",
            "cache-control: no-store",
        ] {
            assert!(head.contains(header), "{path}: {header} not in {head}");
        }
        let sets = head.contains("set-cookie: ");
        assert_eq!(sets, status == 200 && path == with_token, "{path}: {head}");
        if sets {
            assert!(head.contains("; httponly; samesite=strict"), "{head}");
        } else {
            assert!(!answer.contains(&served.token), "{path} tells the token");
        }
    }
    let origin = format!("http://{host}");
    for (origin, cookie, status) in [
        (None, Some(cookie), 403),
        (Some("http://evil.example"), Some(cookie), 403),
        (Some("null"), Some(cookie), 403),
        (Some(origin.as_str()), None, 401),
        (Some(origin.as_str()), Some(wrong), 401),
    ] {
        let refused = handshake(&served, origin, cookie).err();
        assert_eq!(refused, Some(status), "{origin:?} {cookie:?}");
    }
    Page::open(&served).wait_for_state("ENABLED");
}

/// Whoever opens connections without end takes few of the run's file descriptors; once they are
/// gone the page opens again.
#[test]
fn a_flood_of_connections_is_bounded() {
    let served = Served::run("console-flood", "noop");
    Page::open(&served).wait_for_state("ENABLED");
    let descriptors = || {
        let folder = format!("/proc/{}/fd", served.process.id());
        std::fs::read_dir(folder).unwrap().count()
    };
    let before = descriptors();
    let mut held: Vec<TcpStream> = (0..400).map(|_| served.connect()).collect();
    for stream in &mut held {
        // The server may have closed it already.
        let _half_a_request = stream.write_all(b"GET / HT");
    }
    // The last one is closed without an answer.
    let mut answer = Vec::new();
    let _reset = held[399].read_to_end(&mut answer);
    assert!(answer.is_empty());
    let open = descriptors();
    assert!(open <= before + 134, "{before} before, {open} now");
    drop(held);
    let (host, cookie) = (served.host(), served.cookie());
    let page = || {
        let headers = [("Host", host.as_str()), ("Cookie", cookie.as_str())];
        served.try_get("/", &headers)
    };
    while !page().is_some_and(|answer| answer.starts_with("HTTP/1.1 200 ")) {}
    Page::open(&served).wait_for_state("ENABLED");
}

/// The page asks nothing of any other server, and holds no script or style that the policy of its
/// content forbids.
#[test]
fn the_page_is_whole_in_itself() {
    let served = Served::run("console-files", "noop");
    let (host, cookie) = (served.host(), served.cookie());
    let get = |path: &str| {
        served.get(
            path,
            &[("Host", host.as_str()), ("Cookie", cookie.as_str())],
        )
    };
    let page = get("/");
    assert!(!page.contains("style=\"") && !page.contains("onclick"));
    assert!(page.contains("Stop is not an emergency stop"));
    for path in [
        "/",
        "/console.css",
        "/main.js",
        "/connection.js",
        "/dom.js",
        "/panels.js",
        "/cameras.js",
        "/drives.js",
        "/recording.js",
        "/criteria.js",
        "/dataset.js",
        "/spacemouse.js",
        "/operator.js",
        "/teleop.js",
        "/hands.js",
        "/headset.js",
        "/timeline.js",
        "/scene.js",
        "/scene_draw.js",
        "/scene_file.js",
    ] {
        let text = get(path);
        assert!(text.starts_with("HTTP/1.1 200 "), "{path}");
        for foreign in ["http://", "https://", "//cdn", "@import", "eval("] {
            assert!(!text.contains(foreign), "{path} has {foreign}");
        }
    }
    Page::open(&served).wait_for_state("ENABLED");
    let scene = get("/scene.glb");
    assert!(scene.contains("model/gltf-binary") && scene.contains("glTF\u{2}"));
    for part in ["needle", "left finger", "endoscope", "vessel", "psm1"] {
        assert!(scene.contains(&format!("\"name\":\"{part}\"")), "{part}");
    }
}

#[test]
fn what_is_no_address_and_ports_in_use_are_refused() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = taken.local_addr().unwrap().to_string();
    for (address, reason) in [
        ("192.0.2.99:80", "cannot listen there"),
        ("nowhere", "expected ADDRESS:PORT"),
        ("127.0.0.1:70000", "with a port in [0, 65535]"),
        (
            taken.as_str(),
            "cannot listen there: Address already in use",
        ),
    ] {
        expect_refused(&["--console", address], reason);
    }
    expect_refused(&["--lockstep", "--console"], "--lockstep");
}

/// A run with these words ends as bad usage that says `reason`.
fn expect_refused(words: &[&str], reason: &str) {
    let mut command = trocar();
    command.args(["run", "--task", "needle-lift", "--policy", "noop"]);
    let output = command.args(words).output().unwrap();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{words:?}: {said}");
    assert!(said.contains(reason), "{words:?}: {said}");
}
