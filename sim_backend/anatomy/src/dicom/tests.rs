//! Series come out as the volume that was put in, and what is no whole series is refused.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::tags;
use dicom_object::{FileMetaTableBuilder, InMemDicomObject, Tag};
use hal::random::SplitMix64;
use nalgebra::{Matrix3, Vector3};

use super::attributes::{Attributes, READ};
use super::elements::{self, Wanted};
use super::read_series;
use crate::ct::Ct;
use crate::grid::Grid;
use crate::nifti::{DataType, Writer};
use crate::number::rounded_i16;

const PLAIN: &str = "1.2.840.10008.1.2.1";

fn scratch(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("trocar-dicom-{}-{name}", std::process::id()));
    let _absent = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("made");
    folder
}

fn decimals(values: &[f64]) -> String {
    let texts: Vec<String> = values.iter().map(|value| format!("{value:.6}")).collect();
    texts.join("\\")
}

/// An oblique lattice whose slices are stored from above to below; RAS.
fn grid() -> Grid {
    let turn = nalgebra::Rotation3::from_euler_angles(0.2, -0.1, 0.3).into_inner();
    // Rows to the left, columns to posterior, as scanners have them, slices upwards.
    let steps = Matrix3::from_diagonal(&Vector3::new(-0.8, -0.7, 2.5));
    Grid {
        dims: [5, 4, 6],
        steps: turn * steps,
        origin: Vector3::new(31.5, -12.25, 140.0),
    }
}

fn value(x: usize, y: usize, z: usize) -> i16 {
    i16::try_from(100 * z + 10 * y + x).expect("small") - 300
}

/// The attributes of slice `z`: stored numbers are half of the value's distance from -1000.
fn slice(grid: &Grid, z: usize) -> InMemDicomObject {
    let lps = |v: Vector3<f64>| [-v.x, -v.y, v.z];
    let direction = |axis: usize| lps(grid.steps.column(axis).normalize());
    let spacing = grid.spacing();
    #[expect(clippy::cast_precision_loss, reason = "a few slices")]
    let place = grid.origin + grid.steps.column(2) * z as f64;
    let mut object = InMemDicomObject::new_empty();
    let mut text = |tag: Tag, vr, text: &str| {
        object.put_str(tag, vr, text);
    };
    text(tags::SOP_CLASS_UID, VR::UI, "1.2.840.10008.5.1.4.1.1.2");
    text(tags::SOP_INSTANCE_UID, VR::UI, &format!("1.2.3.{}", z + 1));
    text(tags::MODALITY, VR::CS, "CT");
    text(tags::SERIES_INSTANCE_UID, VR::UI, "1.2.3.4");
    text(tags::IMAGE_POSITION_PATIENT, VR::DS, &decimals(&lps(place)));
    text(
        tags::IMAGE_ORIENTATION_PATIENT,
        VR::DS,
        &decimals(&[direction(0), direction(1)].concat()),
    );
    text(
        tags::PIXEL_SPACING,
        VR::DS,
        &decimals(&[spacing[1], spacing[0]]),
    );
    text(tags::RESCALE_SLOPE, VR::DS, "2");
    text(tags::RESCALE_INTERCEPT, VR::DS, "-1000");
    let mut number = |tag: Tag, value: u16| {
        object.put(DataElement::new(tag, VR::US, PrimitiveValue::from(value)));
    };
    let side = |axis: usize| u16::try_from(grid.dims[axis]).expect("small");
    number(tags::SAMPLES_PER_PIXEL, 1);
    number(tags::ROWS, side(1));
    number(tags::COLUMNS, side(0));
    number(tags::BITS_ALLOCATED, 16);
    number(tags::BITS_STORED, 12);
    number(tags::HIGH_BIT, 11);
    number(tags::PIXEL_REPRESENTATION, 0);
    let pixels = (0..grid.slice_len()).map(|at| {
        let stored = (value(at % grid.dims[0], at / grid.dims[0], z) + 1000) / 2;
        // What is above the stored bits is nobody's.
        stored.cast_unsigned() | 0xa000
    });
    let pixels = PrimitiveValue::U16(pixels.collect());
    object.put(DataElement::new(tags::PIXEL_DATA, VR::OW, pixels));
    object
}

