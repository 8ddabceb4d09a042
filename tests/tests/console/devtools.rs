//! Chromium without a window, driven over its DevTools protocol; and a proxy on whose connections a
//! test has its hand.

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use base64::Engine as _;
use serde_json::{Value, json};
use tests::scratch;
use trocar::rt::sleep_ns;
use tungstenite::{Message, WebSocket};

use crate::run::PATIENCE;

/// A browser with one page.
pub(crate) struct Browser {
    process: Child,
    socket: WebSocket<TcpStream>,
    session: String,
    number: u64,
    /// Errors that the page told its console, and addresses that it asked.
    pub(crate) errors: Vec<String>,
    pub(crate) asked: Vec<String>,
}

impl Browser {
    /// Opens `url`; `name` names the folder of its profile.
    pub(crate) fn open(name: &str, url: &str) -> Self {
        Self::open_with(name, url, "")
    }

    /// The same, in which `script` runs before any of the page's.
    pub(crate) fn open_with(name: &str, url: &str, script: &str) -> Self {
        let mut process = Command::new("chromium")
            .args([
                "--headless=new",
                "--no-sandbox",
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
                "--hide-scrollbars",
            ])
            .args([
                "--remote-debugging-port=0",
                "--no-first-run",
                "--disable-dev-shm-usage",
            ])
            .arg(format!("--user-data-dir={}", scratch(name).display()))
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("`make test-console` installs chromium");
        let mut said = BufReader::new(process.stderr.take().unwrap());
        let mut line = String::new();
        while !line.contains("DevTools listening on ") {
            line.clear();
            assert!(
                said.read_line(&mut line).unwrap() > 0,
                "chromium has no DevTools"
            );
        }
        std::thread::spawn(move || std::io::copy(&mut said, &mut std::io::sink()));
        let address = line
            .trim()
            .split("listening on ")
            .nth(1)
            .unwrap()
            .to_owned();
        let socket = connect(&address);
        let mut browser = Self {
            process,
            socket,
            session: String::new(),
            number: 0,
            errors: Vec::new(),
            asked: Vec::new(),
        };
        let target = browser.call("Target.createTarget", &json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let attached = browser.call("Target.attachToTarget", &attach);
        attached["sessionId"]
            .as_str()
            .unwrap()
            .clone_into(&mut browser.session);
        for domain in ["Page", "Runtime", "Log", "Network"] {
            browser.call(&format!("{domain}.enable"), &json!({}));
        }
        browser.call(
            "Page.addScriptToEvaluateOnNewDocument",
            &json!({ "source": script }),
        );
        // As a person does who has compared the certificate's hash.
        browser.call(
            "Security.setIgnoreCertificateErrors",
            &json!({ "ignore": true }),
        );
        browser.visit(url);
        browser
    }

    /// Opens `url` in place of what is shown.
    pub(crate) fn visit(&mut self, url: &str) {
        self.call("Page.navigate", &json!({ "url": url }));
    }

    /// Calls a method of the protocol.
    pub(crate) fn call(&mut self, method: &str, parameters: &Value) -> Value {
        let answer = self.try_call(method, parameters);
        answer.unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    /// The same; what the browser says if it can't be.
    fn try_call(&mut self, method: &str, parameters: &Value) -> Result<Value, String> {
        self.number += 1;
        let mut message = json!({ "id": self.number, "method": method, "params": parameters });
        if !self.session.is_empty() {
            message["sessionId"] = json!(self.session);
        }
        self.socket
            .send(Message::text(message.to_string()))
            .unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else {
                continue;
            };
            let heard: Value = serde_json::from_str(&text).unwrap();
            if heard["id"] == self.number {
                return if heard["error"].is_null() {
                    Ok(heard["result"].clone())
                } else {
                    Err(heard.to_string())
                };
            }
            self.note(&heard);
        }
    }

    fn note(&mut self, event: &Value) {
        let parameters = &event["params"];
        match event["method"].as_str().unwrap_or_default() {
            "Runtime.exceptionThrown" => self.errors.push(parameters.to_string()),
            "Runtime.consoleAPICalled" if parameters["type"] == "error" => {
                self.errors.push(parameters.to_string());
            }
            "Log.entryAdded" if parameters["entry"]["level"] == "error" => {
                self.errors.push(parameters.to_string());
            }
            "Network.requestWillBeSent" => {
                let url = parameters["request"]["url"].as_str().unwrap();
                self.asked.push(url.to_owned());
            }
            "Network.webSocketCreated" => {
                self.asked
                    .push(parameters["url"].as_str().unwrap().to_owned());
            }
            _ => {}
        }
    }

    /// The value of an expression in the page.
    pub(crate) fn evaluate(&mut self, expression: &str) -> Value {
        let parameters =
            json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let result = self.call("Runtime.evaluate", &parameters);
        Self::value(expression, &result)
    }

    fn value(expression: &str, result: &Value) -> Value {
        assert!(
            result["exceptionDetails"].is_null(),
            "{expression}: {result}"
        );
        result["result"]["value"].clone()
    }

    /// Waits until an expression is true. A page that is being loaded anew has none meanwhile.
    pub(crate) fn wait_until(&mut self, expression: &str) {
        if !self.comes_true(expression, PATIENCE) {
            let text = self.evaluate("document.body.innerText");
            panic!("never: {expression}\n{text}\n{:?}", self.errors);
        }
    }

    /// Whether `expression` is true before `patience` is over. It is not read before the page has
    /// its elements.
    pub(crate) fn comes_true(&mut self, expression: &str, patience: Duration) -> bool {
        let rounds = patience.as_millis() / 50;
        let loaded = format!("document.readyState !== 'loading' && ({expression})");
        let parameters = json!({ "expression": loaded, "returnByValue": true });
        for _ in 0..rounds {
            match self.try_call("Runtime.evaluate", &parameters) {
                Ok(result) if Self::value(expression, &result) == true => return true,
                Err(error) if !error.contains("navigated") && !error.contains("context") => {
                    panic!("{expression}: {error}");
                }
                Ok(_) | Err(_) => {}
            }
            sleep_ns(50_000_000);
        }
        false
    }

    /// Presses a key.
    pub(crate) fn press(&mut self, key: &str) {
        for kind in ["rawKeyDown", "keyUp"] {
            self.call(
                "Input.dispatchKeyEvent",
                &json!({ "type": kind, "key": key }),
            );
        }
    }

    /// Gives the page this width and this colour scheme.
    pub(crate) fn look(&mut self, width: u32, scheme: &str) {
        let height = if width < 600 { 844 } else { 900 };
        let metrics = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600 });
        self.call("Emulation.setDeviceMetricsOverride", &metrics);
        let features = json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
        self.call("Emulation.setEmulatedMedia", &features);
    }

    /// Writes a picture of the whole page.
    pub(crate) fn screenshot(&mut self, path: &Path) {
        let parameters = json!({ "format": "png", "captureBeyondViewport": true });
        let taken = self.call("Page.captureScreenshot", &parameters);
        let text = taken["data"].as_str().unwrap();
        let bytes = base64::engine::general_purpose::STANDARD
            .decode(text)
            .unwrap();
        fs::write(path, bytes).unwrap();
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
    }
}

