//! Devices at the desk and in the headset, in the browser: a mouse that drags the tip, a
//! SpaceMouse, and two eyes.

use std::time::Duration;

use nalgebra::{Quaternion, UnitQuaternion};
use serde_json::{Value, json};
use trocar::rt::sleep_ns;
use trocar::session::{Plan, PolicyChoice};

use crate::devtools::Browser;
use crate::lift::{SLOW_MOTION, operated};
use crate::run::{PATIENCE, Served};

/// A run of needle lift by hand.
fn by_hand(test: &str, more: &[&str]) -> Served {
    let words = "run --task needle-lift --policy teleop --seed 7";
    let words: Vec<&str> = words.split(' ').chain(more.iter().copied()).collect();
    Served::start_slow(test, &words, SLOW_MOTION)
}

/// Where the tip is commanded to be, in the picture's axes: position, m, and rotation.
#[derive(Clone, Copy)]
pub(crate) struct Tip(pub(crate) [f64; 3], UnitQuaternion<f64>);

impl Tip {
    fn now(browser: &mut Browser) -> Self {
        let told = browser.evaluate("told.teleop.arms[0].tip");
        let [x, y, z, a, b, c, w] = std::array::from_fn(|place| told[place].as_f64().unwrap());
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, a, b, c));
        Self([x, y, z], turn)
    }

    /// Once it rests.
    pub(crate) fn rested(browser: &mut Browser) -> Self {
        let mut before = Self::now(browser);
        loop {
            // A page that is busy may not have been told anything new for a while.
            browser.evaluate("window.looked = told.seconds, true");
            browser.wait_until("told.seconds > looked + 0.15");
            let now = Self::now(browser);
            if before.way(&now).iter().all(|way| way.abs() < 2e-6)
                && before.1.angle_to(&now.1) < 1e-4
            {
                return now;
            }
            before = now;
        }
    }

    /// From here to there, m.
    pub(crate) fn way(&self, there: &Self) -> [f64; 3] {
        std::array::from_fn(|axis| there.0[axis] - self.0[axis])
    }

    /// Position, m, and rotation as a quaternion x, y, z, w.
    pub(crate) fn numbers(&self) -> [f64; 7] {
        let ([x, y, z], q) = (self.0, self.1.coords);
        [x, y, z, q.x, q.y, q.z, q.w]
    }

    /// The turn from here to there in the picture's axes, rad.
    pub(crate) fn turn(&self, there: &Self) -> [f64; 3] {
        (there.1 * self.1.inverse()).scaled_axis().into()
    }
}

pub(crate) fn near(found: [f64; 3], wanted: [f64; 3], within: f64) {
    let fits = found
        .iter()
        .zip(wanted)
        .all(|(found, wanted)| (found - wanted).abs() < within);
    assert!(
        fits,
        "{found:?} where {wanted:?} is wanted, within {within}"
    );
}

/// A pointer on the picture.
struct Pointer {
    at: [f64; 2],
    /// Of the picture, pixels.
    width: f64,
    modifiers: u8,
}

impl Pointer {
    fn over_the_picture(browser: &mut Browser) -> Self {
        let rect = browser.evaluate(
            "(() => { const image = document.querySelector('.view img'); image.scrollIntoView({ block: 'center' });
            const { x, y, width, height } = image.getBoundingClientRect(); return [x + width / 2, y + height / 2, width]; })()",
        );
        let [x, y, width] = std::array::from_fn(|place| rect[place].as_f64().unwrap());
        Self {
            at: [x, y],
            width,
            modifiers: 0,
        }
    }

    fn tell(&self, browser: &mut Browser, kind: &str, more: &Value) {
        let held = u8::from(kind != "mouseReleased");
        let mut event = json!({
            "type": kind, "x": self.at[0], "y": self.at[1], "modifiers": self.modifiers,
            "button": "left", "buttons": held, "clickCount": 1,
        });
        let fields = more.as_object().into_iter().flatten();
        for (name, value) in fields {
            event[name] = value.clone();
        }
        browser.call("Input.dispatchMouseEvent", &event);
    }

    /// Takes hold of the arm, once more when a busy machine let go of it at once: its hand came
    /// late.
    fn take_hold(&self, browser: &mut Browser) {
        let engaged = "told.teleop.arms[0].engaged";
        for _ in 0..5 {
            self.tell(browser, "mousePressed", &Value::Null);
            if browser.comes_true(engaged, Duration::from_secs(5)) {
                return;
            }
            self.tell(browser, "mouseReleased", &Value::Null);
        }
        browser.wait_until(engaged);
    }

    /// Moves by pixels to the right and down.
    fn go(&mut self, browser: &mut Browser, by: [f64; 2]) {
        for _ in 0..10 {
            self.at = [self.at[0] + by[0] / 10.0, self.at[1] + by[1] / 10.0];
            self.tell(browser, "mouseMoved", &Value::Null);
        }
    }
}

