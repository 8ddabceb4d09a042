//! What is refused, and with which words.

use std::error::Error;
use std::fs;
use std::path::Path;

use hdf5_pure::ScaleOffset;

use super::demo::{Episode, Folder, HEIGHT, WIDTH, act, by_h5py, robomimic};
use crate::dataset::Dataset;
use crate::import::{ImportOptions, import};

/// The error with all its causes.
fn told(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    text
}

/// Importing must fail with every part of `expected` in the message, and leave nothing.
fn refused(options: &ImportOptions, expected: &[&str]) {
    let error = import(options, &mut |_, _| {}).expect_err(expected[0]);
    let message = told(&error);
    for part in expected {
        assert!(message.contains(part), "no {part:?} in: {message}");
    }
    assert!(!options.out.exists(), "{message}");
}

/// A folder with a good episode and one that `spoil` has changed.
fn spoilt(name: &str, spoil: impl Fn(&mut Episode), expected: &[&str]) {
    let folder = Folder::new(name);
    Episode::new(3, 1).write(&folder.0.join("episode_0.hdf5"));
    let mut episode = Episode::new(4, 1);
    spoil(&mut episode);
    episode.write(&folder.0.join("episode_1.hdf5"));
    let options = act(&folder.0, &folder.0.join("out"));
    refused(&options, &[&["episode_1.hdf5: "], expected].concat());
}

#[test]
fn numbers_that_can_not_be_meant_name_their_place() {
    spoilt(
        "degrees",
        |episode| {
            for value in &mut episode.qpos.0[7..] {
                *value = value.to_degrees();
            }
        },
        &[
            "observations/qpos of arm 1: yaw = 2.5210 in step 1 is outside [-1.588, 1.588]",
            "six joints (rad, insertion m) and the jaw (rad) are expected",
        ],
    );
    spoilt(
        "nan",
        |episode| episode.action.0[2 * 7 + 3] = f64::NAN,
        &["action has a number that is not finite in step 2"],
    );
    spoilt(
        "jaw",
        |episode| episode.action.0[13] = 1.5,
        &["action of arm 1: jaw = 1.5000 in step 1 is outside [-0.698, 1.396]"],
    );
    spoilt(
        "joints",
        |episode| {
            episode.qpos.0.truncate(24);
            episode.qpos.1[1] = 6;
        },
        &["observations/qpos has 6 numbers a step, expected 7 for each of one or two arms"],
    );
    spoilt(
        "shape",
        |episode| episode.action.1 = vec![2, 2, 7],
        &["action has the shape [2, 2, 7], expected (steps, numbers)"],
    );
    spoilt(
        "steps",
        |episode| {
            episode.action.0.truncate(21);
            episode.action.1[0] = 3;
        },
        &["action has 1 arms and 3 steps, expected those of observations/qpos: 1 and 4"],
    );
}

#[test]
fn frames_that_are_missing_or_of_another_size_name_their_place() {
    let row = HEIGHT * WIDTH * 3;
    spoilt(
        "frames",
        |episode| {
            episode.camera.0.truncate(3 * row);
            episode.camera.1[0] = 3;
        },
        &["observations/images/top has 3 frames of 4 steps, expected one a step"],
    );
    spoilt(
        "size",
        |episode| episode.camera.1 = vec![4, WIDTH as u64, HEIGHT as u64, 3],
        &[
            "the episode has 1 arms and cameras top (6 x 8)",
            "expected what the first episode has 1 arms and cameras top (8 x 6)",
        ],
    );
    spoilt(
        "grey",
        |episode| {
            episode.camera.0.truncate(4 * HEIGHT * WIDTH);
            episode.camera.1.truncate(3);
        },
        &["observations/images/top has the shape [4, 6, 8], expected (steps, height, width, 3)"],
    );
    spoilt(
        "filter",
        |episode| {
            episode.stored = |dataset, shape| {
                if shape.len() == 4 {
                    dataset.with_chunks(shape);
                    dataset.with_scale_offset(ScaleOffset::Integer(0));
                }
            };
        },
        &["observations/images/top went through the filters [6], expected gzip (1) or lzf (32000)"],
    );
    spoilt(
        "no-jpeg",
        |episode| episode.camera.1 = vec![4, row as u64],
        &["observations/images/top, step 0: cannot be decoded as JPEG"],
    );
    spoilt(
        "arms",
        |episode| *episode = Episode::new(4, 2),
        &["the episode has 2 arms", "the first episode has 1 arms"],
    );
}