fn connect(address: &str) -> WebSocket<TcpStream> {
    let host = address.strip_prefix("ws://").unwrap();
    let host = host.split('/').next().unwrap();
    let stream = TcpStream::connect(host).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    tungstenite::client(address, stream).unwrap().0
}

/// Hands connections on to a port; a test can cut them.
pub(crate) struct Proxy {
    pub(crate) port: u16,
    open: Arc<Mutex<Vec<TcpStream>>>,
    refuses: Arc<AtomicBool>,
}

impl Proxy {
    pub(crate) fn to(port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let own_port = listener.local_addr().unwrap().port();
        let open = Arc::new(Mutex::new(Vec::new()));
        let refuses = Arc::new(AtomicBool::new(false));
        let proxy = Self {
            port: own_port,
            open: Arc::clone(&open),
            refuses: Arc::clone(&refuses),
        };
        std::thread::spawn(move || {
            for from in listener.incoming().map_while(Result::ok) {
                let to = TcpStream::connect(("127.0.0.1", port)).ok();
                let Some(to) = to.filter(|_| !refuses.load(Ordering::SeqCst)) else {
                    continue;
                };
                open.lock().unwrap().push(from.try_clone().unwrap());
                pass(from.try_clone().unwrap(), to.try_clone().unwrap());
                pass(to, from);
            }
        });
        proxy
    }

    /// Cuts every connection and lets no new one through.
    pub(crate) fn cut(&self) {
        self.refuses.store(true, Ordering::SeqCst);
        for stream in self.open.lock().unwrap().drain(..) {
            let _gone = stream.shutdown(Shutdown::Both);
        }
    }

    /// Lets connections through again.
    pub(crate) fn mend(&self) {
        self.refuses.store(false, Ordering::SeqCst);
    }
}

/// Passes bytes on until one side ends.
fn pass(mut from: TcpStream, mut to: TcpStream) {
    std::thread::spawn(move || {
        let mut bytes = [0; 16 << 10];
        while let Ok(count @ 1..) = from.read(&mut bytes) {
            if to.write_all(&bytes[..count]).is_err() {
                break;
            }
        }
        let _gone = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
    });
}
