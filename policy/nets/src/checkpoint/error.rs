//! Why a checkpoint is refused: always the file, and what is wrong with it.

use std::path::{Path, PathBuf};

use crate::parameters::ParameterError;

/// A checkpoint that cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[error("{}: {cause}", .file.display())]
pub struct CheckpointError {
    /// The file.
    pub file: PathBuf,
    /// What is wrong with it.
    pub cause: Cause,
}

/// What is wrong with a file of a checkpoint.
#[derive(Debug, thiserror::Error)]
pub enum Cause {
    /// It is not there.
    #[error("file is missing")]
    Missing,
    /// It is not there, as in folders of LeRobot's own.
    #[error(
        "file is missing: it says what the actions mean and how fast they follow each other; `python policy/convert/lerobot_recipe.py \
         FOLDER --actions absolute_pose --fps 25` writes it for a policy that LeRobot trained"
    )]
    NoRecipe,
    /// It cannot be read or written.
    #[error("{0}")]
    Io(std::io::Error),
    /// It is no JSON, or a field is missing or of the wrong type.
    #[error("malformed: {0}")]
    Json(serde_json::Error),
    /// It is no safetensors file, or is cut off.
    #[error("no intact safetensors file: {0}")]
    Safetensors(safetensors::SafeTensorError),
    /// Weights as torch saves them, which only torch reads.
    #[error(
        "written by torch.save, which is not read here since it can run code; `python policy/convert/resnet18.py NEW.safetensors \
         --weights {}` makes a file of it that is", .0.display()
    )]
    Pickled(PathBuf),
    /// Weights of a whole policy where those of a backbone alone should be.
    #[error("the weights of a whole policy, not of a backbone alone; name their folder instead: {}", .0.display())]
    WholePolicy(PathBuf),
    /// A backbone without the statistics that a frozen one has.
    #[error(
        "a backbone with group normalisation, which learns from scratch; expected one with frozen batch normalisation, that is \
         with running_mean and running_var: torchvision's ResNet-18, or an ACT policy in LeRobot's form"
    )]
    GroupNormalised,
    /// A tensor has an element type that weights do not have.
    #[error("tensor {key} has element type {kind}, not F16, BF16 or F32")]
    ElementType {
        /// The tensor.
        key: String,
        /// Its type.
        kind: String,
    },
    /// A tensor is missing, left over or of another shape than the configuration says.
    #[error("{0}")]
    Parameter(ParameterError),
    /// A weight is NaN or infinite.
    #[error("a weight is not finite")]
    NotFinite,
    /// The policy is of another kind.
    #[error("policy type is {actual:?}, expected \"act\"")]
    PolicyType {
        /// What the file says.
        actual: String,
    },
    /// A field has a value that this program cannot do.
    #[error("{field} = {value} is not supported, expected {expected}")]
    Unsupported {
        /// The field.
        field: String,
        /// What the file says.
        value: String,
        /// What would do.
        expected: String,
    },
    /// The policy is for another number of joints.
    #[error(
        "{feature} has {actual} numbers, expected {expected}: those of each arm, arms = {arms}"
    )]
    JointCount {
        /// The feature.
        feature: String,
        /// Numbers in the checkpoint.
        actual: i64,
        /// Arms that the checkpoint is for.
        arms: usize,
        /// Numbers of these arms.
        expected: i64,
    },
    /// The configuration cannot be built.
    #[error("{0}")]
    Config(String),
    /// Statistics are missing, zero or not finite.
    #[error("statistics of {feature}: {defect}")]
    Statistics {
        /// The feature.
        feature: String,
        /// What is wrong with them.
        defect: String,
    },
    /// Two files do not fit together.
    #[error("{0}")]
    Inconsistent(String),
}

impl Cause {
    /// The error that this is in `file`.
    #[must_use]
    pub fn in_file(self, file: &Path) -> CheckpointError {
        CheckpointError {
            file: file.to_path_buf(),
            cause: self,
        }
    }

    /// The cause behind a failed access.
    #[must_use]
    pub fn io(error: std::io::Error) -> Self {
        if error.kind() == std::io::ErrorKind::NotFound {
            Self::Missing
        } else {
            Self::Io(error)
        }
    }
}
