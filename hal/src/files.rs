//! Files that others made, opened and read within bounds.

use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::Path;

/// Most bytes of a JSON text that describes something: a checkpoint, a dataset.
pub const JSON_SIZE_MAX: u64 = 16 << 20;

/// Opens `path`, which must be a regular file: a device or a pipe may never end, and opening a pipe
/// may wait for ever. A folder is opened too, and refused by the system when it is read.
///
/// # Errors
/// The system's; [`io::ErrorKind::Other`] for a device, a pipe or a socket.
pub fn open(path: &Path) -> io::Result<File> {
    opened(path).map(|(file, _)| file)
}

/// The bytes of the regular file `path`, at most `size_max`; `what` is what it is to be, for the
/// message: `a configuration`.
///
/// # Errors
/// Those of [`open`]; [`io::ErrorKind::Other`] for a larger file, with both sizes.
pub fn read(path: &Path, what: &str, size_max: u64) -> io::Result<Vec<u8>> {
    let (file, size) = opened(path)?;
    let too_large = |size: &str| {
        let reason = format!("it has {size}; the limit for {what} is {size_max} bytes");
        io::Error::other(reason)
    };
    if size > size_max {
        return Err(too_large(&format!("{size} bytes")));
    }
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(size).unwrap_or(usize::MAX))?;
    // It may have grown meanwhile, and files of the kernel say that they are empty.
    let read = file
        .take(size_max.saturating_add(1))
        .read_to_end(&mut bytes)?;
    if u64::try_from(read).is_ok_and(|read| read > size_max) {
        return Err(too_large("more bytes than it says"));
    }
    Ok(bytes)
}

/// As [`read`], of a text in UTF-8.
///
/// # Errors
/// Those of [`read`]; [`io::ErrorKind::InvalidData`] if it is no UTF-8.
pub fn read_text(path: &Path, what: &str, size_max: u64) -> io::Result<String> {
    let bytes = read(path, what, size_max)?;
    String::from_utf8(bytes).map_err(|_| {
        let reason = "stream did not contain valid UTF-8";
        io::Error::new(io::ErrorKind::InvalidData, reason)
    })
}

fn opened(path: &Path) -> io::Result<(File, u64)> {
    let found = fs::metadata(path)?;
    if !found.is_file() && !found.is_dir() {
        let reason = "it is a device, a pipe or a socket, not a file";
        return Err(io::Error::other(reason));
    }
    Ok((File::open(path)?, found.len()))
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixListener;
    use std::path::PathBuf;

    use super::*;

    /// A folder of its own for one test, removed at the end.
    struct Folder(PathBuf);

    impl Folder {
        fn new(test: &str) -> Self {
            let name = format!("trocar-files-{test}-{}", std::process::id());
            let path = std::env::temp_dir().join(name);
            let _absent = fs::remove_dir_all(&path);
            fs::create_dir_all(&path).unwrap();
            Self(path)
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _removed = fs::remove_dir_all(&self.0);
        }
    }

    fn refused(path: &Path, size_max: u64) -> String {
        let bytes = read(path, "a note", size_max).unwrap_err().to_string();
        let text = read_text(path, "a note", size_max).unwrap_err().to_string();
        assert_eq!(bytes, text);
        bytes
    }

    #[test]
    fn a_file_is_read_up_to_its_limit_and_not_beyond() {
        let folder = Folder::new("limit");
        let path = folder.0.join("note");
        fs::write(&path, "12345").unwrap();
        assert_eq!(read(&path, "a note", 5).unwrap(), b"12345");
        assert_eq!(read_text(&path, "a note", u64::MAX).unwrap(), "12345");
        let told = "it has 5 bytes; the limit for a note is 4 bytes";
        assert_eq!(refused(&path, 4), told);
        fs::write(&path, "").unwrap();
        assert_eq!(read(&path, "a note", 0).unwrap(), b"");
    }

    /// What says that it is empty and is not, as files of the kernel do.
    #[test]
    fn a_file_longer_than_it_says_is_refused() {
        let told = refused(Path::new("/proc/self/status"), 8);
        let reason = "it has more bytes than it says; the limit for a note is 8 bytes";
        assert_eq!(told, reason);
    }

    #[test]
    fn devices_sockets_and_folders_are_no_files() {
        let folder = Folder::new("kinds");
        let socket = folder.0.join("socket");
        let _bound = UnixListener::bind(&socket).unwrap();
        for path in [Path::new("/dev/zero"), socket.as_path()] {
            let told = refused(path, 8);
            assert_eq!(told, "it is a device, a pipe or a socket, not a file");
            assert_eq!(open(path).unwrap_err().to_string(), told);
        }
        let kind = read(&folder.0, "a note", 1 << 20).unwrap_err().kind();
        assert_eq!(kind, io::ErrorKind::IsADirectory);
        let kind = open(&folder.0.join("nowhere")).unwrap_err().kind();
        assert_eq!(kind, io::ErrorKind::NotFound);
    }

    #[test]
    fn bytes_that_are_no_text_are_refused_as_text_only() {
        let folder = Folder::new("text");
        let path = folder.0.join("note");
        fs::write(&path, [0xff_u8, 0xfe]).unwrap();
        assert_eq!(read(&path, "a note", 2).unwrap(), [0xff, 0xfe]);
        let error = read_text(&path, "a note", 2).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidData);
    }
}
