//! An episode as the tables of a dataset list it.
//!
//! Paths and numbers as they are claimed, not yet compared with the data files:
//! `rows::check_episode` does that.

use std::path::PathBuf;

/// One episode as the dataset's tables list it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Listed {
    /// Its number, from 0.
    pub(super) index: usize,
    /// Its first frame among all of the dataset.
    pub(super) start: usize,
    /// Its frames.
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
    /// The video file; in v3.0 it may hold other episodes too.
    pub(super) path: PathBuf,
    /// When its first frame is shown, s.
    pub(super) from_s: f64,
}
