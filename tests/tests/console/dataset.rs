//! The console on a dataset: every episode can be looked through.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json};
use tests::{json as read_json, scratch, stderr, trocar};
use trocar_data::dataset::Dataset;

use crate::browser::{SCENE, looks_right};
use crate::devtools::Browser;
use crate::page::Page;
use crate::run::{PLAIN, Served};

/// Two demonstrations of `task` by the expert, with depth, in the scratch folder of `test`.
fn recorded(test: &str, task: &str) -> PathBuf {
    let data = scratch(test).join("data");
    let words = ["record", "--task", task, "--episodes", "2", "--seed", "7"];
    let output = trocar()
        .args(words)
        .args(["--set", PLAIN, "--depth", "--out"])
        .arg(&data)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    data
}

/// What the page is told at a place of the episode that it has opened.
fn frame_at(page: &mut Page, seconds: f64) -> Value {
    page.say(&json!({ "at": seconds }));
    page.wait_for("frame", |_| true)
}

fn numbers(value: &Value) -> Vec<f64> {
    let numbers = value.as_array().unwrap().iter();
    numbers.map(|number| number.as_f64().unwrap()).collect()
}

/// Each frame of each episode is what the dataset's own reader says, and its image that of the
/// frame; what is damaged or is not there is said.
#[test]
fn all_episodes_of_a_dataset_are_looked_through() {
    let data = recorded("console-dataset-made", "needle-lift");
    let read = Dataset::open(&data).unwrap();
    let mut served = Served::start("console-dataset", &["replay", data.to_str().unwrap()]);
    looks_at_its_scene(&served);
    let mut page = Page::open(&served);
    let facts = page.wait_for("facts", |_| true);
    assert_eq!(
        (&facts["subject"], &facts["log"]),
        (&json!("dataset"), &json!(true))
    );
    assert_eq!(facts["title"], "needle-lift");
    let episodes = facts["episodes"].as_array().unwrap();
    assert_eq!(episodes.len(), 2);
    let depth = facts["depth"].as_array().unwrap();
    assert_eq!(depth.len(), read.camera_names().len());
    page.say(&json!({ "show": [[0, "colour"], [0, "ids"]] }));
    for (index, told) in episodes.iter().enumerate() {
        let episode = read.episodes()[index];
        assert_eq!(told["frames"], episode.len);
        assert_eq!(told["note"]["episode_index"], index);
        page.say(&json!({ "open": index }));
        for frame in [0, episode.len / 2, episode.len - 1] {
            let told = frame_at(
                &mut page,
                f64::from(u32::try_from(frame).unwrap()) / f64::from(read.fps()),
            );
            assert_eq!(
                (&told["episode"], &told["frame"]),
                (&json!(index), &json!(frame))
            );
            shows(&told["arms"][0], &read, episode.start + frame);
            leads(&told["paths"][0], episode.len - 1 - frame);
            for plane in [0, 2] {
                let picture = page.wait_for_picture();
                assert_eq!(picture[..2], [0, plane]);
                looks_like(&picture[16..], plane, &read, episode.start + frame);
            }
        }
        for beyond in [-3.0, 1e300] {
            let told = frame_at(&mut page, beyond);
            let last = if beyond > 0.0 { episode.len - 1 } else { 0 };
            assert_eq!(told["frame"], last, "{beyond}");
        }
    }
    page.say(&json!({ "open": 2 }));
    let problem = page.wait_for("problem", |_| true);
    assert_eq!(problem["text"], "episode 2: there are 2");
    let (ok, said) = page.command("pause");
    assert!(!ok, "{said}");
    let id = served.process.id().to_string();
    let killed = Command::new("kill").args(["-INT", &id]).status().unwrap();
    assert!(killed.success());
    page.wait_for("end", |_| true);
    assert_eq!(served.code(), 0);
    let result = read_json(&served.folder.join("result.json"));
    let expected = json!({ "task": "needle-lift", "episodes": 2, "frames": read.len() });
    assert_eq!(result, expected);
}

