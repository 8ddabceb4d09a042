//! Our side of `tests/scripts/eager_peers.py`, which starts it and sets it beside eager PyTorch in
//! one run.
//!
//! `peers FOLDER cpu|cuda THREADS` reads requests from standard input, a line each: `make NETWORK`
//! builds an untrained network and writes its weights and an observation to FOLDER; `time NETWORK
//! RUNS` answers that often, and leaves the answer there. Each is acknowledged with a line of JSON.
//! NETWORK may end in `-half`: weights that half precision holds, as those of committed policies;
//! and in `-bf16`, which takes the weights of the one without. Timed is what the script times of
//! its peers: from a normalised observation on the device to the answer on the host.

#![expect(clippy::print_stdout, reason = "standard output is how it answers")]

use std::collections::BTreeMap;
use std::error::Error;
use std::io::BufRead;
use std::path::{Path, PathBuf};

use hal::random::SplitMix64;
use tch::{Device, Kind, TchError, Tensor};
use trocar::rt::MonotonicClock;
use trocar_nets::act::{Act, ActConfig, FoldedAct};
use trocar_nets::dp3::{CloudObservation, Dp3, Dp3Config, Dp3Preset, FoldedDp3};
use trocar_nets::parameters::{ParameterSource, Parameters};

/// Numbers in a state, and in an action.
const WIDTH: i64 = 7;
const SIDE: i64 = 512;
const POINTS: i64 = 1024;

/// A network and what it is asked.
enum Subject {
    Act(Box<FoldedAct>, [Tensor; 2]),
    Dp3(Box<FoldedDp3>, [Tensor; 3]),
}

impl Subject {
    /// The answer, on the host.
    fn answer(&mut self) -> Result<Tensor, Box<dyn Error>> {
        let answer = tch::no_grad(|| match self {
            Self::Act(act, [images, state]) => act.infer(images, state),
            Self::Dp3(dp3, [points, state, noise]) => {
                dp3.infer(&CloudObservation { points, state }, noise)
            }
        });
        Ok(answer?.f_to_device(Device::Cpu)?)
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "networks compute in single precision"
)]
fn numbers(name: &str, shape: &[i64]) -> Result<Tensor, Box<dyn Error>> {
    let mut random = SplitMix64::named(name, 1);
    let values: Vec<f32> = (0..shape.iter().product::<i64>())
        .map(|_| random.signed_unit() as f32)
        .collect();
    Ok(Tensor::f_from_slice(&values)?.f_view(shape)?)
}

/// Writes the parameters under their keys and the observation under `input.*`.
fn write(
    file: &Path,
    parameters: &Parameters,
    inputs: &[(&str, &Tensor)],
) -> Result<(), Box<dyn Error>> {
    let on_host = |tensor: &Tensor| tensor.f_to_device(Device::Cpu)?.f_contiguous();
    let mut tensors: Vec<(String, Tensor)> = Vec::new();
    for (key, tensor) in parameters.iter() {
        tensors.push((key.to_owned(), on_host(tensor)?));
    }
    for (name, tensor) in inputs {
        tensors.push((format!("input.{name}"), on_host(tensor)?));
    }
    Tensor::write_safetensors(&tensors, file)?;
    Ok(())
}

/// How a network's weights and its answers are made.
#[derive(Clone, Copy)]
struct Way {
    device: Device,
    kind: Kind,
    /// The weights are the nearest numbers of half precision.
    half: bool,
}

impl Way {
    /// Makes `parameters` what they are to be.
    fn settle(self, parameters: &Parameters) -> Result<(), TchError> {
        if !self.half {
            return Ok(());
        }
        tch::no_grad(|| {
            for (_, tensor) in parameters.iter() {
                let near = tensor.f_to_kind(Kind::Half)?.f_to_kind(Kind::Float)?;
                tensor.shallow_clone().f_copy_(&near)?;
            }
            Ok(())
        })
    }
}

fn act(file: &Path, way: Way) -> Result<Subject, Box<dyn Error>> {
    let Way { device, kind, .. } = way;
    let camera = ["observation.images.endoscope".to_owned()];
    let config = ActConfig::lerobot_defaults(WIDTH, WIDTH, &camera, SIDE, SIDE);
    let act = Act::new(config, ParameterSource::seeded(1, device))?;
    way.settle(act.parameters())?;
    let images = numbers("images", &[1, 1, 3, SIDE, SIDE])?;
    let state = numbers("state", &[1, WIDTH])?;
    write(
        file,
        act.parameters(),
        &[("images", &images), ("state", &state)],
    )?;
    let folded = FoldedAct::new(&act, kind)?;
    let inputs = [images.f_to_device(device)?, state.f_to_device(device)?];
    Ok(Subject::Act(Box::new(folded), inputs))
}