#[test]
fn deltas_and_missing_names_are_refused() {
    let folder = Folder::new("names");
    let path = folder.0.join("episode_0.hdf5");
    let out = folder.0.join("out");
    let mut episode = Episode::new(3, 1);
    episode.action = (vec![0.01; 24], vec![3, 8]);
    episode.write(&path);
    let options = act(&folder.0, &out);
    let pose = ImportOptions {
        action_pose: Some("action".to_owned()),
        ..options.clone()
    };
    refused(
        &pose,
        &[
            "a quaternion of length 0.0200 in step 0",
            "are these deltas?",
        ],
    );
    let other = ImportOptions {
        joints: Some("observations/joints".to_owned()),
        ..options.clone()
    };
    refused(&other, &["episode_0.hdf5: observations/joints is missing"]);
    let other = ImportOptions {
        images: vec!["observations/images/wrist".to_owned()],
        action_joints: Some("observations/qpos".to_owned()),
        ..options.clone()
    };
    refused(
        &other,
        &["episode_0.hdf5: observations/images/wrist is missing"],
    );
    let numbers = ImportOptions {
        images: vec!["observations/qpos".to_owned()],
        action_joints: Some("observations/qpos".to_owned()),
        ..options.clone()
    };
    refused(
        &numbers,
        &["episode_0.hdf5: observations/qpos is of float64, expected uint8"],
    );
    let both = ImportOptions {
        action_joints: Some("action".to_owned()),
        ..pose
    };
    refused(&both, &["one of them is needed, not both"]);
    let file = by_h5py("robomimic.hdf5");
    let bare = ImportOptions {
        images: Vec::new(),
        ..robomimic(&file, &out)
    };
    refused(
        &bare,
        &["--joints, --images, and --action-joints or --action-pose are needed"],
    );
    let wide = ImportOptions {
        joints: Some("actions/x".to_owned()),
        ..robomimic(&file, &out)
    };
    refused(
        &wide,
        &["robomimic.hdf5, data/demo_0: actions/x is missing"],
    );
    let twice = ImportOptions {
        images: vec!["obs/scope_image".to_owned(), "obs/scope_image".to_owned()],
        ..robomimic(&file, &out)
    };
    refused(&twice, &["camera \"scope\" is there twice"]);
}

#[test]
fn what_is_no_demonstration_is_refused() {
    let folder = Folder::new("nothing");
    let out = folder.0.join("out");
    let nowhere = folder.0.join("nowhere");
    refused(
        &act(&nowhere, &out),
        &["nowhere: cannot be read: No such file"],
    );
    refused(&act(&folder.0, &out), &["has no episode_N.hdf5"]);
    refused(
        &robomimic(&nowhere, &out),
        &["nowhere: cannot be read: No such file"],
    );
    refused(
        &robomimic(&folder.0, &out),
        &["cannot be read: is a directory"],
    );
    let episode = by_h5py("act/episode_0.hdf5");
    refused(&robomimic(&episode, &out), &["has no data/demo_N"]);
    fs::write(folder.0.join("episode_0.hdf5"), "no HDF5 at all").unwrap();
    let expected = "episode_0.hdf5: the file cannot be read as HDF5: invalid HDF5 magic bytes";
    refused(&act(&folder.0, &out), &[expected]);
}

