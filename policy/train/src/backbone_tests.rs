//! A backbone with fixed statistics starts from what is given, keeps its statistics, and goes on
//! from a state without them.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use tch::{Device, Kind, Tensor};

use super::flat::FlatParameters;
use super::resume_tests::{check, four_steps};
use super::tests::{config, dataset, options, recipe};
use super::{Progress, TrainError, TrainOptions, TrainPrecision, Trainer};
use trocar_nets::act::{Act, ActConfig, BackboneNorm};
use trocar_nets::checkpoint::{self, BackboneWeights, SaveOptions};
use trocar_nets::normalise::ImageNormaliser;
use trocar_nets::parameters::ParameterSource;

fn frozen() -> ActConfig {
    ActConfig {
        backbone_norm: BackboneNorm::FrozenBatchNorm,
        ..config()
    }
}

/// The backbone of a network that was trained elsewhere, by torchvision's names, with what else its
/// file has.
fn foreign() -> BTreeMap<String, Tensor> {
    let act = Act::new(frozen(), ParameterSource::seeded(9, Device::Cpu)).unwrap();
    let mut tensors = BTreeMap::new();
    for (key, tensor) in act.parameters().iter() {
        let Some(name) = key.strip_prefix("model.backbone.") else {
            continue;
        };
        let ramp = Tensor::arange(tensor.size()[0], (Kind::Float, Device::Cpu)).sin();
        let moved = if name.ends_with("running_var") {
            tensor + 0.5 * ramp
        } else if name.ends_with("running_mean") {
            tensor + 0.1 * ramp
        } else {
            tensor.copy()
        };
        tensors.insert(name.to_owned(), moved.contiguous());
    }
    let float = (Kind::Float, Device::Cpu);
    tensors.insert("fc.weight".to_owned(), Tensor::zeros([1000, 512], float));
    tensors.insert("fc.bias".to_owned(), Tensor::zeros([1000], float));
    let count = Tensor::from_slice(&[7_i64]);
    tensors.insert("bn1.num_batches_tracked".to_owned(), count);
    tensors
}

fn write(file: &Path, tensors: &BTreeMap<String, Tensor>) {
    let named: Vec<(&str, &Tensor)> = tensors.iter().map(|(k, t)| (k.as_str(), t)).collect();
    Tensor::write_safetensors(&named, file).unwrap();
}

fn file(name: &str) -> PathBuf {
    let name = format!("trocar-backbone-{name}-{}.safetensors", std::process::id());
    std::env::temp_dir().join(name)
}

#[test]
fn it_starts_from_the_file_and_leaves_the_statistics_alone() {
    let scratch = dataset("backbone");
    let (file, foreign) = (file("start"), foreign());
    write(&file, &foreign);
    let options = four_steps(TrainOptions {
        lr_backbone: 1e-6,
        ..options()
    });
    // What goes on has its statistics from the state, whatever became of the file.
    check(
        &scratch.folder,
        &|state, watch| {
            let trainer = super::resume_tests::trainer(state);
            let trainer = match state {
                Some(_) => trainer,
                None => trainer.starting_from(BackboneWeights::load(&file).unwrap()),
            };
            trainer.run(&frozen(), &options, &scratch.dataset, watch)
        },
        |trained| (trained.network.parameters(), &trained.curve),
    );
    let _alone = super::resume_tests::alone();
    let trained = Trainer::new(Device::Cpu)
        .starting_from(BackboneWeights::load(&file).unwrap())
        .run(
            &frozen(),
            &options,
            &scratch.dataset,
            &mut |_: &Progress| (),
        )
        .unwrap();
    let parameters = trained.network.parameters();
    for (name, given) in &foreign {
        let Some(now) = parameters.get(&format!("model.backbone.{name}")) else {
            assert!(
                name.starts_with("fc.") || name.ends_with("tracked"),
                "{name}"
            );
            continue;
        };
        let moved = (now - given).abs().max().double_value(&[]);
        if name.contains("conv") || name.ends_with("downsample.0.weight") {
            assert!(moved > 0.0 && moved < 1e-4, "{name}: {moved}");
        } else {
            assert_eq!(now, given, "{name}");
        }
    }
    fs::remove_file(&file).unwrap();

    // What was trained is a policy of LeRobot's kind, whose backbone the next can start from.
    let folder = scratch.folder.join("policy");
    let (act, statistics) = (&trained.network, &trained.statistics);
    let saved = SaveOptions::default();
    checkpoint::save(&folder, act, statistics, &recipe(&frozen()), saved).unwrap();
    let json = fs::read_to_string(folder.join("config.json")).unwrap();
    assert!(json.contains("\"resnet18\""), "{json}");
    let loaded = checkpoint::load(&folder, Device::Cpu).unwrap();
    assert_eq!(loaded.act.config(), &frozen());
    for (key, tensor) in BackboneWeights::load(&folder).unwrap().tensors() {
        assert_eq!(parameters.get(key), Some(tensor), "{key}");
    }
}