fn dp3(file: &Path, preset: Dp3Preset, way: Way) -> Result<Subject, Box<dyn Error>> {
    let Way { device, kind, .. } = way;
    let config = Dp3Config::preset(preset, WIDTH, WIDTH);
    let noise = config.start_noise(1, 1)?;
    let points = numbers("points", &[1, config.n_obs_steps, POINTS, 3])?;
    let state = numbers("state", &[1, config.n_obs_steps, WIDTH])?;
    let dp3 = Dp3::new(config, ParameterSource::seeded(1, device))?;
    way.settle(dp3.parameters())?;
    let inputs = [("points", &points), ("state", &state), ("noise", &noise)];
    write(file, dp3.parameters(), &inputs)?;
    let folded = FoldedDp3::new(dp3, kind)?;
    let inputs = [points, state, noise].map(|input| input.to_device(device));
    Ok(Subject::Dp3(Box::new(folded), inputs))
}

fn make(folder: &Path, name: &str, device: Device) -> Result<Subject, Box<dyn Error>> {
    let (plain, kind) = match name.strip_suffix("-bf16") {
        Some(plain) => (plain, Kind::BFloat16),
        None => (name, Kind::Float),
    };
    let file = folder.join(format!("{plain}.safetensors"));
    let (network, half) = match plain.strip_suffix("-half") {
        Some(network) => (network, true),
        None => (plain, false),
    };
    let way = Way { device, kind, half };
    match network {
        "act" => act(&file, way),
        "dp3" => dp3(&file, Dp3Preset::Dp3, way),
        "simple-dp3" => dp3(&file, Dp3Preset::Simple, way),
        _ => Err(format!("no network {name}").into()),
    }
}

/// Time that this thread has had a processor, ns.
fn processor_ns() -> Result<u64, Box<dyn Error>> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    let first = text.split_whitespace().next().ok_or("empty schedstat")?;
    Ok(first.parse()?)
}

/// Answers `runs` times; the times of each, and the last answer left in the folder.
fn time(
    folder: &Path,
    name: &str,
    subject: &mut Subject,
    runs: u32,
) -> Result<serde_json::Value, Box<dyn Error>> {
    let clock = MonotonicClock::new();
    let (mut wall, mut processor) = (Vec::new(), Vec::new());
    let mut answer = subject.answer()?;
    for _ in 0..runs {
        let (before, on_processor) = (clock.now(), processor_ns()?);
        answer = subject.answer()?;
        wall.push(clock.now().since(before));
        processor.push(processor_ns()?.saturating_sub(on_processor));
    }
    let file = folder.join(format!("{name}.answer.safetensors"));
    Tensor::write_safetensors(&[("answer", &answer.f_contiguous()?)], file)?;
    Ok(serde_json::json!({ "wall_ns": wall, "processor_ns": processor }))
}

fn serve(folder: &Path, device: Device) -> Result<(), Box<dyn Error>> {
    let mut subjects: BTreeMap<String, Subject> = BTreeMap::new();
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let words: Vec<&str> = line.split_whitespace().collect();
        let reply = match words.as_slice() {
            ["make", name] => {
                let subject = make(folder, name, device)?;
                subjects.insert((*name).to_owned(), subject);
                serde_json::json!({ "made": name })
            }
            ["time", name, runs] => {
                let subject = subjects.get_mut(*name).ok_or("not made")?;
                time(folder, name, subject, runs.parse()?)?
            }
            ["drop", name] => serde_json::json!({ "dropped": subjects.remove(*name).is_some() }),
            _ => return Err(format!("no such request: {line}").into()),
        };
        println!("{reply}");
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, device, threads] = arguments.as_slice() else {
        println!("run by tests/scripts/eager_peers.py");
        return Ok(());
    };
    tch::set_num_threads(threads.parse()?);
    let device = match device.as_str() {
        "cpu" => Device::Cpu,
        "cuda" if tch::Cuda::is_available() => Device::Cuda(0),
        other => return Err(format!("no device {other}").into()),
    };
    serve(&PathBuf::from(folder), device)
}
