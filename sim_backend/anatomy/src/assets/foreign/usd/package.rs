//! The stage in a `.usdz`: an archive whose files are stored as they are, the stage first.

use flate2::Crc;

use crate::assets::gltf::take;

/// What an archive's first file and its end begin with, and the longest end.
pub(super) const MAGIC: &[u8] = b"PK\x03\x04";
const END: &[u8] = b"PK\x05\x06";
const END_BYTES_MAX: usize = 22 + 65535;

/// Of a file's flags: it is encrypted, or its size comes after it.
const FLAGS_REFUSED: usize = 0b1001;

/// The bytes of the first file in `archive`.
///
/// # Errors
/// What is wrong with the archive.
pub(super) fn first_file(archive: &[u8]) -> Result<&[u8], String> {
    let tail = &archive[archive.len().saturating_sub(END_BYTES_MAX)..];
    if !tail.windows(END.len()).any(|part| part == END) {
        return Err("the archive has no end: it is cut off".to_owned());
    }
    let mut rest = archive;
    let mut number = |bytes: usize| {
        let taken = take(&mut rest, bytes)?;
        let sum = taken.iter().rev();
        Ok::<_, &str>(sum.fold(0, |sum, byte| sum << 8 | usize::from(*byte)))
    };
    let (_magic, _version, flags, method) = (number(4)?, number(2)?, number(2)?, number(2)?);
    let (_time, checksum, stored, size) = (number(4)?, number(4)?, number(4)?, number(4)?);
    let (name, extra) = (number(2)?, number(2)?);
    take(&mut rest, name + extra)?;
    if method != 0 || flags & FLAGS_REFUSED != 0 || stored != size {
        return Err(
            "its first file is compressed or encrypted; in a .usdz files are stored".to_owned(),
        );
    }
    let bytes = take(&mut rest, size)?;
    let mut own = Crc::new();
    own.update(bytes);
    if own.sum() as usize != checksum {
        return Err("its first file has another checksum".to_owned());
    }
    Ok(bytes)
}
