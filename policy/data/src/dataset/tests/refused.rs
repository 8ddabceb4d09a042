//! What is not written, and what is not read.

use std::os::unix::net::UnixListener;

use super::*;

#[test]
fn writer_refuses_what_does_not_fit() {
    let folder = Folder::new("refuse");
    let mut writer = DatasetWriter::create(&folder.0, &spec()).unwrap();
    let frame = FrameRecord {
        arms: &[STILL],
        images: &[],
        depth: &[],
    };
    let message = writer.push_frame(&frame).unwrap_err().to_string();
    assert_eq!(message, "the frame is 0 images, expected 2, one a camera");
    let message = writer
        .push_frame(&FrameRecord {
            images: &[&[0; 1152], &[0; 287]],
            ..frame
        })
        .unwrap_err()
        .to_string();
    assert_eq!(
        message,
        "the image of overview is 287 bytes, expected 288 for 8 x 12 RGB"
    );
    let mut action = [0.0; 8];
    action[7] = f64::NAN;
    let message = writer
        .push_frame(&FrameRecord {
            arms: &[ArmFrame { action, ..STILL }],
            ..frame
        })
        .unwrap_err()
        .to_string();
    assert_eq!(message, "action[7] is NaN, expected a finite number");
    assert!(writer.end_episode().is_err(), "no frame was added");
    push(&mut writer, 0).unwrap();
    assert!(writer.finish().is_err(), "an episode is open");
    assert!(matches!(
        DatasetWriter::create(&folder.0, &spec()),
        Err(DatasetError::Exists { .. })
    ));
}

#[test]
fn missing_and_cut_files_are_named() {
    let folder = Folder::new("damaged");
    record(&folder.0).finish().unwrap();
    let data = meta::data_path(&folder.0, 0, 1);
    let whole = fs::read(&data).unwrap();
    for len in [0, 3, whole.len() / 2, whole.len() - 1] {
        fs::write(&data, &whole[..len]).unwrap();
        let message = error_of(&folder.0);
        assert!(
            message.contains("file-001.parquet: not a whole parquet file"),
            "{message}"
        );
    }
    fs::remove_file(&data).unwrap();
    let message = error_of(&folder.0);
    assert!(
        message.contains("file-001.parquet: cannot be read or written: No such file"),
        "{message}"
    );
    fs::write(&data, &whole).unwrap();

    for file in [
        "meta/tasks.parquet",
        "meta/episodes/chunk-000/file-000.parquet",
    ] {
        let path = folder.0.join(file);
        let kept = fs::read(&path).unwrap();
        fs::write(&path, &kept[..kept.len() / 2]).unwrap();
        let message = error_of(&folder.0);
        assert!(message.contains(file), "{message}");
        fs::write(&path, kept).unwrap();
    }
    let message = error_of(&folder.0.join("nowhere"));
    assert!(
        message.contains("nowhere/meta/info.json: cannot be read or written: No such file"),
        "{message}"
    );
    assert_eq!(message.matches("No such file").count(), 1, "{message}");
}

#[test]
fn info_that_is_too_large_or_no_file_is_refused() {
    let folder = Folder::new("no-file");
    record(&folder.0).finish().unwrap();
    let info = meta::info_path(&folder.0);
    let file = fs::File::options().write(true).open(&info).unwrap();
    file.set_len((16 << 20) + 1).unwrap();
    let message = error_of(&folder.0);
    assert!(
        message.contains("meta/info.json: cannot be read or written: it has 16777217 bytes"),
        "{message}"
    );
    fs::remove_file(&info).unwrap();
    let _bound = UnixListener::bind(&info).unwrap();
    let message = error_of(&folder.0);
    assert!(
        message.contains("it is a device, a pipe or a socket"),
        "{message}"
    );
}

#[test]
fn damaged_image_is_an_error_not_a_picture() {
    let folder = Folder::new("image");
    record(&folder.0).finish().unwrap();
    let data = meta::data_path(&folder.0, 0, 0);
    let mut bytes = fs::read(&data).unwrap();
    let place = bytes
        .windows(8)
        .position(|window| window == b"\x89PNG\r\n\x1a\n")
        .unwrap();
    bytes[place + 1] = b'X';
    fs::write(&data, bytes).unwrap();
    let dataset = Dataset::open(&folder.0).unwrap();
    let message = dataset.image_rgb(0, 0).unwrap_err().to_string();
    assert!(
        message.contains("scope of frame 0") && message.contains("file-000.parquet"),
        "{message}"
    );
    assert!(dataset.image_rgb(1, 0).is_ok());
}

