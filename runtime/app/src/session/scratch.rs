//! Files and folders of tests, which go with them.

use std::fs;
use std::ops::Deref;
use std::path::{Path, PathBuf};

/// A path of its own in the system's folder for temporary files. What is there is removed with it.
pub(crate) struct Scratch(pub(crate) PathBuf);

impl Scratch {
    /// `name` is that of no other in this process; nothing is there yet.
    pub(crate) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("trocar-{}-{name}", std::process::id()));
        remove(&path);
        Self(path)
    }

    /// An empty folder.
    pub(crate) fn folder(name: &str) -> Self {
        let scratch = Self::new(name);
        fs::create_dir_all(&scratch).unwrap();
        scratch
    }
}

impl Deref for Scratch {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.0
    }
}

impl AsRef<Path> for Scratch {
    fn as_ref(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        remove(&self.0);
    }
}

fn remove(path: &Path) {
    let _gone = fs::remove_file(path).or_else(|_| fs::remove_dir_all(path));
}