/// From scratch, statistics are those of the dataset's images: they are not the neutral ones,
/// training leaves them alone, and a run that goes on has them from its state.
#[test]
fn from_scratch_the_statistics_are_those_of_the_images() {
    let scratch = dataset("backbone-scratch");
    // As large as the dataset's images.
    let config = ActConfig {
        image_height: 64,
        image_width: 64,
        ..frozen()
    };
    let options = four_steps(options());
    check(
        &scratch.folder,
        &|state, watch| {
            let trainer = super::resume_tests::trainer(state);
            trainer.run(&config, &options, &scratch.dataset, watch)
        },
        |trained| (trained.network.parameters(), &trained.curve),
    );
    let _alone = super::resume_tests::alone();
    let trainer = Trainer::new(Device::Cpu);
    let mut quiet = |_: &Progress| ();
    let trained = trainer.run(&config, &options, &scratch.dataset, &mut quiet);
    let trained = trained.unwrap();
    let kept = |name: &str| {
        let key = format!("model.backbone.{name}");
        trained.network.parameters().get(&key).unwrap().copy()
    };
    // All images of the dataset are fewer than are measured, so the first layer's can be said by
    // hand.
    let drawn = Act::new(
        config.clone(),
        ParameterSource::seeded(options.seed, Device::Cpu),
    )
    .unwrap();
    let pixels: Vec<Tensor> = (0..scratch.dataset.len())
        .map(|frame| {
            let image = scratch.dataset.image_rgb(frame, 0).unwrap();
            let bytes = Tensor::from_slice(image.as_raw());
            let (width, height) = image.dimensions();
            bytes.view([1, i64::from(height), i64::from(width), 3])
        })
        .collect();
    let images = ImageNormaliser::imagenet(Device::Cpu).unwrap();
    let images = images.apply(&Tensor::cat(&pixels, 0)).unwrap();
    let stem = drawn
        .parameters()
        .get("model.backbone.conv1.weight")
        .unwrap();
    let convolved = images.conv2d::<&Tensor>(stem, None, [2, 2], [3, 3], [1, 1], 1);
    let channels = convolved.transpose(0, 1).flatten(1, 3);
    let close = |found: &Tensor, expected: &Tensor| {
        let apart = (found - expected).abs().max().double_value(&[]);
        assert!(
            apart < 1e-4 * expected.abs().max().double_value(&[]),
            "{apart}"
        );
    };
    close(
        &kept("bn1.running_mean"),
        &channels.mean_dim(1, false, Kind::Float),
    );
    close(&kept("bn1.running_var"), &channels.var_dim(1, true, false));
    // No layer keeps the neutral ones.
    for key in ["layer1.1.bn2", "layer4.0.downsample.1", "layer4.1.bn2"] {
        let variance = kept(&format!("{key}.running_var"));
        assert!(variance.min().double_value(&[]) > 0.0, "{key}");
        assert!(
            (variance - 1.0).abs().min().double_value(&[]) > 0.0,
            "{key}"
        );
    }
}

#[test]
fn only_fixed_statistics_start_from_a_file() {
    let scratch = dataset("backbone-group");
    let file = file("group");
    write(&file, &foreign());
    let weights = BackboneWeights::load(&file).unwrap();
    fs::remove_file(&file).unwrap();
    let trainer = Trainer::new(Device::Cpu).starting_from(weights);
    let mut quiet = |_: &Progress| ();
    let error = trainer.run(&config(), &options(), &scratch.dataset, &mut quiet);
    assert!(matches!(error.unwrap_err(), TrainError::Options(_)));
}

#[track_caller]
fn refused(name: &str, change: impl FnOnce(&mut BTreeMap<String, Tensor>), reason: &str) {
    let file = file(name);
    let mut tensors = foreign();
    change(&mut tensors);
    write(&file, &tensors);
    let error = BackboneWeights::load(&file).unwrap_err().to_string();
    fs::remove_file(&file).unwrap();
    let at = file.display().to_string();
    assert!(error.contains(reason) && error.contains(&at), "{error}");
}