#[test]
fn other_versions_features_and_widths_are_refused() {
    let folder = Folder::new("info");
    record(&folder.0).finish().unwrap();
    let path = meta::info_path(&folder.0);
    let whole = fs::read_to_string(&path).unwrap();
    let check = |from: &str, to: &str, expected: &str| {
        assert!(whole.contains(from), "{from}");
        fs::write(&path, whole.replace(from, to)).unwrap();
        let message = error_of(&folder.0);
        assert!(
            message.contains("info.json") && message.contains(expected),
            "{message}"
        );
    };
    check(
        "\"v3.0\"",
        "\"v1.6\"",
        "codebase_version is \"v1.6\", this program reads v3.0, v2.1, v2.0",
    );
    check(
        "observation.tip_pose",
        "observation.tool",
        "feature observation.tip_pose is missing",
    );
    check(
        "        8\n",
        "        9\n",
        "the shape of action is [9], expected 8",
    );
    check(
        "\"dtype\": \"image\"",
        "\"dtype\": \"jpeg\"",
        "observation.images.scope is jpeg, expected image",
    );
    check("\"fps\": 25,", "", "missing field `fps`");
    check(
        "\"total_episodes\": 3",
        "\"total_episodes\": 9",
        "the number of episodes is 3, expected 9",
    );
}

#[test]
fn a_number_that_is_not_finite_is_refused_with_its_row() {
    let folder = Folder::new("not-finite");
    record(&folder.0).finish().unwrap();
    let data = meta::data_path(&folder.0, 0, 0);
    let whole = fs::read(&data).unwrap();
    let number = arm(2, 0).tip_pose[1].to_le_bytes();
    let places = whole.windows(8).enumerate();
    let places: Vec<usize> = places
        .filter(|(_, window)| *window == number)
        .map(|(at, _)| at)
        .collect();
    assert!(!places.is_empty(), "numbers are stored as they are");
    let mut bytes = whole;
    for at in places {
        bytes[at..at + 8].copy_from_slice(&f64::NEG_INFINITY.to_le_bytes());
    }
    fs::write(&data, bytes).unwrap();
    let message = error_of(&folder.0);
    let reason = "file-000.parquet: observation.tip_pose in row 2 is -inf, expected finite";
    assert!(message.contains(reason), "{message}");
}

#[test]
fn data_that_disagrees_with_the_description_is_refused() {
    let folder = Folder::new("disagree");
    record(&folder.0).finish().unwrap();
    let [first, third] = [0, 2].map(|file| meta::data_path(&folder.0, 0, file));
    let kept = fs::read(&first).unwrap();
    fs::copy(&third, &first).unwrap();
    let message = error_of(&folder.0);
    assert!(
        message.contains("file-000.parquet: episode 0 is cut off by the end of the file"),
        "{message}"
    );
    fs::write(&first, kept).unwrap();

    // A data file in which a column has another name, and one in which it has another width.
    let other = Folder::new("disagree-other");
    let mut narrow = spec();
    narrow.cameras.pop();
    let mut writer = DatasetWriter::create(&other.0, &narrow).unwrap();
    let image = image(0, narrow.cameras[0].image_size_bytes());
    let frame = FrameRecord {
        arms: &[STILL],
        images: &[&image],
        depth: &[],
    };
    (0..5).for_each(|_| writer.push_frame(&frame).unwrap());
    writer.end_episode().unwrap();
    fs::copy(meta::data_path(&other.0, 0, 0), &first).unwrap();
    let message = error_of(&folder.0);
    assert!(
        message.ends_with("column observation.images.overview is missing"),
        "{message}"
    );

    let table = crate::dataset::table::Table::open(&first).unwrap();
    let message = table
        .vectors::<9>(schema::ACTION, 1)
        .unwrap_err()
        .to_string();
    assert!(
        message.ends_with("action is 8 numbers wide, expected 9"),
        "{message}"
    );
}
