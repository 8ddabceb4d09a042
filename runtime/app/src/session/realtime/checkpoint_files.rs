//! Whether a checkpoint is still the one that a run began with: training may write another into its
//! folder meanwhile.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::thread::{self, JoinHandle};

use trocar_nets::checkpoint::{WEIGHTS, is_read};

use crate::digest::hash_file;
use crate::session::SessionError;

/// A checkpoint's files as they were.
#[derive(Clone)]
pub(super) struct CheckpointFiles {
    /// The checkpoint's, which the run read at its start.
    folder: PathBuf,
    /// SHA-256 by name.
    hashes: BTreeMap<String, String>,
}

impl CheckpointFiles {
    /// Those in `folder`; the SHA-256 of its weights is not taken again if it is known.
    ///
    /// Reads every file that loading a checkpoint reads; large weights take their time, hence
    /// `weights_sha256`.
    pub(super) fn read(folder: &Path, weights_sha256: Option<&str>) -> Result<Self, SessionError> {
        let hashes = hashes(folder, weights_sha256).map_err(|error| unreadable(folder, &error))?;
        Ok(Self {
            folder: folder.to_owned(),
            hashes,
        })
    }

    /// Where they are.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Begins to compare them with what is there now.
    ///
    /// Returns at once.
    ///
    /// # Errors
    /// If no thread can be started.
    pub(super) fn begin_check(&self) -> Result<FilesCheck, SessionError> {
        let files = self.clone();
        let thread = thread::Builder::new()
            .name("policy-files".to_owned())
            .spawn(move || files.check_unchanged());
        let thread = thread.map_err(|error| unreadable(&self.folder, &error))?;
        Ok(FilesCheck(thread))
    }

    /// Refuses them by name if they are not the same any more.
    ///
    /// A file that came, went or changed is named, the first by name order.
    fn check_unchanged(&self) -> Result<(), SessionError> {
        let now = hashes(&self.folder, None).map_err(|error| unreadable(&self.folder, &error))?;
        let names = self.hashes.keys().chain(now.keys());
        let mut changed = names.filter(|name| self.hashes.get(*name) != now.get(*name));
        changed.next().map_or(Ok(()), |name| {
            Err(SessionError::RealTime(format!(
                "policy {}: {name} has changed since the run began with it",
                self.folder.display()
            )))
        })
    }
}

/// A comparison under way, in a thread of its own: whoever looks at signals does not wait until
/// weights are hashed.
pub(super) struct FilesCheck(JoinHandle<Result<(), SessionError>>);

impl FilesCheck {
    /// Whether [`Self::found`] would not wait.
    pub(super) fn is_done(&self) -> bool {
        self.0.is_finished()
    }

    /// Refuses the files by name if they are not the same any more.
    ///
    /// Blocks until the comparison is over; a panic of its thread is an error.
    pub(super) fn found(self) -> Result<(), SessionError> {
        let panicked =
            || SessionError::RealTime("the check of the policy's files panicked".to_owned());
        self.0.join().unwrap_or_else(|_| Err(panicked()))
    }
}

/// SHA-256 of each file in `folder` that is read; that of the weights is `weights_sha256`, if it is
/// known.
fn hashes(folder: &Path, weights_sha256: Option<&str>) -> io::Result<BTreeMap<String, String>> {
    let mut hashes = BTreeMap::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if is_read(&name) && path.is_file() {
            let hash = match weights_sha256.filter(|_| name == WEIGHTS) {
                Some(known) => known.to_owned(),
                None => hash_file(&path)?,
            };
            hashes.insert(name.into_owned(), hash);
        }
    }
    Ok(hashes)
}

fn unreadable(folder: &Path, error: &io::Error) -> SessionError {
    SessionError::RealTime(format!("policy {}: {error}", folder.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_changes_comes_or_goes_is_named() {
        let folder = std::env::temp_dir().join(format!("trocar-files-{}", std::process::id()));
        let _old = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        let (weights, recipe) = (folder.join("model.safetensors"), folder.join("trocar.json"));
        fs::write(&weights, [1, 2, 3]).unwrap();
        fs::write(&recipe, "{}").unwrap();
        let files = CheckpointFiles::read(&folder, None).unwrap();
        let changed = || {
            let check = files.begin_check().unwrap();
            check.found().map_err(|error| error.to_string())
        };
        for name in ["loss.csv", "evaluation.json", "optimiser.safetensors"] {
            fs::write(folder.join(name), "not read").unwrap();
        }
        assert_eq!(changed(), Ok(()));
        fs::write(&weights, [1, 2, 4]).unwrap();
        let said = changed().unwrap_err();
        assert!(said.contains("model.safetensors has changed"), "{said}");
        fs::write(&weights, [1, 2, 3]).unwrap();
        assert_eq!(
            changed(),
            Ok(()),
            "by what it holds, not by when it was written"
        );
        let known = hash_file(&weights).unwrap();
        for (known, same) in [(known.as_str(), true), ("5a", false)] {
            let files = CheckpointFiles::read(&folder, Some(known)).unwrap();
            let check = files.begin_check().unwrap();
            assert_eq!(check.found().is_ok(), same, "weights are known by {known}");
        }
        fs::write(folder.join("config.json"), "{}").unwrap();
        assert!(changed().unwrap_err().contains("config.json has changed"));
        fs::remove_file(folder.join("config.json")).unwrap();
        fs::remove_file(&recipe).unwrap();
        assert!(changed().unwrap_err().contains("trocar.json has changed"));
        fs::remove_dir_all(&folder).unwrap();
        assert!(changed().is_err());
    }
}