fn save(object: &InMemDicomObject, syntax: &str, path: &Path) {
    let meta = FileMetaTableBuilder::new().transfer_syntax(syntax);
    let file = object.clone().with_meta(meta).expect("complete");
    file.write_to_file(path).expect("written");
}

/// A series in `folder`, its names in no order, after `change` of each slice.
fn series(folder: &Path, change: impl Fn(usize, &mut InMemDicomObject)) {
    let grid = grid();
    for z in 0..grid.dims[2] {
        let mut object = slice(&grid, z);
        change(z, &mut object);
        save(
            &object,
            PLAIN,
            &folder.join(format!("{}.dcm", (z * 5 + 2) % 7)),
        );
    }
}

#[test]
fn a_series_is_the_volume_that_its_nifti_is() {
    let folder = scratch("series");
    series(&folder, |_, _| ());
    fs::write(folder.join("notes.txt"), "no DICOM").expect("written");
    let found = read_series(&folder).expect("a series");

    let grid = grid();
    let path = folder.join("ct.nii.gz");
    let mut writer = Writer::create(&path, &grid, DataType::I16).expect("begun");
    for z in 0..grid.dims[2] {
        let values = (0..grid.slice_len()).map(|at| value(at % grid.dims[0], at / grid.dims[0], z));
        // Odd values are not stored.
        let bytes: Vec<u8> = values
            .flat_map(|value| ((value + 1000) / 2 * 2 - 1000).to_le_bytes())
            .collect();
        writer.slice(&bytes).expect("written");
    }
    writer.finish().expect("ended");
    let wanted = Ct::read(&path).expect("a volume");
    assert_eq!(found.grid.dims, wanted.grid.dims);
    assert!((found.grid.steps - wanted.grid.steps).norm() < 1e-4);
    assert!((found.grid.origin - wanted.grid.origin).norm() < 1e-4);
    assert_eq!(found.hounsfield, wanted.hounsfield);
    assert_eq!(rounded_i16(f64::from(found.hounsfield[0])), -300);
    fs::remove_dir_all(folder).expect("gone");
}

/// The message about a series after `change`.
fn refusal(name: &str, change: impl Fn(usize, &mut InMemDicomObject)) -> String {
    let folder = scratch(name);
    series(&folder, change);
    let error = Ct::read(&folder).expect_err(name).to_string();
    fs::remove_dir_all(folder).expect("gone");
    error
}

/// What slice 3 is changed to, and what is then said of the series.
type Case = (&'static str, fn(&mut InMemDicomObject), &'static str);

fn refusals(cases: &[Case]) {
    for (name, change, reason) in cases {
        let message = refusal(name, |z, object| {
            if z == 3 {
                change(object);
            }
        });
        assert!(message.contains(reason), "{name}: {message}");
    }
}

#[test]
fn slices_that_do_not_fit_together_are_refused() {
    let mixed = "several series: 1.2.3.4 with 5 files, 1.2.9 with 1";
    refusals(&[
        (
            "mixed",
            |it| text(it, tags::SERIES_INSTANCE_UID, VR::UI, "1.2.9"),
            mixed,
        ),
        (
            "place",
            |it| {
                let place = decimals(&[-31.5, 12.25, 140.0]);
                text(it, tags::IMAGE_POSITION_PATIENT, VR::DS, &place);
            },
            "at the same place",
        ),
        (
            "line",
            |it| {
                let grid = grid();
                let aside = grid.steps.column(0).normalize() * 5.0;
                let place = grid.origin + grid.steps.column(2) * 3.0 + aside;
                let place = decimals(&[-place.x, -place.y, place.z]);
                text(it, tags::IMAGE_POSITION_PATIENT, VR::DS, &place);
            },
            "not in line",
        ),
        (
            "spacing",
            |it| text(it, tags::PIXEL_SPACING, VR::DS, "0.7\\0.9"),
            "differ in size, pixel spacing",
        ),
    ]);
}

