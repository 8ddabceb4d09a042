//! Demonstrations of a dVRK arm or two in HDF5, as ACT's and robomimic's programs write them, into
//! a LeRobot v3 dataset.
//!
//! ```text
//! act        FOLDER/episode_0.hdf5 ...   observations/qpos and action (steps, 7 an arm): six joint positions (rad, insertion m)
//!                                        and the jaw (rad); observations/images/CAMERA (steps, height, width, 3), or JPEG, a row
//!                                        each and padded to the same length, as act-plus-plus has them: with
//!                                        red and blue the other way round, so that its own reading puts them right
//! robomimic  FILE, data/demo_0 ...       joints, images and actions by the names that the options give them
//! ```
//!
//! A dataset here has for each frame the arm's joints, the pose of its tip, and the commanded pose
//! of its tip. Poses that the file lacks are computed from the joints by the arm's forward
//! kinematics. What can't be told from the file is refused rather than guessed: deltas as actions,
//! another number of joints, numbers that are not finite, joints outside of the arm's limits
//! (degrees, or a normalised gripper), frames that are missing.
//!
//! Any other LeRobot dataset, and a dVRK's raw recordings, come in by a table of names:
//! [`import_mapped`].
//!
//! All episodes are looked at before the first is written. An import that is cut off keeps whole
//! episodes, as [`DatasetWriter`](crate::dataset::DatasetWriter) does. HDF5 is read by a library
//! without C, links that lead out of the file are refused, and what a damaged file can have it
//! allocate is bounded.

mod arms;
mod chain;
mod error;
mod file;
mod filters;
mod inverse;
mod lzf;
mod mapped;
mod names;
mod pictures;
mod run;
mod source;
#[cfg(test)]
mod tests;

pub use arms::robot_type;
pub use chain::read_chain;
pub use error::ImportError;
pub use mapped::{
    AngleUnit, ArmMapping, Columns, Format, Frame, ImportRequest, LengthUnit, MappedCamera,
    MappedSummary, Mapping, QuaternionOrder, import_mapped,
};
pub use run::{ImportSummary, import};

use std::path::PathBuf;

use hal::JOINT_COUNT;
use hal::psm::DhRow;

use crate::dataset::VideoCodec;

/// Whose program wrote the demonstrations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// A folder with a file an episode.
    Act,
    /// A file with a group an episode.
    Robomimic,
}

/// What to import, from where, and what it is called there.
#[derive(Clone, Debug)]
pub struct ImportOptions {
    /// Whose layout.
    pub layout: Layout,
    /// The folder, or the file.
    pub source: PathBuf,
    /// The dataset's folder; a new or an empty one.
    pub out: PathBuf,
    /// Frames a second, which the files do not say.
    pub fps: u32,
    /// What the demonstrations show, in words.
    pub task: String,
    /// Joints and jaw within an episode; ACT's name if not given.
    pub joints: Option<String>,
    /// Commanded joints and jaw within an episode; ACT's name if neither this nor a pose is given.
    pub action_joints: Option<String>,
    /// Commanded tip poses within an episode: position (m), quaternion x, y, z, w in the arm's RCM
    /// frame, jaw (rad).
    pub action_pose: Option<String>,
    /// Cameras' frames within an episode; with ACT's layout all of its cameras if empty.
    pub images: Vec<String>,
    /// Width and height that frames are brought to, pixels, each 1 to
    /// [`SIDE_MAX`](crate::dataset::SIDE_MAX); as they are if not given.
    pub size: Option<(u32, u32)>,
    /// The arm's chain from the RCM to its last joint.
    pub chain: [DhRow; JOINT_COUNT],
    /// Keep colour as video.
    pub video: Option<VideoCodec>,
}
