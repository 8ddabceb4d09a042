//! Trainings on several datasets.

use trocar_nets::checkpoint;

use super::disturbed::{options, small_lift};
use super::*;
use crate::session::SessionError;

/// Records `episodes` with depth from `seed` on. The seeds of those that were kept.
fn record_from(seed: u64, episodes: usize, out: &Path) -> Vec<u64> {
    let plan = Plan {
        seed,
        ..small_lift(&[])
    };
    let options = RecordOptions {
        episodes,
        depth: true,
        ..options(out, None)
    };
    let summary = record(&plan, &options, &|| false, &mut |_| {}).unwrap();
    let kept = summary.attempts.iter().filter(|attempt| attempt.kept);
    kept.map(|attempt| attempt.seed).collect()
}

fn train_on(data: &[PathBuf], out: &Path) -> Result<(), SessionError> {
    let options = TrainingOptions {
        data: data.to_vec(),
        network: NetworkChoice::Dp3,
        preset: "simple".to_owned(),
        ..training_options(PathBuf::new(), out.to_owned())
    };
    train(&options, &mut |_| {}).map(|_| ())
}

/// Two recordings of an episode train to the bytes of one recording of both, and the checkpoint
/// says what it learned from.
#[test]
fn two_datasets_train_as_one_with_their_episodes() {
    let folder = Scratch::new("session-joined");
    let path = |name: &str| folder.0.join(name);
    let seeds = record_from(40, 2, &path("whole"));
    let parts = [path("a"), path("b")];
    for (part, &seed) in parts.iter().zip(&seeds) {
        assert_eq!(record_from(seed, 1, part), [seed]);
    }
    train_on(&[path("whole")], &path("of-whole")).unwrap();
    train_on(&parts, &path("of-parts")).unwrap();
    let weights = |out: &str| fs::read(path(out).join("model.safetensors")).unwrap();
    assert!(weights("of-whole") == weights("of-parts"));

    let of = |out: &str| {
        let policy = checkpoint::load_dp3(&path(out), Device::Cpu).unwrap();
        policy.recipe.dataset
    };
    let (one, two) = (of("of-whole"), of("of-parts"));
    assert!(one.parts.is_empty());
    assert_eq!((one.episodes, one.frames), (two.episodes, two.frames));
    let [a, b] = &two.parts[..] else {
        panic!("{two:?}");
    };
    assert_eq!((a.episodes, b.episodes), (1, 1));
    assert_eq!(a.frames + b.frames, two.frames);
    assert!(b.folder.ends_with("/b") && b.task == "needle-lift", "{b:?}");
}

/// A network that sees depth learns from no dataset without it, and is told which that is.
#[test]
fn a_dataset_without_depth_does_not_join_one_with_it() {
    let folder = Scratch::new("session-apart");
    let path = |name: &str| folder.0.join(name);
    record_from(40, 1, &path("deep"));
    let flat = RecordOptions {
        episodes: 1,
        ..options(&path("flat"), None)
    };
    record(&small_lift(&[]), &flat, &|| false, &mut |_| {}).unwrap();
    let error = train_on(&[path("deep"), path("flat")], &path("out")).unwrap_err();
    assert!(error.is_bad_input(), "{error}");
    let message = error.to_string();
    for part in [
        "/deep and ",
        "/flat do not go together",
        "not recorded in the other",
    ] {
        assert!(message.contains(part), "no {part:?} in: {message}");
    }
}

/// A state of a training from before there could be several datasets names one.
#[test]
fn options_with_one_dataset_are_still_read() {
    let options = training_options(PathBuf::from("demos"), PathBuf::from("out"));
    let mut value = serde_json::to_value(&options).unwrap();
    for data in [serde_json::json!("demos"), serde_json::json!(["demos"])] {
        value["data"] = data;
        let read: TrainingOptions = serde_json::from_value(value.clone()).unwrap();
        assert_eq!(read.data, [PathBuf::from("demos")]);
    }
}
