//! A trained ACT network as a policy: frames and arm states in, a chunk of absolute tip targets for
//! each arm out.

use std::path::Path;

use hal::chunk::CHUNK_STEPS_MAX;
use hal::count::count_u32;
use hal::{Chunk, FrameRef, Observation, Policy, PolicyError};
use tch::{Device, Kind, TchError, Tensor};

use crate::act::{ActConfig, FoldedAct};
use crate::checkpoint::{self, Cause, CheckpointError, Recipe};
use crate::compute::Compute;
use crate::dimension::{dimension, length};
use crate::images::{area_average, shrink_factor};
use crate::interface::Interface;
use crate::normalise::{ImageNormaliser, Normaliser};

pub use crate::interface::state_numbers;

/// An ACT policy that was loaded from a folder.
#[derive(Debug)]
pub struct ActPolicy {
    config: ActConfig,
    act: FoldedAct,
    device: Device,
    interface: Interface,
    image_factors: Vec<u32>,
    images: ImageNormaliser,
    state: Normaliser,
    action: Normaliser,
}

impl ActPolicy {
    /// Loads the policy in `folder` and runs it once. The threads of `compute` become those of the
    /// whole process.
    ///
    /// # Errors
    /// [`CheckpointError`] naming the file and what is wrong with it; a folder without
    /// `trocar.json` is refused, since nothing then says what the actions mean.
    pub fn load(folder: &Path, compute: impl Into<Compute>) -> Result<Self, CheckpointError> {
        let compute = compute.into();
        let (device, kind) = (compute.device, compute.prepare(folder)?);
        let recipe_file = folder.join("trocar.json");
        if folder.is_dir() && !recipe_file.exists() {
            return Err(Cause::NoRecipe.in_file(&recipe_file));
        }
        let loaded = checkpoint::load(folder, device)?;
        let Some(recipe) = loaded.recipe else {
            return Err(Cause::NoRecipe.in_file(&recipe_file));
        };
        let config = loaded.act.config();
        if !(1..=dimension(CHUNK_STEPS_MAX)).contains(&config.chunk_size) {
            let defect = format!(
                "chunk_size = {} is outside [1, {CHUNK_STEPS_MAX}]",
                config.chunk_size
            );
            return Err(Cause::Config(defect).in_file(&folder.join("config.json")));
        }
        let (high, wide) = (side(config.image_height), side(config.image_width));
        let image_factors = recipe
            .cameras
            .iter()
            .map(|camera| shrink_factor(camera.width, camera.height, wide, high))
            .collect::<Result<Vec<u32>, _>>()
            .map_err(|error| Cause::Inconsistent(error.to_string()).in_file(&recipe_file))?;
        let torch = |error: TchError| Cause::Parameter(error.into()).in_file(folder);
        let mut policy = Self {
            image_factors,
            images: ImageNormaliser::imagenet(device).map_err(torch)?,
            state: loaded.statistics.state.normaliser(),
            action: loaded.statistics.action.normaliser(),
            act: FoldedAct::new(&loaded.act, kind).map_err(torch)?,
            config: loaded.act.config().clone(),
            device,
            interface: Interface::new(recipe),
        };
        policy.warm_up().map_err(torch)?;
        Ok(policy)
    }

    /// The checkpoint's recipe: cameras, step, query interval.
    #[must_use]
    pub const fn recipe(&self) -> &Recipe {
        &self.interface.recipe
    }

    /// One inference on a black image, so that a network that cannot run fails now, and the first
    /// answer is not late.
    fn warm_up(&mut self) -> Result<(), TchError> {
        let config = &self.config;
        let cameras = dimension(self.interface.recipe.cameras.len());
        let shape = [1, cameras, config.image_height, config.image_width, 3];
        let images = Tensor::f_zeros(shape, (Kind::Uint8, self.device))?;
        let state = Tensor::f_zeros([1, config.state_dim], (Kind::Float, Device::Cpu))?;
        self.network(&images, &state).map(|_| ())
    }

    /// Image bytes `(1, cameras, height, width, 3)` and the state in SI units to actions in SI
    /// units, row-major.
    fn network(&mut self, images: &Tensor, state: &Tensor) -> Result<Vec<f32>, TchError> {
        tch::no_grad(|| {
            let images = self.images.apply(images)?;
            let state = self.state.apply(state)?.f_to_device(self.device)?;
            let chunk = self.act.infer(&images, &state)?.f_to_device(Device::Cpu)?;
            Vec::<f32>::try_from(&self.action.invert(&chunk)?.f_reshape([-1])?)
        })
    }

    /// The frames, of the recipe's sizes, as one tensor of bytes `(1, cameras, height, width, 3)`
    /// at the network's size.
    fn image_bytes(&self, frames: &[FrameRef<'_>]) -> Result<Tensor, PolicyError> {
        let mut bytes = Vec::new();
        for (camera, (frame, factor)) in frames.iter().zip(&self.image_factors).enumerate() {
            let (width, height) = (frame.intrinsics.width, frame.intrinsics.height);
            if frame.colour.len() != 3 * frame.intrinsics.pixel_count() {
                return Err(PolicyError::ImageSize {
                    camera,
                    expected_width: width,
                    expected_height: height,
                    width,
                    height,
                });
            }
            bytes.extend(area_average(frame.colour, width, *factor));
        }
        let config = &self.config;
        let count = dimension(frames.len());
        let shape = [1, count, config.image_height, config.image_width, 3];
        let tensor = Tensor::f_from_data_size(&bytes, &shape, Kind::Uint8)
            .and_then(|t| t.f_to_device(self.device));
        tensor.map_err(|error| PolicyError::Inference(error.to_string()))
    }
}

impl Policy for ActPolicy {
    fn reset(&mut self, _seed: u64) {
        // Inference draws nothing at random: the latent is zero.
        self.interface.sequence = 0;
    }

    fn infer(&mut self, observation: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError> {
        let numbers = self.interface.state(observation)?;
        let images = self.image_bytes(observation.frames)?;
        let state = Tensor::f_from_slice(&numbers).and_then(|state| state.f_unsqueeze(0));
        let actions = state.and_then(|state| self.network(&images, &state));
        self.interface.chunks(observation, actions)
    }
}

/// A side of the network's images; the configuration allows no more than 4096.
fn side(pixels: i64) -> u32 {
    count_u32(length(pixels))
}
