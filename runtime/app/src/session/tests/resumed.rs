//! Recordings that are resumed: what they come to, and with which options they are not.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

use trocar_tasks::task::{Variation, View};

use super::disturbed::{options, small_lift};
use super::*;
use crate::session::SessionError;
use crate::session::record::{Attempt, RecordSummary};
use crate::session::scene_options::SceneOptions;

/// Every file below `dir` by its name there.
pub(super) fn files(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![dir.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(dir).unwrap().to_owned();
                found.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    found
}

/// Records until `kept` episodes were kept by this call, then stops.
fn record_some(plan: &Plan, options: &RecordOptions, kept: usize) -> RecordSummary {
    let stop = AtomicBool::new(kept == 0);
    let mut now = 0;
    let mut on_attempt = |attempt: &Attempt| {
        now += usize::from(attempt.kept);
        stop.store(now >= kept, Ordering::Release);
    };
    record(
        plan,
        options,
        &|| stop.load(Ordering::Acquire),
        &mut on_attempt,
    )
    .unwrap()
}

/// An interrupted recording comes to the same as one without a break.
#[test]
fn resumed_recording_equals_an_unbroken_one() {
    let folder = Scratch::new("session-resumed");
    let plan = small_lift(&[Variation::Light]);
    let whole = RecordOptions {
        episodes: 3,
        ..options(&folder.0.join("whole"), Some(1.0))
    };
    let summary = record(&plan, &whole, &|| false, &mut |_| {}).unwrap();
    assert!(!summary.interrupted && summary.episodes_before == 0);

    let mut cut = RecordOptions {
        out: folder.0.join("cut"),
        ..whole.clone()
    };
    let mut before = 0;
    let mut last = None;
    // Stopped at once, then after each episode.
    for kept in [0, 1, 1, 1] {
        let summary = record_some(&plan, &cut, kept);
        assert_eq!(summary.episodes_before, before);
        assert_eq!(summary.interrupted, summary.episodes < 3);
        before = summary.episodes;
        cut.resume = true;
        last = Some(summary);
        if before == 3 {
            break;
        }
    }
    let last = last.unwrap();
    assert_eq!((last.episodes, last.steps), (3, summary.steps));
    let (cut_files, whole_files) = (files(&cut.out), files(&whole.out));
    assert!(cut_files.keys().eq(whole_files.keys()));
    for (name, bytes) in &whole_files {
        assert!(cut_files[name] == *bytes, "{} differs", name.display());
    }
    // Enough are there.
    let again = record(&plan, &cut, &|| false, &mut |_| {}).unwrap();
    assert_eq!((again.episodes, again.episodes_before), (3, 3));
    assert!(again.attempts.is_empty() && !again.interrupted);
    assert!(files(&cut.out) == whole_files, "nothing is touched");
}

/// Why `options` can't go on.
fn refused(plan: &Plan, options: &RecordOptions) -> String {
    let error = record(plan, options, &|| false, &mut |_| {}).unwrap_err();
    assert!(matches!(error, SessionError::BadArgument(_)), "{error:?}");
    error.to_string()
}

#[test]
fn a_recording_goes_on_with_its_own_options_only() {
    let folder = Scratch::new("session-other-options");
    let plan = small_lift(&[]);
    let made = RecordOptions {
        episodes: 1,
        resume: true,
        ..options(&folder.0, None)
    };
    let first = RecordOptions {
        resume: false,
        ..made.clone()
    };
    record(&plan, &first, &|| false, &mut |_| {}).unwrap();
    let message = refused(&plan, &first);
    assert!(
        message.contains("not an empty folder") && message.contains("--resume appends to"),
        "{message}"
    );
    let before = files(&folder.0);
    let other = |change: &dyn Fn(&mut RecordOptions), expected: &str| {
        let mut options = RecordOptions {
            episodes: 2,
            ..made.clone()
        };
        change(&mut options);
        let message = refused(&plan, &options);
        assert!(
            message.ends_with(&format!("{expected} is asked for")),
            "{message}"
        );
    };
    let reseeded = Plan {
        seed: 7,
        ..plan.clone()
    };
    let more = RecordOptions {
        episodes: 2,
        ..made.clone()
    };
    let message = refused(&reseeded, &more);
    assert!(
        message.ends_with("was recorded with --seed 40, now 7 is asked for"),
        "{message}"
    );
    other(&|it| it.depth = true, "--depth off, now on");
    other(&|it| it.disturb = Some(0.5), "--disturb none, now 0.5");
    other(
        &|it| it.instruction = Some("Lift".to_owned()),
        "--instruction none, now Lift",
    );
    let video = trocar_data::dataset::VideoCodec::H264;
    other(&|it| it.video = Some(video), "--video none, now h264");
    scenes_that_are_refused(&made);
    assert!(files(&folder.0) == before, "nothing is touched");
}

/// What of the scene must be as it was.
fn scenes_that_are_refused(made: &RecordOptions) {
    let seen = |scene: SceneOptions, expected: &str| {
        let mut plan = small_lift(&[]);
        plan.setup = plan.setup.with_scene(&scene).unwrap();
        let message = refused(&plan, made);
        assert!(message.contains(expected), "{message}");
    };
    let of = SceneOptions::default;
    seen(
        SceneOptions {
            view: View::View1,
            ..of()
        },
        "--view train, now view1",
    );
    seen(
        SceneOptions {
            needle: Some("N3".to_owned()),
            ..of()
        },
        "--needle N1, now N3",
    );
    seen(
        SceneOptions {
            varied: vec![Variation::Light],
            ..of()
        },
        "--vary none, now light",
    );
    let cameras = crate::session::scene_options::CameraSet::Multi;
    seen(
        SceneOptions {
            cameras: Some(cameras),
            ..of()
        },
        "--cameras endoscope, now endoscope,wrist",
    );
    let mut changed = small_lift(&[]);
    changed.setup.robot.texts.safety.push('#');
    let message = refused(&changed, made);
    assert!(
        message.contains("was recorded with another safety.toml"),
        "{message}"
    );
}

/// A dataset that does not say how it was made is not resumed.
#[test]
fn dataset_without_its_options_is_not_resumed() {
    let folder = Scratch::new("session-silent");
    let plan = small_lift(&[]);
    let made = RecordOptions {
        episodes: 1,
        ..options(&folder.0, None)
    };
    let more = RecordOptions {
        episodes: 2,
        resume: true,
        ..made.clone()
    };
    let message = refused(&plan, &more);
    assert!(message.contains("holds no dataset"), "{message}");
    record(&plan, &made, &|| false, &mut |_| {}).unwrap();
    let notes = folder.0.join("meta/trocar_episodes.jsonl");
    let options = folder.0.join("meta/trocar_recording.json");
    let line = fs::read_to_string(&notes).unwrap();
    for (text, expected) in [
        (line.replace("\"seed\"", "\"sown\""), "lacks the seed"),
        (
            line.replace("\"episode_index\":0", "\"episode_index\":1"),
            "one line for each",
        ),
        (String::new(), "one line for each"),
    ] {
        fs::write(&notes, text).unwrap();
        let message = refused(&plan, &more);
        assert!(
            message.contains("does not say how it was recorded") && message.contains(expected),
            "{message}"
        );
    }
    fs::write(&notes, line).unwrap();
    fs::remove_file(&options).unwrap();
    let message = refused(&plan, &more);
    assert!(
        message.contains("trocar_recording.json is missing"),
        "{message}"
    );
}
