//! Several datasets that are read as one, and those that are not.

use super::*;

/// Records episodes of `lens` frames, the first of which is frame `first`.
fn record_from(dir: &Path, spec: &DatasetSpec, mut first: usize, lens: &[usize]) -> PathBuf {
    let mut writer = DatasetWriter::create(dir, spec).unwrap();
    for len in lens {
        for frame in first..first + len {
            push_seen(&mut writer, spec, frame);
        }
        first += len;
        writer.end_episode().unwrap();
    }
    writer.finish().unwrap();
    dir.to_owned()
}

fn push_seen(writer: &mut DatasetWriter, spec: &DatasetSpec, frame: usize) {
    let cameras = spec.cameras.iter();
    let images: Vec<Vec<u8>> = cameras
        .map(|camera| image(frame, camera.image_size_bytes()))
        .collect();
    let images: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
    let arms: Vec<ArmFrame> = (0..spec.arms).map(|index| arm(frame, index)).collect();
    let record = FrameRecord {
        arms: &arms,
        images: &images,
        depth: &[],
    };
    writer.push_frame(&record).unwrap();
}

fn open(dirs: &[PathBuf], episodes: Option<usize>) -> Result<Dataset, DatasetError> {
    Dataset::open_joined(dirs, episodes, None, false)
}

/// The same episodes, frames and images.
fn assert_same(one: &Dataset, other: &Dataset) {
    assert_eq!(one.episodes(), other.episodes());
    assert_eq!(one.camera_names(), other.camera_names());
    for frame in 0..one.len() {
        let states = [one, other].map(|it| it.state(frame, 0).map(f32::to_bits));
        assert_eq!(states[0], states[1]);
        assert_eq!(bits(one.tip_pose(frame, 0)), bits(other.tip_pose(frame, 0)));
        assert_eq!(bits(one.action(frame, 0)), bits(other.action(frame, 0)));
        for camera in 0..one.camera_names().len() {
            let [a, b] = [one, other].map(|it| it.image_rgb(frame, camera).unwrap());
            assert!(a == b, "frame {frame} of camera {camera}");
        }
    }
}

/// The cameras of the second are in another order, and it says who drove.
#[test]
fn two_datasets_are_as_one_that_was_split() {
    let folder = Folder::new("joined");
    let path = |name: &str| folder.0.join(name);
    let mut other = DatasetSpec {
        intervention: true,
        ..spec()
    };
    other.cameras.reverse();
    let whole = record_from(&path("whole"), &spec(), 0, &[4, 2, 3]);
    let parts = [
        record_from(&path("a"), &spec(), 0, &[4]),
        record_from(&path("b"), &other, 4, &[2, 3]),
    ];
    for episodes in [None, Some(1), Some(2), Some(3)] {
        let whole = Dataset::open_first(&whole, episodes).unwrap();
        let joined = open(&parts, episodes).unwrap();
        assert_same(&whole, &joined);
        assert!(!joined.spec().intervention);
        let lens = joined.parts().iter().map(|part| part.frames);
        assert_eq!(lens.sum::<usize>(), whole.len());
    }
    let parted = open(&parts, Some(2)).unwrap();
    let counts = parted.parts().iter().map(|it| (it.episodes, it.frames));
    assert_eq!(counts.collect::<Vec<_>>(), [(1, 4), (1, 2)]);
    let message = open(&parts, Some(4)).unwrap_err().to_string();
    assert!(message.ends_with("/b is 3, expected 4"), "{message}");
    assert!(open(&[], None).is_err());
}

/// The message names both datasets, what differs, and what it is in each.
#[test]
fn datasets_that_differ_are_not_joined() {
    let folder = Folder::new("apart");
    let mine = record_from(&folder.0.join("mine"), &spec(), 0, &[2]);
    let camera = |name: &str, width| CameraSpec {
        name: name.to_owned(),
        width,
        height: 12,
        depth: None,
    };
    let scope = spec().cameras[0].clone();
    let cases = [
        (
            DatasetSpec { arms: 2, ..spec() },
            "the number of arms is 1 in the first, 2 in the other",
        ),
        (
            DatasetSpec { fps: 50, ..spec() },
            "fps is 25 in the first, 50 in the other",
        ),
        (
            DatasetSpec {
                cameras: vec![scope.clone(), camera("overview", 10)],
                ..spec()
            },
            "the size of overview is 8 x 12 in the first, 10 x 12 in the other",
        ),
        (
            DatasetSpec {
                cameras: vec![scope],
                ..spec()
            },
            "the list of cameras is scope, overview in the first, scope in the other",
        ),
    ];
    for (index, (spec, expected)) in cases.into_iter().enumerate() {
        let theirs = record_from(&folder.0.join(format!("other{index}")), &spec, 0, &[2]);
        let message = open(&[mine.clone(), theirs.clone()], None)
            .unwrap_err()
            .to_string();
        let both = format!("{} and {} do not go", mine.display(), theirs.display());
        assert!(
            message.starts_with(&both) && message.ends_with(expected),
            "{message}"
        );
    }
    // What the network does not see may differ.
    let scope = ["scope".to_owned()];
    let other = |name: &str| folder.0.join(name);
    for name in ["other2", "other3"] {
        let dirs = [mine.clone(), other(name)];
        let joined = Dataset::open_joined(&dirs, None, Some(&scope), false).unwrap();
        assert_eq!((joined.len(), joined.camera_names()), (4, &scope[..]));
    }
}
