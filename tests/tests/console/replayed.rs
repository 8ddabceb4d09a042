//! The page on a log in Chromium: it has what the page on its run had, and goes to any place.

use crate::browser::{PATH, PICTURE, SCENE, looks_right};
use crate::devtools::Browser;
use crate::log::as_if_on_can;
use crate::run::{Served, made_log};

#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn the_page_shows_a_log() {
    let log = made_log("console-browser-log-made", "needle-handover");
    let served = Served::start("console-browser-log", &["replay", log.to_str().unwrap()]);
    let mut browser = Browser::open("console-browser-log-profile", &served.url());
    browser.look(1280, "light");
    browser.wait_until("document.querySelectorAll('#events button').length > 1");
    browser.wait_until(PICTURE);
    assert_eq!(
        browser.evaluate("document.querySelector('#steering').hidden"),
        true
    );
    assert_eq!(
        browser.evaluate("document.querySelectorAll('.chip').length"),
        2
    );
    browser.evaluate("(() => { const at = document.querySelector('#at'); at.value = at.max / 2; at.dispatchEvent(new Event('input')); })()");
    let time = "parseFloat(document.querySelector('#time').textContent)";
    browser.wait_until(&format!(
        "Math.abs({time} - document.querySelector('#at').value) < 0.05"
    ));
    looks_like_its_run(&mut browser, time);
    let before = browser.evaluate(time).as_f64().unwrap();
    for _ in 0..5 {
        browser.press("ArrowRight");
    }
    browser.wait_until(&format!("{time} > {before} + 0.15"));
    looks_right(&mut browser, "log");
    browser.evaluate("[...document.querySelectorAll('#events button')].at(-1).click()");
    browser.wait_until("document.querySelector('#events li:last-child button').getAttribute('aria-current') === 'true'");
    browser.evaluate("document.querySelector('#events button').click()");
    browser.wait_until(&format!("{time} < 0.1"));
    browser.evaluate("document.querySelector('#play').click()");
    browser.wait_until(&format!("{time} > 0.5"));
    assert_eq!(browser.errors, Vec::<String>::new());
}

/// The log of a run on CAN: how its bus was, what the operator's hand did, without anything to
/// steer, and the instruments over the ground.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn the_page_shows_a_log_of_a_bus() {
    let made = made_log("console-browser-can-made", "needle-lift");
    let log = made.with_file_name("can.mcap");
    as_if_on_can(&made, &log);
    let served = Served::start("console-browser-can", &["replay", log.to_str().unwrap()]);
    let mut browser = Browser::open("console-browser-can-profile", &served.url());
    browser.look(1280, "light");
    browser.wait_until("document.querySelectorAll('#events button').length > 1");
    let buses = "document.querySelector('#drive-facts').innerText";
    let hands = "document.querySelector('#hands').textContent";
    for (at, said, hand) in [
        (0.6, "30.0 % busy", "psm1 follows the policy"),
        (1.2, "40.0 % busy", "psm1 follows the hand"),
        (2.1, "60.0 % busy", "psm1 holds"),
    ] {
        browser.evaluate(&format!("(() => {{ const at = document.querySelector('#at'); at.value = {at}; at.dispatchEvent(new Event('input')); }})()"));
        browser.wait_until(&format!("{buses}.includes('{said}')"));
        browser.wait_until(&format!("{hands}.endsWith('{hand}')"));
    }
    browser.wait_until("document.querySelector('#driver').textContent === 'The operator drives.'");
    browser.wait_until("document.querySelector('#scale-out').textContent === '50 %'");
    let clutch = browser.evaluate("document.querySelector('#hold').checkVisibility()");
    assert_eq!(clutch, false);
    browser.wait_until(&format!("{buses}.includes('2 errors and drops')"));
    let scene = "document.querySelector('#scene-view').dataset";
    browser.wait_until(&format!("Math.abs(Number({scene}.seconds) - 2.1) < 0.1"));
    let colours = browser.evaluate(SCENE);
    assert!(colours[0].as_u64() > Some(300), "{colours}");
    browser.wait_until(&format!("Number({scene}.paths) > 1"));
    looks_right(&mut browser, "log-can");
    assert_eq!(browser.errors, Vec::<String>::new());
}

/// The page on a log has what the page on its run had: the scene, depth and ids, the criteria, and
/// where the chunks led.
fn looks_like_its_run(browser: &mut Browser, time: &str) {
    let scene = "document.querySelector('#scene-view').dataset";
    browser.wait_until(&format!("Math.abs(Number({scene}.seconds) - {time}) < 0.1"));
    let colours = browser.evaluate(SCENE);
    assert!(colours[0].as_u64() > Some(300), "{colours}");
    browser.wait_until(&format!("{PATH} > 1"));
    browser.wait_until(&format!("Number({scene}.paths) > 1"));
    browser.wait_until("document.querySelectorAll('#criteria-rows tr').length > 1");
    let view = "document.querySelector('.view:last-child')";
    for plane in ["ids", "off"] {
        browser.evaluate(&format!("(() => {{ const select = {view}.querySelector('select'); select.value = '{plane}'; select.dispatchEvent(new Event('change')); }})()"));
        browser.wait_until(&format!(
            "{view}.querySelector('.frame').hidden === {}",
            plane == "off"
        ));
    }
    for plane in ["depth", "ids", "colour"] {
        browser.evaluate(&format!("(() => {{ const select = document.querySelector('.view select'); select.value = '{plane}'; select.dispatchEvent(new Event('change')); }})()"));
        browser.wait_until(&format!(
            "document.querySelector('.view img').alt.includes('{plane}, at')"
        ));
    }
}
