//! A recording that is killed leaves every finished episode, and nothing that looks like one but isn't.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::path::{Path, PathBuf};
use std::process::Stdio;

use tests::{Profile, repository, scratch, trocar};
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

#[test]
fn a_killed_recording_keeps_every_episode_but_the_one_in_progress() {
    let folder = scratch("record-killed");
    let out = folder.join("demos");
    let mut record = trocar(Profile::Debug)
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
    assert!((1..=2).contains(&episodes), "{episodes}");
    // Every frame of what is counted is there.
    for frame in 0..dataset.len() {
        dataset.image_rgb(frame, 0).unwrap();
    }
}
