//! A recording that is killed leaves every finished episode, and nothing that looks like one but
//! isn't; it can be resumed.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use tests::{json, repository, scratch, stderr, trocar};
use trocar::rt::interrupt_process;
use trocar_data::dataset::Dataset;

/// Episodes that the dataset's commit record counts; none while it is not there.
fn committed(dir: &Path) -> u64 {
    let info = std::fs::read(dir.join("meta/info.json")).unwrap_or_default();
    let info: Option<serde_json::Value> = serde_json::from_slice(&info).ok();
    info.and_then(|info| info["total_episodes"].as_u64())
        .unwrap_or(0)
}

/// A file of an episode that is being written or was finished.
fn has_file(dir: &Path, number: u64) -> bool {
    let name = format!("file-{number:03}");
    let entries = std::fs::read_dir(dir.join("data/chunk-000"));
    entries.is_ok_and(|mut entries| {
        entries.any(|entry| {
            let file = entry.unwrap().file_name();
            file.to_string_lossy().starts_with(&name)
        })
    })
}

/// The shipped scene with small pictures, so that episodes come quickly.
fn small_scene(folder: &Path) -> PathBuf {
    let shipped = repository().join("config/tasks/block-transfer/scene.toml");
    let text = std::fs::read_to_string(shipped).unwrap();
    assert!(text.contains("width = 512") && text.contains("height = 512"));
    let path = folder.join("small.toml");
    std::fs::write(&path, text.replace("= 512", "= 64")).unwrap();
    path
}

/// A killed recording keeps every episode but the one in progress.
#[test]
fn killed_recording_loses_one_episode_at_most() {
    let folder = scratch("record-killed");
    let out = folder.join("demos");
    let mut record = trocar()
        .args(["record", "--task", "block-transfer", "--episodes", "40"])
        .arg("--scene")
        .arg(small_scene(&folder))
        .arg("--out")
        .arg(&out)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    // As soon as the second episode's file is there, whole or not, counted or not.
    while committed(&out) == 0 || !has_file(&out, 1) {
        assert_eq!(record.try_wait().unwrap(), None, "it ended too early");
        std::thread::yield_now();
    }
    record.kill().unwrap();
    record.wait().unwrap();

    let dataset = Dataset::open(&out).unwrap();
    let episodes = u64::try_from(dataset.episodes().len()).unwrap();
    assert_eq!(episodes, committed(&out));
    assert!(episodes >= 1);
    assert!(!has_file(&out, episodes + 1), "one at most was under way");
    // Every frame of what is counted is there.
    for frame in 0..dataset.len() {
        dataset.image_rgb(frame, 0).unwrap();
    }
}

/// A recording of `episodes` small episodes in `out`.
fn recording(folder: &Path, out: &Path, episodes: u64, more: &[&str]) -> Command {
    let mut record = trocar();
    record
        .args(["record", "--task", "block-transfer"])
        .args(["--episodes", &episodes.to_string()])
        .arg("--scene")
        .arg(small_scene(folder))
        .arg("--out")
        .arg(out)
        .args(more)
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    record
}

/// Waits until `out` has `episodes` episodes.
fn wait_for(record: &mut Child, out: &Path, episodes: u64) {
    while committed(out) < episodes {
        assert_eq!(record.try_wait().unwrap(), None, "it ended too early");
        std::thread::yield_now();
    }
}

/// Records to the end.
fn finish(mut record: Command) {
    let output = record.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
}

/// Every file below `dir` by its name there.
fn files(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![dir.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(dir).unwrap().to_owned();
                found.insert(name, std::fs::read(&path).unwrap());
            }
        }
    }
    found
}

