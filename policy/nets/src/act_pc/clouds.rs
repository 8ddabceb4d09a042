//! Clouds on their way into the network, with the centres of the tokens and the points around them.

use tch::{Device, TchError, Tensor};

use super::config::ActPcConfig;
use crate::dimension::{dimension, length};
use trocar_data::perception::{PerceptionError, Point, farthest_points, nearest_points};

/// A batch of clouds, in metres, and what belongs together in them.
#[derive(Debug)]
pub struct Clouds {
    /// `(batch, points, 3)`.
    pub points: Tensor,
    /// Indices of the tokens' centres among the points, `(batch, tokens)`, whole numbers.
    pub centres: Tensor,
    /// Indices of the points around each centre, nearest first, `(batch, tokens, neighbours)`,
    /// whole numbers.
    pub neighbours: Tensor,
}

/// Why clouds cannot enter the network.
#[derive(Debug, thiserror::Error)]
pub enum CloudsError {
    /// A cloud has another number of points than the network wants.
    #[error("cloud {cloud} has {actual} points, the network wants {expected}")]
    Count {
        /// Index of the cloud.
        cloud: usize,
        /// What the network wants.
        expected: i64,
        /// What is there.
        actual: usize,
    },
    /// Its points make no sense.
    #[error(transparent)]
    Perception(#[from] PerceptionError),
    /// The network library failed.
    #[error(transparent)]
    Torch(#[from] TchError),
}

impl Clouds {
    /// The batch of `clouds` for a network of `config`, on `device`.
    ///
    /// Which points belong together is found on the CPU, in plain Rust: the same on every machine,
    /// and it can be done ahead while a network trains. Centres by farthest-point sampling,
    /// neighbours exhaustively.
    ///
    /// # Errors
    /// [`CloudsError`] if a cloud has another number of points than the network wants, or one that
    /// is not finite.
    pub fn new(
        clouds: &[&[Point]],
        config: &ActPcConfig,
        device: Device,
    ) -> Result<Self, CloudsError> {
        let (mut points, mut centres, mut neighbours) = (Vec::new(), Vec::new(), Vec::new());
        for (index, cloud) in clouds.iter().enumerate() {
            check_count(index, cloud.len(), config.points)?;
            let chosen = farthest_points(cloud, length(config.tokens))?;
            let places: Vec<Point> = chosen.iter().map(|&index| cloud[index]).collect();
            let around = nearest_points(cloud, &places, length(config.neighbours))?;
            points.extend_from_slice(cloud.as_flattened());
            centres.extend(chosen.into_iter().map(dimension));
            neighbours.extend(around.into_iter().map(dimension));
        }
        let on_device = |tensor: Tensor, shape: &[i64]| tensor.f_view(shape)?.f_to_device(device);
        Ok(Self {
            points: on_device(Tensor::f_from_slice(&points)?, &[-1, config.points, 3])?,
            centres: on_device(Tensor::f_from_slice(&centres)?, &[-1, config.tokens])?,
            neighbours: on_device(
                Tensor::f_from_slice(&neighbours)?,
                &[-1, config.tokens, config.neighbours],
            )?,
        })
    }
}

/// Refuses a cloud that would not fill its row of the tensor.
fn check_count(cloud: usize, actual: usize, expected: i64) -> Result<(), CloudsError> {
    if i64::try_from(actual) == Ok(expected) {
        return Ok(());
    }
    Err(CloudsError::Count {
        cloud,
        expected,
        actual,
    })
}
