//! A stage in a `.usdz`: an archive whose files are stored as they are and begin at multiples of 64
//! bytes.

use flate2::Crc;

use crate::number::index;

/// Files begin at multiples of this, so that programs may map them.
const ALIGNMENT: usize = 64;
/// Bytes of a file's header before its name.
const HEADER_BYTES: usize = 30;
/// The extra field that fills up to the alignment, a private one as others use: its number and its
/// length take four bytes.
const PADDING: u16 = 0x1986;
/// 1980-01-01, the first day that archives know: the same stage gives the same bytes.
const DATE: u16 = 0x21;

/// What the header of a file and its entry in the directory have in common, but for the extra
/// field.
fn common(name: &str, bytes: &[u8], extra: usize) -> Vec<u8> {
    let mut crc = Crc::new();
    crc.update(bytes);
    let mut out = Vec::new();
    // Version 2.0, no flags, stored, midnight.
    for short in [20, 0, 0, 0, DATE] {
        out.extend(short.to_le_bytes());
    }
    out.extend(crc.sum().to_le_bytes());
    out.extend(index(bytes.len()).to_le_bytes());
    out.extend(index(bytes.len()).to_le_bytes());
    out.extend(short(name.len()));
    out.extend(short(extra));
    out
}

fn short(count: usize) -> [u8; 2] {
    let [low, high, ..] = index(count).to_le_bytes();
    [low, high]
}

/// The bytes of an archive with `files`, names with their bytes, the stage first.
///
/// # Panics
/// If the archive would exceed 4 GiB or 65535 files.
#[must_use]
pub fn usdz(files: &[(String, &[u8])]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut directory = Vec::new();
    for (name, bytes) in files {
        let header = out.len();
        let begin = (header + HEADER_BYTES + name.len() + 4).next_multiple_of(ALIGNMENT);
        let padding = begin - header - HEADER_BYTES - name.len() - 4;
        out.extend(b"PK\x03\x04");
        out.extend(common(name, bytes, padding + 4));
        out.extend(name.as_bytes());
        out.extend(PADDING.to_le_bytes());
        out.extend(short(padding));
        out.resize(begin, 0);
        out.extend(*bytes);
        directory.extend(b"PK\x01\x02\x14\0");
        directory.extend(common(name, bytes, 0));
        // No comment, first disk, no attributes.
        directory.extend([0; 10]);
        directory.extend(index(header).to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let from = out.len();
    out.extend(&directory);
    out.extend(b"PK\x05\x06\0\0\0\0");
    out.extend([short(files.len()); 2].concat());
    out.extend(index(directory.len()).to_le_bytes());
    out.extend(index(from).to_le_bytes());
    out.extend([0; 2]);
    out
}