/// Records in `out` until it is killed, goes on until it is interrupted, and ends with one episode
/// more: how many there are.
fn killed_interrupted_and_ended(folder: &Path, out: &Path) -> u64 {
    let mut record = recording(folder, out, 40, &["--depth"]).spawn().unwrap();
    wait_for(&mut record, out, 1);
    record.kill().unwrap();
    record.wait().unwrap();
    let killed = committed(out);

    let result = folder.join("result.json");
    let resume = ["--depth", "--resume", "--jobs", "2", "--json"];
    let resume = [&resume[..], &[result.to_str().unwrap()]].concat();
    let mut record = recording(folder, out, 40, &resume).spawn().unwrap();
    wait_for(&mut record, out, killed + 1);
    interrupt_process(record.id()).unwrap();
    let output = record.wait_with_output().unwrap();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    let there = committed(out);
    let expected = format!("trocar: interrupted: {there} of 40 episodes are in ");
    assert!(
        said.contains(&expected) && said.contains("--resume goes on"),
        "{said}"
    );
    let summary = json(&result);
    assert_eq!(summary["interrupted"], true);
    assert_eq!(summary["episodes"], there);
    assert_eq!(summary["episodes_before"], killed);
    let attempts = summary["attempts"].as_array().unwrap().iter();
    let kept = attempts.filter(|attempt| attempt["kept"] == true).count();
    assert_eq!(u64::try_from(kept).unwrap(), there - killed);

    finish(recording(folder, out, there + 1, &resume));
    assert_eq!(json(&result)["episodes_before"], there);
    // Fewer than there are: nothing is done.
    let before = files(out);
    finish(recording(folder, out, 1, &resume));
    let summary = json(&result);
    assert_eq!(summary["episodes"], there + 1);
    assert_eq!(summary["attempts"], serde_json::json!([]));
    assert!(files(out) == before, "nothing is touched");
    there + 1
}

/// What can't be resumed is bad input, and stays as it is.
fn other_recordings_are_refused(folder: &Path, out: &Path) {
    let before = files(out);
    for (out, more, expected) in [
        (out, &["--depth"][..], "which --resume appends to"),
        (
            out,
            &["--depth", "--resume", "--seed", "7"],
            "was recorded with --seed 0, now 7 is asked for",
        ),
        (
            out,
            &["--depth", "--resume", "--cameras", "side"],
            "was recorded with --cameras endoscope, now side is asked for",
        ),
        (out, &["--resume"], "was recorded with --depth on, now off"),
        (folder, &["--resume"], "holds no dataset"),
    ] {
        let output = recording(folder, out, 50, more).output().unwrap();
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(expected), "{said}");
    }
    assert!(files(out) == before, "nothing is touched");
}

/// A recording that was killed and interrupted goes on to the same dataset.
#[test]
fn killed_recording_resumes_to_the_same_dataset() {
    let folder = scratch("record-resumed");
    let (cut, whole) = (folder.join("cut"), folder.join("whole"));
    let episodes = killed_interrupted_and_ended(&folder, &cut);
    finish(recording(
        &folder,
        &whole,
        episodes,
        &["--depth", "--jobs", "2"],
    ));
    let (found, expected) = (files(&cut), files(&whole));
    assert!(found.keys().eq(expected.keys()));
    for (name, bytes) in &expected {
        assert!(found[name] == *bytes, "{} differs", name.display());
    }
    other_recordings_are_refused(&folder, &cut);
}

/// Two eyes are recorded, which see different pictures, and go out under Open-H's names.
#[test]
fn two_eyes_are_recorded_and_exported() {
    let folder = scratch("record-stereo");
    let (ours, theirs) = (folder.join("ours"), folder.join("theirs"));
    finish(recording(&folder, &ours, 1, &["--stereo"]));
    let info = json(&ours.join("meta/info.json"));
    for eye in ["endoscope", "endoscope_right"] {
        let feature = format!("observation.images.{eye}");
        assert!(info["features"][&feature].is_object(), "{info}");
    }
    let dataset = Dataset::open(&ours).unwrap();
    let [left, right] = [0, 1].map(|camera| dataset.image_rgb(0, camera).unwrap());
    assert_eq!(left.len(), right.len());
    assert_ne!(left, right);
    let mut export = trocar();
    export
        .args(["export", "open-h"])
        .arg(&ours)
        .arg("--out")
        .arg(&theirs);
    finish(export);
    let info = json(&theirs.join("meta/info.json"));
    for eye in ["left", "right"] {
        let feature = format!("observation.images.endoscope.{eye}");
        assert_eq!(info["features"][&feature]["dtype"], "video", "{info}");
    }
}
