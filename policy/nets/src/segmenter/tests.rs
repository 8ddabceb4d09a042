//! Segmenters against MONAI's numbers, against themselves in little memory, and files that are
//! refused.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use tch::{Device, Kind, Tensor};

use super::axis::Axis;
use super::{
    BACKGROUND, Image, SegmentError, Segmenter, SegmenterSettings, UNet, UNetConfig, Weighting,
    load_segmenter, save_segmenter,
};
use crate::parameters::ParameterSource;

/// Averaged scores may differ by so much from MONAI's.
const PARITY: f64 = 1e-5;

#[derive(Deserialize)]
struct Golden {
    classes: u16,
    window_hu: [f64; 2],
    stride: usize,
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    dims: [usize; 3],
    patch: [usize; 3],
    overlap: f64,
    weighting: Weighting,
    scores: Vec<f32>,
}

fn settings(patch: [usize; 3], classes: Vec<u16>) -> SegmenterSettings {
    SegmenterSettings {
        patch,
        spacing_mm: [2.0; 3],
        orientation: "RAS".to_owned(),
        window_hu: [-500.0, 600.0],
        range: [0.0, 1.0],
        overlap: 0.5,
        weighting: Weighting::Gaussian,
        table: "groups".to_owned(),
        classes,
    }
}

/// The volume of `tests/scripts/segmenter_golden.py`, x fastest.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "a small volume"
)]
fn volume([wide, high, deep]: [usize; 3]) -> Vec<f32> {
    let mut values = Vec::new();
    for z in 0..deep {
        for y in 0..high {
            for x in 0..wide {
                let [x, y, z] = [x, y, z].map(|at| at as f64);
                let wave = (0.37 * x + 0.11 * y).sin();
                let value = 500.0 * wave + 300.0 * (0.23 * z - 0.013 * x * y).cos();
                values.push(value as f32);
            }
        }
    }
    values
}

fn image(dims: [usize; 3], spacing_mm: f64, values: &[f32]) -> Image<'_> {
    Image {
        dims,
        spacing_mm: [spacing_mm; 3],
        values,
    }
}

fn golden_folder() -> PathBuf {
    let committed = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden");
    std::env::var_os("TROCAR_SEGMENTER").map_or(committed, PathBuf::from)
}

/// One window, several, and windows larger than the volume; all scores, or the classes that they
/// give in few strips and in many.
#[test]
fn a_torchscript_model_gives_what_it_gives_in_monai() {
    let folder = golden_folder();
    let text = fs::read_to_string(folder.join("segmenter.json")).unwrap();
    let golden: Golden = serde_json::from_str(&text).unwrap();
    for case in golden.cases {
        let settings = SegmenterSettings {
            window_hu: golden.window_hu,
            overlap: case.overlap,
            weighting: case.weighting,
            ..settings(case.patch, (0..golden.classes).collect())
        };
        let file = folder.join("segmenter.ts");
        let segmenter = Segmenter::script(&file, settings, Device::Cpu).unwrap();
        let values = volume(case.dims);
        let image = image(case.dims, 2.0, &values);
        let scores = segmenter.averages(&image).unwrap();
        // As MONAI has them: x, y, z.
        let flat = scores.permute([0, 3, 2, 1]).contiguous().view([-1]);
        let found = Vec::<f32>::try_from(&flat).unwrap();
        let found: Vec<f32> = found.into_iter().step_by(golden.stride).collect();
        assert_eq!(found.len(), case.scores.len());
        let apart = found
            .iter()
            .zip(&case.scores)
            .map(|(a, b)| f64::from((a - b).abs()));
        let worst = apart.fold(0.0, f64::max);
        assert!(worst < PARITY, "{:?}: {worst:e}", case.dims);

        let best = scores
            .argmax(0, false)
            .to_kind(Kind::Uint8)
            .contiguous()
            .view([-1]);
        let best = Vec::<u8>::try_from(&best).unwrap();
        let mut windows = Vec::new();
        for bytes in [u64::MAX, 400_000] {
            let (mut calls, mut promised) = (0, 0);
            let classes = segmenter.classify(&image, bytes, &mut |done, all| {
                calls += 1;
                promised = all;
                assert_eq!(done, calls);
            });
            assert_eq!(classes.unwrap(), best, "{bytes} bytes");
            assert_eq!(calls, promised);
            windows.push(calls);
        }
        assert!(windows[1] >= windows[0]);
    }
}

