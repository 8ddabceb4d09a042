//! What a process leaves that was killed while it registered a port or a service with its node.
//!
//! The transport writes a tag for each into the node's folder, and makes it read-only once it is
//! complete. Its clean-up passes over one that is not, and then can't remove the folder: the dead
//! node would stay for ever.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

/// The owner may write: the transport has not finished the file.
const OWNER_WRITES: u32 = 0o200;

/// Removes the tags in `folder`, that of a dead node, that end with one of `suffixes` and were not
/// finished.
pub(super) fn remove_tags(folder: &Path, suffixes: &[String]) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let is_tag = suffixes.iter().any(|suffix| name.ends_with(suffix));
        let mode = entry.metadata().map_or(0, |data| data.permissions().mode());
        if is_tag && mode & OWNER_WRITES != 0 {
            // Another process may clean up too.
            let _gone = fs::remove_file(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_tags_that_were_not_finished_go() {
        let folder = std::env::temp_dir().join(format!("trocar-tags-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        for (name, mode) in [
            ("a.port_tag", 0o600),
            ("b.port_tag", 0o400),
            ("node.details", 0o600),
        ] {
            fs::write(folder.join(name), "").unwrap();
            let permissions = fs::Permissions::from_mode(mode);
            fs::set_permissions(folder.join(name), permissions).unwrap();
        }
        remove_tags(&folder, &[".port_tag".to_owned()]);
        let left = fs::read_dir(&folder).unwrap();
        let mut left: Vec<_> = left.map(|entry| entry.unwrap().file_name()).collect();
        left.sort();
        assert_eq!(left, ["b.port_tag", "node.details"]);
        remove_tags(&folder.join("nowhere"), &[]);
        fs::remove_dir_all(&folder).unwrap();
    }
}
