//! The page in Chromium: it shows and steers a run, comes back after a cut, fits its window, and
//! can be read.

use serde_json::Value;
use tests::scratch;

use crate::devtools::{Browser, Proxy};
use crate::run::{SLOW_MOTION, Served, UNPACED};

/// Texts and placeholders whose contrast with what is behind them is below WCAG's AA (4.5, or 3
/// where they are large), and fields and ends of meters whose borders' contrast with either side is
/// below 3; disabled controls apart.
const LOW_CONTRAST: &str = r"(() => {
  const rgb = (text) => text.match(/[\d.]+/g).map(Number);
  const light = ([r, g, b]) => {
    const part = (v) => ((v /= 255) <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * part(r) + 0.7152 * part(g) + 0.0722 * part(b);
  };
  const behind = (node) => {
    for (; node; node = node.parentElement) {
      const colour = rgb(getComputedStyle(node).backgroundColor);
      if (colour.length < 4 || colour[3] > 0.99) return colour;
    }
    return [255, 255, 255];
  };
  const contrast = (...both) => {
    const [a, b] = both.map(light).sort((x, y) => y - x);
    return (a + 0.05) / (b + 0.05);
  };
  const seen = (node) => node.getClientRects().length > 0 && !node.closest(':disabled, .visually-hidden, option');
  const low = [];
  const tell = (node, what, ratio, least) => {
    if (!(ratio >= least)) low.push(`${node.tagName} ${node.className} ${what} ${ratio.toFixed(2)}`);
  };
  for (const node of document.querySelectorAll('body *')) {
    const own = [...node.childNodes].some((child) => child.nodeType === 3 && child.data.trim());
    if (!own || !seen(node)) continue;
    const style = getComputedStyle(node);
    const large = parseFloat(style.fontSize) >= 24 || (parseFloat(style.fontSize) >= 18.66 && style.fontWeight >= 700);
    tell(node, `'${node.textContent.slice(0, 30)}'`, contrast(rgb(style.color), behind(node)), large ? 3 : 4.5);
  }
  for (const node of document.querySelectorAll('[placeholder]')) {
    if (!seen(node)) continue;
    const style = getComputedStyle(node, '::placeholder');
    const back = behind(node);
    const [r, g, b, alpha = 1] = rgb(style.color);
    const share = alpha * style.opacity;
    const mixed = [r, g, b].map((channel, i) => share * channel + (1 - share) * back[i]);
    tell(node, `'${node.placeholder}'`, contrast(mixed, back), 4.5);
  }
  for (const node of document.querySelectorAll('input[type=text], select, .meter')) {
    if (!seen(node)) continue;
    const style = getComputedStyle(node);
    for (const side of node.matches('.meter') ? ['left', 'right'] : ['left', 'right', 'top', 'bottom']) {
      const drawn = parseFloat(style.getPropertyValue(`border-${side}-width`)) >= 1;
      const edge = drawn ? rgb(style.getPropertyValue(`border-${side}-color`)) : behind(node);
      // Without a border it is the field itself that is seen against the panel.
      const sides = drawn ? [node, node.parentElement] : [node.parentElement];
      tell(node, `${side} edge`, Math.min(...sides.map((at) => contrast(edge, behind(at)))), 3);
    }
  }
  return low;
})()";

/// Controls without a name.
const NAMELESS: &str = r"[...document.querySelectorAll('button, input, select, img')]
  .filter((node) => !(node.textContent.trim() || node.getAttribute('aria-label') || node.alt || node.labels?.length))
  .map((node) => node.outerHTML)";

/// Whatever reaches out of the window at its side.
const OVERFLOW: &str = r"[...document.querySelectorAll('body *')]
  .filter((node) => node.getClientRects().length && !node.closest('.visually-hidden, .ends'))
  .filter((node) => node.getBoundingClientRect().right > innerWidth + 0.5 || node.scrollWidth > node.clientWidth + 1 && getComputedStyle(node).overflowX === 'visible' && getComputedStyle(node).display !== 'inline')
  .map((node) => `${node.tagName}.${node.className} ${node.textContent.slice(0, 40)}`)";

/// Looks at the page at all widths and in both schemes, and keeps a picture of each.
pub(crate) fn looks_right(browser: &mut Browser, name: &str) {
    let folder = scratch(&format!("console-pictures-{name}"));
    for (width, scheme) in [
        (1280, "light"),
        (1280, "dark"),
        (390, "light"),
        (390, "dark"),
        (820, "light"),
    ] {
        browser.look(width, scheme);
        browser.evaluate("new Promise((done) => setTimeout(done, 400))");
        // A busy browser has not drawn itself anew by then.
        browser.evaluate(
            "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))",
        );
        let what = format!("{name} at {width} px, {scheme}");
        for (fault, expression) in [
            ("overflow", OVERFLOW),
            ("low contrast", LOW_CONTRAST),
            ("nameless", NAMELESS),
        ] {
            let found = browser.evaluate(expression);
            assert_eq!(found, serde_json::json!([]), "{what}: {fault}");
        }
        let wide = browser.evaluate("document.documentElement.scrollWidth <= innerWidth");
        assert_eq!(wide, true, "{what}");
        browser.screenshot(&folder.join(format!("{width}-{scheme}.png")));
    }
    browser.look(1280, "light");
}

