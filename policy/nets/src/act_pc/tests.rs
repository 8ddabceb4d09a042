//! ACT-PC's tokens against the same computed by hand in double precision, and what the network
//! promises.

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor};

use super::{ActPc, ActPcConfig, ActPcPreset, Clouds, CloudsError};
use crate::act::{ActConfig, Demonstration};
use crate::parameters::ParameterSource;
use hal::random::SplitMix64;
use trocar_data::perception::Point;

pub(super) fn config(pre_sample: bool) -> ActPcConfig {
    let cameras = ["observation.images.endoscope".to_owned()];
    let preset = ActPcConfig::preset(ActPcPreset::Small, &cameras);
    ActPcConfig {
        act: ActConfig {
            chunk_size: 6,
            dim_model: if pre_sample { 512 } else { 64 },
            dim_feedforward: 64,
            n_encoder_layers: 1,
            n_vae_encoder_layers: 1,
            dropout: 0.0,
            ..preset.act
        },
        points: 40,
        tokens: 9,
        neighbours: 5,
        pre_sample,
        ..preset
    }
}

/// A network whose statistics and norms are not those of the beginning.
pub(super) fn network(config: &ActPcConfig) -> ActPc {
    let network = ActPc::new(config.clone(), ParameterSource::seeded(5, Device::Cpu)).unwrap();
    for (key, tensor) in network.parameters().iter() {
        let random = &mut SplitMix64::named(key, 9);
        let lift = |base: f64, spread: f64, random: &mut SplitMix64| {
            let values: Vec<f64> = (0..tensor.numel())
                .map(|_| base + spread * random.signed_unit())
                .collect();
            let values = Tensor::from_slice(&values).to_kind(Kind::Float);
            tensor.shallow_clone().copy_(&values.view_as(tensor));
        };
        if key.ends_with("running_var") {
            lift(1.0, 0.5, random);
        } else if key.ends_with("running_mean") {
            lift(0.0, 0.1, random);
        } else if key.contains(".bn.") || key.contains("backbone") && tensor.dim() == 1 {
            // Negative weights too: then the greatest comes from the least.
            lift(0.2, 1.0, random);
        }
    }
    network
}

#[expect(clippy::cast_possible_truncation, reason = "coordinates")]
pub(super) fn cloud(seed: u64) -> Vec<Point> {
    let mut random = SplitMix64::new(seed);
    (0..40)
        .map(|_| core::array::from_fn(|_| (0.1 * random.signed_unit()) as f32))
        .collect()
}

fn numbers(tensor: &Tensor) -> Vec<f64> {
    Vec::try_from(tensor.to_kind(Kind::Double).flatten(0, -1)).unwrap()
}

/// The network's tensors as plain numbers.
struct Plain(BTreeMap<String, Vec<f64>>);

impl Plain {
    fn linear(&self, key: &str, x: &[f64]) -> Vec<f64> {
        let weight = &self.0[&format!("model.{key}.weight")];
        let row = |row: &[f64]| row.iter().zip(x).map(|(w, x)| w * x).sum();
        weight.chunks_exact(x.len()).map(row).collect()
    }

    /// Batch normalisation with the stored statistics, then the rectifier.
    fn normal(&self, key: &str, epsilon: f64, x: &[f64]) -> Vec<f64> {
        let get = |name: &str| &self.0[&format!("model.{key}.{name}")];
        let (mean, variance) = (get("running_mean"), get("running_var"));
        let (weight, bias) = (get("weight"), get("bias"));
        (0..x.len())
            .map(|i| {
                let normal = (x[i] - mean[i]) / (variance[i] + epsilon).sqrt();
                (normal * weight[i] + bias[i]).max(0.0)
            })
            .collect()
    }

    fn point_net(&self, x: &[f64]) -> Vec<f64> {
        (1..=5).fold(x.to_vec(), |x, index| {
            let mixed = self.linear(&format!("backbone.conv{index}.0"), &x);
            self.normal(&format!("backbone.conv{index}.1"), 1e-3, &mixed)
        })
    }

