//! The SHA-256 of texts and files. Texts are configurations and scenes, files are executables and
//! weights: a run's provenance and a study's addresses are made of these.

use std::io::{self, Read};
use std::path::Path;

use hal::files;
use sha2::{Digest, Sha256};

/// 64 digits, 0 to 9 and a to f.
pub(crate) fn hexadecimal(hash: Sha256) -> String {
    format!("{:x}", hash.finalize())
}

/// SHA-256 of `text`, hexadecimal.
#[must_use]
pub fn hash_text(text: &str) -> String {
    let mut hash = Sha256::new();
    hash.update(text);
    hexadecimal(hash)
}

/// SHA-256 of the file at `path`, hexadecimal. It is read in pieces of 1 MiB, whatever its size.
///
/// # Errors
/// The system's, and for a device, a pipe or a socket.
pub fn hash_file(path: &Path) -> io::Result<String> {
    let mut file = files::open(path)?;
    let mut hash = Sha256::new();
    let mut buffer = vec![0_u8; 1 << 20];
    loop {
        let count = file.read(&mut buffer)?;
        if count == 0 {
            return Ok(hexadecimal(hash));
        }
        hash.update(&buffer[..count]);
    }
}

#[cfg(test)]
mod tests {
    use super::hash_text;

    #[test]
    fn hashes_match_the_published_test_vectors() {
        // FIPS 180-2, appendix B.1.
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(hash_text("abc"), expected);
    }
}
