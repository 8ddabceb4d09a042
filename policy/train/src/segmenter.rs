//! Training of a segmenter on labelled CT volumes.
//!
//! A step takes windows from volumes drawn at random and changes their intensities as scanners do:
//! another contrast of each tissue, scale and shift of all, blur, noise, rings and streaks. The
//! loss is cross-entropy plus the Dice loss over all classes. On the CPU, with one seed and one
//! thread, two runs give the same bits.

mod scanner;
#[cfg(test)]
mod tests;

use tch::{Device, Kind, TchError, Tensor};

use hal::random::SplitMix64;
use trocar_nets::act::ActPreset;
use trocar_nets::cuda_graph::allow_tf32_products;
use trocar_nets::dimension::{dimension, length};
use trocar_nets::generator;
use trocar_nets::parameters::ParameterSource;
use trocar_nets::segmenter::{SegmenterSettings, UNet, UNetConfig};

use super::TrainError;
use super::flat::{FlatParameters, Rates};
use super::options::{Schedule, TrainOptions};
use scanner::changed;

/// A labelled volume, at the spacing and in the orientation of the settings.
#[derive(Clone, Debug)]
pub struct LabelledScan {
    /// Voxels along x, y and z; no fewer than a window's.
    pub dims: [usize; 3],
    /// CT values, HU, x fastest.
    pub hounsfield: Vec<i16>,
    /// Index into the settings' classes of each voxel.
    pub classes: Vec<u8>,
}

/// How a segmenter is trained.
#[derive(Clone, Copy, Debug)]
pub struct SegmenterTraining {
    /// Steps of the optimiser.
    pub steps: u64,
    /// Windows in a step.
    pub batch: usize,
    /// Greatest learning rate.
    pub lr: f64,
    /// The seed of everything random.
    pub seed: u64,
    /// Threads on the CPU.
    pub threads: usize,
    /// Where it trains.
    pub device: Device,
}

/// Steps over which the reported loss is averaged.
const LOSS_EVERY: u64 = 20;

impl SegmenterTraining {
    /// What is impossible in the options, if something is.
    #[must_use]
    pub fn defect(&self) -> Option<String> {
        self.options().defect()
    }

    /// The options of the optimiser; those of images and datasets have no effect.
    fn options(&self) -> TrainOptions {
        TrainOptions {
            steps: self.steps,
            batch: self.batch,
            lr: self.lr,
            lr_backbone: self.lr,
            weight_decay: 1e-4,
            warm_up_steps: (self.steps / 20).min(100),
            schedule: Schedule::Cosine,
            clip_norm: 5.0,
            ema_decay: 0.99,
            ema_power: 0.0,
            seed: self.seed,
            threads: self.threads,
            ..TrainOptions::preset(ActPreset::Small)
        }
    }

    /// Trains a network of `config` on `scans`; `watch` gets the step and the mean loss since its
    /// last call, and says whether to go on: if not, the network is what it is by then.
    ///
    /// # Errors
    /// [`TrainError`]: impossible options, no scan, one smaller than a window, a loss that is not finite.
    pub fn run(
        &self,
        config: &UNetConfig,
        settings: &SegmenterSettings,
        scans: &[LabelledScan],
        watch: &mut dyn FnMut(u64, f64) -> bool,
    ) -> Result<UNet, TrainError> {
        let options = self.options();
        let defect = options.defect().or_else(|| config.defect());
        let defect = defect.or_else(|| settings.defect().map(|defect| defect.to_string()));
        if let Some(defect) = defect.or_else(|| misfit(settings, scans)) {
            return Err(TrainError::Options(defect));
        }
        if scans.is_empty() {
            return Err(TrainError::Empty);
        }
        tch::set_num_threads(i32::try_from(self.threads.max(1)).unwrap_or(i32::MAX));
        allow_tf32_products();
        let fresh = UNet::new(
            config.clone(),
            ParameterSource::seeded(self.seed, Device::Cpu),
        )?;
        let mut flat = FlatParameters::new(fresh.parameters(), self.device, &options)?;
        let working = ParameterSource::given(flat.working_tensors());
        let network = UNet::new(config.clone(), working)?;
        let volumes = scans.iter().map(|scan| Volume::new(scan, self.device));
        let volumes = volumes.collect::<Result<Vec<_>, _>>()?;
        let (mut sum, mut count) = (Tensor::f_zeros([], (Kind::Float, self.device))?, 0.0);
        for step in 0..self.steps {
            let mut random = SplitMix64::named(&format!("segmenter/step/{step}"), self.seed);
            let _drawing = generator::seeded(random.next_u64());
            let (seen, wanted) = self.batch(settings, &volumes, &mut random)?;
            let loss = loss(&network.forward(&seen)?, &wanted, config.classes)?;
            let factor = options.lr_factor(step);
            let rates = Rates::of(step + 1, [self.lr * factor; 2], &options);
            let _norm = if self.device.is_cuda() {
                flat.fused_step(&loss, None, &rates.sent(self.device)?, &options)?
            } else {
                flat.step(&loss, rates, &options)?
            };
            sum = sum.f_add(&loss.f_detach()?)?;
            count += 1.0;
            if (step + 1).is_multiple_of(LOSS_EVERY) || step + 1 == self.steps {
                let mean = sum.f_double_value(&[])? / count;
                if !mean.is_finite() {
                    let (step, term, value) = (step + 1, "loss", mean);
                    return Err(TrainError::Diverged { step, term, value });
                }
                (sum, count) = (sum.f_zeros_like()?, 0.0);
                if !watch(step + 1, mean) {
                    break;
                }
            }
        }
        let averaged = ParameterSource::given(flat.averaged_tensors()?);
        Ok(UNet::new(config.clone(), averaged)?)
    }

