//! Several datasets as one, their episodes one after another.
//!
//! A joined dataset has one numbering: episodes, frames and tables of the second follow those of
//! the first. Files stay where they are; nothing is copied.

use core::cell::Cell;
use std::path::{Path, PathBuf};

use hal::Intrinsics;

use super::{CameraSpec, Dataset, DatasetError, DatasetSpec, Episode, Totals, check::input};

/// One of the datasets that a [`Dataset`] is of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Its folder.
    pub dir: PathBuf,
    /// Its task, as [`Dataset::task`] has it.
    pub task: String,
    /// Its episodes, of those that were opened.
    pub episodes: usize,
    /// Frames in them.
    pub frames: usize,
}

impl Dataset {
    /// Opens the datasets in the folders `dirs` as one: the episodes of the first, then those of
    /// the next. Of all these the first `episodes`, or all; `cameras` as in [`Self::open_part`], if
    /// they are not named those of the first.
    ///
    /// They must have the same arms, the same frames a second, and the cameras with the same sizes:
    /// all the same ones, or those that are named. With `depth` their lenses must be the same too;
    /// without, depth is left out where they are not. The task is the first's. Folders beyond the
    /// requested number of episodes are counted and not opened.
    ///
    /// # Errors
    /// Those of [`Self::open_part`]; [`DatasetError::Apart`], which names two datasets and what
    /// differs; [`DatasetError::Input`] if there are no folders, or too few episodes in all.
    pub fn open_joined(
        dirs: &[PathBuf],
        episodes: Option<usize>,
        cameras: Option<&[String]>,
        depth: bool,
    ) -> Result<Self, DatasetError> {
        let Some((first, others)) = dirs.split_first() else {
            return Err(input("the number of datasets", "0", "at least 1"));
        };
        if others.is_empty() {
            return Self::open_part(first, episodes, cameras);
        }
        let left = Cell::new(check_episodes(dirs, episodes)?);
        let all = Self::cameras_in(first)?;
        let open = |dir: &Path| {
            let seen = check_cameras((first, &all), dir, cameras)?;
            let episodes = left.get().min(Totals::read(dir)?.episodes);
            left.set(left.get() - episodes);
            Self::open_part(dir, Some(episodes), Some(seen))
        };
        let mut joined = open(first)?;
        for dir in others {
            if left.get() == 0 {
                break;
            }
            joined.append(open(dir)?, depth)?;
        }
        Ok(joined)
    }

    /// Appends the episodes of `other`. Indices of `other` are moved up by what is already there.
    fn append(&mut self, other: Self, depth: bool) -> Result<(), DatasetError> {
        if let Some(difference) = difference(&self.spec, &other.spec, depth) {
            let dir = |dataset: &Self| dataset.parts.first().map(|part| part.dir.clone());
            return Err(DatasetError::Apart {
                first: dir(self).unwrap_or_default(),
                other: dir(&other).unwrap_or_default(),
                difference,
            });
        }
        keep_common(&mut self.spec, &other.spec);
        let (episodes, frames, tables) = (self.episodes.len(), self.len(), self.tables.len());
        let moved = |episode: Episode| Episode {
            index: episodes + episode.index,
            start: frames + episode.start,
            ..episode
        };
        self.episodes.extend(other.episodes.into_iter().map(moved));
        self.rows.append(other.rows, tables);
        self.tables.extend(other.tables);
        self.videos.append(other.videos);
        self.parts.extend(other.parts);
        Ok(())
    }
}

/// Leaves in `mine` only what `theirs` has as well: interventions, and depth through the same lens.
fn keep_common(mine: &mut DatasetSpec, theirs: &DatasetSpec) {
    mine.intervention &= theirs.intervention;
    for (mine, theirs) in mine.cameras.iter_mut().zip(&theirs.cameras) {
        mine.depth = mine.depth.filter(|lens| theirs.depth == Some(*lens));
    }
}

/// How many episodes are to be opened; they must be there.
fn check_episodes(dirs: &[PathBuf], wanted: Option<usize>) -> Result<usize, DatasetError> {
    let mut there = 0_usize;
    for dir in dirs {
        there = there.saturating_add(Totals::read(dir)?.episodes);
    }
    match wanted {
        Some(wanted) if wanted > there => {
            let dirs: Vec<String> = dirs.iter().map(|dir| dir.display().to_string()).collect();
            let what = format!("the number of episodes in {}", dirs.join(", "));
            Err(input(&what, &there.to_string(), &wanted.to_string()))
        }
        wanted => Ok(wanted.unwrap_or(there)),
    }
}

/// The cameras to open in `dir`: those that are `named`, which must be there, or those of the
/// `first` dataset, which it must have and no more.
fn check_cameras<'a>(
    (first, all): (&Path, &'a [String]),
    dir: &Path,
    named: Option<&'a [String]>,
) -> Result<&'a [String], DatasetError> {
    let there = Dataset::cameras_in(dir)?;
    let seen = named.unwrap_or(all);
    let has_them = seen.iter().all(|name| there.contains(name));
    if (has_them || dir == first) && (named.is_some() || there.len() == all.len()) {
        return Ok(seen);
    }
    Err(DatasetError::Apart {
        first: first.to_owned(),
        other: dir.to_owned(),
        difference: apart("the list of cameras", &listed(all), &listed(&there)),
    })
}

/// The names for a message.
fn listed(names: &[String]) -> String {
    match names {
        [] => "empty".to_owned(),
        names => names.join(", "),
    }
}

/// What something is in each of two datasets, in words.
fn apart(what: &str, first: &str, other: &str) -> String {
    format!("{what} is {first} in the first, {other} in the other")
}

/// The first thing that datasets with the same cameras must have in common and have not, in words.
///
/// Arms first, then the rate, then each camera's size and, with `depth`, its lens to the bit.
fn difference(a: &DatasetSpec, b: &DatasetSpec, depth: bool) -> Option<String> {
    let apart = |what: &str, a: String, b: String| (a != b).then(|| apart(what, &a, &b));
    let number = |what: &str, a: usize, b: usize| apart(what, a.to_string(), b.to_string());
    let of_cameras = || {
        let mut cameras = a.cameras.iter().zip(&b.cameras);
        cameras.find_map(|(a, b)| {
            let size = |camera: &CameraSpec| format!("{} x {}", camera.width, camera.height);
            let what = |of: &str| format!("the {of} of {}", a.name);
            let sizes = apart(&what("size"), size(a), size(b));
            let lenses = || apart(&what("depth"), lens(a.depth), lens(b.depth));
            sizes.or_else(|| lenses().filter(|_| depth))
        })
    };
    number("the number of arms", a.arms, b.arms)
        .or_else(|| number("fps", a.fps as usize, b.fps as usize))
        .or_else(of_cameras)
}

/// A lens in words; two lenses are the same if their words are, and `{:?}` gives every bit of a
/// float.
fn lens(depth: Option<Intrinsics>) -> String {
    depth.map_or_else(
        || "not recorded".to_owned(),
        |lens| {
            let (focal, centre) = ((lens.fx, lens.fy), (lens.cx, lens.cy));
            let bent = if lens.distortion.is_none() {
                String::new()
            } else {
                let coefficients = lens.distortion.coefficients();
                format!(", distorted by {coefficients:?}")
            };
            format!(
                "seen by a lens with focal lengths {focal:?} and centre {centre:?} pixels{bent}"
            )
        },
    )
}
