//! An episode as the tables of a dataset list it.

use std::path::PathBuf;

/// One episode as the dataset's tables list it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Listed {
    pub(super) index: usize,
    pub(super) start: usize,
    pub(super) len: usize,
    /// The file with its rows.
    pub(super) data: PathBuf,
    /// Whether that holds no other episode's, as in v2.x.
    pub(super) alone: bool,
    /// Where its frames are, of each camera that is asked about.
    pub(super) videos: Vec<VideoPlace>,
}

/// Where an episode's frames of one camera are.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct VideoPlace {
    pub(super) path: PathBuf,
    /// When its first frame is shown, s.
    pub(super) from_s: f64,
}
