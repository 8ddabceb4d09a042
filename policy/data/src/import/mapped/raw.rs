//! Folders of a dVRK's recordings: images and a table of numbers an episode.
//!
//! ```text
//! tissue_N/K_SUBTASK[_recovery]/episode_NNN/ee_csv.csv                     a row a frame; timestamp in ns
//! tissue_N/K_SUBTASK[_recovery]/episode_NNN/left_img_dir/frame000000_*.jpg   and other cameras' folders
//! ```

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use hal::files;
use image::RgbImage;

use super::super::ImportError;
use super::ImportRequest;
use super::csv::read_table;
use super::mapping::CameraMapping;
use super::recordings::{Label, Numbers, Recordings};
use crate::dataset::DatasetError;
use crate::dataset::foreign::decode;

/// The table of an episode, and what a mapping calls its numbers.
pub(super) const TABLE: &str = "ee_csv.csv";
/// When each frame was taken, ns.
const TIME: &str = "timestamp";
/// Folders from the one that is given down to an episode.
const DEPTH_MAX: usize = 3;
/// Rows or images that one may have more than the other, as recorders leave them. The surplus at
/// the end is cut off; frames are matched to rows by their number.
const SURPLUS_MAX: usize = 10;
/// By what share an episode's rate may differ from the dataset's, which is given or the first
/// episode's. Frames are not resampled.
const RATE_TOLERANCE: f64 = 0.1;
/// Frames' time that may pass between two of them.
const GAP_MAX_FRAMES: f64 = 5.0;
/// What the folder of a subtask ends with where a state that went wrong is put right.
const RECOVERY: &str = "_recovery";
/// Bytes that an image file may have.
const IMAGE_BYTES_MAX: u64 = 64 << 20;

/// The episodes' folders in order of their names; one episode's table is in memory at a time.
pub(super) struct RawRecordings {
    folders: Vec<PathBuf>,
    cameras: Vec<CameraMapping>,
    fps: u32,
    open: Option<(usize, Episode)>,
}

/// An episode's table, and the files of its frames by camera.
struct Episode {
    table: Numbers,
    steps: usize,
    frames: Vec<Vec<PathBuf>>,
}

impl RawRecordings {
    /// Looks for episodes, and says which cameras of the mapping they have.
    pub(super) fn open(request: &ImportRequest) -> Result<(Self, Vec<CameraMapping>), ImportError> {
        let mut folders = Vec::new();
        collect(&request.source, DEPTH_MAX, &mut folders)?;
        let Some(first) = folders.first() else {
            return Err(ImportError::Empty {
                path: request.source.clone(),
                expected: "tissue_N/K_SUBTASK/episode_NNN/ee_csv.csv",
            });
        };
        let cameras = cameras_in(first, &request.mapping.cameras)?;
        let mut recordings = Self {
            folders,
            cameras: cameras.clone(),
            fps: 0,
            open: None,
        };
        recordings.fps = recordings.first_rate(request.fps)?;
        Ok((recordings, cameras))
    }

    /// The rate that is given, or that of the first episode's timestamps.
    fn first_rate(&mut self, given: Option<u32>) -> Result<u32, ImportError> {
        let place = self.place(0);
        let rate_hz = rate_of(&self.episode(0)?.table, &place)?;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "within 1 to 1000"
        )]
        let found = (1.0..=1000.0)
            .contains(&rate_hz)
            .then_some(rate_hz.round() as u32);
        given.or(found).ok_or_else(|| ImportError::Mismatch {
            place,
            name: TIME.to_owned(),
            found: format!("is {rate_hz:.3} a second"),
            expected: "1 to 1000, in ns".to_owned(),
        })
    }

    fn episode(&mut self, index: usize) -> Result<&Episode, ImportError> {
        if self.open.as_ref().is_none_or(|(open, _)| *open != index) {
            let episode = Episode::read(&self.folders[index], &self.cameras)?;
            self.open = Some((index, episode));
        }
        let open = self.open.as_ref().map(|(_, episode)| episode);
        open.ok_or_else(|| ImportError::Options("no episode is open".to_owned()))
    }

    /// The folder of a subtask: its words and whether it shows recoveries.
    fn subtask(&self, episode: usize) -> (String, bool) {
        let folder = self.folders[episode].parent();
        let name = folder.and_then(Path::file_name).unwrap_or_default();
        let name = name.to_string_lossy();
        let (name, recovery) = match name.strip_suffix(RECOVERY) {
            Some(name) => (name, true),
            None => (&*name, false),
        };
        let digits = name.trim_start_matches(|sign: char| sign.is_ascii_digit());
        let words = digits.trim_start_matches('_').replace('_', " ");
        (words, recovery)
    }
}