/// The place of `bytes` in the file.
fn find(path: &Path, bytes: &[u8]) -> usize {
    let file = fs::read(path).unwrap();
    file.windows(bytes.len())
        .position(|window| window == bytes)
        .unwrap()
}

#[test]
fn an_episode_that_breaks_off_leaves_those_before_it() {
    let folder = Folder::new("later");
    for number in 0..3 {
        let stored = |dataset: &mut hdf5_pure::DatasetBuilder, shape: &[u64]| {
            let sides: Vec<u64> = [1].into_iter().chain(shape[1..].iter().copied()).collect();
            dataset.with_chunks(&sides).with_fletcher32();
        };
        let episode = Episode {
            stored,
            ..Episode::new(4, 1)
        };
        episode.write(&folder.0.join(format!("episode_{number}.hdf5")));
    }
    let path = folder.0.join("episode_1.hdf5");
    let place = find(&path, &super::demo::image(2)[..60]);
    let mut bytes = fs::read(&path).unwrap();
    bytes[place] ^= 1;
    fs::write(&path, bytes).unwrap();
    let options = act(&folder.0, &folder.0.join("out"));
    let error = import(&options, &mut |_, _| {}).unwrap_err();
    let message = told(&error);
    let expected = "episode_1.hdf5: observations/images/top cannot be read as HDF5";
    assert!(message.contains(expected), "{message}");
    let dataset = Dataset::open(&options.out).unwrap();
    let lengths: Vec<usize> = dataset.episodes().iter().map(|one| one.len).collect();
    assert_eq!(lengths, [4]);
    assert!(dataset.image_rgb(3, 0).is_ok());
}

#[test]
fn demonstrations_of_nothing_are_refused() {
    let folder = Folder::new("nameless");
    Episode::new(3, 1).write(&folder.0.join("episode_0.hdf5"));
    let nameless = ImportOptions {
        task: " ".to_owned(),
        ..act(&folder.0, &folder.0.join("out"))
    };
    refused(&nameless, &["--task"]);
}

#[test]
fn poses_in_other_units_are_refused() {
    let folder = Folder::new("units");
    let path = folder.0.join("episode_0.hdf5");
    let pose = [0.01, 0.02, -0.15, 1.0, 0.0, 0.0, 0.0, 0.5];
    let options = ImportOptions {
        action_pose: Some("action".to_owned()),
        ..act(&folder.0, &folder.0.join("out"))
    };
    for (place, value, told) in [
        (2, -150.0, "-1.5000e2 with the jaw at 5.0000e-1 in step 1"),
        (0, 1e39, "is at 1.0000e39"),
        (7, 30.0, "with the jaw at 3.0000e1 in step 1"),
    ] {
        let mut rows = pose.repeat(3);
        rows[8 + place] = value;
        let mut episode = Episode::new(3, 1);
        episode.action = (rows, vec![3, 8]);
        episode.write(&path);
        let range = "within [-1, 1] and the jaw in rad within";
        refused(&options, &["action of arm 1 is at", told, range]);
    }
    let mut episode = Episode::new(3, 1);
    episode.action = (pose.repeat(3), vec![3, 8]);
    episode.write(&path);
    assert!(import(&options, &mut |_, _| {}).is_ok());
}

#[test]
fn what_is_in_too_many_pieces_is_refused() {
    let folder = Folder::new("pieces");
    let mut episode = Episode::new(2, 1);
    let side = 600;
    episode.camera = (vec![0; 2 * side * side * 3], vec![2, 600, 600, 3]);
    episode.stored = |data, shape| {
        if shape.len() == 4 {
            data.with_chunks(&[1, 1, 1, 1]);
        }
    };
    episode.write(&folder.0.join("episode_0.hdf5"));
    let options = act(&folder.0, &folder.0.join("out"));
    refused(
        &options,
        &["is in chunks of [1, 1, 1, 1]", "at most 262144"],
    );
}
