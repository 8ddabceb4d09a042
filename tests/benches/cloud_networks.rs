//! One answer of an untrained ACT-PC, DP3 and SimpleDP3, folded as policies run them, to a point
//! cloud, on one core. What it takes does not depend on the parameters' values, but for those that
//! half precision holds. DP3 is set beside what the core takes for no more than reading the weights
//! of its convolutions, in single precision, once each inference step.

#![expect(
    clippy::expect_used,
    reason = "a bench can't go on without its subject"
)]

mod support;

use std::error::Error;
use std::hint::black_box;

use criterion::Criterion;
use hal::TimeNs;
use hal::random::SplitMix64;
use tch::{Device, Kind, Tensor};
use trocar::rt::MonotonicClock;
use trocar::session::source::STEP_NS;
use trocar_data::perception::Point;
use trocar_nets::act_pc::{ActPc, ActPcConfig, ActPcPreset, Clouds, FoldedActPc};
use trocar_nets::dp3::{CloudObservation, Dp3, Dp3Config, Dp3Preset, FoldedDp3};
use trocar_nets::parameters::ParameterSource;

const CAMERA: &str = "observation.images.endoscope";
const RUNS: u32 = 10;

/// Numbers in a state, and in an action.
const WIDTH: i64 = 7;

/// Points all over a tenth of a metre.
#[expect(clippy::cast_possible_truncation, reason = "coordinates")]
fn cloud(points: i64) -> Vec<Point> {
    let mut random = SplitMix64::new(1);
    (0..points)
        .map(|_| core::array::from_fn(|_| (0.05 * random.signed_unit()) as f32))
        .collect()
}

/// Times `work`, which is to be done within `steps` steps; its median, ms.
fn report(
    criterion: &mut Criterion,
    name: &str,
    steps: f64,
    work: &mut dyn FnMut() -> Tensor,
) -> f64 {
    let clock = MonotonicClock::new();
    let times = support::measure(criterion, &format!("networks/{name}"), RUNS, || {
        let before = clock.now();
        let answer = tch::no_grad(&mut *work);
        let took_ns = clock.now().since(before);
        assert!(answer.numel() > 0, "the network says something");
        took_ns
    });
    let ms = |fraction| TimeNs(times.percentile(fraction)).seconds() * 1e3;
    let figure = format!(
        "{name}, one core: p50 {:.1} ms, worst {:.1} ms of {RUNS}",
        ms(0.5),
        ms(1.0)
    );
    let period_ms = steps * TimeNs(STEP_NS).seconds() * 1e3;
    let target = format!("within the {period_ms} ms after which it is asked again");
    support::report(&figure, &target, period_ms / ms(0.5));
    ms(0.5)
}

/// What the core takes to read as many bytes from four places at once, which is the fastest it
/// reads; the best of ten, ms.
fn reading_ms(bytes: usize) -> f64 {
    let clock = MonotonicClock::new();
    let numbers = vec![1_u64; bytes / size_of::<u64>()];
    let quarter = numbers.len() / 4;
    let read = || {
        let before = clock.now();
        let [mut a, mut b, mut c, mut d] = [0_u64; 4];
        for index in 0..quarter {
            a = a.wrapping_add(numbers[index]);
            b = b.wrapping_add(numbers[quarter + index]);
            c = c.wrapping_add(numbers[2 * quarter + index]);
            d = d.wrapping_add(numbers[3 * quarter + index]);
        }
        black_box([a, b, c, d]);
        clock.now().since(before)
    };
    let best = (0..10).map(|_| read()).min().unwrap_or_default();
    TimeNs(best).seconds() * 1e3
}

fn act_pc(
    criterion: &mut Criterion,
    name: &str,
    preset: ActPcPreset,
) -> Result<(), Box<dyn Error>> {
    let config = ActPcConfig::preset(preset, &[CAMERA.to_owned()]);
    let cloud = cloud(config.points);
    let network = ActPc::new(config.clone(), ParameterSource::seeded(1, Device::Cpu))?;
    let network = FoldedActPc::new(&network, Kind::Float)?;
    let state = Tensor::zeros([1, WIDTH], (Kind::Float, Device::Cpu));
    // Half a chunk is executed.
    let steps = f64::from(i32::try_from(config.act.chunk_size / 2)?);
    report(criterion, name, steps, &mut || {
        let clouds = Clouds::new(&[&cloud], &config, Device::Cpu).expect("clouds");
        network.infer(&clouds, &state).expect("it answers")
    });
    Ok(())
}

fn dp3(criterion: &mut Criterion, name: &str, preset: Dp3Preset) -> Result<(), Box<dyn Error>> {
    let config = Dp3Config::preset(preset, WIDTH, WIDTH);
    let network = Dp3::new(config.clone(), ParameterSource::seeded(1, Device::Cpu))?;
    let convolutions = network.parameters().iter().map(|(_, tensor)| tensor);
    let weights: usize = convolutions
        .filter(|tensor| tensor.dim() == 3)
        .map(Tensor::numel)
        .sum();
    let mut network = FoldedDp3::new(network, Kind::Float)?;
    let observations = config.n_obs_steps;
    let cloud = cloud(observations * 1024);
    let observation = CloudObservation {
        points: &Tensor::from_slice(cloud.as_flattened()).view([1, observations, 1024, 3]),
        state: &Tensor::zeros([1, observations, WIDTH], (Kind::Float, Device::Cpu)),
    };
    let noise = config.start_noise(1, 1)?;
    let steps = f64::from(i32::try_from(config.n_action_steps)?);
    let ms = report(criterion, name, steps, &mut || {
        network.infer(&observation, &noise).expect("it answers")
    });
    if preset == Dp3Preset::Simple {
        // Whose weights stay in a cache.
        return Ok(());
    }
    let times = config.num_inference_steps;
    let least = reading_ms(4 * weights) * f64::from(i32::try_from(times)?);
    let figure = format!(
        "reading the {} MB of {name}'s convolutions {times} times: {least:.1} ms",
        4 * weights / 1_000_000
    );
    support::report(&figure, "an answer in 1.25 times that", 1.25 * least / ms);
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    tch::set_num_threads(1);
    let mut criterion = support::criterion();
    act_pc(&mut criterion, "ACT-PC small", ActPcPreset::Small)?;
    act_pc(&mut criterion, "ACT-PC paper", ActPcPreset::Paper)?;
    dp3(&mut criterion, "SimpleDP3", Dp3Preset::Simple)?;
    dp3(&mut criterion, "DP3", Dp3Preset::Dp3)?;
    criterion.final_summary();
    Ok(())
}
