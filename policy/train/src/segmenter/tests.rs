//! Segmenters learn, and learn the same again.

use std::sync::PoisonError;

use tch::Device;

use super::{LabelledScan, SegmenterTraining};
use crate::TrainError;
use crate::tests::ONE_AT_A_TIME;
use trocar_nets::parameters::Parameters;
use trocar_nets::segmenter::{Image, Segmenter, SegmenterSettings, UNet, UNetConfig, Weighting};

const SIDE: usize = 20;

fn settings() -> SegmenterSettings {
    SegmenterSettings {
        patch: [16; 3],
        spacing_mm: [4.0; 3],
        orientation: "RAS".to_owned(),
        window_hu: [-1000.0, 1000.0],
        range: [0.0, 1.0],
        overlap: 0.5,
        weighting: Weighting::Gaussian,
        table: "groups".to_owned(),
        classes: vec![0, 1, 2],
    }
}

/// A box of 60 HU in air, with one of 500 HU in it, somewhere.
fn scan(seed: usize) -> LabelledScan {
    let (mut hounsfield, mut classes) = (Vec::new(), Vec::new());
    let corner = 3 + seed % 4;
    for at in 0..SIDE.pow(3) {
        let place = [at % SIDE, at / SIDE % SIDE, at / SIDE / SIDE];
        let within =
            |low: usize, side: usize| place.iter().all(|at| (low..low + side).contains(at));
        let class = u8::from(within(corner, 12)) + u8::from(within(corner + 4, 5));
        classes.push(class);
        hounsfield.push([-1000, 60, 500][usize::from(class)]);
    }
    LabelledScan {
        dims: [SIDE; 3],
        hounsfield,
        classes,
    }
}

fn trained(seed: u64, steps: u64, scans: &[LabelledScan]) -> Result<(UNet, Vec<f64>), TrainError> {
    let training = SegmenterTraining {
        steps,
        batch: 2,
        lr: 5e-3,
        seed,
        threads: 1,
        device: Device::Cpu,
    };
    let config = UNetConfig {
        widths: vec![8, 16],
        classes: 3,
        narrow: [0.42, 0.62],
    };
    let mut losses = Vec::new();
    let network = training.run(&config, &settings(), scans, &mut |_, loss| {
        losses.push(loss);
        true
    })?;
    Ok((network, losses))
}

fn bits(parameters: &Parameters) -> Vec<f32> {
    let flat = parameters
        .iter()
        .map(|(_, tensor)| Vec::<f32>::try_from(tensor.flatten(0, -1)));
    flat.flat_map(Result::unwrap).collect()
}

#[test]
fn boxes_are_learned_and_the_same_seed_gives_the_same_bits() {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let scans: Vec<LabelledScan> = (0..4).map(scan).collect();
    let (network, losses) = trained(3, 120, &scans).unwrap();
    assert_eq!(losses.len(), 6);
    assert!(losses[5] < 0.5 * losses[0], "{losses:?}");
    // Lighter than those that it has seen.
    let unseen = scan(2);
    let values: Vec<f32> = unseen
        .hounsfield
        .iter()
        .map(|value| f32::from(*value) + 5.0)
        .collect();
    let image = Image {
        dims: unseen.dims,
        spacing_mm: [4.0; 3],
        values: &values,
    };
    let segmenter = Segmenter::new(network, settings(), Device::Cpu);
    let found = segmenter
        .classify(&image, u64::MAX, &mut |_, _| ())
        .unwrap();
    let right = found
        .iter()
        .zip(&unseen.classes)
        .filter(|(a, b)| a == b)
        .count();
    // Air alone would be 78 % of it.
    assert!(right * 100 > found.len() * 90, "{right} of {}", found.len());

    let short = |seed| bits(trained(seed, 4, &scans).unwrap().0.parameters());
    assert_eq!(short(1), short(1));
    assert_ne!(short(1), short(2));
}

#[test]
fn scans_that_do_not_fit_are_refused() {
    let message = |scans: &[LabelledScan]| trained(0, 1, scans).unwrap_err().to_string();
    assert!(matches!(trained(0, 1, &[]), Err(TrainError::Empty)));
    let mut small = scan(0);
    small.dims = [SIDE, 8, SIDE];
    assert!(message(&[scan(1), small]).contains("scan 1 has [20, 8, 20] voxels"));
    let mut beyond = scan(0);
    beyond.classes[5] = 3;
    assert!(message(&[beyond]).contains("classes beyond the 3"));
    let mut short = scan(0);
    short.classes.pop();
    assert!(message(&[short]).contains("not a value and a class a voxel"));
}