    /// The greatest over the neighbours of what the layer makes of relative place and features,
    /// each pair by itself.
    fn token(&self, centre: &[f64], around: &[(Vec<f64>, Vec<f64>)]) -> Vec<f64> {
        let of_pair = |(place, features): &(Vec<f64>, Vec<f64>)| {
            let relative = place.iter().zip(centre).map(|(p, c)| p - c);
            let pair: Vec<f64> = relative.chain(features.iter().copied()).collect();
            self.normal("bn", 1e-5, &self.linear("linear", &pair))
        };
        around
            .iter()
            .map(of_pair)
            .reduce(|a, b| a.iter().zip(&b).map(|(a, b)| a.max(*b)).collect())
            .unwrap()
    }
}

fn wide(point: Point) -> Vec<f64> {
    point.map(f64::from).to_vec()
}

/// Centres and their neighbours by sorting everything.
fn groups(cloud: &[Point], config: &ActPcConfig) -> Vec<(usize, Vec<usize>)> {
    let apart = |a: usize, b: usize| -> f32 {
        let [x, y, z]: Point = core::array::from_fn(|axis| cloud[a][axis] - cloud[b][axis]);
        x * x + y * y + z * z
    };
    let mut taken = vec![0];
    while i64::try_from(taken.len()).unwrap() < config.tokens {
        let nearest = |i: usize| taken.iter().map(|&t| apart(i, t)).fold(f32::MAX, f32::min);
        let all = (0..cloud.len()).map(|i| (nearest(i), i));
        let (_, farthest) = all
            .reduce(|best, next| if next.0 > best.0 { next } else { best })
            .unwrap();
        taken.push(farthest);
    }
    let neighbours = usize::try_from(config.neighbours).unwrap();
    let with_neighbours = |centre: usize| {
        let mut order: Vec<usize> = (0..cloud.len()).collect();
        order.sort_by(|&a, &b| apart(a, centre).total_cmp(&apart(b, centre)));
        order.truncate(neighbours);
        (centre, order)
    };
    taken.into_iter().map(with_neighbours).collect()
}

#[test]
fn tokens_are_those_computed_by_hand() {
    for pre_sample in [false, true] {
        let config = config(pre_sample);
        let network = network(&config);
        let entries = network.parameters().iter();
        let plain = Plain(
            entries
                .map(|(key, t)| (key.to_owned(), numbers(t)))
                .collect(),
        );
        let points = [cloud(1), cloud(2)];
        let slices: Vec<&[Point]> = points.iter().map(Vec::as_slice).collect();
        let clouds = Clouds::new(&slices, &config, Device::Cpu).unwrap();
        let (tokens, _) = tch::no_grad(|| network.point_tokens(&clouds, false)).unwrap();
        assert_eq!(tokens.size(), [2, 9, config.act.dim_model]);
        let mut expected = Vec::new();
        for cloud in &points {
            for (centre, neighbours) in groups(cloud, &config) {
                let around: Vec<_> = neighbours
                    .iter()
                    .map(|&index| {
                        let place = wide(cloud[index]);
                        let features = if pre_sample {
                            place.clone()
                        } else {
                            plain.point_net(&place)
                        };
                        (place, features)
                    })
                    .collect();
                let token = plain.token(&wide(cloud[centre]), &around);
                expected.extend(if pre_sample {
                    plain.point_net(&token)
                } else {
                    token
                });
            }
        }
        let actual = numbers(&tokens);
        let scale = expected.iter().fold(0.0_f64, |scale, x| scale.max(x.abs()));
        let pairs = expected.iter().zip(&actual);
        let error = pairs.fold(0.0_f64, |error, (a, b)| error.max((a - b).abs()));
        assert!(scale > 0.01, "tokens say something: {scale}");
        assert!(
            error < 1e-5 * scale,
            "pre_sample {pre_sample}: off by {error:e} of {scale}"
        );
    }
}