/// Those of the mapping's `cameras` that the episode in `folder` has: all but optional ones whose
/// folder is missing.
fn cameras_in(folder: &Path, cameras: &[CameraMapping]) -> Result<Vec<CameraMapping>, ImportError> {
    let there = |camera: &&CameraMapping| !camera.optional || folder.join(&camera.feature).is_dir();
    let found: Vec<CameraMapping> = cameras.iter().filter(there).cloned().collect();
    if found.is_empty() && !cameras.is_empty() {
        return Err(ImportError::Missing {
            place: folder.display().to_string(),
            name: "each camera's folder".to_owned(),
        });
    }
    Ok(found)
}

impl Episode {
    fn read(folder: &Path, cameras: &[CameraMapping]) -> Result<Self, ImportError> {
        let path = folder.join(TABLE);
        let mut table = read_table(&path)?;
        let rows = table.values.len() / table.width.max(1);
        let mut frames = Vec::new();
        for camera in cameras {
            frames.push(frames_in(&folder.join(&camera.feature))?);
        }
        let counts = frames.iter().map(Vec::len);
        let steps = counts.clone().fold(rows, usize::min);
        let most = counts.fold(rows, usize::max);
        if steps == 0 || most - steps > SURPLUS_MAX {
            let images = cameras.iter().zip(&frames);
            let images = images.map(|(camera, frames)| (frames.len(), camera.feature.as_str()));
            return Err(uneven(&path, rows, images));
        }
        table.values.truncate(steps * table.width);
        Ok(Self {
            table,
            steps,
            frames,
        })
    }
}

/// An episode with `rows` rows in the table `path` and other numbers of images, each with its
/// camera's folder.
fn uneven<'a>(
    path: &Path,
    rows: usize,
    images: impl Iterator<Item = (usize, &'a str)>,
) -> ImportError {
    let counts: Vec<String> = images
        .map(|(count, folder)| format!("{count} {folder}"))
        .collect();
    ImportError::Mismatch {
        place: path.display().to_string(),
        name: "the episode".to_owned(),
        found: format!("has {rows} rows and images: {}", counts.join(", ")),
        expected: format!("as many of each, or up to {SURPLUS_MAX} more at the end"),
    }
}

impl Recordings for RawRecordings {
    fn fps(&self) -> u32 {
        self.fps
    }

    fn robot_type(&self) -> Option<String> {
        Some("dvrk".to_owned())
    }

    fn episodes(&self) -> usize {
        self.folders.len()
    }

    fn place(&self, episode: usize) -> String {
        let path = self.folders[episode].join(TABLE);
        format!("{}, episode {episode}", path.display())
    }

    fn steps(&mut self, episode: usize) -> Result<usize, ImportError> {
        let (fps, place) = (self.fps, self.place(episode));
        let open = self.episode(episode)?;
        let rate_hz = rate_of(&open.table, &place)?;
        if (rate_hz / f64::from(fps) - 1.0).abs() > RATE_TOLERANCE {
            return Err(ImportError::Mismatch {
                place,
                name: TIME.to_owned(),
                found: format!("is {rate_hz:.2} a second"),
                expected: format!("{fps}"),
            });
        }
        Ok(open.steps)
    }

    fn numbers(&mut self, episode: usize, feature: &str) -> Result<Numbers, ImportError> {
        if feature != TABLE {
            return Err(ImportError::Missing {
                place: self.folders[episode].display().to_string(),
                name: format!("{feature} (numbers are in {TABLE} alone)"),
            });
        }
        Ok(self.episode(episode)?.table.clone())
    }

    fn words(&mut self, episode: usize) -> Result<Vec<String>, ImportError> {
        let (words, _) = self.subtask(episode);
        Ok(super::recordings::distinct(vec![words]))
    }

    fn label(&self, episode: usize) -> Result<Label, ImportError> {
        Ok(match self.subtask(episode).1 {
            true => Label::Recovery,
            false => Label::Plain,
        })
    }

