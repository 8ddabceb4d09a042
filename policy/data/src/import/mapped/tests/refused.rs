//! What is refused, and with which words.

use super::made::{Folder, Made};
use super::*;

/// Importing what `spoil` made of a good dataset must fail with every part of `expected`, and leave
/// nothing.
fn spoilt(
    name: &str,
    spoil: impl Fn(&mut Made),
    change: impl Fn(&mut ImportRequest),
    expected: &[&str],
) {
    let folder = Folder::new(name);
    let mut made = Made::new(4);
    spoil(&mut made);
    made.write(&folder.0.join("theirs"));
    let mut request = folder.request("open-h-dvrk", "theirs");
    request.mapping.cameras.clear();
    change(&mut request);
    let error = import_mapped(&request, &mut |_, _| {}).expect_err(expected[0]);
    let told = error.to_string();
    for part in expected {
        assert!(told.contains(part), "no {part:?} in: {told}");
    }
    assert!(!request.out.exists(), "{told}");
}

#[test]
fn what_is_missing_names_file_feature_and_key() {
    spoilt(
        "column",
        |made| made.names[0][7] = "gripper".to_owned(),
        |_| {},
        &[
            "episode_000000.parquet, episode 0: psm1_jaw of feature observation.state",
            "jaw of the mapping",
        ],
    );
    spoilt(
        "feature",
        |made| drop(made.columns.pop()),
        |_| {},
        &["info.json: feature action is missing"],
    );
    spoilt(
        "camera",
        |_| {},
        |request| {
            request.mapping = Mapping::read("open-h-dvrk").unwrap();
            request.mapping.cameras[0].optional = false;
        },
        &["info.json: feature observation.images.endoscope.left is missing"],
    );
    spoilt(
        "cameras",
        |_| {},
        |request| request.mapping = Mapping::read("open-h-dvrk").unwrap(),
        &[
            "info.json: each camera of the mapping",
            "observation.images.wrist.left",
        ],
    );
    spoilt(
        "arm",
        |_| {},
        |request| request.mapping.arms[1].optional = false,
        &["psm2_pose.position.x of feature observation.state"],
    );
}

#[test]
fn wrong_lengths_and_rates_are_refused() {
    spoilt(
        "rows",
        |made| made.episodes = vec![5],
        |_| {},
        &["episode_000000.parquet", "cut off by the end of the file"],
    );
    spoilt(
        "more",
        |made| made.episodes = vec![3],
        |_| {},
        &[
            "episode_000000.parquet",
            "episode 0 is 4 rows long, expected 3, its length in meta/episodes.jsonl",
        ],
    );
    spoilt(
        "width",
        |made| {
            for names in &mut made.names {
                names.clear();
            }
        },
        |request| {
            request.mapping.arms.truncate(1);
            request.mapping.arms[0].tip_position = Some(Columns {
                feature: "observation.state".to_owned(),
                names: Vec::new(),
                indices: Vec::new(),
            });
        },
        &[
            "observation.state, tip_position of the mapping",
            "has 8 numbers a step, expected 3",
        ],
    );
    spoilt(
        "rate",
        |made| made.timestamps = vec![0.0, 0.1, 0.2, 0.3],
        |_| {},
        &[
            "timestamp is 0.1000 s apart in the mean, expected 0.0400",
            "fps of meta/info.json",
        ],
    );
    spoilt(
        "fps",
        |_| {},
        |request| request.fps = Some(30),
        &["--fps: a LeRobot dataset says its own"],
    );
}

#[test]
fn numbers_that_can_not_be_meant_name_episode_and_step() {
    let at = |column: usize, place: usize, value: f64| {
        move |made: &mut Made| made.columns[column].2[2 * 8 + place] = value
    };
    spoilt(
        "nan",
        at(0, 1, f64::NAN),
        |_| {},
        &["episode 0: tip_position in observation.state has a number that is not finite in step 2"],
    );
    spoilt(
        "quaternion",
        at(1, 3, 3.0),
        |_| {},
        &[
            "action_orientation of arm 1 has a quaternion of length",
            "in step 2",
        ],
    );
    spoilt(
        "jaw",
        at(0, 7, 35.0),
        |_| {},
        &["jaw of arm 1: jaw = 35.0000 in step 2 is outside [-0.698, 1.396]"],
    );
    spoilt(
        "delta",
        |made| {
            for row in made.columns[1].2.chunks_exact_mut(8) {
                row[..3].fill(0.001);
            }
        },
        |_| {},
        &[
            "the action of arm 1 in step 0",
            "m from the measured tip",
            "no delta",
        ],
    );
}

/// The frame of an endoscope in place of the arm's, or a pose that the arm can't take.
#[test]
fn pose_out_of_reach_names_the_joint() {
    spoilt(
        "reach",
        |made| {
            for column in &mut made.columns {
                for row in column.2.chunks_exact_mut(8).skip(1) {
                    row[..3].iter_mut().for_each(|along| *along *= 3.0);
                }
            }
        },
        |_| {},
        &[
            "episode 0: the tip pose of arm 1 in step 1 is out of reach: insertion = 0.",
            "is outside [0.000, 0.240]",
        ],
    );
    spoilt(
        "behind",
        |made| {
            for column in &mut made.columns {
                for row in column.2.chunks_exact_mut(8) {
                    row[2] = -row[2];
                }
            }
        },
        |_| {},
        &["the tip pose of arm 1 in step 0 is out of reach"],
    );
    spoilt(
        "millimetres",
        |_| {},
        |request| request.mapping.length_unit = LengthUnit::Mm,
        &["the tip pose of arm 1 in step 0 is out of reach"],
    );
}