#[test]
fn slices_that_are_not_a_ct_s_are_refused() {
    refusals(&[
        (
            "nan",
            |it| text(it, tags::PIXEL_SPACING, VR::DS, "NaN\\0.8"),
            "PixelSpacing is [NaN, 0.8]",
        ),
        (
            "two",
            |it| text(it, tags::PIXEL_SPACING, VR::DS, "0.8"),
            "PixelSpacing is [0.8], allowed are 2 numbers",
        ),
        (
            "modality",
            |it| text(it, tags::MODALITY, VR::CS, "MR"),
            "Modality is \"MR\"",
        ),
        (
            "frames",
            |it| text(it, tags::NUMBER_OF_FRAMES, VR::IS, "7"),
            "several slices in one file",
        ),
        (
            "skew",
            |it| {
                text(
                    it,
                    tags::IMAGE_ORIENTATION_PATIENT,
                    VR::DS,
                    "1\\0\\0\\1\\0\\0",
                )
            },
            "right angle",
        ),
        (
            "missing",
            |it| assert!(it.remove_element(tags::IMAGE_POSITION_PATIENT)),
            "ImagePositionPatient is missing",
        ),
        (
            "short",
            |it| put(it, tags::PIXEL_DATA, VR::OW, &[1, 2, 3]),
            "PixelData has 6 bytes, 5 x 4 pixels have 40",
        ),
        (
            "rows",
            |it| put(it, tags::ROWS, VR::US, &[0]),
            "Rows is 0, allowed is 1 to 4096",
        ),
    ]);
}

fn put(object: &mut InMemDicomObject, tag: Tag, vr: VR, numbers: &[u16]) {
    object.put(DataElement::new(
        tag,
        vr,
        PrimitiveValue::U16(numbers.into()),
    ));
}

fn text(object: &mut InMemDicomObject, tag: Tag, vr: VR, text: &str) {
    object.put_str(tag, vr, text);
}

#[test]
fn missing_slices_compression_and_cut_files_are_refused() {
    let folder = scratch("files");
    series(&folder, |_, _| ());
    let refusal = || Ct::read(&folder).expect_err("refused").to_string();
    let third = folder.join(format!("{}.dcm", (2 * 5 + 2) % 7));
    let whole = fs::read(&third).expect("there");
    fs::remove_file(&third).expect("gone");
    assert!(refusal().contains("5.000 mm apart and others 2.500 mm: slices are missing"));
    fs::write(&third, &whole[..whole.len() - 11]).expect("written");
    let cut = refusal();
    assert!(cut.contains(&third.display().to_string()), "{cut}");
    fs::write(&third, &whole[..300]).expect("written");
    assert!(refusal().contains(&third.display().to_string()));
    save(&slice(&grid(), 2), "1.2.840.10008.1.2.2", &third);
    let other = refusal();
    assert!(
        other.contains("transfer syntax is 1.2.840.10008.1.2.2"),
        "{other}"
    );
    fs::remove_dir_all(&folder).expect("gone");
    fs::create_dir_all(&folder).expect("made");
    assert!(refusal().contains("no DICOM file is in it"));
    fs::remove_dir_all(folder).expect("gone");
}

/// A slice's file, and where its data begin.
fn whole(syntax: &str) -> (Vec<u8>, usize) {
    let folder = scratch(&format!("whole-{}", syntax.len()));
    let path = folder.join("slice.dcm");
    save(&slice(&grid(), 2), syntax, &path);
    let bytes = fs::read(&path).expect("there");
    fs::remove_dir_all(folder).expect("gone");
    let length = u32::from_le_bytes(bytes[140..144].try_into().expect("four"));
    (bytes, 144 + length as usize)
}

/// What is said of a slice's file.
fn answer(bytes: &[u8]) -> Result<usize, String> {
    let size = bytes.len() as u64;
    let attributes = elements::of(Cursor::new(bytes), size, &Wanted::Attributes(&READ))?;
    let pixels = elements::of(Cursor::new(bytes), size, &Wanted::Pixels)?;
    let (path, object) = (Path::new("slice.dcm"), &attributes);
    let slice = Attributes { path, object }.slice();
    slice.map_err(|error| error.to_string())?;
    let pixels = pixels
        .element(tags::PIXEL_DATA)
        .map_err(|error| error.to_string())?;
    let pixels = pixels.to_bytes().map_err(|error| error.to_string())?;
    Ok(pixels.len())
}