/// The check finds pale placeholders, pale borders of fields and meters without ends on a page that
/// has placeholders, fields and meters.
pub(crate) fn finds_what_is_faint(browser: &mut Browser) {
    browser.evaluate(FAINT);
    let found = browser.evaluate(LOW_CONTRAST);
    let found = found.as_array().unwrap();
    for what in ["'kept with", "INPUT  left edge", "DIV meter"] {
        let is_found = found
            .iter()
            .any(|text| text.as_str().unwrap().contains(what));
        assert!(is_found, "{what}: {found:?}");
    }
    browser.evaluate("document.adoptedStyleSheets = [], true");
    assert_eq!(browser.evaluate(LOW_CONTRAST), serde_json::json!([]));
}

const FAINT: &str = "(() => {
  const sheet = new CSSStyleSheet();
  sheet.replaceSync('input::placeholder { opacity: 0.6 } input[type=text] { border-color: var(--line) } .meter { border-width: 0 }');
  document.adoptedStyleSheets = [sheet];
})()";

fn number(value: &Value) -> f64 {
    value
        .as_str()
        .and_then(|text| text.parse().ok())
        .unwrap_or(f64::NAN)
}

/// Whether the first camera's picture is there, with its time.
pub(crate) const PICTURE: &str = "(({ naturalWidth, dataset }) => naturalWidth > 100 && dataset.seconds !== undefined)(document.querySelector('.view img'))";

/// How many points the path of the newest chunk has in the first camera's picture.
pub(crate) const PATH: &str =
    "(document.querySelector('.view .path .arm0')?.getAttribute('points') ?? '').split(' ').length";

const STATE: &str = "document.querySelector('.chip')?.dataset.state";

/// How many colours the scene's picture has, and a sum of it that another picture hardly has.
pub(crate) const SCENE: &str = "(() => {
  const from = document.querySelector('#scene-view');
  const to = new OffscreenCanvas(from.width, from.height).getContext('2d');
  to.drawImage(from, 0, 0);
  const pixels = new Uint32Array(to.getImageData(0, 0, from.width, from.height).data.buffer);
  return [new Set(pixels).size, pixels.reduce((sum, pixel, index) => (sum + pixel * (index % 9973)) % 2 ** 40, 0)];
})()";

/// The scene is drawn, goes on, and can be turned by keys; without its limits it looks otherwise.
fn looks_at_the_scene(browser: &mut Browser) {
    let stamp = "Number(document.querySelector('#scene-view').dataset.seconds)";
    browser.wait_until(&format!("{stamp} > 0"));
    let before = browser.evaluate(stamp).as_f64().unwrap();
    browser.wait_until(&format!("{stamp} > {before} + 1"));
    let mut seen = browser.evaluate(SCENE);
    assert!(seen[0].as_u64() > Some(300), "{seen}");
    // What the simulation moves meanwhile is told apart by pausing it.
    browser.press("p");
    browser.wait_until(&format!("{STATE} === 'PAUSED'"));
    browser.evaluate("document.querySelector('#scene-view').focus()");
    for what in ["ArrowLeft", "PageDown", "limits"] {
        if what == "limits" {
            browser.evaluate("document.querySelector('#scene-limits').click()");
        } else {
            browser.press(what);
        }
        browser.wait_until(&format!("({SCENE})[1] !== {}", seen[1]));
        seen = browser.evaluate(SCENE);
    }
    browser.evaluate("document.querySelector('#scene-limits').click()");
    browser.evaluate("document.querySelector('[data-command=resume]').click()");
    browser.wait_until(&format!("{STATE} === 'ENABLED'"));
    browser.evaluate("document.activeElement.blur(); scrollTo(0, 0)");
}

/// Beside 125 messages of hands a second the page acknowledges at most 40 times, though 200
/// messages come, and leaves fewer than the 8 open that the run has on their way; where few come it
/// acknowledges every second one.
fn acknowledges_within_its_bound(browser: &mut Browser) {
    for (every_ms, counts) in [(5, [40, 4]), (20, [25, 1]), (1, [167, 5])] {
        let found = browser.evaluate(&ACKNOWLEDGED.replace("EVERY_MS", &every_ms.to_string()));
        assert_eq!(found, serde_json::json!(counts), "{every_ms} ms");
    }
}