#[test]
fn what_is_no_resnet_18_is_refused_with_the_tensor() {
    refused(
        "missing",
        |tensors| drop(tensors.remove("layer3.1.bn2.running_var")),
        "tensor layer3.1.bn2.running_var is missing",
    );
    refused(
        "shape",
        |tensors| {
            let wide = Tensor::zeros([128, 64, 3, 3], (Kind::Float, Device::Cpu));
            tensors.insert("layer1.0.conv1.weight".to_owned(), wide);
        },
        "tensor layer1.0.conv1.weight has shape [128, 64, 3, 3], the network needs [64, 64, 3, 3]",
    );
    refused(
        "deeper",
        |tensors| {
            let more = tensors["layer1.1.conv1.weight"].copy();
            tensors.insert("layer1.2.conv1.weight".to_owned(), more);
        },
        "tensor layer1.2.conv1.weight belongs to no part",
    );
    refused(
        "variance",
        |tensors| {
            let _ = tensors["layer2.0.bn1.running_var"].get(3).fill_(-1.0);
        },
        "tensor layer2.0.bn1.running_var has a negative variance",
    );
    refused(
        "nan",
        |tensors| {
            let _ = tensors["conv1.weight"].get(3).fill_(f64::NAN);
        },
        "tensor conv1.weight has a number that is not finite",
    );
    refused(
        "kind",
        |tensors| {
            let double = tensors["bn1.bias"].to_kind(Kind::Double);
            tensors.insert("bn1.bias".to_owned(), double);
        },
        "tensor bn1.bias has element type F64",
    );
}

#[test]
fn what_torch_saved_is_refused_with_the_way_to_convert_it() {
    // An archive, and the pickle that torch wrote before.
    for start in [
        &b"PK\x03\x04\0\0\x08\x08resnet18/data.pkl"[..],
        &b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."[..],
    ] {
        let file = file("torch");
        fs::write(&file, start).unwrap();
        let error = BackboneWeights::load(&file).unwrap_err().to_string();
        fs::remove_file(&file).unwrap();
        let at = file.display();
        let told = format!("policy/convert/resnet18.py NEW.safetensors --weights {at}`");
        assert!(
            error.starts_with(&format!("{at}: ")) && error.contains(&told),
            "{error}"
        );
    }
    let cut = file("cut");
    fs::write(&cut, b"no weights at all").unwrap();
    let error = BackboneWeights::load(&cut).unwrap_err().to_string();
    fs::remove_file(&cut).unwrap();
    assert!(error.contains("no intact safetensors file"), "{error}");
}

#[test]
fn a_policy_s_file_is_refused_with_its_folder() {
    let folder = std::env::temp_dir().join(format!("trocar-backbone-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let act = Act::new(frozen(), ParameterSource::seeded(9, Device::Cpu)).unwrap();
    let tensors = act.parameters().iter();
    let tensors = tensors.map(|(key, tensor)| (key.to_owned(), tensor.contiguous()));
    let file = folder.join("model.safetensors");
    write(&file, &tensors.collect());
    let error = BackboneWeights::load(&file).unwrap_err().to_string();
    let told = format!("name their folder instead: {}", folder.display());
    assert!(error.ends_with(&told), "{error}");
    // And that does it.
    assert!(BackboneWeights::load(&folder).is_ok());
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn in_16_bits_statistics_are_still_those_of_32() {
    // Of numbers that 16 bits can't hold.
    let tensors = foreign().into_iter();
    let backbone: BTreeMap<String, Tensor> = tensors
        .map(|(name, tensor)| (format!("model.backbone.{name}"), tensor))
        .collect();
    let drawn = Act::new(frozen(), ParameterSource::seeded(9, Device::Cpu)).unwrap();
    let all = drawn.parameters().iter().map(|(key, tensor)| {
        let given = backbone.get(key).unwrap_or(tensor);
        (key.to_owned(), given.shallow_clone())
    });
    let act = Act::new(frozen(), ParameterSource::given(all.collect())).unwrap();
    let options = TrainOptions {
        precision: TrainPrecision::Bf16,
        ..options()
    };
    let flat = FlatParameters::new(act.parameters(), Device::Cpu, &options).unwrap();
    let working = flat.working_tensors();
    for (key, tensor) in &working {
        if act.parameters().is_trainable(key) {
            assert_eq!(tensor.kind(), Kind::BFloat16, "{key}");
        } else {
            assert_eq!(Some(tensor), act.parameters().get(key), "{key}");
        }
    }
    // The network takes them so.
    assert!(Act::new(frozen(), ParameterSource::given(working)).is_ok());
}

#[test]
fn a_policy_with_group_normalisation_has_no_statistics() {
    let scratch = dataset("backbone-none");
    let act = Act::new(config(), ParameterSource::seeded(9, Device::Cpu)).unwrap();
    let _alone = super::resume_tests::alone();
    let one = TrainOptions {
        steps: 1,
        ..options()
    };
    let trained = Trainer::new(Device::Cpu)
        .run(&config(), &one, &scratch.dataset, &mut |_: &Progress| ())
        .unwrap();
    let folder = scratch.folder.join("policy");
    let (statistics, saved) = (&trained.statistics, SaveOptions::default());
    checkpoint::save(&folder, &act, statistics, &recipe(&config()), saved).unwrap();
    let error = BackboneWeights::load(&folder).unwrap_err().to_string();
    let reason = "model.safetensors: a backbone with group normalisation, which learns from scratch; expected one with frozen";
    assert!(error.contains(reason), "{error}");
}
