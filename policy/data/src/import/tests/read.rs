//! What comes in is what was there.

use std::fs;

use hal::psm;
use hdf5_pure::DatasetBuilder;
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;

use super::demo::{Episode, Folder, act, by_h5py, image, joint, robomimic};
use crate::dataset::Dataset;
use crate::import::chain::tip_in_rcm;
use crate::import::{ImportOptions, ImportSummary, import, read_chain};

#[expect(clippy::cast_possible_truncation, reason = "as a dataset stores it")]
fn narrow(value: f64) -> f32 {
    value as f32
}

/// Every number and pixel of `dataset`, whose episodes have `lengths`.
fn check(dataset: &Dataset, lengths: &[usize], arms: usize) {
    assert_eq!(dataset.spec().arms, arms);
    let found: Vec<usize> = dataset.episodes().iter().map(|one| one.len).collect();
    assert_eq!(found, lengths);
    for episode in dataset.episodes() {
        for (step, frame) in episode.frames().enumerate() {
            for arm in 0..arms {
                let measured: Vec<f64> = (0..7).map(|place| joint(step, 7 * arm + place)).collect();
                let wanted: Vec<f64> = (0..7)
                    .map(|place| joint(step + 1, 7 * arm + place))
                    .collect();
                let state: Vec<f32> = measured.iter().map(|&value| narrow(value)).collect();
                assert_eq!(dataset.state(frame, arm).to_vec(), state);
                // The file may have the joints in single precision.
                let tip = tip_in_rcm(&psm::DH, &measured);
                same_pose(&dataset.tip_pose(frame, arm), &tip, 3e-8);
                let action = dataset.action(frame, arm);
                same_pose(&action, &tip_in_rcm(&psm::DH, &wanted), 2e-7);
                assert!((action[7] - wanted[6]).abs() < 1e-7);
            }
            let rgb = dataset.image_rgb(frame, 0).unwrap();
            assert_eq!(rgb.into_raw(), image(step), "frame {frame}");
        }
    }
}

fn same_pose(found: &[f64], expected: &hal::Pose, tolerance: f64) {
    let at = expected.translation.vector;
    let turn = expected.rotation.coords;
    for (found, expected) in found[..3].iter().zip(at.iter()) {
        assert!((found - expected).abs() < tolerance, "{found} {expected}");
    }
    let inner: f64 = found[3..7]
        .iter()
        .zip(turn.iter())
        .map(|(a, b)| a * b)
        .sum();
    assert!((inner.abs() - 1.0).abs() < 4.0 * tolerance, "{inner}");
}

#[test]
fn both_layouts_of_h5py_come_in_number_for_number() {
    let folder = Folder::new("h5py");
    let out = folder.0.join("act");
    let mut told = Vec::new();
    let summary = import(&act(&by_h5py("act"), &out), &mut |done, all| {
        told.push((done, all));
    });
    let expected = ImportSummary {
        arms: 1,
        cameras: vec!["top".to_owned()],
        episodes: 1,
        frames: 4,
    };
    assert_eq!((summary.unwrap(), told), (expected, vec![(1, 1)]));
    let dataset = Dataset::open(&out).unwrap();
    check(&dataset, &[4], 1);
    assert_eq!(dataset.spec().robot_type, "dvrk_psm");
    assert_eq!(
        (dataset.spec().fps, dataset.spec().task.as_str()),
        (25, "Lift the needle")
    );

    let out = folder.0.join("robomimic");
    let options = robomimic(&by_h5py("robomimic.hdf5"), &out);
    let summary = import(&options, &mut |_, _| {}).unwrap();
    assert_eq!(
        (summary.arms, summary.cameras),
        (2, vec!["scope".to_owned()])
    );
    let dataset = Dataset::open(&out).unwrap();
    check(&dataset, &[3, 4], 2);
    assert_eq!(dataset.spec().robot_type, "bi_dvrk_psm");
}

type Stored = fn(&mut DatasetBuilder, &[u64]);

/// Three steps a chunk, so that the last one is not whole.
fn chunked<'a>(dataset: &'a mut DatasetBuilder, shape: &[u64]) -> &'a mut DatasetBuilder {
    let sides: Vec<u64> = [3].into_iter().chain(shape[1..].iter().copied()).collect();
    dataset.with_chunks(&sides)
}

#[test]
fn every_kind_of_storage_comes_in_alike() {
    let kinds: [Stored; 5] = [
        |_, _| {},
        |dataset, shape| {
            chunked(dataset, shape);
        },
        |dataset, shape| {
            chunked(dataset, shape).with_deflate(6);
        },
        |dataset, shape| {
            let dataset = chunked(dataset, shape);
            dataset.with_shuffle().with_deflate(4).with_fletcher32();
        },
        |dataset, shape| {
            chunked(dataset, shape).with_shuffle().with_lzf();
        },
    ];
    for arms in [1, 2] {
        let folder = Folder::new(&format!("storage-{arms}"));
        for (index, kind) in kinds.into_iter().enumerate() {
            // The numbers of the files are not in alphabetical order.
            let path = folder.0.join(format!("episode_{}.hdf5", index + 8));
            let episode = Episode {
                stored: kind,
                ..Episode::new(index + 4, arms)
            };
            episode.write(&path);
        }
        let out = folder.0.join("out");
        import(&act(&folder.0, &out), &mut |_, _| {}).unwrap();
        check(&Dataset::open(&out).unwrap(), &[4, 5, 6, 7, 8], arms);
    }
}