/// How often the page's connection acknowledges in a second in which a message comes so often, and
/// how many are open at most after one.
const ACKNOWLEDGED: &str = r#"(async () => {
  const { Connection } = await import('/connection.js');
  const real = window.WebSocket;
  let [now, socket, times, open, most] = [0, null, 0, 0, 0];
  window.WebSocket = class {
    static OPEN = 1;
    readyState = 1;
    constructor() { socket = this; }
    send(text) {
      times += 1;
      open -= JSON.parse(text).seen;
    }
  };
  performance.now = () => now;
  new Connection({ text() {}, change() {} });
  for (now = EVERY_MS; now <= 1000; now += EVERY_MS) {
    open += 1;
    socket.onmessage({ data: '{"kind":"state"}' });
    most = Math.max(most, open);
  }
  delete performance.now;
  window.WebSocket = real;
  return [times, most];
})()"#;

#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn the_page_shows_and_steers_a_run() {
    let mut served = Served::run("console-browser", "random");
    let proxy = Proxy::to(served.port);
    let url = served
        .url()
        .replace(&served.host(), &format!("127.0.0.1:{}", proxy.port));
    let mut browser = Browser::open("console-browser-profile", &url);
    browser.look(1280, "light");
    browser.wait_until(&format!("{STATE} === 'ENABLED'"));
    browser.wait_until(PICTURE);
    assert_eq!(
        browser.evaluate("location.search"),
        "",
        "the token stands in the address"
    );
    let stamp = "document.querySelector('.view img').dataset.seconds";
    let before = number(&browser.evaluate(stamp));
    browser.wait_until(&format!("Number({stamp}) > {before} + 1"));
    browser.wait_until("document.querySelector('#steer').getAttribute('aria-pressed') === 'true'");
    browser.wait_until(&format!("{PATH} > 5"));
    browser.evaluate("document.querySelector('#path-show').click()");
    browser.wait_until(&format!("{PATH} === 1"));
    browser.wait_until("document.querySelector('#scene-view').dataset.paths === '0'");
    browser.evaluate("document.querySelector('#path-show').click()");
    browser.wait_until(&format!("{PATH} > 5"));
    browser.wait_until("Number(document.querySelector('#scene-view').dataset.paths) > 5");
    looks_at_the_scene(&mut browser);
    looks_right(&mut browser, "run");
    acknowledges_within_its_bound(&mut browser);

    // Also while the slider has the focus, as it has after it was moved.
    browser.evaluate("document.querySelector('#speed').focus()");
    browser.press("p");
    browser.wait_until(&format!("{STATE} === 'PAUSED'"));
    browser.wait_until("document.querySelector('#live').textContent.includes('PAUSED')");
    browser.evaluate("document.querySelector('[data-command=resume]').click()");
    browser.wait_until(&format!("{STATE} === 'ENABLED'"));
    browser.press("-");
    browser.wait_until("document.querySelector('#task').textContent.includes('90 %')");

    assert_eq!(browser.errors, Vec::<String>::new());
    browser.evaluate("window.notReloaded = true");
    proxy.cut();
    browser
        .wait_until("document.querySelector('#banner').textContent.startsWith('Connection lost')");
    browser.wait_until(
        "/connection lost · [1-9]/.test(document.querySelector('#link-text').textContent)",
    );
    assert_eq!(
        browser.evaluate("document.querySelector('[data-command=pause]').disabled"),
        true
    );
    proxy.mend();
    browser.wait_until("document.querySelector('#link').dataset.link === 'open'");
    let back = number(&browser.evaluate(stamp));
    browser.wait_until(&format!("Number({stamp}) > {back}"));
    assert_eq!(browser.evaluate("window.notReloaded"), true);
    browser.wait_until("!document.querySelector('[data-command=stop]').disabled");
    browser.evaluate("document.querySelector('[data-command=stop]').click()");
    browser.wait_until(
        "document.querySelector('#banner').textContent.includes('stopped by the operator')",
    );
    browser.wait_until("document.querySelector('#link-text').textContent === 'run ended'");
    let foreign = browser.asked.iter().find(|url| {
        !url.contains("://127.0.0.1:") && !url.starts_with("data:") && !url.starts_with("blob:")
    });
    assert_eq!(foreign, None);
    assert_eq!(served.code(), 1);
}

