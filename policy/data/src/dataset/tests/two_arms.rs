//! Datasets of two arms.

use super::*;

#[test]
fn two_arms_are_read_back_as_they_were_written() {
    let folder = Folder::new("two-arms");
    let spec = DatasetSpec { arms: 2, ..spec() };
    let mut writer = DatasetWriter::create(&folder.0, &spec).unwrap();
    // More frames than are handed to the file together.
    for frame in 0..70 {
        push_arms(&mut writer, frame, &[arm(frame, 0), arm(frame, 1)]).unwrap();
    }
    writer.end_episode().unwrap();
    let message = push_arms(&mut writer, 0, &[arm(0, 0)])
        .unwrap_err()
        .to_string();
    assert_eq!(message, "the frame is of 1 arms, expected 2");
    let mut nan = arm(0, 1);
    nan.tip_pose[2] = f64::NAN;
    let message = push_arms(&mut writer, 0, &[arm(0, 0), nan])
        .unwrap_err()
        .to_string();
    assert_eq!(message, "psm2 tip_pose[2] is NaN, expected a finite number");
    writer.finish().unwrap();

    let dataset = Dataset::open(&folder.0).unwrap();
    assert_eq!(
        (dataset.spec(), dataset.arms(), dataset.len()),
        (&spec, 2, 70)
    );
    for frame in 0..dataset.len() {
        for index in 0..2 {
            let written = arm(frame, index);
            let state = dataset.state(frame, index).map(f32::to_bits);
            assert_eq!(state, written.state.map(f32::to_bits));
            assert_eq!(bits(dataset.tip_pose(frame, index)), bits(written.tip_pose));
            let action = narrow(written.action).map(f64::from);
            assert_eq!(bits(dataset.action(frame, index)), bits(action));
        }
    }
    let stats: serde_json::Value =
        serde_json::from_slice(&fs::read(meta::stats_path(&folder.0)).unwrap()).unwrap();
    let least = |place: usize| stats[schema::ACTION]["min"][place].as_f64().unwrap();
    for (place, index) in [(1, 0), (9, 1)] {
        let values = (0..70).map(|frame| f64::from(narrow(arm(frame, index).action)[1]));
        assert!((least(place) - values.fold(f64::INFINITY, f64::min)).abs() < 1e-12);
    }
}

/// One arm's names stand alone and of two each begins with its arm's.
#[test]
fn names_of_two_arms_have_a_prefix() {
    let described = |arms: usize| {
        let folder = Folder::new(&format!("names-{arms}"));
        let spec = DatasetSpec { arms, ..spec() };
        drop(DatasetWriter::create(&folder.0, &spec).unwrap());
        let text = fs::read(meta::info_path(&folder.0)).unwrap();
        let info: serde_json::Value = serde_json::from_slice(&text).unwrap();
        [schema::STATE, schema::TIP_POSE, schema::ACTION].map(|name| {
            let feature = &info["features"][name];
            let names: Vec<String> = serde_json::from_value(feature["names"].clone()).unwrap();
            assert_eq!(feature["shape"], serde_json::json!([names.len()]));
            (
                feature["dtype"].as_str().unwrap().to_owned(),
                names.join(" "),
            )
        })
    };
    let [state, tip_pose, action] = described(1);
    let joints = "yaw pitch insertion roll wrist_pitch wrist_yaw jaw";
    assert_eq!(state, ("float32".to_owned(), joints.to_owned()));
    assert_eq!(
        tip_pose,
        ("float64".to_owned(), "x y z qx qy qz qw".to_owned())
    );
    assert_eq!(
        action,
        ("float32".to_owned(), "x y z qx qy qz qw jaw".to_owned())
    );
    for (alone, both) in [state, tip_pose, action].into_iter().zip(described(2)) {
        let prefixed = |arm: &str| {
            let names = alone.1.split(' ').map(|name| format!("{arm}_{name}"));
            names.collect::<Vec<_>>().join(" ")
        };
        let names = format!("{} {}", prefixed("psm1"), prefixed("psm2"));
        assert_eq!(both, (alone.0.clone(), names));
    }
}

/// A number of arms that no robot has and vectors that disagree are refused.
#[test]
fn odd_arm_counts_and_vector_lengths_are_refused() {
    for arms in [0, 3] {
        let folder = Folder::new(&format!("arms-{arms}"));
        let spec = DatasetSpec { arms, ..spec() };
        let message = DatasetWriter::create(&folder.0, &spec)
            .unwrap_err()
            .to_string();
        assert_eq!(
            message,
            format!("the number of arms is {arms}, expected 1 to 2")
        );
    }
    let folder = Folder::new("arms-disagree");
    let spec = DatasetSpec { arms: 2, ..spec() };
    drop(DatasetWriter::create(&folder.0, &spec).unwrap());
    let path = meta::info_path(&folder.0);
    let whole = fs::read_to_string(&path).unwrap();
    for (from, to, expected) in [
        (
            "        16\n",
            "        8\n",
            "the shape of action is [8], expected 16",
        ),
        (
            "        14\n",
            "        15\n",
            "the shape of observation.state is [15], expected 7 or 14",
        ),
    ] {
        assert!(whole.contains(from), "{whole}");
        fs::write(&path, whole.replacen(from, to, 1)).unwrap();
        let message = error_of(&folder.0);
        assert!(message.ends_with(expected), "{message}");
    }
}
