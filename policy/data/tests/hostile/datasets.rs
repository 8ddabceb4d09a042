//! Datasets: every file of a small one damaged in turn, and files of another make in the place of
//! the right ones.

use std::fs;
use std::path::{Path, PathBuf};

use trocar_data::dataset::{Dataset, DatasetError, VideoCodec};

use crate::common::{Folder, seeds, told, within_memory};
use crate::damage::damaged;
use crate::recorded::{record, record_with};

/// Every file below `folder`, in order.
pub(crate) fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut entries: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    entries.sort();
    for entry in entries {
        if entry.is_dir() {
            found.extend(files(&entry));
        } else {
            found.push(entry);
        }
    }
    found
}

/// Reads all that can be read. What comes is finite, and its episodes follow one another.
pub(crate) fn read(dir: &Path) -> Result<(), DatasetError> {
    let dataset = Dataset::open(dir)?;
    let mut next = 0;
    for episode in dataset.episodes() {
        assert_eq!(episode.start, next, "{}", dir.display());
        next += episode.len;
    }
    assert_eq!(dataset.len(), next, "{}", dir.display());
    for frame in 0..dataset.len() {
        let state = dataset.state(frame, 0).map(f64::from);
        let numbers = [
            &state[..],
            &dataset.tip_pose(frame, 0),
            &dataset.action(frame, 0),
        ]
        .concat();
        let finite = numbers.iter().all(|number| number.is_finite());
        assert!(finite, "{}, frame {frame}: {numbers:?}", dir.display());
        for camera in 0..dataset.camera_names().len() {
            dataset.image_rgb(frame, camera)?;
            dataset.depth(frame, camera)?;
        }
    }
    Ok(())
}

pub(crate) fn check(error: &DatasetError, dir: &Path, case: &str) {
    let text = told(error);
    let place = dir.display().to_string();
    assert!(text.contains(&place), "{case}: no file is named: {text}");
    assert!(text.len() < 4000, "{case}: {} bytes of reason", text.len());
}

#[test]
fn a_damaged_dataset_is_read_or_refused_by_name() {
    let folder = Folder::new("dataset");
    record(&folder.path().join("d"), "scope");
    let dir = folder.path().join("d");
    let files = files(&dir);
    let whole: Vec<Vec<u8>> = files.iter().map(|file| fs::read(file).unwrap()).collect();
    within_memory(|| {
        let mut refused = 0_u32;
        for seed in seeds(1) {
            let number = usize::try_from(seed).unwrap() % files.len();
            fs::write(&files[number], damaged(&whole[number], seed)).unwrap();
            let case = format!("seed {seed}, {}", files[number].display());
            if let Err(error) = read(&dir) {
                check(&error, &dir, &case);
                refused += 1;
            }
            fs::write(&files[number], &whole[number]).unwrap();
        }
        assert!(refused > 0, "nothing was refused: is anything damaged?");
    });
    read(&dir).expect("it is whole again");
}

#[test]
fn a_damaged_video_is_read_or_refused_by_name() {
    let folder = Folder::new("video");
    let dir = folder.path().join("d");
    record_with(&dir, "scope", Some(VideoCodec::H264));
    let file = dir.join("videos/observation.images.scope/chunk-000/file-001.mp4");
    let whole = fs::read(&file).unwrap();
    let mut refused = 0_u32;
    // Each case starts several programs.
    for seed in seeds(20) {
        fs::write(&file, damaged(&whole, seed)).unwrap();
        if let Err(error) = read(&dir) {
            check(&error, &dir, &format!("seed {seed}"));
            assert!(
                matches!(error, DatasetError::Video { .. }),
                "seed {seed}: {error}"
            );
            refused += 1;
        }
    }
    assert!(refused > 0, "nothing was refused: is anything damaged?");
    fs::write(&file, &whole).unwrap();
    read(&dir).expect("it is whole again");
}

#[test]
fn a_file_of_another_make_is_refused_by_name() {
    let folder = Folder::new("schema");
    let (dir, other) = (folder.path().join("d"), folder.path().join("other"));
    record(&dir, "scope");
    record(&other, "side");
    let data = "data/chunk-000/file-001.parquet";
    let whole = fs::read(dir.join(data)).unwrap();
    let cases = [
        // Another camera's columns.
        (other.join(data), "observation.images.scope is missing"),
        // A parquet file of another schema altogether.
        (dir.join("meta/tasks.parquet"), "is missing"),
        (dir.join("meta/info.json"), "not a whole parquet file"),
        // The same schema, but another episode's rows.
        (
            dir.join("data/chunk-000/file-000.parquet"),
            "mixed with rows of episode 0",
        ),
    ];
    for (from, reason) in cases {
        fs::copy(from, dir.join(data)).unwrap();
        let error = read(&dir).expect_err(reason);
        let text = told(&error);
        assert!(
            text.contains(reason) && text.contains("file-001.parquet"),
            "{text}"
        );
    }
    fs::write(dir.join(data), whole).unwrap();
    read(&dir).unwrap();
}

/// The checksum of a part of a PNG (CRC-32), without which the lie would not be read.
fn checksum(bytes: &[u8]) -> u32 {
    let step = |sum: u32| {
        if sum & 1 == 1 {
            (sum >> 1) ^ 0xedb8_8320
        } else {
            sum >> 1
        }
    };
    let sum = bytes.iter().fold(u32::MAX, |sum, &byte| {
        (0..8).fold(sum ^ u32::from(byte), |sum, _| step(sum))
    });
    !sum
}

/// An image that claims to be huge is refused before memory is asked for.
#[test]
fn huge_image_is_refused_before_allocation() {
    // A PNG of 60000 x 60000 pixels, of which hardly any are there.
    let mut png = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut png);
    image::ImageEncoder::write_image(encoder, &[0; 3], 1, 1, image::ExtendedColorType::Rgb8)
        .unwrap();
    png[16..24].copy_from_slice(&[0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60]);
    let checksum = checksum(&png[12..29]).to_be_bytes();
    png[29..33].copy_from_slice(&checksum);
    within_memory(|| {
        let error = trocar_data::dataset::decode_rgb(&png).expect_err("it is too large");
        let text = told(&error);
        assert!(text.contains("imit") || text.contains("large"), "{text}");
    });
}