#[test]
fn positions_are_blocks_of_sines_and_cosines_in_metres() {
    let config = config(false);
    let network = network(&config);
    let cloud = cloud(3);
    let clouds = Clouds::new(&[&cloud], &config, Device::Cpu).unwrap();
    let (_, position) = network.point_tokens(&clouds, false).unwrap();
    let position = numbers(&position);
    for (row, (centre, _)) in position.chunks_exact(64).zip(groups(&cloud, &config)) {
        let mut expected = Vec::new();
        // A third of 64 is 21: 11 even places, 10 odd ones.
        for &x in &cloud[centre] {
            let angle = |i: i32| f64::from(x) / 10_000_f64.powf(f64::from(2 * (i / 2)) / 21.0);
            expected.extend((0..21).step_by(2).map(|i| angle(i).sin()));
            expected.extend((1..21).step_by(2).map(|i| angle(i).cos()));
        }
        expected.push(0.0);
        for (place, (a, b)) in expected.iter().zip(row).enumerate() {
            assert!((a - b).abs() < 1e-6, "place {place}: {b} instead of {a}");
        }
    }
}

#[test]
fn a_cloud_s_chunk_is_independent_of_the_batch() {
    let config = config(false);
    let network = network(&config);
    let (first, second) = (cloud(1), cloud(2));
    let infer = |clouds: &[&[Point]]| {
        let batch = i64::try_from(clouds.len()).unwrap();
        let clouds = Clouds::new(clouds, &config, Device::Cpu).unwrap();
        let state = Tensor::full([batch, 7], 0.3, (Kind::Float, Device::Cpu));
        tch::no_grad(|| network.infer(&clouds, &state)).unwrap()
    };
    let (alone, together) = (infer(&[&second]), infer(&[&first, &second]));
    assert_eq!(together.size(), [2, 6, 7]);
    let apart = (together.select(0, 1) - alone.select(0, 0)).abs().max();
    assert!(apart.double_value(&[]) < 1e-5);
    let moved = (together.select(0, 0) - together.select(0, 1)).abs().max();
    assert!(moved.double_value(&[]) > 1e-4, "it looks at the cloud");
}

#[test]
fn training_moves_the_statistics_and_reaches_the_point_net() {
    let config = config(false);
    let network = network(&config);
    let parameters = network.parameters();
    for (key, tensor) in parameters.iter() {
        let _ = tensor.set_requires_grad(parameters.is_trainable(key));
    }
    let cloud = cloud(4);
    let clouds = Clouds::new(&[&cloud, &cloud], &config, Device::Cpu).unwrap();
    let places = Tensor::arange(2 * 6 * 7, (Kind::Float, Device::Cpu));
    let actions = (places * 0.3_f64).sin().view([2, 6, 7]);
    let demonstration = Demonstration {
        actions: &actions,
        is_pad: &Tensor::zeros([2, 6], (Kind::Bool, Device::Cpu)),
        noise: &Tensor::zeros([2, 32], (Kind::Float, Device::Cpu)),
    };
    let state = Tensor::zeros([2, 7], (Kind::Float, Device::Cpu));
    let key = "model.backbone.conv1.1.running_mean";
    let before = numbers(parameters.get(key).unwrap());
    let (predicted, latent) = network.train(&clouds, &state, &demonstration).unwrap();
    let parts = network
        .losses(&predicted, latent.as_ref(), &actions, demonstration.is_pad)
        .unwrap();
    parts.total.backward();
    // What the first layer makes of the points, each of the two clouds the same: a hundredth of the
    // way to its mean.
    let weight = parameters.get("model.backbone.conv1.0.weight").unwrap();
    let mean = clouds.points.matmul(&weight.transpose(0, 1)).mean_dim(
        [0, 1].as_slice(),
        false,
        Kind::Double,
    );
    let after = numbers(parameters.get(key).unwrap());
    for ((before, after), mean) in before.iter().zip(&after).zip(numbers(&mean)) {
        assert!((after - (0.99 * before + 0.01 * mean)).abs() < 1e-6);
    }
    for key in [
        "backbone.conv1.0.weight",
        "backbone.conv5.1.bias",
        "linear.weight",
        "bn.weight",
    ] {
        let gradient = parameters.get(&format!("model.{key}")).unwrap().grad();
        assert!(gradient.norm().double_value(&[]) > 0.0, "{key}");
    }
}

#[test]
fn clouds_of_another_size_are_refused() {
    let config = config(false);
    let short = &cloud(1)[..39];
    let error = Clouds::new(&[&cloud(1), short], &config, Device::Cpu).unwrap_err();
    let message = "cloud 1 has 39 points, the network wants 40";
    assert_eq!(error.to_string(), message);
    assert!(matches!(error, CloudsError::Count { cloud: 1, .. }));
}
