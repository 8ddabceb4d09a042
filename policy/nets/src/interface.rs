//! What the policies of all networks share: on the way in an observation is checked against the
//! checkpoint's recipe, on the way out actions become chunks.

use std::fmt::Display;

use hal::{ArmState, Chunk, FrameRef, Observation, PolicyError};

use crate::checkpoint::{Recipe, RecordedCamera};
use trocar_data::perception::{CloudRecipe, Point};
use trocar_data::relative_action::chunks_of;

/// The recipe of a policy, and how many observations it has answered.
#[derive(Debug)]
pub(crate) struct Interface {
    pub(crate) recipe: Recipe,
    /// Answers since the last reset; a chunk carries it, from 1.
    pub(crate) sequence: u64,
}

impl Interface {
    pub(crate) const fn new(recipe: Recipe) -> Self {
        Self {
            recipe,
            sequence: 0,
        }
    }

    /// The state of all arms of `observation`, arm by arm, in SI units.
    ///
    /// # Errors
    /// [`PolicyError`] if its arms or frames are not those of the recipe.
    pub(crate) fn state(&self, observation: &Observation<'_>) -> Result<Vec<f32>, PolicyError> {
        let (expected, actual) = (self.recipe.arms, observation.arms.len());
        if expected != actual {
            return Err(PolicyError::ArmCount { expected, actual });
        }
        check_frames(&self.recipe.cameras, observation.frames)?;
        let arms = observation.arms.iter();
        Ok(arms.flat_map(|arm| state_numbers(&arm.state)).collect())
    }

    /// The chunks of all arms that `actions` mean, which a network predicted of `observation`,
    /// row-major, in SI units.
    ///
    /// # Errors
    /// [`PolicyError::Inference`] if it failed, or a number is not finite.
    pub(crate) fn chunks<E: Display>(
        &mut self,
        observation: &Observation<'_>,
        actions: Result<Vec<f32>, E>,
    ) -> Result<Vec<Chunk>, PolicyError> {
        let actions = actions.map_err(|error| PolicyError::Inference(error.to_string()))?;
        if !actions.iter().all(|value| value.is_finite()) {
            return Err(PolicyError::Inference(
                "the network answered with a number that is not finite".to_owned(),
            ));
        }
        self.sequence += 1;
        let recipe = &self.recipe;
        Ok(chunks_of(
            &recipe.action_representation,
            observation,
            &actions,
            self.sequence,
            recipe.step_ns,
        ))
    }
}

/// The point cloud that `recipe` makes of `observation`, in metres.
pub(crate) fn cloud(
    recipe: &CloudRecipe,
    observation: &Observation<'_>,
) -> Result<Vec<Point>, PolicyError> {
    let cloud = recipe.cloud(observation.frames);
    cloud.map_err(|error| PolicyError::Inference(format!("point cloud: {error}")))
}

/// The frames must be those of `cameras`, of their sizes.
fn check_frames(cameras: &[RecordedCamera], frames: &[FrameRef<'_>]) -> Result<(), PolicyError> {
    let (expected, actual) = (cameras.len(), frames.len());
    if expected != actual {
        return Err(PolicyError::CameraCount { expected, actual });
    }
    for (camera, (frame, expected)) in frames.iter().zip(cameras).enumerate() {
        let (width, height) = (frame.intrinsics.width, frame.intrinsics.height);
        if (width, height) != (expected.width, expected.height) {
            return Err(PolicyError::ImageSize {
                camera,
                expected_width: expected.width,
                expected_height: expected.height,
                width,
                height,
            });
        }
    }
    Ok(())
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