/// Ground, cameras and limits are those of the task, the instrument is where it was measured in
/// each frame, and the needle is not there: where it was is not in the dataset.
fn looks_at_its_scene(served: &Served) {
    let mut page = Page::open(served);
    // The scene is there once a page is told of it.
    let facts = page.wait_for("facts", |_| true);
    assert_eq!(facts["scene"], true);
    let (host, cookie) = (served.host(), served.cookie());
    let headers = [("Host", host.as_str()), ("Cookie", cookie.as_str())];
    let scene = served.get("/scene.glb", &headers);
    for (part, is_there) in [
        ("organ", true),
        ("left finger", true),
        ("endoscope", true),
        ("psm1", true),
        ("needle", false),
    ] {
        let named = format!("\"name\":\"{part}\"");
        assert_eq!(scene.contains(&named), is_there, "{part}");
    }
    page.say(&json!({ "open": 0 }));
    page.say(&json!({ "show": [[255, "colour"]] }));
    let places = [0.0, 1.0].map(|at| {
        page.say(&json!({ "at": at }));
        let places = page.wait_for_picture();
        let stamp = f64::from_le_bytes(places[8..16].try_into().unwrap());
        assert!(places[0] == 255 && (stamp - at).abs() < 1e-9, "{stamp}");
        places
    });
    assert_ne!(places[0][16..], places[1][16..], "the arm moved");
}

/// A path shows this frame's action and the `left` after it, a second's at most, in the picture
/// too.
fn leads(path: &Value, left: usize) {
    let points = path["points"].as_array().unwrap().len();
    assert_eq!(points, thinned(left.min(25) + 1), "{path}");
    let seen = path["pictures"]["0"].as_array().unwrap();
    assert_eq!(seen.len(), points, "{path}");
    let within = |part: &Value| (0.0..1.0).contains(&part.as_f64().unwrap());
    assert!(
        seen.iter()
            .flat_map(|at| at.as_array().unwrap())
            .all(within),
        "{path}"
    );
}

/// How many points are shown of so many: 24 at most, as far apart as one another.
const fn thinned(count: usize) -> usize {
    count.div_ceil(count.div_ceil(24))
}

/// The numbers of an arm are those of the frame.
fn shows(arm: &Value, read: &Dataset, frame: usize) {
    let state = read.state(frame, 0).map(f64::from);
    assert_eq!(numbers(&arm["measured"]), state);
    assert_eq!(numbers(&arm["tip"]), read.tip_pose(frame, 0));
    let action = read.action(frame, 0);
    assert_eq!(numbers(&arm["action"]), action);
    // The expert asks for what the arm can do, and not far from where it is.
    let wanted = numbers(&arm["wanted"]);
    assert!((wanted[6] - action[7]).abs() < 1e-12);
    for (wanted, measured) in wanted.iter().zip(state).take(6) {
        assert!((wanted - measured).abs() < 0.35, "{wanted} {measured}");
    }
}

/// A JPEG or PNG is that of a frame: as large, and its colours are close.
fn looks_like(bytes: &[u8], plane: u8, read: &Dataset, frame: usize) {
    let shown = image::load_from_memory(bytes).unwrap().into_rgb8();
    let colour = read.image_rgb(frame, 0).unwrap();
    assert_eq!(shown.dimensions(), colour.dimensions());
    if plane == 0 {
        let pairs = shown.iter().zip(colour.iter());
        let off: u64 = pairs.map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        assert!(off < 6 * shown.len() as u64, "{off}");
        return;
    }
    let instance = read.depth(frame, 0).unwrap().instance;
    let black = |rgb: &image::Rgb<u8>| rgb.0 == [0; 3];
    for (pixel, id) in shown.pixels().zip(instance) {
        assert_eq!(black(pixel), id == 0);
    }
}

#[test]
fn a_folder_without_a_dataset_is_refused() {
    let folder = scratch("console-dataset-none");
    for (words, reason) in [
        (&[][..], "meta/info.json"),
        (&["--console", "127.0.0.1:0"], "meta/info.json"),
        (&["--foxglove", "127.0.0.1:0"], "has no --foxglove"),
    ] {
        let output = trocar()
            .arg("replay")
            .arg(&folder)
            .args(words)
            .output()
            .unwrap();
        let said = stderr(&output);
        assert!(
            !output.status.success() && said.contains(reason),
            "{words:?}: {said}"
        );
    }
}

