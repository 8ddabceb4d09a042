//! A dVRK's folders.

use std::fmt::Write as _;
use std::path::Path;

use super::made::{Folder, Made, numbers_of};
use super::*;

const FRAME_NS: u64 = 33_333_333;

/// An episode of `steps` rows of psm1, spaced by `frame_ns`, and one image a row.
fn write(folder: &Path, steps: usize, frame_ns: u64) {
    fs::create_dir_all(folder).unwrap();
    let names = Made::new(1).names.concat();
    let mut text = format!("timestamp,{}\n", names.join(","));
    let columns = numbers_of(steps);
    for step in 0..steps {
        let time = 1_700_000_000_000_000_000 + frame_ns * step as u64;
        write!(text, "{time}").unwrap();
        for (_, width, values) in &columns {
            for value in &values[step * width..(step + 1) * width] {
                write!(text, ",{value}").unwrap();
            }
        }
        text.push('\n');
        for (camera, ending) in [("left_img_dir", "left"), ("endo_psm1", "psm1")] {
            fs::create_dir_all(folder.join(camera)).unwrap();
            let path = folder.join(format!("{camera}/frame{step:06}_{ending}.jpg"));
            let grey = image::Rgb([40 + 10 * step as u8; 3]);
            image::RgbImage::from_pixel(16, 12, grey)
                .save(path)
                .unwrap();
        }
    }
    fs::write(folder.join("ee_csv.csv"), text).unwrap();
}

#[test]
fn raw_folders_are_read_with_words_recoveries_and_rate() {
    let folder = Folder::new("raw");
    let tissue = folder.0.join("raw/tissue_3");
    write(&tissue.join("1_suture_throw/episode_001"), 4, FRAME_NS);
    write(
        &tissue.join("1_suture_throw_recovery/episode_001"),
        3,
        FRAME_NS,
    );
    // A recorder may have been stopped between a row and its picture.
    fs::remove_file(tissue.join("1_suture_throw/episode_001/left_img_dir/frame000003_left.jpg"))
        .unwrap();
    let mut request = folder.request("dvrk-raw", "raw");
    let summary = import_mapped(&request, &mut |_, _| {}).unwrap();
    assert_eq!((summary.episodes, summary.frames, summary.fps), (2, 6, 30));
    assert_eq!((summary.arms, summary.recoveries), (1, 1));
    assert_eq!(summary.cameras, ["endoscope", "wrist"]);
    assert_eq!(summary.instructions, ["suture throw"]);
    let dataset = Dataset::open(&request.out).unwrap();
    assert_eq!(dataset.spec().task, "suture throw");
    let columns = numbers_of(3);
    for step in 0..3 {
        let (pose, action) = (dataset.tip_pose(step, 0), dataset.action(step, 0));
        for axis in 0..3 {
            assert!((pose[axis] - columns[0].2[8 * step + axis]).abs() < 1e-12);
            assert!((action[axis] - columns[1].2[8 * step + axis]).abs() < 1e-7);
        }
        let state = dataset.state(step, 0).map(f64::from);
        for (found, meant) in state.iter().zip(joints_of_step(step)) {
            assert!((found - meant).abs() < 1e-6, "{state:?}");
        }
        let image = dataset.image_rgb(step, 1).unwrap();
        let grey = 40 + 10 * step as u8;
        assert!(image.pixels().all(|pixel| pixel.0[0].abs_diff(grey) <= 2));
    }
    request.split = Some("recovery".to_owned());
    request.out = folder.0.join("recoveries");
    let summary = import_mapped(&request, &mut |_, _| {}).unwrap();
    assert_eq!((summary.episodes, summary.left_out), (1, 1));
}

/// Importing a folder that `spoil` has changed must fail with every part of `expected`, and leave
/// nothing.
fn spoilt(name: &str, spoil: impl Fn(&Path), expected: &[&str]) {
    let folder = Folder::new(name);
    let tissue = folder.0.join("raw/tissue_3");
    write(&tissue.join("1_tie/episode_001"), 14, FRAME_NS);
    write(&tissue.join("1_tie/episode_002"), 14, FRAME_NS);
    spoil(&tissue.join("1_tie/episode_002"));
    let request = folder.request("dvrk-raw", "raw");
    let error = import_mapped(&request, &mut |_, _| {}).expect_err(expected[0]);
    let told = error.to_string();
    for part in expected {
        assert!(told.contains(part), "no {part:?} in: {told}");
    }
    assert!(!request.out.exists(), "{told}");
}

fn edit(folder: &Path, change: impl Fn(&str) -> String) {
    let path = folder.join("ee_csv.csv");
    let text = fs::read_to_string(&path).unwrap();
    let changed = change(&text);
    assert_ne!(changed, text);
    fs::write(path, changed).unwrap();
}

#[test]
fn damaged_folders_are_refused_with_file_and_row() {
    spoilt(
        "raw-picture",
        |folder| fs::remove_file(folder.join("endo_psm1/frame000002_psm1.jpg")).unwrap(),
        &["endo_psm1: the image frame000002 is missing"],
    );
    spoilt(
        "raw-pictures",
        |folder| {
            for step in 2..14 {
                let name = format!("left_img_dir/frame{step:06}_left.jpg");
                fs::remove_file(folder.join(name)).unwrap();
            }
        },
        &["ee_csv.csv: the episode has 14 rows and images: 2 left_img_dir, 14 endo_psm1"],
    );
    spoilt(
        "raw-cells",
        |folder| edit(folder, |text| text.replacen(",0.2\n", "\n", 1)),
        &["ee_csv.csv:2: the row has 16 cells, expected 17"],
    );
    spoilt(
        "raw-text",
        |folder| edit(folder, |text| text.replacen(",0.2\n", ",open\n", 1)),
        &["episode 1: action_jaw in ee_csv.csv has a number that is not finite in step 0"],
    );
    spoilt(
        "raw-time",
        |folder| edit(folder, |text| text.replacen("timestamp", "time", 1)),
        &["ee_csv.csv, episode 1: timestamp is missing"],
    );
    spoilt(
        "raw-rate",
        |folder| write(folder, 14, 2 * FRAME_NS),
        &["episode 1: timestamp is 15.00 a second, expected 30"],
    );
    spoilt(
        "raw-gap",
        |folder| {
            edit(folder, |text| {
                let lines: Vec<&str> = text.lines().collect();
                // Rows 3 to 9 of the table are those of pictures that were lost.
                [&lines[..3], &lines[9..]].concat().join("\n")
            });
        },
        &["timestamp has a gap of 0.233 s after step 1"],
    );
}

#[test]
fn a_folder_without_episodes_says_what_one_looks_like() {
    let folder = Folder::new("raw-empty");
    fs::create_dir_all(folder.0.join("raw/tissue_1")).unwrap();
    let request = folder.request("dvrk-raw", "raw");
    let told = import_mapped(&request, &mut |_, _| {})
        .unwrap_err()
        .to_string();
    assert!(
        told.contains("tissue_N/K_SUBTASK/episode_NNN/ee_csv.csv"),
        "{told}"
    );
}
