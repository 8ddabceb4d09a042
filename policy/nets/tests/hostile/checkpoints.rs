//! Checkpoints: a small DP3 whose every file is damaged in turn, and headers that lie about their
//! size.

use std::fs;
use std::path::Path;

use tch::Device;
use trocar_nets::checkpoint::{
    self, AggregationName, CheckpointError, CloudStatistics, DatasetSummary, PolicyPreset,
    Precision, RECIPE_FORMAT, Recipe, RecommendedAggregation, RecordedCamera, Variants, load_dp3,
    save_dp3,
};
use trocar_nets::dp3::{Dp3, Dp3Config, Dp3Preset};
use trocar_nets::normalise::Statistics;
use trocar_nets::parameters::ParameterSource;

use crate::cloud::cloud;
use crate::common::{Folder, seeds, told, within_memory};
use crate::damage::damaged;

const FILES: [&str; 4] = [
    "config.json",
    "model.safetensors",
    "statistics.safetensors",
    "trocar.json",
];

pub(crate) fn recipe() -> Recipe {
    Recipe {
        format: RECIPE_FORMAT,
        arms: 1,
        action_representation: trocar_data::relative_action::REPRESENTATION.to_owned(),
        step_ns: 40_000_000,
        query_every_steps: 4,
        aggregation: RecommendedAggregation {
            mode: AggregationName::WholeChunk,
            decay: 0.0,
        },
        cameras: vec![RecordedCamera {
            feature: "observation.images.endoscope".to_owned(),
            width: 64,
            height: 64,
        }],
        preset: PolicyPreset::SimpleDp3,
        variants: Variants::default(),
        recipe: "test".to_owned(),
        dataset: DatasetSummary::default(),
        seed: 1,
        training: serde_json::Value::Null,
    }
}

fn save(folder: &Path) {
    let config = Dp3Config {
        down_dims: vec![8, 16],
        diffusion_step_embed_dim: 8,
        ..Dp3Config::preset(Dp3Preset::Simple, 7, 7)
    };
    let network = Dp3::new(config, ParameterSource::seeded(1, Device::Cpu)).unwrap();
    let of = |scale: f32| Statistics {
        mean: vec![0.0; 7],
        std: vec![scale; 7],
        min: vec![-scale; 7],
        max: vec![scale; 7],
    };
    let statistics = CloudStatistics {
        state: of(0.5),
        action: of(0.01),
        points: [[-0.1; 3], [0.1; 3]],
    };
    save_dp3(
        folder,
        &network,
        &cloud(),
        &statistics,
        &recipe(),
        Precision::F32,
    )
    .unwrap();
}

/// A refusal names a file of the folder.
pub(crate) fn check(error: &CheckpointError, folder: &Path, case: &str) {
    let text = told(error);
    assert!(error.file.starts_with(folder), "{case}: {text}");
    assert!(text.len() < 2000, "{case}: {} bytes of reason", text.len());
}

#[test]
fn a_damaged_checkpoint_is_read_or_refused_by_name() {
    let folder = Folder::new("checkpoint");
    save(folder.path());
    let whole = FILES.map(|file| fs::read(folder.path().join(file)).unwrap());
    within_memory(|| {
        let mut refused = 0_u32;
        for seed in seeds(1) {
            let number = usize::try_from(seed).unwrap() % FILES.len();
            let file = folder.path().join(FILES[number]);
            fs::write(&file, damaged(&whole[number], seed)).unwrap();
            if let Err(error) = load_dp3(folder.path(), Device::Cpu) {
                check(
                    &error,
                    folder.path(),
                    &format!("seed {seed}, {}", FILES[number]),
                );
                refused += 1;
            }
            fs::write(&file, &whole[number]).unwrap();
        }
        assert!(refused > 0, "nothing was refused: is anything damaged?");
    });
    load_dp3(folder.path(), Device::Cpu).expect("it is whole again");
}

