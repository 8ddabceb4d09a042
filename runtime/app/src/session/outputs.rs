//! Where results go, checked before the work that they cost.

use std::fs::{self, OpenOptions};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use super::{SessionError, pictures};

/// Checks that every file in `written`, each given with the option that names it, can be written,
/// and that no two paths of `written` and `others` are the same; absent ones are skipped.
///
/// Parent folders are made. A file that is there keeps its content, and none is left behind that
/// was not there.
///
/// # Errors
/// [`SessionError::BadArgument`] with the option and the reason.
pub fn check(
    written: &[(&str, Option<&Path>)],
    others: &[(&str, Option<&Path>)],
) -> Result<(), SessionError> {
    let mut seen: Vec<(&str, PathBuf)> = Vec::new();
    for (option, path) in others {
        if let Some(path) = path {
            seen.push((option, identity(path)));
        }
    }
    for (option, path) in written {
        let to_stdout = |path: &Path| *option == "--json" && is_standard_output(path);
        let Some(path) = path.filter(|path| !to_stdout(path)) else {
            continue;
        };
        pictures::create_parent(path).map_err(|error| refused(option, path, &error.to_string()))?;
        let identity = identity(path);
        let same = |other: &PathBuf| *other == identity || is_same_file(other, &identity);
        if let Some((other, _)) = seen.iter().find(|(_, other)| same(other)) {
            return Err(refused(option, path, &format!("{other} names the same")));
        }
        probe(path).map_err(|error| refused(option, path, &unwritable(&error)))?;
        seen.push((option, identity));
    }
    Ok(())
}

/// Whether `path` stands for standard output.
#[must_use]
pub fn is_standard_output(path: &Path) -> bool {
    path == Path::new("-")
}

/// Makes the folder `path` that `option` names, or takes an empty one, and checks that files can be
/// written into it.
///
/// # Errors
/// [`SessionError::BadArgument`] if it is a file, is not empty or can't be written.
pub fn new_folder(option: &str, path: &Path) -> Result<(), SessionError> {
    let refuse = |reason: &str| refused(option, path, reason);
    if path.exists() && !path.is_dir() {
        return Err(refuse("exists and is no folder"));
    }
    fs::create_dir_all(path).map_err(|error| refuse(&unwritable(&error)))?;
    let mut entries = fs::read_dir(path).map_err(|error| refuse(&unwritable(&error)))?;
    if entries.next().is_some() {
        return Err(refuse("exists and is not an empty folder"));
    }
    probe(&path.join("writable")).map_err(|error| refuse(&unwritable(&error)))
}

/// Checks that `path`, which `option` names, is the folder of a dataset and that files can be
/// written into it.
///
/// # Errors
/// [`SessionError::BadArgument`] if it is none or can't be written.
pub fn dataset_folder(option: &str, path: &Path) -> Result<(), SessionError> {
    if !has_dataset(path) {
        let reason = "holds no dataset that a recording could go on with";
        return Err(refused(option, path, reason));
    }
    probe(&path.join("writable")).map_err(|error| refused(option, path, &unwritable(&error)))
}

/// Whether the folder `path` is a dataset's.
#[must_use]
pub fn has_dataset(path: &Path) -> bool {
    path.join("meta/info.json").is_file()
}

/// Whether the folder `path` is that of a dataset which says how it was recorded.
#[must_use]
pub fn has_recording(path: &Path) -> bool {
    has_dataset(path) && path.join("meta/trocar_recording.json").is_file()
}

fn unwritable(error: &std::io::Error) -> String {
    format!("cannot be written: {error}")
}

fn refused(option: &str, path: &Path, reason: &str) -> SessionError {
    SessionError::BadArgument(format!("{option} {}: {reason}", path.display()))
}

/// One name for one file, whether it is there or not.
#[must_use]
pub fn identity(path: &Path) -> PathBuf {
    if let Ok(whole) = path.canonicalize() {
        return whole;
    }
    let parent = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    match (parent.canonicalize(), path.file_name()) {
        (Ok(parent), Some(name)) => parent.join(name),
        _ => path.to_path_buf(),
    }
}

/// Whether two paths are links to one file.
fn is_same_file(one: &Path, other: &Path) -> bool {
    let inode = |path: &Path| {
        let found = fs::metadata(path).ok()?;
        found.is_file().then(|| (found.dev(), found.ino()))
    };
    inode(one).is_some_and(|found| inode(other) == Some(found))
}

/// Opens `path` for writing and leaves everything as it was. Pipes and devices are left alone:
/// opening one may wait.
fn probe(path: &Path) -> std::io::Result<()> {
    match fs::metadata(path) {
        Ok(found) if found.is_file() || found.is_dir() => {
            OpenOptions::new().append(true).open(path).map(drop)
        }
        Ok(_) => Ok(()),
        Err(_) => {
            OpenOptions::new().write(true).create_new(true).open(path)?;
            fs::remove_file(path)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scratch(name: &str) -> PathBuf {
        let folder =
            std::env::temp_dir().join(format!("trocar-outputs-{}-{name}", std::process::id()));
        let _absent = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_check_makes_parents_and_leaves_no_file() {
        let folder = scratch("parents");
        let file = folder.join("a/b/result.json");
        check(&[("--json", Some(&file)), ("--log", None)], &[]).unwrap();
        assert!(file.parent().unwrap().is_dir() && !file.exists());
    }

    #[test]
    fn a_check_keeps_what_is_there() {
        let file = scratch("keeps").join("old.json");
        fs::write(&file, "old").unwrap();
        check(&[("--json", Some(&file))], &[]).unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "old");
    }

    #[test]
    fn one_file_for_two_results_is_refused_however_it_is_written() {
        let folder = scratch("same");
        let (plain, detour) = (folder.join("x"), folder.join("./y/../x"));
        fs::create_dir_all(folder.join("y")).unwrap();
        let message = check(&[("--log", Some(&plain)), ("--json", Some(&detour))], &[])
            .unwrap_err()
            .to_string();
        assert!(
            message.starts_with("--json ") && message.contains("--log names the same"),
            "{message}"
        );
        assert!(check(&[("--json", Some(&plain))], &[("--config", Some(&plain))]).is_err());
    }

    #[test]
    fn a_folder_or_a_file_in_the_way_is_refused() {
        let folder = scratch("in-the-way");
        assert!(check(&[("--json", Some(&folder))], &[]).is_err());
        let file = folder.join("file");
        fs::write(&file, "").unwrap();
        assert!(check(&[("--json", Some(&file.join("below")))], &[]).is_err());
        assert!(new_folder("--out", &file).is_err() && new_folder("--out", &folder).is_err());
    }

    #[test]
    fn a_new_or_an_empty_folder_is_taken_and_stays_empty() {
        let folder = scratch("empty");
        new_folder("--out", &folder).unwrap();
        new_folder("--out", &folder.join("new")).unwrap();
        assert_eq!(fs::read_dir(folder.join("new")).unwrap().count(), 0);
    }
}