/// At another address than loopback the page is a secure context, as a headset's WebXR needs it,
/// and everything comes by TLS.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn the_page_opens_beyond_loopback() {
    let words = ["run", "--task", "needle-lift", "--policy", "noop"];
    let open = [
        "--set",
        "scene.episode.time_limit_s=300",
        "--console",
        "0.0.0.0:0",
    ];
    let words = [&words[..], &open].concat();
    let served = Served::start_at(&scratch("console-browser-tls"), &words, SLOW_MOTION);
    let url = served.url();
    let mut browser = Browser::open("console-browser-tls-profile", &url);
    browser.look(1280, "light");
    browser.wait_until("document.querySelector('.chip')?.dataset.state === 'ENABLED'");
    browser.wait_until(PICTURE);
    assert_eq!(
        browser.evaluate("isSecureContext && Boolean(navigator.xr)"),
        true
    );
    assert_eq!(browser.evaluate("location.search"), "");
    let origin = url.split("/?").next().unwrap();
    let socket = origin.replace("https://", "wss://") + "/socket";
    assert!(browser.asked.contains(&socket), "{:?}", browser.asked);
    let foreign = browser.asked.iter().find(|url| {
        let own = url.starts_with(origin) || **url == socket;
        !own && !url.starts_with("data:") && !url.starts_with("blob:")
    });
    assert_eq!(foreign, None);
    assert_eq!(browser.errors, Vec::<String>::new());
}

/// The expert records by itself: the page says how far it is, and shows an episode. The browser is
/// there before, and there are enough for a page that is loaded late.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn the_page_follows_a_recording() {
    let folder = scratch("console-browser-record");
    let out = folder.join("dataset");
    let words = [
        "record",
        "--task",
        "needle-lift",
        "--episodes",
        "6",
        "--seed",
        "3",
    ];
    let more = ["--console", "127.0.0.1:0"];
    let to = ["--out", out.to_str().unwrap()];
    let mut browser = Browser::open("console-browser-record-profile", "about:blank");
    let mut served = Served::start_at(&folder, &[&words[..], &more, &to].concat(), UNPACED);
    browser.visit(&served.url());
    browser.look(1280, "light");
    browser.wait_until("document.querySelector('#attempts li')?.dataset.kept === 'true'");
    browser.wait_until(PICTURE);
    browser.wait_until("document.querySelector('.axis .measured')?.hidden === false");
    browser.wait_until("document.querySelectorAll('#criteria-rows tr').length > 1");
    assert_eq!(
        browser.evaluate("document.querySelector('#steering').hidden"),
        true
    );
    browser.screenshot(&folder.join("recording.png"));
    browser.wait_until("document.querySelector('#recorded').value === 6");
    browser.wait_until("document.querySelector('#banner').textContent.includes('6 episodes')");
    looks_right(&mut browser, "recording");
    assert_eq!(browser.errors, Vec::<String>::new());
    assert_eq!(served.code(), 0);
}

/// What a page is told of drives fits its window and can be read, faults and all.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn the_page_shows_drives() {
    let served = Served::run("console-browser-drives", "noop");
    let mut browser = Browser::open("console-browser-drives-profile", &served.url());
    browser.wait_until("document.querySelector('.chip')?.dataset.state === 'ENABLED'");
    browser.evaluate(DRIVES);
    let shown = "document.querySelector('.drives').innerText";
    for text in ["operation enabled", "no power", "8130h", "fault"] {
        browser.wait_until(&format!("{shown}.includes('{text}')"));
    }
    for hidden in ["steering", "loop", "safety", "joints"] {
        let rects = format!("document.querySelector('.{hidden}').getClientRects().length");
        assert_eq!(browser.evaluate(&rects), 0, "{hidden}");
    }
    looks_right(&mut browser, "drives");
    assert_eq!(browser.errors, Vec::<String>::new());
}

/// Hands the page's own panel what drives of two arms say of themselves, one of them pulled and one
/// at fault.
const DRIVES: &str = r"(async () => {
  const { Drives } = await import('/drives.js');
  const names = ['yaw', 'pitch', 'insertion', 'roll', 'wrist_pitch', 'wrist_yaw', 'jaw'];
  const axis = (name, i) => ({ name, node: i + 1, nmt: 'operational', state: 'operation enabled', mode: 'cyclic position', error: null, unit: i === 2 ? 'm' : 'rad', position: 0.1, wanted: 0.11 });
  const arms = ['psm1', 'psm2'].map((name) => ({ name, axes: names.map(axis) }));
  Object.assign(arms[1].axes[2], { node: null, nmt: 'no power', state: 'no power', mode: '', position: null, wanted: null });
  Object.assign(arms[1].axes[3], { state: 'fault', error: '8130h, life guard or heartbeat error', wanted: null });
  document.body.dataset.subject = 'drives';
  new Drives().show({
    seconds: 12.3, episode_s: 4.5, stalled_s: 0, frames_lost: 0, arms,
    buses: [{ interface: 'can0', frames_per_s: 14003, load: 0.74, errors: 0 }, { interface: 'can1', frames_per_s: 5003, load: 0.31, errors: 2 }],
    happened: [{ seconds: 1.2, text: 'all drives are enabled at 1.200 s: the episode begins' }, { seconds: 9.1, text: 'psm2 node 3: it lost its power' }],
  });
})()";