fn tiny(patch: usize, seed: u64) -> (UNet, SegmenterSettings) {
    let config = UNetConfig {
        widths: vec![8, 16],
        classes: 3,
        narrow: [0.4, 0.6],
    };
    let network = UNet::new(config, ParameterSource::seeded(seed, Device::Cpu)).unwrap();
    (network, settings([patch; 3], vec![0, 7, 300]))
}

/// At another spacing the result has the volume's voxels, in strips as in one piece; a plane stays
/// where it is.
#[test]
fn a_volume_of_another_spacing_comes_back_on_its_own_lattice() {
    let (network, settings) = tiny(8, 1);
    let segmenter = Segmenter::new(network, settings, Device::Cpu);
    let dims = [19, 23, 31];
    let values = volume(dims);
    let whole = segmenter.classify(&image(dims, 1.1, &values), u64::MAX, &mut |_, _| ());
    let strips = segmenter.classify(&image(dims, 1.1, &values), 120_000, &mut |_, _| ());
    assert_eq!(whole.unwrap(), strips.unwrap());
    let error = segmenter.classify(&image(dims, 1.1, &values), 2_000, &mut |_, _| ());
    assert!(matches!(
        error,
        Err(SegmentError::Memory { classes: 3, .. })
    ));

    // A model that answers with what it sees tells where half of it is.
    let folder = scratch("plane");
    let file = folder.join("identity.ts");
    let example = Tensor::zeros([1, 1, 8, 8, 8], (Kind::Float, Device::Cpu));
    let identity = tch::CModule::create_by_tracing("model", "forward", &[example], &mut |seen| {
        vec![&seen[0] - 0.5]
    });
    identity.unwrap().save(&file).unwrap();
    let settings = SegmenterSettings {
        spacing_mm: [3.0; 3],
        ..super::tests::settings([8; 3], vec![5])
    };
    let segmenter = Segmenter::script(&file, settings, Device::Cpu).unwrap();
    // Rises along y and crosses 50 HU, the middle of the window, between rows 12 and 13.
    let values: Vec<f32> = (0..20 * 30 * 10)
        .map(|at| [-400.0, 500.0][usize::from(at / 20 % 30 > 12)])
        .collect();
    let classes = segmenter.classify(&image([20, 30, 10], 1.0, &values), u64::MAX, &mut |_, _| ());
    for (at, class) in classes.unwrap().into_iter().enumerate() {
        let row = at / 20 % 30;
        // Resampled to 3 mm the step becomes a ramp from row 12 to row 15.
        let wanted = if row <= 13 { BACKGROUND } else { 0 };
        assert_eq!(class, wanted, "row {row}");
    }
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn windows_lie_as_monai_lays_them() {
    let axis = |voxels, patch, overlap| Axis::new(voxels, [1.0, 1.0], patch, overlap).starts;
    assert_eq!(axis(40, 16, 0.25), [0, 12, 24]);
    assert_eq!(axis(41, 16, 0.25), [0, 12, 24, 25]);
    assert_eq!(axis(16, 16, 0.5), [0]);
    assert_eq!(axis(10, 16, 0.5), [0]);
    let small = Axis::new(10, [1.0, 1.0], 16, 0.5);
    assert_eq!((small.before, small.padded), (3, 16));
    // 10 mm of voxels of 1 mm are 4 of 3 mm, whose last is at the last one's place.
    let coarse = Axis::new(10, [1.0, 3.0], 4, 0.5);
    assert_eq!(coarse.seen, 4);
    assert_eq!(coarse.sources(), [0.0, 3.0, 6.0, 9.0]);
    assert!((coarse.place(9) - 3.0).abs() < 1e-12 && (coarse.place(1) - 1.0 / 3.0).abs() < 1e-12);
}

fn scratch(name: &str) -> PathBuf {
    let folder =
        std::env::temp_dir().join(format!("trocar-segmenter-{}-{name}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    folder
}

#[test]
fn a_segmenter_comes_back_in_half_precision_with_its_settings() {
    let folder = scratch("file");
    let file = folder.join("a.safetensors");
    let (network, settings) = tiny(16, 4);
    save_segmenter(&file, &network, &settings).unwrap();
    let (again, its) = load_segmenter(&file, Device::Cpu).unwrap();
    assert_eq!(its, settings);
    let seen = Tensor::rand([1, 1, 16, 16, 16], (Kind::Float, Device::Cpu));
    let apart = (network.forward(&seen).unwrap() - again.forward(&seen).unwrap())
        .abs()
        .max();
    assert!(apart.double_value(&[]) < 0.02);
    save_segmenter(&folder.join("b.safetensors"), &again, &its).unwrap();
    assert_eq!(
        fs::read(&file).unwrap(),
        fs::read(folder.join("b.safetensors")).unwrap()
    );
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn damaged_and_misfitting_files_are_refused_with_the_reason() {
    let folder = scratch("refused");
    let file = folder.join("a.safetensors");
    let refusal = |network: &UNet, settings: &SegmenterSettings| {
        save_segmenter(&file, network, settings).unwrap();
        load_segmenter(&file, Device::Cpu).unwrap_err().to_string()
    };
    let (network, good) = tiny(16, 4);
    type Change = fn(&mut SegmenterSettings);
    let cases: [(Change, &str); 6] = [
        (|it| it.patch[1] = 18, "multiples of 4"),
        (|it| it.classes.push(9), "4 classes do not fit"),
        (|it| it.classes[2] = 7, "classes = [0, 7, 7]"),
        (|it| it.spacing_mm[0] = 0.0, "spacing_mm"),
        (|it| it.orientation = "RAA".to_owned(), "orientation = RAA"),
        (|it| it.overlap = 1.0, "overlap = 1 is outside [0, 0.9]"),
    ];
    for (change, reason) in cases {
        let mut settings = good.clone();
        change(&mut settings);
        let message = refusal(&network, &settings);
        assert!(message.contains(reason), "{message}, expected {reason}");
    }
    save_segmenter(&file, &network, &good).unwrap();
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() - 10]).unwrap();
    let cut = load_segmenter(&file, Device::Cpu).unwrap_err().to_string();
    assert!(cut.contains("no intact safetensors"), "{cut}");
    // A NaN in half precision, as the last weight.
    let mut planted = bytes;
    let end = planted.len();
    planted[end - 2..].copy_from_slice(&[0x00, 0x7e]);
    fs::write(&file, planted).unwrap();
    let nan = load_segmenter(&file, Device::Cpu).unwrap_err().to_string();
    assert!(nan.contains("not finite"), "{nan}");

    let script = folder.join("no.ts");
    fs::write(&script, "no model").unwrap();
    let none = Segmenter::script(&script, good.clone(), Device::Cpu).unwrap_err();
    assert!(none.to_string().contains("no TorchScript model"), "{none}");
    let golden = golden_folder().join("segmenter.ts");
    let other = Segmenter::script(&golden, good, Device::Cpu).unwrap();
    let values = vec![0.0; 4096];
    let wrong = other.classify(&image([16; 3], 2.0, &values), u64::MAX, &mut |_, _| ());
    let wrong = wrong.unwrap_err().to_string();
    assert!(
        wrong.contains("[1, 5, 16, 16, 16] numbers, its settings say [1, 3"),
        "{wrong}"
    );
    fs::remove_dir_all(folder).unwrap();
}
