//! A trained ACT network as a policy: frames and arm states in, a chunk of absolute tip targets for each arm out.

use std::path::Path;

use hal::chunk::CHUNK_STEPS_MAX;
use hal::count::count_u32;
use hal::{ArmState, Chunk, FrameRef, Observation, Policy, PolicyError};
use tch::{Device, Kind, TchError, Tensor};

use crate::act::{ActConfig, FoldedAct};
use crate::checkpoint::{self, Cause, CheckpointError, Recipe};
use crate::compute::Compute;
use crate::dimension::{dimension, length};
use crate::images::{area_average, shrink_factor};
use crate::normalise::{ImageNormaliser, Normaliser};
use trocar_data::relative_action::chunks_of;

/// An ACT policy that was loaded from a folder.
#[derive(Debug)]
pub struct ActPolicy {
    config: ActConfig,
    act: FoldedAct,
    device: Device,
    recipe: Recipe,
    image_factors: Vec<u32>,
    images: ImageNormaliser,
    state: Normaliser,
    action: Normaliser,
    sequence: u64,
}

impl ActPolicy {
    /// Loads the policy in `folder` and runs it once. The threads of `compute` become those of the whole process.
    ///
    /// # Errors
    /// [`CheckpointError`] naming the file and what is wrong with it; a folder without `trocar.json` is refused, since
    /// nothing then says what the actions mean.
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
            recipe,
            sequence: 0,
        };
        policy.warm_up().map_err(torch)?;
        Ok(policy)
    }

    /// What the policy says of itself: cameras, step, how often to ask it.
    #[must_use]
    pub const fn recipe(&self) -> &Recipe {
        &self.recipe
    }

    /// One inference on a black image, so that a network that cannot run fails now, and the first answer is not late.
    fn warm_up(&mut self) -> Result<(), TchError> {
        let config = &self.config;
        let cameras = dimension(self.recipe.cameras.len());
        let shape = [1, cameras, config.image_height, config.image_width, 3];
        let images = Tensor::f_zeros(shape, (Kind::Uint8, self.device))?;
        let state = Tensor::f_zeros([1, config.state_dim], (Kind::Float, Device::Cpu))?;
        self.network(&images, &state).map(|_| ())
    }

    /// Image bytes `(1, cameras, height, width, 3)` and the state in SI units to actions in SI units, row-major.
    fn network(&mut self, images: &Tensor, state: &Tensor) -> Result<Vec<f32>, TchError> {
        tch::no_grad(|| {
            let images = self.images.apply(images)?;
            let state = self.state.apply(state)?.f_to_device(self.device)?;
            let chunk = self.act.infer(&images, &state)?.f_to_device(Device::Cpu)?;
            Vec::<f32>::try_from(&self.action.invert(&chunk)?.f_reshape([-1])?)
        })
    }

    /// The frames as one tensor of bytes `(1, cameras, height, width, 3)` at the network's size.
    fn image_bytes(&self, frames: &[FrameRef<'_>]) -> Result<Tensor, PolicyError> {
        let cameras = &self.recipe.cameras;
        if frames.len() != cameras.len() {
            return Err(PolicyError::CameraCount {
                expected: cameras.len(),
                actual: frames.len(),
            });
        }
        let mut bytes = Vec::new();
        for (camera, (frame, expected)) in frames.iter().zip(cameras).enumerate() {
            let (width, height) = (frame.intrinsics.width, frame.intrinsics.height);
            let whole = frame.colour.len() == 3 * frame.intrinsics.pixel_count();
            if (width, height) != (expected.width, expected.height) || !whole {
                let (expected_width, expected_height) = (expected.width, expected.height);
                return Err(PolicyError::ImageSize {
                    camera,
                    expected_width,
                    expected_height,
                    width,
                    height,
                });
            }
            bytes.extend(area_average(
                frame.colour,
                width,
                self.image_factors[camera],
            ));
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
        self.sequence = 0;
    }

    fn infer(&mut self, observation: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError> {
        let (expected, actual) = (self.recipe.arms, observation.arms.len());
        if expected != actual {
            return Err(PolicyError::ArmCount { expected, actual });
        }
        let images = self.image_bytes(observation.frames)?;
        let numbers: Vec<f32> = observation
            .arms
            .iter()
            .flat_map(|arm| state_numbers(&arm.state))
            .collect();
        let state = Tensor::f_from_slice(&numbers).and_then(|state| state.f_unsqueeze(0));
        let actions = state
            .and_then(|state| self.network(&images, &state))
            .map_err(|error| PolicyError::Inference(error.to_string()))?;
        if !actions.iter().all(|value| value.is_finite()) {
            return Err(PolicyError::Inference(
                "the network answered with a number that is not finite".to_owned(),
            ));
        }
        self.sequence += 1;
        let (sequence, step_ns) = (self.sequence, self.recipe.step_ns);
        let representation = &self.recipe.action_representation;
        Ok(chunks_of(
            representation,
            observation,
            &actions,
            sequence,
            step_ns,
        ))
    }
}

/// One arm's part of `observation.state`: six joint positions (rad, insertion m) and the jaw (rad).
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    reason = "networks compute in single precision"
)]
pub fn state_numbers(arm: &ArmState) -> [f32; 7] {
    let q = arm.position;
    [q[0], q[1], q[2], q[3], q[4], q[5], arm.jaw_position].map(|value| value as f32)
}

/// A side of the network's images; the configuration allows no more than 4096.
fn side(pixels: i64) -> u32 {
    count_u32(length(pixels))
}