/// A safetensors file with `header` in front of `data`.
fn container(header: &str, data: &[u8]) -> Vec<u8> {
    let length = u64::try_from(header.len()).unwrap().to_le_bytes();
    [&length[..], header.as_bytes(), data].concat()
}

#[test]
fn headers_that_lie_are_refused_before_memory_is_asked_for() {
    let folder = Folder::new("headers");
    save(folder.path());
    let file = folder.path().join("model.safetensors");
    let many = format!(
        "{{{}}}",
        (0..200_000)
            .map(|n| format!("\"t{n}\":{{\"dtype\":\"F32\",\"shape\":[0],\"data_offsets\":[0,0]}}"))
            .collect::<Vec<_>>()
            .join(",")
    );
    let nested = "[".repeat(100_000);
    let one = |shape: &str, offsets: &str| {
        let header =
            format!("{{\"a\":{{\"dtype\":\"F32\",\"shape\":{shape},\"data_offsets\":{offsets}}}}}");
        container(&header, &[0; 16])
    };
    let cases: [(&str, Vec<u8>); 9] = [
        (
            "a header of 2^64 - 1 bytes",
            u64::MAX.to_le_bytes().to_vec(),
        ),
        (
            "a header of 2^40 bytes",
            (1_u64 << 40).to_le_bytes().to_vec(),
        ),
        (
            "a header of 99 MB that is not there",
            99_000_000_u64.to_le_bytes().to_vec(),
        ),
        ("a shape of 2^60", one("[1152921504606846976]", "[0,16]")),
        (
            "a shape that overflows",
            one("[4294967296,4294967296,4294967296]", "[0,16]"),
        ),
        ("data beyond the end", one("[4]", "[0,1099511627776]")),
        ("data that ends before it begins", one("[4]", "[16,0]")),
        ("very many tensors", container(&many, &[])),
        ("very deep nesting", container(&nested, &[])),
    ];
    within_memory(|| {
        for (case, bytes) in cases {
            fs::write(&file, bytes).unwrap();
            let error = load_dp3(folder.path(), Device::Cpu).expect_err(case);
            assert_eq!(error.file, file, "{case}: {error}");
        }
    });
}

/// Numbers of a configuration that ask for too much are refused.
#[test]
fn excessive_configuration_numbers_are_refused() {
    let folder = Folder::new("sizes");
    save(folder.path());
    let file = folder.path().join("config.json");
    let text = fs::read_to_string(&file).unwrap();
    let config: serde_json::Value = serde_json::from_str(&text).unwrap();
    let fields: Vec<String> = config["network"]
        .as_object()
        .unwrap()
        .keys()
        .cloned()
        .collect();
    within_memory(|| {
        for field in &fields {
            for size in [
                serde_json::json!(1_u64 << 40),
                serde_json::json!(-1),
                serde_json::json!(0),
            ] {
                let mut other = config.clone();
                let place = &mut other["network"][field];
                *place = if place.is_array() {
                    serde_json::json!([8, size])
                } else {
                    size.clone()
                };
                fs::write(&file, other.to_string()).unwrap();
                let error = load_dp3(folder.path(), Device::Cpu).expect_err(field);
                check(&error, folder.path(), field);
            }
        }
    });
}

#[test]
fn a_state_file_outside_of_the_folder_is_not_opened() {
    let folder = Folder::new("outside");
    let committed =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/policies/needle-lift/act-compact");
    for entry in fs::read_dir(committed).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
    }
    checkpoint::load(folder.path(), Device::Cpu).expect("it is whole");
    let file = folder.path().join("policy_preprocessor.json");
    let text = fs::read_to_string(&file).unwrap();
    let name = "policy_preprocessor_step_3_normalizer_processor.safetensors";
    assert!(text.contains(name));
    for other in [
        "/etc/passwd",
        "../secret.safetensors",
        "a/../../b",
        "..",
        "",
    ] {
        fs::write(&file, text.replace(name, other)).unwrap();
        let error = checkpoint::load(folder.path(), Device::Cpu).expect_err(other);
        assert!(
            error.to_string().contains("no plain name"),
            "{other}: {error}"
        );
    }
}
