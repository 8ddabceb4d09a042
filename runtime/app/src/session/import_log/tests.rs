//! Logs made by hand: the right frames, ticks and drivers, and what is refused.

mod hand_made;
mod refusals;

use hal::TipTarget;
use serde_json::json;
use trocar_control::OperatorEvent;
use trocar_control::kinematics::forward;
use trocar_data::dataset::{Dataset, Notes};
use trocar_log::{RunMark, RunNote};

use super::{LogImportSummary, import_logs};
use crate::session::scratch::Scratch;
use hand_made::{Feed, HandMade, colour_of, commanded, jittered, measured, options, target};

/// The stamp, ns, in `stamps` nearest to `at`, and which it is: by looking at all of them.
fn nearest(stamps: &[u64], at: f64) -> (usize, u64) {
    let all = stamps.iter().copied().enumerate();
    #[expect(clippy::cast_precision_loss, reason = "stamps of seconds")]
    let apart = |stamp: u64| (stamp as f64 - at).abs();
    all.min_by(|one, other| apart(one.1).total_cmp(&apart(other.1)))
        .unwrap()
}

/// Two arms, two cameras of 30 Hz with jitter, ENABLED at 0.2 s, asked at 0.3 s, by hand from 1.5 s
/// to 2.5 s, paused for the end at 4 s.
fn two_arms() -> HandMade {
    HandMade {
        arms: 2,
        ticks: 4500,
        cameras: vec![
            Feed::new("endoscope", jittered(30, 4500, 1)),
            Feed::new("wrist", jittered(30, 4500, 5)),
        ],
        events: vec![
            (1500, OperatorEvent::TakeOver),
            (2500, OperatorEvent::HandBack),
        ],
        ..HandMade::default()
    }
}

/// Every step of the dataset against a search through all stamps and the formulas by which the log
/// was made.
#[test]
fn each_step_has_the_nearest_frames_and_tick() {
    let folder = Scratch::folder("import-log-two-arms");
    let made = two_arms();
    let log = made.write(&folder.join("a.mcap"));
    let options = options(&folder, &[&log]);
    let summary = import_logs(&options, &mut |_, _| {}).unwrap();
    let dataset = Dataset::open(&options.out).unwrap();
    assert_eq!((dataset.arms(), dataset.fps()), (2, 25));
    assert_eq!(dataset.camera_names(), ["endoscope", "wrist"]);

    let stamps = |camera: usize| &made.cameras[camera].stamps_ns;
    let start = *stamps(0)
        .iter()
        .find(|stamp| **stamp >= 300_000_000)
        .unwrap();
    let mut by_hand = Vec::new();
    for frame in 0..dataset.len() {
        #[expect(clippy::cast_precision_loss, reason = "stamps of seconds")]
        let point = start as f64 + 40e6 * frame as f64;
        let (first, at) = nearest(stamps(0), point);
        #[expect(clippy::cast_precision_loss, reason = "stamps of seconds")]
        let (second, _) = nearest(stamps(1), at as f64);
        for (camera, place) in [first, second].into_iter().enumerate() {
            let seen = dataset.image_rgb(frame, camera).unwrap();
            assert_eq!(seen.get_pixel(3, 3).0, colour_of(camera, place), "{frame}");
        }
        let tick = (at + 500_000) / 1_000_000;
        by_hand.push((1500..2500).contains(&tick));
        for arm in 0..2 {
            let (position, jaw) = measured(arm, tick);
            #[expect(clippy::cast_possible_truncation, reason = "states are f32")]
            let expected: Vec<f32> = position.iter().chain([&jaw]).map(|it| *it as f32).collect();
            assert_eq!(
                dataset.state(frame, arm).to_vec(),
                expected,
                "{frame} {arm}"
            );
            let tip = TipTarget::new(&forward(&position), jaw).pose_numbers();
            assert_eq!(
                dataset.tip_pose(frame, arm).to_vec(),
                tip.to_vec(),
                "{frame} {arm}"
            );
            // The second arm is asked 40 ms later; until then it is where it is commanded to be.
            let expected = if arm == 1 && tick < 340 {
                commanded(arm, tick)
            } else {
                target(arm, tick)
            };
            assert_action(&dataset, frame, arm, &expected);
        }
    }
    // The last point before the pause at 4 s.
    let last = nearest(stamps(0), 4e9).1;
    let count = usize::try_from((last - start) / 40_000_000 + 1).unwrap();
    assert!(
        dataset.len().abs_diff(count) <= 1,
        "{} {count}",
        dataset.len()
    );
    assert_eq!(
        dataset.interventions(dataset.episodes()[0]).unwrap(),
        by_hand
    );
    let hand = by_hand.iter().filter(|it| **it).count();
    assert_eq!((dataset.len(), hand), (summary.frames, summary.by_hand));
    assert!((24..=26).contains(&hand), "{hand}");
}

