//! Files of cells: written whole or not at all, and known again.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::StudyError;
use crate::digest::hash_file;

/// A file of a cell as it was when the cell was done.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRecord {
    /// Its path below the cell's folder.
    pub path: PathBuf,
    /// Its length.
    pub bytes: u64,
    /// When it was last written, ns since 1970: if that is the same still, its hash is not computed
    /// again.
    pub modified_ns: i128,
    /// Its hash.
    pub sha256: String,
}

/// Files that are not part of what a cell is.
const OWN_FILES: [&str; 6] = [
    "cell.json",
    "cell.json.old",
    "result.json.old",
    "attempts.json",
    "lock",
    "log.txt",
];

/// Every file below a cell's folder, by path.
pub(super) fn files_of(folder: &Path) -> Result<Vec<FileRecord>, StudyError> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(here) = folders.pop() {
        let entries = fs::read_dir(&here).map_err(|error| StudyError::io(&here, error))?;
        for entry in entries {
            let entry = entry.map_err(|error| StudyError::io(&here, error))?;
            let path = entry.path();
            let kind = entry
                .file_type()
                .map_err(|error| StudyError::io(&path, error))?;
            let relative = path.strip_prefix(folder).unwrap_or(&path).to_owned();
            let own = OWN_FILES.iter().any(|own| relative == Path::new(own));
            if kind.is_dir() {
                folders.push(path);
            } else if kind.is_file() && !own {
                files.push(file_record(&path, relative)?);
            }
        }
    }
    files.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(files)
}

fn file_record(path: &Path, relative: PathBuf) -> Result<FileRecord, StudyError> {
    let failed = |error| StudyError::io(path, error);
    let found = fs::metadata(path).map_err(failed)?;
    Ok(FileRecord {
        path: relative,
        bytes: found.len(),
        modified_ns: modified_ns(&found),
        sha256: hash_file(path).map_err(failed)?,
    })
}

fn modified_ns(found: &fs::Metadata) -> i128 {
    use std::os::unix::fs::MetadataExt;
    i128::from(found.mtime()) * 1_000_000_000 + i128::from(found.mtime_nsec())
}

/// In what a file differs from what it was; none if in nothing.
pub(super) fn difference(folder: &Path, file: &FileRecord) -> Option<String> {
    let path = folder.join(&file.path);
    let shown = path.display();
    let found = match fs::metadata(&path) {
        Ok(found) => found,
        Err(error) => return Some(format!("{shown}: {error}")),
    };
    if found.len() != file.bytes {
        let (bytes, had) = (found.len(), file.bytes);
        return Some(format!(
            "{shown}: has {bytes} bytes and had {had} when its cell was done"
        ));
    }
    if modified_ns(&found) == file.modified_ns {
        return None;
    }
    match hash_file(&path) {
        Ok(hash) if hash == file.sha256 => None,
        Ok(_) => Some(format!(
            "{shown}: its content has changed since its cell was done"
        )),
        Err(error) => Some(format!("{shown}: {error}")),
    }
}

/// Writes `value` to `path`, whole or not at all.
///
/// # Errors
/// [`StudyError::Io`].
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<(), StudyError> {
    let text = serde_json::to_string_pretty(value).map_err(|error| StudyError::io(path, error))?;
    write_whole(path, (text + "\n").as_bytes())
}

/// Writes `bytes` to `path`, whole or not at all: into a file beside it, which then takes its name.
///
/// # Errors
/// [`StudyError::Io`].
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), StudyError> {
    let failed = |error: std::io::Error| StudyError::io(path, error);
    let parent = path
        .parent()
        .filter(|parent| !parent.as_os_str().is_empty());
    if let Some(parent) = parent {
        fs::create_dir_all(parent).map_err(failed)?;
    }
    // Two processes may write the same file, but not the same process twice at a time.
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.tmp", std::process::id()));
    let beside = path.with_file_name(name);
    let write = || -> std::io::Result<()> {
        let mut file = File::create(&beside)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&beside, path)
    };
    write().map_err(|error| {
        let _gone = fs::remove_file(&beside);
        failed(error)
    })
}