    fn is_in_split(&self, split: &str, episode: usize) -> Result<bool, ImportError> {
        let recovery = self.subtask(episode).1;
        match split {
            "recovery" => Ok(recovery),
            "perfect" => Ok(!recovery),
            _ => Err(ImportError::Options(format!(
                "--split {split}: raw folders have splits perfect, recovery"
            ))),
        }
    }

    fn camera_size(&mut self, camera: usize) -> Result<(u32, u32), ImportError> {
        Ok(self.rgb(0, 0, camera)?.dimensions())
    }

    fn rgb(&mut self, episode: usize, step: usize, camera: usize) -> Result<RgbImage, ImportError> {
        let path = self.episode(episode)?.frames[camera][step].clone();
        let io_error = |source| ImportError::Io {
            path: path.clone(),
            source,
        };
        let bytes = files::read(&path, "an image", IMAGE_BYTES_MAX).map_err(io_error)?;
        let decoded = decode(&bytes).map_err(|source| DatasetError::Image {
            what: path.display().to_string(),
            source,
        });
        Ok(decoded?)
    }
}

/// Frames a second by the median of the times between them.
///
/// The median, since a few late frames must not change the rate. Times must increase, and no gap
/// may be longer than `GAP_MAX_FRAMES` such medians.
fn rate_of(table: &Numbers, place: &str) -> Result<f64, ImportError> {
    let Some(column) = table.names.iter().position(|name| name == TIME) else {
        return Err(ImportError::Missing {
            place: place.to_owned(),
            name: TIME.to_owned(),
        });
    };
    let times_ns: Vec<f64> = table
        .values
        .chunks_exact(table.width)
        .map(|row| row[column])
        .collect();
    let mut gaps_s: Vec<f64> = times_ns
        .windows(2)
        .map(|pair| (pair[1] - pair[0]) * 1e-9)
        .collect();
    let mismatch = |found: String, expected: &str| ImportError::Mismatch {
        place: place.to_owned(),
        name: TIME.to_owned(),
        found,
        expected: expected.to_owned(),
    };
    let unordered = gaps_s
        .iter()
        .position(|gap_s| gap_s.is_nan() || *gap_s <= 0.0);
    if let Some(step) = unordered {
        let found = format!("does not grow after step {step}");
        return Err(mismatch(found, "times in ns that do"));
    }
    let (step, longest_s) =
        gaps_s.iter().copied().enumerate().fold(
            (0, 0.0),
            |most, gap| if gap.1 > most.1 { gap } else { most },
        );
    gaps_s.sort_by(f64::total_cmp);
    let Some(&median_s) = gaps_s.get(gaps_s.len() / 2) else {
        return Err(mismatch("is of one frame".to_owned(), "two at least"));
    };
    if longest_s > GAP_MAX_FRAMES * median_s {
        let found = format!("has a gap of {longest_s:.3} s after step {step}");
        return Err(mismatch(found, "frames without gaps"));
    }
    Ok(1.0 / median_s)
}

/// Adds the folders with a table in and below `folder`, by name.
fn collect(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) -> Result<(), ImportError> {
    if folder.join(TABLE).is_file() {
        found.push(folder.to_owned());
        return Ok(());
    }
    let mut inside = Vec::new();
    for path in entries(folder)? {
        if path.is_dir() && depth > 0 {
            inside.push(path);
        }
    }
    inside.sort();
    inside
        .iter()
        .try_for_each(|path| collect(path, depth - 1, found))
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let listed =
        fs::read_dir(folder).and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect());
    listed.map_err(|source| ImportError::Io {
        path: folder.to_owned(),
        source,
    })
}

/// The images `frameNNNNNN...` in a folder, by number from 0 on; none may be missing.
fn frames_in(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let mut numbered = BTreeMap::new();
    for path in entries(folder)? {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let digits = name.strip_prefix("frame").map(|rest| {
            let end = rest.find(|sign: char| !sign.is_ascii_digit());
            rest[..end.unwrap_or(rest.len())].to_owned()
        });
        if let Some(number) = digits.and_then(|digits| digits.parse::<usize>().ok()) {
            numbered.insert(number, path);
        }
    }
    let gap = numbered
        .keys()
        .enumerate()
        .find(|(index, number)| index != *number);
    if let Some((index, _)) = gap {
        return Err(ImportError::Missing {
            place: folder.display().to_string(),
            name: format!("the image frame{index:06}"),
        });
    }
    Ok(numbered.into_values().collect())
}