/// What is dragged stays under the pointer, the wheel pushes it away, with Shift it turns; it holds
/// on release, wherever the pointer goes.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn a_mouse_drags_the_tip() {
    let _turn = tests::alone();
    let served = by_hand("teleop-mouse", &[]);
    let mut browser = operated("teleop-mouse", &served, "mouse");
    let plan = Plan::load("needle-lift", PolicyChoice::Teleop).unwrap();
    let lens = plan.setup.task.cameras[0].intrinsics();
    let wide = f64::from(lens.width) / lens.fx;

    let start = Tip::rested(&mut browser);
    let mut pointer = Pointer::over_the_picture(&mut browser);
    pointer.take_hold(&mut browser);
    pointer.go(&mut browser, [30.0, -40.0]);
    let dragged = Tip::rested(&mut browser);
    // At its depth a pixel of the picture is so many metres.
    let pixel = wide * -start.0[2] / pointer.width;
    near(start.way(&dragged), [30.0 * pixel, 40.0 * pixel, 0.0], 6e-4);

    for _ in 0..2 {
        pointer.tell(
            &mut browser,
            "mouseWheel",
            &json!({ "deltaX": 0, "deltaY": -50 }),
        );
    }
    let away = Tip::rested(&mut browser);
    // 5 mm of the hand each, at a scale of 0.4.
    near(dragged.way(&away), [0.0, 0.0, -0.004], 6e-4);

    pointer.modifiers = 8;
    pointer.go(&mut browser, [40.0, 0.0]);
    let turned = Tip::rested(&mut browser);
    near(
        away.turn(&turned),
        [0.0, 3.0 * 40.0 / pointer.width, 0.0],
        0.03,
    );
    near(away.way(&turned), [0.0; 3], 6e-4);

    pointer.modifiers = 0;
    pointer.tell(&mut browser, "mouseReleased", &Value::Null);
    browser.wait_until("!told.teleop.arms[0].engaged");
    pointer.go(&mut browser, [-60.0, 60.0]);
    near(turned.way(&Tip::rested(&mut browser)), [0.0; 3], 6e-4);
    assert_eq!(browser.errors, Vec::<String>::new());
}

