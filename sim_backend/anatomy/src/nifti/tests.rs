//! What is written is read again, and what is damaged is refused by name.

use std::path::PathBuf;

use hal::random::SplitMix64;
use nalgebra::{Matrix3, Rotation3, Vector3};

use super::{DataType, NiftiError, Writer, read_header, read_labels, read_slices};
use crate::grid::Grid;
use crate::groups::Groups;

/// A folder of the test's own.
fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("trocar-anatomy-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder can be made");
    folder
}

fn oblique() -> Grid {
    let turn = Rotation3::from_euler_angles(0.2, -0.3, 0.5);
    Grid {
        dims: [5, 4, 3],
        steps: turn.matrix() * Matrix3::from_diagonal(&Vector3::new(-0.7, 0.8, 2.5)),
        origin: Vector3::new(-120.5, 33.25, 900.0),
    }
}

fn write(path: &std::path::Path, grid: &Grid, labels: &[u8]) {
    let mut writer = Writer::create(path, grid, DataType::U8).expect("the file can be made");
    for slice in labels.chunks(grid.slice_len()) {
        writer.slice(slice).expect("a slice can be written");
    }
    writer.finish().expect("the file can be ended");
}

fn small() -> Vec<u8> {
    (0..60).map(|i| [0, 1, 3, 62][i % 4]).collect()
}

#[test]
fn what_was_written_is_read_with_its_place() {
    let folder = folder("round-trip");
    let groups = Groups::load("vista3d").expect("the table is right");
    for name in ["a.nii", "a.nii.gz"] {
        let path = folder.join(name);
        write(&path, &oblique(), &small());
        let volume = read_labels(&path, &groups).expect("the volume is right");
        assert_eq!(volume.grid.dims, [5, 4, 3]);
        assert!((volume.grid.steps - oblique().steps).norm() < 1e-5);
        assert!((volume.grid.origin - oblique().origin).norm() < 1e-4);
        let expected: Vec<u8> = small()
            .iter()
            .map(|label| groups.group_of(u16::from(*label)).expect("known"))
            .collect();
        assert_eq!(volume.voxels, expected);
    }
    std::fs::remove_dir_all(folder).expect("the folder can go");
}

#[test]
fn qform_alone_gives_the_same_place() {
    let folder = folder("qform");
    let path = folder.join("a.nii");
    write(&path, &oblique(), &small());
    let mut bytes = std::fs::read(&path).expect("readable");
    bytes[254] = 0;
    std::fs::write(&path, bytes).expect("writable");
    let grid = read_header(&path).expect("the qform suffices").grid;
    assert!(
        (grid.steps - oblique().steps).norm() < 1e-5,
        "{}",
        grid.steps
    );
    std::fs::remove_dir_all(folder).expect("the folder can go");
}

/// The bytes of a volume with `values` as `data_type`, of either byte order.
fn bytes_of(data_type: DataType, big_endian: bool, values: &[i32]) -> Vec<u8> {
    let mut bytes = super::Header::bytes(&oblique(), data_type).to_vec();
    if big_endian {
        for at in [0]
            .into_iter()
            .chain((76..=104).step_by(4))
            .chain([108, 112, 116])
            .chain((256..328).step_by(4))
        {
            bytes[at..at + 4].reverse();
        }
        for at in (40..56).step_by(2).chain([70, 72, 252, 254]) {
            bytes[at..at + 2].reverse();
        }
    }
    bytes.extend([0; 4]);
    for &value in values {
        macro_rules! as_type {
            ($kind:ty) => {{
                #[expect(clippy::allow_attributes, reason = "the casts differ by type")]
                #[allow(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    clippy::cast_precision_loss,
                    clippy::cast_lossless,
                    trivial_numeric_casts,
                    reason = "small numbers"
                )]
                let value = value as $kind;
                if big_endian {
                    bytes.extend(value.to_be_bytes());
                } else {
                    bytes.extend(value.to_le_bytes());
                }
            }};
        }
        match data_type {
            DataType::U8 => as_type!(u8),
            DataType::I8 => as_type!(i8),
            DataType::U16 => as_type!(u16),
            DataType::I16 => as_type!(i16),
            DataType::U32 => as_type!(u32),
            DataType::I32 => as_type!(i32),
            DataType::F32 => as_type!(f32),
            DataType::F64 => as_type!(f64),
        }
    }
    bytes
}