    /// Windows `(batch, 1, x, y, z)` as the network sees them, and their classes `(batch, x, y,
    /// z)`.
    fn batch(
        &self,
        settings: &SegmenterSettings,
        volumes: &[Volume],
        random: &mut SplitMix64,
    ) -> Result<(Tensor, Tensor), TchError> {
        let (mut seen, mut wanted) = (Vec::new(), Vec::new());
        for _ in 0..self.batch {
            let volume = &volumes[random.below(volumes.len())];
            let (hounsfield, classes) = volume.window(settings.patch, random)?;
            let changed = changed(&hounsfield, &classes, settings.classes.len(), random)?;
            let [low, high] = settings.window_hu;
            let [least, most] = settings.range;
            let scaled = changed
                .f_sub_scalar(low)?
                .f_mul_scalar((most - least) / (high - low))?;
            seen.push(
                scaled
                    .f_add_scalar(least)?
                    .f_clamp(least, most)?
                    .f_unsqueeze(0)?,
            );
            wanted.push(classes);
        }
        Ok((Tensor::f_stack(&seen, 0)?, Tensor::f_stack(&wanted, 0)?))
    }
}

/// What of `scans` does not fit `settings`, if anything does not.
fn misfit(settings: &SegmenterSettings, scans: &[LabelledScan]) -> Option<String> {
    let classes = settings.classes.len();
    scans.iter().enumerate().find_map(|(index, scan)| {
        let voxels = scan.dims.iter().product::<usize>();
        if scan
            .dims
            .iter()
            .zip(&settings.patch)
            .any(|(side, patch)| side < patch)
        {
            return Some(format!(
                "scan {index} has {:?} voxels, fewer than a window's {:?}",
                scan.dims, settings.patch
            ));
        }
        if [scan.hounsfield.len(), scan.classes.len()] != [voxels; 2] {
            return Some(format!("scan {index} has not a value and a class a voxel"));
        }
        let beyond = scan
            .classes
            .iter()
            .any(|class| usize::from(*class) >= classes);
        beyond.then(|| format!("scan {index} has classes beyond the {classes} of the settings"))
    })
}

/// A scan where the training is: `(z, y, x)`.
struct Volume {
    /// HU, 16-bit integers.
    hounsfield: Tensor,
    /// Indices of the classes, 8-bit.
    classes: Tensor,
}

impl Volume {
    fn new(scan: &LabelledScan, device: Device) -> Result<Self, TchError> {
        let [x, y, z] = scan.dims.map(dimension);
        let place = |tensor: Tensor| tensor.f_view([z, y, x])?.f_to_device(device);
        Ok(Self {
            hounsfield: place(Tensor::f_from_slice(&scan.hounsfield)?)?,
            classes: place(Tensor::f_from_slice(&scan.classes)?)?,
        })
    }

    /// A window `(x, y, z)` somewhere.
    fn window(
        &self,
        patch: [usize; 3],
        random: &mut SplitMix64,
    ) -> Result<(Tensor, Tensor), TchError> {
        let (mut hounsfield, mut classes) = (
            self.hounsfield.shallow_clone(),
            self.classes.shallow_clone(),
        );
        for (dim, side) in [(2, patch[0]), (1, patch[1]), (0, patch[2])] {
            let free = length(hounsfield.size()[length(dim)]) - side;
            let (start, side) = (dimension(random.below(free + 1)), dimension(side));
            hounsfield = hounsfield.f_narrow(dim, start, side)?;
            classes = classes.f_narrow(dim, start, side)?;
        }
        let turned = |tensor: &Tensor| tensor.f_permute([2, 1, 0])?.f_contiguous();
        Ok((
            turned(&hounsfield)?.f_to_kind(Kind::Float)?,
            turned(&classes)?.f_to_kind(Kind::Int64)?,
        ))
    }
}

/// Cross-entropy plus one minus the mean Dice over the classes, of `scores` `(batch, classes, x, y,
/// z)`.
///
/// Dice of a class is `(2 sum p g + 1) / (sum p + sum g + 1)` with probabilities `p` and labels `g`
/// over the whole batch (Milletari et al. 2016, without squares); the ones keep an absent class
/// from dividing by zero.
fn loss(scores: &Tensor, wanted: &Tensor, classes: i64) -> Result<Tensor, TchError> {
    let log = scores
        .f_log_softmax(1, Kind::Float)?
        .f_permute([0, 2, 3, 4, 1])?
        .f_reshape([-1, classes])?;
    let wanted = wanted.f_reshape([-1])?;
    let entropy = log
        .f_gather(1, &wanted.f_unsqueeze(1)?, false)?
        .f_mean(Kind::Float)?
        .f_neg()?;
    let chosen = log.f_exp()?;
    let hot = wanted.f_one_hot(classes)?.f_to_kind(Kind::Float)?;
    let over = |x: &Tensor| x.f_sum_dim_intlist([0].as_slice(), false, Kind::Float);
    let both = over(&chosen.f_mul(&hot)?)?
        .f_mul_scalar(2.0)?
        .f_add_scalar(1.0)?;
    let all = over(&chosen)?.f_add(&over(&hot)?)?.f_add_scalar(1.0)?;
    let dice = both.f_div(&all)?.f_mean(Kind::Float)?;
    entropy.f_sub(&dice)?.f_add_scalar(1.0)
}