/// Of a camera that lost one frame the step shows the one before or after; one whose clock drifts
/// by 1 % loses none.
#[test]
fn lost_frames_and_drift_are_tolerated() {
    for (name, period_us, lost) in [("lost", 40_000, 700_000_000), ("drift", 40_400, 0)] {
        let folder = Scratch::folder(&format!("import-log-{name}"));
        let stamps = (0..100).map(|frame| frame * period_us * 1000);
        let stamps: Vec<u64> = stamps.filter(|stamp| *stamp != lost).collect();
        let mut endoscope = Feed::new("endoscope", Vec::new());
        endoscope.stamps_ns = stamps.clone();
        let made = HandMade {
            ticks: 4000,
            cameras: vec![endoscope],
            ..HandMade::default()
        };
        let log = made.write(&folder.join("a.mcap"));
        let options = options(&folder, &[&log]);
        import_logs(&options, &mut |_, _| {}).unwrap();
        let dataset = Dataset::open(&options.out).unwrap();
        let start = *stamps.iter().find(|stamp| **stamp >= 300_000_000).unwrap();
        for frame in 0..dataset.len() {
            let seen = dataset.image_rgb(frame, 0).unwrap().get_pixel(3, 3).0;
            let near = stamps.iter().enumerate().filter(|(_, stamp)| {
                let point = start + 40_000_000 * u64::try_from(frame).unwrap();
                stamp.abs_diff(point) <= 40_000_000
            });
            let mut near = near.map(|(place, _)| colour_of(0, place));
            assert!(near.any(|colour| colour == seen), "{name} {frame}");
        }
        assert!(
            (79..=81).contains(&dataset.len()),
            "{name} {}",
            dataset.len()
        );
    }
}

fn assert_action(dataset: &Dataset, frame: usize, arm: usize, expected: &TipTarget) {
    let [x, y, z, i, j, k, w] = expected.pose_numbers();
    #[expect(clippy::cast_possible_truncation, reason = "actions are f32")]
    let expected = [x, y, z, i, j, k, w, expected.jaw].map(|value| f64::from(value as f32));
    assert_eq!(
        dataset.action(frame, arm).to_vec(),
        expected.to_vec(),
        "{frame} {arm}"
    );
}

#[test]
fn a_dataset_says_which_runs_it_is_of() {
    let folder = Scratch::folder("import-log-notes");
    let robot = HandMade::default().write(&folder.join("robot.mcap"));
    let failed = HandMade {
        task: "needle-lift",
        success: Some(false),
        ..HandMade::default()
    };
    let failed = failed.write(&folder.join("failed.mcap"));
    let mut options = options(&folder, &[&robot, &failed]);
    let summary = import_logs(&options, &mut |_, _| {}).unwrap();
    let expected = LogImportSummary {
        arms: 1,
        cameras: vec!["endoscope".to_owned()],
        episodes: 1,
        frames: summary.frames,
        by_hand: 0,
        left_out: 1,
        discarded: Vec::new(),
    };
    assert_eq!(summary, expected);
    let notes = Notes::read(&options.out).unwrap();
    let recording = notes.recording.unwrap();
    assert_eq!(
        (&recording["source"], recording.get("task")),
        (&"log".into(), None)
    );
    let expected = serde_json::json!({
        "episode_index": 0,
        "source": "log",
        "log": "robot.mcap",
        "policy": "runs/act",
        "policy_sha256": "5a",
        "commit": "c0ffee",
        "command_hash": "0123456789abcdef",
        "reason": "the 1 s are over",
    });
    assert_eq!(notes.episodes, [expected]);
    let dataset = Dataset::open(&options.out).unwrap();
    assert_eq!(dataset.spec().task, "Lift the needle");
    assert!(!dataset.spec().intervention);

    options.out = folder.join("both");
    options.failures = true;
    let summary = import_logs(&options, &mut |_, _| {}).unwrap();
    assert_eq!((summary.episodes, summary.left_out), (2, 0));
    let notes = Notes::read(&options.out).unwrap();
    let note = &notes.episodes[1];
    assert_eq!(
        (&note["success"], &note["task"]),
        (&false.into(), &"needle-lift".into())
    );
}

