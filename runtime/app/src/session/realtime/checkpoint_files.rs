//! Whether a checkpoint is still the one that a run began with: training may write another into its folder meanwhile.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use trocar_nets::checkpoint::is_read;

use crate::session::SessionError;
use crate::digest::hash_file;

/// A checkpoint's files as they were.
pub(super) struct CheckpointFiles {
    folder: PathBuf,
    /// SHA-256 by name.
    hashes: BTreeMap<String, String>,
}

impl CheckpointFiles {
    /// Those in `folder`.
    pub(super) fn read(folder: &Path) -> Result<Self, SessionError> {
        let hashes = hashes(folder).map_err(|error| unreadable(folder, &error))?;
        Ok(Self {
            folder: folder.to_owned(),
            hashes,
        })
    }

    /// Refuses them by name if they are not the same any more.
    pub(super) fn check_unchanged(&self) -> Result<(), SessionError> {
        let now = hashes(&self.folder).map_err(|error| unreadable(&self.folder, &error))?;
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

fn hashes(folder: &Path) -> io::Result<BTreeMap<String, String>> {
    let mut hashes = BTreeMap::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if is_read(&name) && path.is_file() {
            hashes.insert(name.into_owned(), hash_file(&path)?);
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
        let files = CheckpointFiles::read(&folder).unwrap();
        let changed = || files.check_unchanged().map_err(|error| error.to_string());
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
        fs::write(folder.join("config.json"), "{}").unwrap();
        assert!(changed().unwrap_err().contains("config.json has changed"));
        fs::remove_file(folder.join("config.json")).unwrap();
        fs::remove_file(&recipe).unwrap();
        assert!(changed().unwrap_err().contains("trocar.json has changed"));
        fs::remove_dir_all(&folder).unwrap();
        assert!(changed().is_err());
    }
}