#[test]
fn jpeg_in_padded_rows_comes_in_with_red_and_blue_put_right() {
    let folder = Folder::new("jpeg");
    let encoded: Vec<Vec<u8>> = (0..4)
        .map(|step| {
            let mut jpeg = Vec::new();
            // As by an encoder that takes blue first.
            let mut blue_first = image(step);
            for pixel in blue_first.chunks_exact_mut(3) {
                pixel.reverse();
            }
            JpegEncoder::new_with_quality(&mut jpeg, 90)
                .encode(&blue_first, 8, 6, ExtendedColorType::Rgb8)
                .unwrap();
            jpeg
        })
        .collect();
    let longest = encoded.iter().map(Vec::len).max().unwrap() + 3;
    let mut rows = Vec::new();
    for jpeg in &encoded {
        rows.extend(jpeg);
        rows.extend(vec![0; longest - jpeg.len()]);
    }
    let mut episode = Episode::new(4, 1);
    episode.camera = (rows, vec![4, longest as u64]);
    episode.write(&folder.0.join("episode_0.hdf5"));
    let out = folder.0.join("out");
    import(&act(&folder.0, &out), &mut |_, _| {}).unwrap();
    let dataset = Dataset::open(&out).unwrap();
    for (step, jpeg) in encoded.iter().enumerate() {
        let mut expected = image::load_from_memory(jpeg).unwrap().into_rgb8();
        for pixel in expected.pixels_mut() {
            pixel.0.reverse();
        }
        let found = dataset.image_rgb(step, 0).unwrap();
        assert_eq!(found, expected, "step {step}");
        let differences = found.as_raw().iter().zip(image(step));
        let mean = differences
            .map(|(&found, meant)| f64::from(found.abs_diff(meant)))
            .sum::<f64>()
            / 144.0;
        assert!(mean < 20.0, "step {step}: {mean}");
    }
}

#[test]
fn a_commanded_pose_comes_in_as_it_is() {
    let folder = Folder::new("pose");
    let pose = |step: usize| {
        let turn = [0.5, -0.5, 0.5, -0.5];
        [
            [joint(step, 0), joint(step, 1), -0.1].as_slice(),
            &turn,
            &[0.3],
        ]
        .concat()
    };
    let mut episode = Episode::new(3, 1);
    episode.action = ((0..3).flat_map(pose).collect(), vec![3, 8]);
    episode.write(&folder.0.join("episode_0.hdf5"));
    let mut options = act(&folder.0, &folder.0.join("out"));
    options.action_pose = Some("action".to_owned());
    import(&options, &mut |_, _| {}).unwrap();
    let dataset = Dataset::open(&options.out).unwrap();
    for step in 0..3 {
        let expected: Vec<f64> = pose(step)
            .iter()
            .map(|&value| f64::from(narrow(value)))
            .collect();
        assert_eq!(dataset.action(step, 0).to_vec(), expected);
    }
}

#[test]
fn another_arm_has_another_chain() {
    let folder = Folder::new("chain");
    let file = folder.0.join("arm.json");
    // The same arm on a longer tool: the fourth row's offset along the axis.
    let rows: Vec<String> = psm::DH
        .iter()
        .enumerate()
        .map(|(index, row)| {
            let longer = if index == 3 { 0.01 } else { 0.0 };
            let (along, slides) = (row.d + longer, row.prismatic);
            format!(
                "[{}, {}, {along}, {}, {slides}]",
                row.alpha, row.a, row.theta
            )
        })
        .collect();
    fs::write(&file, format!("[{}]", rows.join(", "))).unwrap();
    let chain = read_chain(&file).unwrap();
    let joints = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0];
    // Straight down: the insertion, less the way to the remote centre, plus the wrist's link.
    let down = 0.1 - psm::RCC_M + psm::TOOL_M + psm::WRIST_M;
    for (chain, down) in [(psm::DH, down), (chain, down + 0.01)] {
        let tip = tip_in_rcm(&chain, &joints).translation.vector;
        assert!(
            (tip.z + down).abs() < 1e-12 && tip.xy().norm() < 1e-12,
            "{tip}"
        );
    }
    for (text, expected) in [
        ("[[0, 0, 0, 0, true]]", "arm.json: has 1 rows, expected 6"),
        ("{}", "expected six rows"),
        (&"[0, 0, 1e9, 0, true],".repeat(6), "expected six rows"),
    ] {
        fs::write(&file, text).unwrap();
        let message = read_chain(&file).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    let far = "[0, 0, 1e9, 0, true]";
    fs::write(&file, format!("[{}]", [far; 6].join(","))).unwrap();
    let message = read_chain(&file).unwrap_err().to_string();
    assert!(
        message.contains("row 1: 1000000000 is outside"),
        "{message}"
    );
}

#[test]
fn frames_are_brought_to_the_size_that_is_asked_for() {
    let folder = Folder::new("resized");
    let mut episode = Episode::new(3, 1);
    // Of one colour above and another below, so that half the size is of the same two.
    let row = |level: u8| vec![level; 8 * 3 * 3];
    let picture = [row(40), row(200)].concat();
    episode.camera = (picture.repeat(3), vec![3, 6, 8, 3]);
    episode.write(&folder.0.join("episode_0.hdf5"));
    let out = folder.0.join("out");
    let options = ImportOptions {
        size: Some((4, 2)),
        ..act(&folder.0, &out)
    };
    import(&options, &mut |_, _| {}).unwrap();
    let dataset = Dataset::open(&out).unwrap();
    let found = dataset.image_rgb(2, 0).unwrap();
    assert_eq!(found.dimensions(), (4, 2));
    let (above, below) = found.as_raw().split_at(12);
    assert!(
        above.iter().all(|level| (40..=60).contains(level)),
        "{above:?}"
    );
    assert!(
        below.iter().all(|level| (180..=200).contains(level)),
        "{below:?}"
    );
}