/// A person's word is the episode's: failures are left out unless they are asked for, what was
/// discarded always is, by name.
#[test]
fn runs_are_taken_as_their_operator_marked_them() {
    let folder = Scratch::folder("import-log-marked");
    let marked = |name: &str, mark: Option<RunMark>, label: &str| {
        let said = RunNote {
            mark,
            label: label.to_owned(),
        };
        let made = HandMade {
            said,
            ..HandMade::default()
        };
        made.write(&folder.join(name))
    };
    let good = marked("good.mcap", Some(RunMark::Success), "third try");
    let bad = marked("bad.mcap", Some(RunMark::Failure), "");
    let useless = marked("useless.mcap", Some(RunMark::Discard), "camera fell");
    let unmarked = marked("unmarked.mcap", None, "as it was");
    let mut options = options(&folder, &[&useless, &good, &bad, &unmarked]);
    let summary = import_logs(&options, &mut |_, _| {}).unwrap();
    assert_eq!((summary.episodes, summary.left_out), (2, 1));
    assert_eq!(summary.discarded, [useless.as_path()]);
    let said = |index: usize| {
        let note = Notes::read(&options.out).unwrap().episodes.remove(index);
        let of = |key: &str| note[key].clone();
        json!([of("log"), of("success"), of("ended_by"), of("label")])
    };
    let (good, unmarked) = (said(0), said(1));
    assert_eq!(good, json!(["good.mcap", true, "operator", "third try"]));
    assert_eq!(unmarked, json!(["unmarked.mcap", null, null, "as it was"]));

    options.out = folder.join("all");
    options.failures = true;
    let summary = import_logs(&options, &mut |_, _| {}).unwrap();
    assert_eq!((summary.episodes, summary.left_out), (3, 0));
    assert_eq!(summary.discarded, [useless.as_path()]);
    let note = Notes::read(&options.out).unwrap().episodes.remove(1);
    assert_eq!(note["success"], false);
    assert!(note["label"].is_null());

    (options.out, options.logs) = (folder.join("none"), vec![useless]);
    let error = import_logs(&options, &mut |_, _| {}).unwrap_err();
    assert!(error.is_bad_input(), "{error}");
    assert!(
        error.to_string().contains("discarded all of the 1 runs"),
        "{error}"
    );
    assert!(!options.out.exists());
}

/// Who drove is the episode's source, and what is known of the hands is there as the run counted
/// it.
#[test]
fn an_episode_by_hand_says_so() {
    let folder = Scratch::folder("import-log-by-hand");
    let text = r#"{"hand_to_command_ms":{"p50":9.5,"p99":21.0},"device":"headset","scale":0.4}"#;
    let made = |name: &str, policy, teleop| {
        let made = HandMade {
            policy,
            teleop,
            ..HandMade::default()
        };
        made.write(&folder.join(name))
    };
    let logs = [
        made("hands.mcap", "teleop", Some(text)),
        made("taken.mcap", "runs/act", Some(text)),
        // Logs of before do not say what hands did.
        made("before.mcap", "teleop", None),
    ];
    let options = options(&folder, &[&logs[0], &logs[1], &logs[2]]);
    import_logs(&options, &mut |_, _| {}).unwrap();
    let notes = Notes::read(&options.out).unwrap().episodes;
    let said = notes
        .iter()
        .map(|note| json!([note["source"], note["teleop"]]));
    let hands: serde_json::Value = serde_json::from_str(text).unwrap();
    assert_eq!(
        said.collect::<Vec<_>>(),
        [
            json!(["teleop", hands]),
            json!(["intervention", hands]),
            json!(["log", null])
        ]
    );
}

/// Of two sizes --resize makes one, and images of the chosen cameras alone are there, in the order
/// that was asked for.
#[test]
fn cameras_are_chosen_and_resized() {
    let folder = Scratch::folder("import-log-chosen");
    let cameras = ["left", "wrist", "right"].map(|name| Feed::new(name, jittered(30, 1200, 0)));
    let made = HandMade {
        cameras: cameras.into(),
        ..HandMade::default()
    };
    let one = made.write(&folder.join("one.mcap"));
    let mut larger = made;
    larger
        .cameras
        .iter_mut()
        .for_each(|camera| camera.side = 16);
    larger.cameras.swap(0, 2);
    let other = larger.write(&folder.join("other.mcap"));
    let mut options = options(&folder, &[&one, &other]);
    options.cameras = vec!["right".to_owned(), "left".to_owned()];
    options.size = Some((12, 10));
    let summary = import_logs(&options, &mut |_, _| {}).unwrap();
    assert_eq!(summary.cameras, ["right", "left"]);
    let dataset = Dataset::open(&options.out).unwrap();
    assert_eq!(dataset.image_rgb(0, 0).unwrap().dimensions(), (12, 10));
    // `right` was the third camera of the first log, and the first of the other.
    let episodes = dataset.episodes();
    let camera_of = |frame| dataset.image_rgb(frame, 0).unwrap().get_pixel(0, 0).0[2];
    assert_eq!(
        episodes
            .iter()
            .map(|it| camera_of(it.start))
            .collect::<Vec<_>>(),
        [2, 0]
    );
}