#[test]
fn all_types_in_both_byte_orders_hold_the_same_labels() {
    let folder = folder("types");
    let path = folder.join("a.nii");
    let values: Vec<i32> = small().into_iter().map(i32::from).collect();
    for data_type in [
        DataType::U8,
        DataType::I8,
        DataType::U16,
        DataType::I16,
        DataType::U32,
        DataType::I32,
        DataType::F32,
        DataType::F64,
    ] {
        for big_endian in [false, true] {
            std::fs::write(&path, bytes_of(data_type, big_endian, &values)).expect("writable");
            let mut read = Vec::new();
            let header = read_slices(&path, |_, _, slice| {
                read.extend_from_slice(slice);
                Ok(())
            });
            let grid = header.expect("the volume is right").grid;
            assert!((grid.steps - oblique().steps).norm() < 1e-5);
            let expected: Vec<f64> = values.iter().copied().map(f64::from).collect();
            assert_eq!(read, expected, "{data_type:?} {big_endian}");
        }
    }
    std::fs::remove_dir_all(folder).expect("the folder can go");
}

/// The error for a volume whose `bytes` at `at` are changed.
fn refused(at: usize, change: &[u8]) -> String {
    let folder = folder(&format!("refused-{at}"));
    let path = folder.join("a.nii");
    let values: Vec<i32> = small().into_iter().map(i32::from).collect();
    let mut bytes = bytes_of(DataType::F32, false, &values);
    bytes[at..at + change.len()].copy_from_slice(change);
    std::fs::write(&path, bytes).expect("writable");
    let groups = Groups::load("vista3d").expect("the table is right");
    let error = read_labels(&path, &groups).expect_err("refused");
    std::fs::remove_dir_all(folder).expect("the folder can go");
    error.to_string()
}

#[test]
fn damaged_headers_and_voxels_are_named() {
    for (at, change, message) in [
        (0, &540_i32.to_le_bytes()[..], "sizeof_hdr is 540"),
        (344, b"ni1\0", "magic is ni1"),
        (40, &[9, 0], "dim[0] is 9"),
        (42, &(-5_i16).to_le_bytes(), "dim[1..3] is -5"),
        (48, &[2, 0], "dim[4..] is 2"),
        (70, &[128, 0], "datatype is 128"),
        (72, &[8, 0], "bitpix is 8"),
        (108, &1e9_f32.to_le_bytes(), "vox_offset"),
        (123, &[7], "xyzt_units is 7"),
        (280, &f32::NAN.to_le_bytes(), "voxel size"),
        (116, &f32::INFINITY.to_le_bytes(), "scl_slope"),
        (352 + 8, &0.5_f32.to_le_bytes(), "voxel (2, 0, 0) is 0.5"),
        (
            352 + 4 * 21,
            &(-3.0_f32).to_le_bytes(),
            "voxel (1, 0, 1) is -3",
        ),
        (352, &999.0_f32.to_le_bytes(), "no label 999 (1 voxels)"),
    ] {
        let error = if at == 48 {
            refused_in_4d()
        } else {
            refused(at, change)
        };
        assert!(error.contains(message), "{message}: {error}");
    }
}

/// The error for a volume with two instants.
fn refused_in_4d() -> String {
    let mut change = Vec::new();
    for side in [4_i16, 5, 4, 3, 2] {
        change.extend(side.to_le_bytes());
    }
    refused(40, &change)
}

#[test]
fn a_header_cannot_make_the_reader_allocate() {
    let mut change = Vec::new();
    for side in [3_i16, 4096, 4096, 4096] {
        change.extend(side.to_le_bytes());
    }
    assert!(refused(40, &change).contains("at most 2^30 voxels"));
    // As many voxels as are allowed, in a file of 592 bytes.
    let mut change = Vec::new();
    for side in [3_i16, 1024, 1024, 1024] {
        change.extend(side.to_le_bytes());
    }
    assert!(refused(40, &change).contains("ends within slice 1 of 1024"));
}

#[test]
fn cut_and_garbled_files_are_refused_wherever_that_is() {
    let folder = folder("cut");
    let groups = Groups::load("vista3d").expect("the table is right");
    for name in ["a.nii", "a.nii.gz"] {
        let path = folder.join(name);
        write(&path, &oblique(), &small());
        let whole = std::fs::read(&path).expect("readable");
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).expect("writable");
            let result = read_labels(&path, &groups);
            assert!(result.is_err(), "{name} cut to {length}");
        }
        let mut random = SplitMix64::new(5);
        for _ in 0..2000 {
            let mut bytes = whole.clone();
            for _ in 0..1 + random.below(4) {
                let at = random.below(bytes.len());
                bytes[at] = u8::try_from(random.below(256)).expect("a byte");
            }
            std::fs::write(&path, bytes).expect("writable");
            // Whatever it says, it says it without a panic.
            let _result: Result<_, NiftiError> = read_labels(&path, &groups);
        }
    }
    std::fs::remove_dir_all(folder).expect("the folder can go");
}
