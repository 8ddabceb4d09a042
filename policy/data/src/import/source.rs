//! Which episodes and cameras there are.

use std::fs;
use std::path::PathBuf;

use super::file::Recording;
use super::{ImportError, ImportOptions, Layout};

/// Where ACT's files have their cameras.
const ACT_IMAGES: &str = "observations/images";

/// One episode: a file, and with robomimic's layout a group in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct EpisodeAt {
    path: PathBuf,
    group: Option<String>,
}

impl EpisodeAt {
    pub(super) fn open(&self) -> Result<Recording, ImportError> {
        Recording::open(&self.path, self.group.as_deref())
    }
}

/// All episodes, by their numbers.
pub(super) fn episodes(options: &ImportOptions) -> Result<Vec<EpisodeAt>, ImportError> {
    let (found, expected) = match options.layout {
        Layout::Act => (files(options)?, "episode_N.hdf5"),
        Layout::Robomimic => (groups(options)?, "data/demo_N"),
    };
    if found.is_empty() {
        return Err(ImportError::Empty {
            path: options.source.clone(),
            expected,
        });
    }
    Ok(found)
}

/// The number of `name`, which is `before`, digits, `after`.
fn numbered(name: &str, before: &str, after: &str) -> Option<u64> {
    let digits = name.strip_prefix(before)?.strip_suffix(after)?;
    let plain = digits.bytes().all(|byte| byte.is_ascii_digit());
    digits.parse().ok().filter(|_| plain)
}

/// ACT's files in a folder, in order of their numbers; other names are ignored.
fn files(options: &ImportOptions) -> Result<Vec<EpisodeAt>, ImportError> {
    let io_error = |source| ImportError::Io {
        path: options.source.clone(),
        source,
    };
    let mut found = Vec::new();
    for entry in fs::read_dir(&options.source).map_err(io_error)? {
        let path = entry.map_err(io_error)?.path();
        let name = path.file_name().and_then(|name| name.to_str());
        if let Some(number) = name.and_then(|name| numbered(name, "episode_", ".hdf5")) {
            found.push((number, path));
        }
    }
    found.sort_unstable();
    let at = |(_, path)| EpisodeAt { path, group: None };
    Ok(found.into_iter().map(at).collect())
}

/// robomimic's groups, in order of their numbers and not of their names, where `demo_10` would come
/// before `demo_2`.
fn groups(options: &ImportOptions) -> Result<Vec<EpisodeAt>, ImportError> {
    let whole = Recording::open(&options.source, None)?;
    let names = whole.members("data")?.unwrap_or_default();
    let mut found: Vec<(u64, String)> = names
        .into_iter()
        .filter_map(|name| Some((numbered(&name, "demo_", "")?, name)))
        .collect();
    found.sort_unstable();
    let at = |(_, name)| EpisodeAt {
        path: options.source.clone(),
        group: Some(format!("data/{name}")),
    };
    Ok(found.into_iter().map(at).collect())
}

/// The cameras of an episode: their names, and where their frames are. A given path names its
/// camera by its last part, without robomimic's ending `_image`.
pub(super) fn cameras(
    recording: &Recording,
    options: &ImportOptions,
) -> Result<Vec<(String, String)>, ImportError> {
    if !options.images.is_empty() {
        let named = options.images.iter().map(|path| {
            let last = path.rsplit('/').next().unwrap_or(path);
            let name = last.strip_suffix("_image").unwrap_or(last);
            (name.to_owned(), path.clone())
        });
        return Ok(named.collect());
    }
    let names = recording.members(ACT_IMAGES)?.unwrap_or_default();
    if names.is_empty() {
        return Err(ImportError::Missing {
            place: recording.place.clone(),
            name: format!("a camera in {ACT_IMAGES}"),
        });
    }
    let at = |name: String| {
        let path = format!("{ACT_IMAGES}/{name}");
        (name, path)
    };
    Ok(names.into_iter().map(at).collect())
}