/// The page goes from episode to episode, frame by frame, and shows colour, depth and ids, joints,
/// tips and actions.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn the_page_shows_a_dataset() {
    let data = recorded("console-browser-dataset-made", "needle-handover");
    let served = Served::start(
        "console-browser-dataset",
        &["replay", data.to_str().unwrap()],
    );
    let mut browser = Browser::open("console-browser-dataset-profile", &served.url());
    browser.look(1280, "light");
    looks_through(&mut browser, &Dataset::open(&data).unwrap());
    looks_right(&mut browser, "dataset");
    browser.screenshot(Path::new(
        &scratch("console-browser-dataset-pictures").join("page.png"),
    ));
    assert_eq!(browser.errors, Vec::<String>::new());
}

fn looks_through(browser: &mut Browser, read: &Dataset) {
    let picture = "document.querySelector('.view img')";
    browser.wait_until("document.querySelectorAll('#chosen option').length === 2");
    browser.wait_until(&format!("{picture}.naturalWidth > 16"));
    let scene = "document.querySelector('#scene-view').dataset";
    browser.wait_until(&format!(
        "Number({scene}.paths) > 5 && {scene}.seconds === '0.000'"
    ));
    let colours = browser.evaluate(SCENE);
    assert!(colours[0].as_u64() > Some(300), "{colours}");
    browser.wait_until(
        "document.querySelector('.view .path .arm0').getAttribute('points').split(' ').length > 5",
    );
    let name = "document.querySelector('#path-name').textContent";
    assert_eq!(browser.evaluate(name), "Path of the actions, 1 s");
    assert_eq!(
        browser.evaluate("document.querySelector('#steering').hidden"),
        true
    );
    assert_eq!(
        browser.evaluate("document.querySelectorAll('#actions table').length"),
        2
    );
    let noted = "document.querySelector('#noted').textContent";
    let frames = |index: usize| format!("{noted}.includes('{} at ')", read.episodes()[index].len);
    browser.wait_until(&frames(0));
    browser.press("]");
    browser.wait_until("document.querySelector('#chosen').value === '1'");
    browser.wait_until(&frames(1));
    // Frame by frame: each has an image of its own.
    let stamp = format!("Number({picture}.dataset.seconds)");
    let step = 1.0 / f64::from(read.fps());
    for frame in 1..4 {
        browser.press("ArrowRight");
        let at = step * f64::from(frame);
        browser.wait_until(&format!("Math.abs({stamp} - {at}) < 0.002"));
        browser.wait_until(&format!("Math.abs({scene}.seconds - {at}) < 0.002"));
    }
    let cell = "document.querySelector('#actions tbody tr td').textContent";
    let tip = read.tip_pose(read.episodes()[1].start + 3, 0)[0] * 1e3;
    browser.wait_until(&format!("{cell} === '{tip:.1} mm'"));
    browser.evaluate("(() => { const at = document.querySelector('#at'); at.value = at.max; at.dispatchEvent(new Event('input')); })()");
    let last = read.episodes()[1].len - 1;
    browser.wait_until(&format!(
        "document.querySelector('#at').getAttribute('aria-valuetext') === 'frame {last} of {}'",
        last + 1
    ));
    // Another plane of the very frame that is shown, and back.
    for plane in ["depth", "ids", "colour"] {
        browser.evaluate(&format!("(() => {{ const select = document.querySelector('.view select'); select.value = '{plane}'; select.dispatchEvent(new Event('change')); }})()"));
        browser.wait_until(&format!("{picture}.alt.includes('{plane}, at')"));
    }
    browser.evaluate("document.querySelector('#previous').click()");
    browser.wait_until(&format!(
        "{} && parseFloat(document.querySelector('#time').textContent) === 0",
        frames(0)
    ));
    browser.evaluate("document.querySelector('#play').click()");
    browser.wait_until(&format!("{stamp} > 0.5"));
}