/// A cap that is pushed moves the tip that way and turns it that way, with its first button alone;
/// the second closes the jaw. One that is unplugged in mid-motion lets go.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn a_spacemouse_moves_the_tip() {
    let _turn = tests::alone();
    let served = by_hand("teleop-spacemouse", &[]);
    let mut browser = operated("teleop-spacemouse", &served, "spacemouse");
    browser.wait_until("!document.querySelector('#connect-cap').hidden");
    browser.evaluate("document.querySelector('#connect-cap').click()");
    browser.wait_until("document.querySelector('#device').textContent.includes('SpaceMouse')");
    let start = Tip::rested(&mut browser);
    // Without its button it moves nothing.
    browser.evaluate("operator.push([0, 1, 0]), new Promise((done) => setTimeout(done, 500))");
    near(start.way(&Tip::rested(&mut browser)), [0.0; 3], 1e-5);
    let y = start.0[1];
    browser.evaluate(&format!(
        "operator.until([0, 1, 0], [0, 0, 0], () => told.teleop.arms[0].tip[1] > {y} + 0.004), true"
    ));
    browser.wait_until("operator.there");
    let risen = Tip::rested(&mut browser);
    let [x, up, z] = start.way(&risen);
    assert!(up > 0.004 && x.hypot(z) < 0.1 * up, "{x} {up} {z}");
    browser.evaluate("operator.hold(false), operator.push([1, 0, 0]), true");
    browser.wait_until("!told.teleop.arms[0].engaged");
    near(risen.way(&Tip::rested(&mut browser)), [0.0; 3], 5e-4);

    browser.evaluate("operator.hands.combined = true, window.turned = false, operator.until([0, 0, 0], [0, 0, 1], () => window.turned), true");
    let mut rounds = PATIENCE.as_millis() / 20;
    while risen.turn(&Tip::now(&mut browser))[2] < 0.12 {
        assert!(rounds > 0, "it does not turn");
        rounds -= 1;
        sleep_ns(20_000_000);
    }
    browser.evaluate("window.turned = true");
    browser.wait_until("operator.there");
    let [x, y, roll] = risen.turn(&Tip::rested(&mut browser));
    assert!(roll > 0.1 && x.hypot(y) < 0.2 * roll, "{x} {y} {roll}");
    let jaw = "told.teleop.arms[0].jaw";
    let open = browser.evaluate(&format!("{jaw} < 0.5")) == true;
    browser.evaluate("operator.take(), true");
    browser.wait_until("told.teleop.arms[0].engaged");
    browser.evaluate("operator.hands.second(), true");
    browser.wait_until(&format!("{jaw} {}", if open { "> 0.95" } else { "< 0.05" }));

    browser.evaluate("operator.move([1, 0, 0]), true");
    browser.wait_until("operator.moves");
    browser.evaluate("operator.hands.unplug(), true");
    browser.wait_until("!told.teleop.arms[0].engaged");
    browser.wait_until("told.arms[0].commanded_velocity.every((v) => Math.abs(v) < 1e-4)");
    browser.wait_until("!document.querySelector('#device').textContent.includes('SpaceMouse')");
    assert_eq!(browser.errors, Vec::<String>::new());
}

/// A headset tells of its hands in each frame of 90 Hz, and no more often at 144 Hz.
fn bounds_its_messages(browser: &mut Browser) {
    for (hz, told_hz) in [(72.0_f64, 72.0), (90.0, 90.0), (144.0, 91.0)] {
        browser.evaluate(&format!(
            "operator.eyes = false, operator.hz = {hz}, operator.looked(4)"
        ));
        browser.evaluate("window.before = { handsTold, looks }, operator.looked(90)");
        let share = browser.evaluate("(handsTold - before.handsTold) / (looks - before.looks)");
        let found_hz = share.as_f64().unwrap() * hz;
        assert!((found_hz - told_hz).abs() < 4.0, "{hz}: {found_hz}");
    }
}

/// With two eyes the headset shows each its own picture, with one the same to both. That a picture
/// is shown is told from within its frames alone.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn a_headset_has_two_eyes() {
    let _turn = tests::alone();
    for (test, more, differ) in [
        ("teleop-stereo", &["--stereo"][..], true),
        ("teleop-mono", &[], false),
    ] {
        let served = by_hand(test, more);
        let mut browser = operated(test, &served, "headset");
        browser.wait_until("!document.querySelector('#enter-vr').hidden");
        browser.evaluate("operator.eyes = true, document.querySelector('#enter-vr').click()");
        // Share of the pixels that one eye sees otherwise than the other, and of those that are not
        // black.
        browser.wait_until("operator.seen?.[1] > 0.2");
        if differ {
            browser.wait_until("operator.seen[0] > 0.05 && operator.seen[0] < 0.9");
        } else {
            assert_eq!(browser.evaluate("operator.seen[0]"), 0);
        }
        browser.wait_until("shown.headset > 0");
        browser.evaluate("window.before = { ...shown }, true");
        browser.wait_until("shown.headset > before.headset + 2");
        assert_eq!(browser.evaluate("shown.page === before.page"), true);
        browser.wait_until("told.teleop.camera_to_page_ms?.p50 > 0");
        assert_eq!(
            browser.evaluate("document.querySelector('#mono').hidden"),
            differ
        );
        bounds_its_messages(&mut browser);
        assert_eq!(browser.errors, Vec::<String>::new());
    }
}
