//! Frames of video for readers that want one after another: pieces are decoded whole and the latest
//! are kept.
//!
//! A decoder has to begin at a key frame and costs a process, so single frames are dear; a training
//! that walks along an episode pays for one piece in up to 64 frames. The cache is shared by all
//! threads and locked only for the look-up, not while decoding: two threads that miss the same
//! piece both decode it.

use std::{
    collections::{BTreeMap, VecDeque},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use image::RgbImage;

use super::{
    DatasetError,
    listed::Listed,
    video::{FrameTimes, failed},
};

/// Bytes that a piece should not exceed; it has at least one frame, at most [`PIECE_FRAMES_MAX`].
const PIECE_BYTES: usize = 24 << 20;
/// Frames that a piece has at most.
const PIECE_FRAMES_MAX: usize = 64;

/// Pieces that are kept: at least one for each camera of each thread that reads.
const PIECES_MAX: usize = 32;

/// The frames of the cameras that are kept as video.
#[derive(Debug)]
pub(super) struct VideoFrames {
    /// By camera, then episode; none of a camera that is not kept as video.
    cameras: Vec<Vec<Option<Place>>>,
    /// Each file once, however many episodes it holds.
    files: Vec<VideoFile>,
    /// Decoded RGB, the least recently used first.
    recent: Mutex<VecDeque<(Key, Arc<Vec<u8>>)>>,
}

/// File and first frame there of an episode.
#[derive(Clone, Copy, Debug)]
struct Place {
    file: usize,
    /// Its first frame among those of the file.
    first: usize,
    len: usize,
}

/// A file and when each of its frames is shown.
#[derive(Debug)]
struct VideoFile {
    path: PathBuf,
    times: FrameTimes,
}

/// Camera, episode, piece.
type Key = (usize, usize, usize);

impl VideoFrames {
    /// Of the cameras `features` in the `listed` episodes; `kept` are the features that are kept as
    /// video, in the order of the listing. Looks at every file once: each episode's first and last
    /// frame must be shown when the dataset, with `fps` frames a second, says so, and all of its
    /// frames must be there.
    pub(super) fn open(
        features: &[String],
        kept: &[String],
        listed: &[Listed],
        fps: u32,
    ) -> Result<Self, DatasetError> {
        let mut files: Vec<VideoFile> = Vec::new();
        let mut numbers: BTreeMap<&Path, usize> = BTreeMap::new();
        let mut cameras = Vec::new();
        for feature in features {
            let Some(camera) = kept.iter().position(|other| other == feature) else {
                cameras.push(vec![None; listed.len()]);
                continue;
            };
            let mut places = Vec::new();
            for Listed { videos, len, .. } in listed {
                let (place, len) = (&videos[camera], *len);
                let file = match numbers.get(place.path.as_path()) {
                    Some(&file) => file,
                    None => {
                        let (path, times) = (place.path.clone(), FrameTimes::read(&place.path)?);
                        files.push(VideoFile { path, times });
                        numbers.insert(&place.path, files.len() - 1);
                        files.len() - 1
                    }
                };
                let first = first_frame(&files[file], place.from_s, len, fps)?;
                places.push(Some(Place { file, first, len }));
            }
            cameras.push(places);
        }
        Ok(Self {
            cameras,
            files,
            recent: Mutex::new(VecDeque::new()),
        })
    }

    /// Is the camera kept as video in an episode?
    pub(super) fn has(&self, camera: usize, episode: usize) -> bool {
        self.place(camera, episode).is_some()
    }

    fn place(&self, camera: usize, episode: usize) -> Option<Place> {
        *self.cameras.get(camera)?.get(episode)?
    }

    /// Appends the episodes of `other`, which has the same cameras.
    pub(super) fn append(&mut self, other: Self) {
        let files = self.files.len();
        let moved = |place: Place| Place {
            file: files + place.file,
            ..place
        };
        for (mine, theirs) in self.cameras.iter_mut().zip(other.cameras) {
            mine.extend(theirs.into_iter().map(|place| place.map(moved)));
        }
        self.files.extend(other.files);
    }

    /// A frame of an episode, of `width` by `height` pixels; none if the camera is not kept as
    /// video there.
    pub(super) fn image(
        &self,
        camera: usize,
        [episode, frame]: [usize; 2],
        [width, height]: [u32; 2],
    ) -> Result<Option<RgbImage>, DatasetError> {
        let Some(place) = self.place(camera, episode) else {
            return Ok(None);
        };
        let file = &self.files[place.file];
        let frame_bytes = 3 * width as usize * height as usize;
        let piece_frames = (PIECE_BYTES / frame_bytes.max(1)).clamp(1, PIECE_FRAMES_MAX);
        let (piece, within) = (frame / piece_frames, frame % piece_frames);
        let bytes = if let Some(bytes) = self.recall((camera, episode, piece)) {
            bytes
        } else {
            let first = piece * piece_frames;
            let count = piece_frames.min(place.len.saturating_sub(first));
            let range = [place.first + first, count];
            let decoded = file.times.decode(&file.path, range, [width, height])?;
            self.remember((camera, episode, piece), Arc::new(decoded))
        };
        let start = within * frame_bytes;
        let image = bytes.get(start..start + frame_bytes);
        let image = image.and_then(|bytes| RgbImage::from_raw(width, height, bytes.to_vec()));
        image.map_or_else(
            || Err(failed(&file.path, format!("frame {frame} is missing"))),
            |image| Ok(Some(image)),
        )
    }

    /// A piece that is kept; it becomes the most recent one.
    fn recall(&self, key: Key) -> Option<Arc<Vec<u8>>> {
        let mut recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        let place = recent.iter().position(|(other, _)| *other == key)?;
        let found = recent.remove(place)?;
        let bytes = Arc::clone(&found.1);
        recent.push_back(found);
        Some(bytes)
    }

    /// Keeps a piece, and drops the oldest beyond `PIECES_MAX`.
    fn remember(&self, key: Key, bytes: Arc<Vec<u8>>) -> Arc<Vec<u8>> {
        let mut recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        while recent.len() >= PIECES_MAX {
            let _forgotten = recent.pop_front();
        }
        recent.push_back((key, Arc::clone(&bytes)));
        bytes
    }
}

/// The file's frame that an episode of `len` frames begins with at `from_s`.
///
/// The episode's first and last frame must be shown at their times and be `len - 1` frames apart; a
/// file whose rate differs is refused here rather than read out of step.
#[expect(
    clippy::cast_precision_loss,
    reason = "frame counts stay far below 2^53"
)]
fn first_frame(file: &VideoFile, from_s: f64, len: usize, fps: u32) -> Result<usize, DatasetError> {
    let first = file.times.frame_at(from_s, &file.path)?;
    let last_s = from_s + len.saturating_sub(1) as f64 / f64::from(fps);
    let last = file.times.frame_at(last_s, &file.path)?;
    if last - first != len.saturating_sub(1) || last >= file.times.len() {
        let found = last - first + 1;
        let what = format!("{found} frames from {from_s:.6} s to {last_s:.6} s, expected {len}");
        return Err(failed(&file.path, what));
    }
    Ok(first)
}