#[test]
fn nested_and_overlong_elements_are_refused_before_they_cost_anything() {
    // A sequence and an item of unknown length, and an element of unknown type that claims 4 GB.
    let explicit: [&[u8]; 2] = [
        b"\x08\0\x40\x11SQ\0\0\xff\xff\xff\xff\xfe\xff\0\xe0\xff\xff\xff\xff",
        b"\x08\0\x01\0UN\0\0\xfe\xff\xff\xff",
    ];
    let implicit: [&[u8]; 2] = [
        b"\x08\0\x40\x11\xff\xff\xff\xff\xfe\xff\0\xe0\xff\xff\xff\xff",
        b"\x08\0\x01\0\xfe\xff\xff\xff",
    ];
    for (syntax, [sequence, long]) in [(PLAIN, explicit), ("1.2.840.10008.1.2", implicit)] {
        let (bytes, start) = whole(syntax);
        assert_eq!(answer(&bytes), Ok(40), "{syntax}");
        let with = |more: &[u8]| {
            let found = answer(&[&bytes[..start], more, &bytes[start..]].concat());
            found.expect_err("hostile")
        };
        let deep = with(&sequence.repeat(200_000));
        assert!(deep.contains("nested more than 64 deep"), "{deep}");
        let claimed = with(long);
        assert!(
            claimed.contains("(0008,0001) claims 4294967294 bytes"),
            "{claimed}"
        );
        // Within a sequence, and as what is wanted.
        let within = with(&[sequence, long].concat());
        assert!(within.contains("claims 4294967294 bytes"), "{within}");
        let mut modality = long.to_vec();
        modality[2] = 0x60;
        let modality = with(&modality);
        assert!(modality.contains("(0008,0060) claims"), "{modality}");
        let open = with(sequence);
        assert!(open.contains("no intact DICOM file"), "{open}");
        // An item ends where none has begun, and another begins.
        let stray = with(b"\xfe\xff\x0d\xe0\0\0\0\0\xfe\xff\0\xe0\0\0\0\0");
        assert!(stray.contains("that has not begun"), "{stray}");
    }
    let (bytes, start) = whole(PLAIN);
    let changed = |at: usize, new: &[u8]| {
        let mut bytes = bytes.clone();
        bytes[at..at + new.len()].copy_from_slice(new);
        answer(&bytes).expect_err("hostile")
    };
    let meta = changed(140, &[0xff; 4]);
    assert!(meta.contains("meta information has no length"), "{meta}");
    assert!(changed(140, &[0; 4]).contains("no transfer syntax"));
    let syntax = bytes.windows(6).position(|part| part == b"\x02\0\x10\0UI");
    let syntax = changed(syntax.expect("there") + 6, &[0xff; 2]);
    assert!(
        syntax.contains("(0002,0010) claims 65535 bytes"),
        "{syntax}"
    );
    let much = [&b"\x08\0\x60\0UT\0\0\0\0\x01\0"[..], &vec![b' '; 65536]].concat();
    let much = [&bytes[..start], &much, &bytes[start..]].concat();
    let much = answer(&much).expect_err("long");
    assert!(
        much.contains("(0008,0060) has 65536 bytes, allowed are 4096"),
        "{much}"
    );
}

#[test]
fn whatever_byte_of_a_slice_is_another_one_gets_an_answer() {
    let mut random = SplitMix64::new(19);
    let (mut read, mut refused) = (0, 0);
    for syntax in [PLAIN, "1.2.840.10008.1.2"] {
        let (bytes, _) = whole(syntax);
        for end in 0..bytes.len() {
            assert!(answer(&bytes[..end]).is_err(), "{end} bytes");
        }
        for _ in 0..4000 {
            let mut bytes = bytes.clone();
            for _ in 0..1 + random.below(4) {
                let at = 132 + random.below(bytes.len() - 132);
                bytes[at] = [0, 1, 0x7f, 0xff, 0xfe, 0xe0][random.below(6)];
            }
            match answer(&bytes) {
                Ok(pixels) => {
                    read += 1;
                    assert!(pixels < 2 * bytes.len(), "{pixels}");
                }
                Err(_) => refused += 1,
            }
        }
    }
    assert!(
        read > 500 && refused > 2000,
        "{read} read, {refused} refused"
    );
}
