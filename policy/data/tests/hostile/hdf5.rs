//! Demonstrations in HDF5: those that h5py wrote in the old form, which has no checksums, and
//! packed ones of the new form.

use std::fs;
use std::path::{Path, PathBuf};

use hal::psm;
use hdf5_pure::{DatasetBuilder, FileBuilder};
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use trocar_data::dataset::Dataset;
use trocar_data::import::{ImportError, ImportOptions, Layout, import};

use crate::common::{Folder, seeds, told, within_memory};
use crate::damage::damaged;

fn by_h5py(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/hdf5");
    fs::read(folder.join(name)).unwrap()
}

fn options(layout: Layout, source: PathBuf, out: PathBuf) -> ImportOptions {
    let robomimic = layout == Layout::Robomimic;
    let named = |name: &str| robomimic.then(|| name.to_owned());
    ImportOptions {
        layout,
        source,
        out,
        fps: 25,
        task: "Lift the needle".to_owned(),
        joints: named("obs/joint_pos"),
        action_joints: named("actions"),
        action_pose: None,
        images: named("obs/scope_image").into_iter().collect(),
        chain: psm::DH,
        video: None,
        size: None,
    }
}

/// Imports; what comes in is whole and finite, or the refusal names the file and leaves no half
/// episode.
fn judge(options: &ImportOptions, case: &str) -> bool {
    let _ = fs::remove_dir_all(&options.out);
    let result = import(options, &mut |_, _| {});
    if options.out.exists() {
        let dataset = Dataset::open(&options.out).expect(case);
        for frame in 0..dataset.len() {
            dataset.image_rgb(frame, 0).expect(case);
            for arm in 0..dataset.arms() {
                let finite = dataset.state(frame, arm).iter().all(|it| it.is_finite())
                    && dataset.tip_pose(frame, arm).iter().all(|it| it.is_finite());
                assert!(finite, "{case}: frame {frame}");
            }
        }
    }
    let Err(error) = result else {
        return false;
    };
    let text = told(&error);
    let place = options.source.display().to_string();
    let named = text.contains(&place) || matches!(error, ImportError::Dataset(_));
    assert!(named, "{case}: no file is named: {text}");
    assert!(text.len() < 2000, "{case}: {} bytes of reason", text.len());
    true
}

/// Imports `whole` with damage, as the file `file`.
fn damage(whole: &[u8], file: &Path, options: &ImportOptions, share: u64) {
    fs::write(file, whole).unwrap();
    assert!(!judge(options, "it is whole"));
    within_memory(|| {
        let mut refused = 0_u32;
        for seed in seeds(share) {
            // Each kind of damage alone, and up to three times one after another.
            let mut bytes = damaged(whole, seed);
            for again in 0..seed % 3 {
                if !bytes.is_empty() {
                    bytes = damaged(&bytes, seed ^ ((again + 1) << 32));
                }
            }
            fs::write(file, bytes).unwrap();
            refused += u32::from(judge(options, &format!("seed {seed}")));
        }
        assert!(refused > 0, "nothing was refused: is anything damaged?");
    });
}

#[test]
fn a_damaged_episode_of_act_is_imported_or_refused_by_name() {
    let folder = Folder::new("hdf5-act");
    let file = folder.path().join("episode_0.hdf5");
    let source = folder.path().to_owned();
    let options = options(Layout::Act, source, folder.path().join("out"));
    damage(&by_h5py("act/episode_0.hdf5"), &file, &options, 2);
}

/// An extent that the file can not hold is refused before memory is asked for.
#[test]
fn oversized_extent_is_refused_before_allocation() {
    let folder = Folder::new("hdf5-extent");
    let file = folder.path().join("episode_0.hdf5");
    let source = folder.path().to_owned();
    let options = options(Layout::Act, source, folder.path().join("out"));
    let whole = by_h5py("act/episode_0.hdf5");
    let extents = |extents: &[u64]| -> Vec<u8> {
        extents.iter().flat_map(|side| side.to_le_bytes()).collect()
    };
    within_memory(|| {
        for (from, to) in [
            ([4, 7].as_slice(), [1 << 40, 7].as_slice()),
            (&[4, 7], &[u64::MAX, 7]),
            (&[4, 7], &[1 << 20, 14]),
            (&[4, 6, 8, 3], &[4, 1 << 12, 1 << 12, 3]),
            (&[4, 6, 8, 3], &[4, 1 << 62, 1 << 62, 3]),
        ] {
            let (from, to) = (extents(from), extents(to));
            let mut bytes = whole.clone();
            let places = whole.windows(from.len()).enumerate();
            let places: Vec<usize> = places
                .filter(|(_, window)| *window == from)
                .map(|(at, _)| at)
                .collect();
            assert!(!places.is_empty());
            for at in places {
                bytes[at..at + to.len()].copy_from_slice(&to);
            }
            fs::write(&file, bytes).unwrap();
            let error = import(&options, &mut |_, _| {}).unwrap_err();
            let text = told(&error);
            let reason = "expected what a file of 6440 bytes can hold";
            assert!(text.contains(reason), "{text}");
        }
    });
}

#[test]
fn a_damaged_file_of_robomimic_is_imported_or_refused_by_name() {
    let folder = Folder::new("hdf5-robomimic");
    let file = folder.path().join("demos.hdf5");
    let options = options(Layout::Robomimic, file.clone(), folder.path().join("out"));
    damage(&by_h5py("robomimic.hdf5"), &file, &options, 2);
}

/// An episode in ACT's layout, of the form that HDF5 has since 1.10, packed in every way, with
/// JPEG.
fn packed() -> Vec<u8> {
    let jpeg = |step: u8| {
        let rgb: Vec<u8> = (0..192).map(|at: u8| at.wrapping_mul(step + 3)).collect();
        let mut jpeg = Vec::new();
        let encoder = JpegEncoder::new_with_quality(&mut jpeg, 60);
        let mut encoder = encoder;
        encoder.encode(&rgb, 8, 8, ExtendedColorType::Rgb8).unwrap();
        jpeg
    };
    let rows: Vec<Vec<u8>> = (0..4).map(jpeg).collect();
    let longest = rows.iter().map(Vec::len).max().unwrap();
    let padded = |row: &Vec<u8>| [row.clone(), vec![0; longest - row.len()]].concat();
    let rows: Vec<u8> = rows.iter().flat_map(padded).collect();
    let joints = [0.1; 28];
    let table = |dataset: &mut DatasetBuilder| {
        let dataset = dataset.with_f64_data(&joints).with_shape(&[4, 7]);
        dataset.with_chunks(&[3, 7]).with_shuffle().with_deflate(4);
    };
    let mut file = FileBuilder::new();
    let mut observations = file.create_group("observations");
    table(observations.create_dataset("qpos"));
    let mut images = observations.create_group("images");
    let camera = images.create_dataset("top").with_u8_data(&rows);
    let camera = camera.with_shape(&[4, longest as u64]);
    camera.with_chunks(&[1, longest as u64]).with_lzf();
    observations.add_group(images.finish());
    file.add_group(observations.finish());
    table(file.create_dataset("action"));
    file.finish().unwrap()
}

#[test]
fn a_damaged_packed_episode_is_imported_or_refused_by_name() {
    let folder = Folder::new("hdf5-packed");
    let file = folder.path().join("episode_0.hdf5");
    let source = folder.path().to_owned();
    let options = options(Layout::Act, source, folder.path().join("out"));
    damage(&packed(), &file, &options, 2);
}
