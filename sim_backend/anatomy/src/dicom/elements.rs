//! The few elements of a DICOM file that a slice needs.
//!
//! Elements come one after the other and are passed over unread, without a call within a call. No
//! length is believed before as many bytes are seen to be there, and brackets must fit together.
//!
//! A file is 128 bytes of anything, `DICM`, a group of meta information in explicit little-endian
//! with its length first (PS3.10, 7.1), and then the data set in the transfer syntax that the meta
//! information names.

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::Path;

use dicom_core::DataElement;
use dicom_dictionary_std::tags;
use dicom_object::{InMemDicomObject, Tag};
use dicom_parser::StatefulDecode;
use dicom_parser::dataset::LazyDataToken;
use dicom_parser::dataset::lazy_read::LazyDataSetReader;
use dicom_transfer_syntax_registry::TransferSyntax;
use dicom_transfer_syntax_registry::entries::{
    EXPLICIT_VR_LITTLE_ENDIAN, IMPLICIT_VR_LITTLE_ENDIAN,
};

use super::{DicomError, unreadable};

/// Most bytes of a slice's file: 256 MiB.
const FILE_MAX: u64 = 1 << 28;
/// Most bytes of its meta information.
const META_MAX: u32 = 1 << 16;
/// Most bytes of an attribute.
const ATTRIBUTE_MAX: u64 = 1 << 12;

/// How deep sequences may be nested, items counted.
const DEPTH_MAX: usize = 64;

/// What meta information begins with: the element of its length, of 4 bytes.
const META_START: [u8; 8] = *b"\x02\0\0\0UL\x04\0";

/// What of a file is read.
pub(super) enum Wanted<'a> {
    /// These elements, which are small.
    Attributes(&'a [Tag]),
    /// The pixels.
    Pixels,
}

impl Wanted<'_> {
    /// Whether the element is wanted.
    fn has(&self, tag: Tag) -> bool {
        match self {
            Self::Attributes(tags) => tags.contains(&tag),
            Self::Pixels => tag == tags::PIXEL_DATA,
        }
    }

    /// Whether nothing more comes from `tag` on: elements are in order.
    fn ends_before(&self, tag: Tag) -> bool {
        match self {
            Self::Attributes(tags) => tags.iter().all(|own| *own < tag),
            Self::Pixels => tags::PIXEL_DATA < tag,
        }
    }

    /// Most bytes of one wanted element.
    const fn bytes_max(&self) -> u64 {
        match self {
            Self::Attributes(_) => ATTRIBUTE_MAX,
            Self::Pixels => FILE_MAX,
        }
    }
}

/// What is wanted of the file at `path`.
///
/// # Errors
/// [`DicomError`] with the file's name.
pub(super) fn read(path: &Path, wanted: &Wanted<'_>) -> Result<InMemDicomObject, DicomError> {
    let opened = File::open(path).and_then(|file| Ok((file.metadata()?.len(), file)));
    let (bytes, file) = opened.map_err(|error| unreadable(path, error))?;
    of(BufReader::new(file), bytes, wanted).map_err(|reason| DicomError::File {
        path: path.display().to_string(),
        reason,
    })
}

/// What is wanted of a file of so many bytes.
pub(super) fn of<F: Read + Seek>(
    mut file: F,
    bytes: u64,
    wanted: &Wanted<'_>,
) -> Result<InMemDicomObject, String> {
    if bytes > FILE_MAX {
        return Err(format!("{bytes} bytes; a slice has at most {FILE_MAX}"));
    }
    let cut = |error| format!("no intact DICOM file: {error}");
    let mut start = [0; 144];
    file.read_exact(&mut start).map_err(cut)?;
    let (_, meta) = start.split_at(132);
    let length = meta.strip_prefix(&META_START).and_then(<[u8]>::first_chunk);
    let length = length.map(|length| u32::from_le_bytes(*length));
    let length = length.filter(|length| *length <= META_MAX).ok_or_else(|| {
        format!("no intact DICOM file: its meta information has no length of at most {META_MAX}")
    })?;
    let mut meta = vec![0; length as usize];
    file.read_exact(&mut meta).map_err(cut)?;
    let explicit = EXPLICIT_VR_LITTLE_ENDIAN.erased();
    let syntax = [tags::TRANSFER_SYNTAX_UID];
    let meta = elements(
        Cursor::new(meta),
        u64::from(length),
        &explicit,
        &Wanted::Attributes(&syntax),
    )?;
    let syntax = meta.element(syntax[0]).ok().and_then(|it| it.to_str().ok());
    let syntax = syntax.ok_or("no intact DICOM file: it has no transfer syntax")?;
    let syntax = syntax.trim_matches(['\0', ' ']);
    // Those whose pixels are plain little-endian numbers.
    let plain = [explicit, IMPLICIT_VR_LITTLE_ENDIAN.erased()];
    let plain = plain.iter().find(|own| own.uid() == syntax);
    let plain = plain.ok_or_else(|| {
        format!(
            "its transfer syntax is {syntax}: compressed or big-endian pixels are not read; make them plain first, by `gdcmconv --raw` or `dcmdjpeg`"
        )
    })?;
    elements(file, bytes, plain, wanted)
}

/// The elements of `source`, of so many bytes, that are wanted and in no sequence.
///
/// Brackets are sequences and items; a stack of them tells whether an element is at the top.
/// Reading ends at the first tag behind all that are wanted, so pixels are not even passed over
/// when attributes are.
fn elements<F: Read + Seek>(
    source: F,
    bytes: u64,
    syntax: &TransferSyntax,
    wanted: &Wanted<'_>,
) -> Result<InMemDicomObject, String> {
    let broken = |error: &dyn std::fmt::Display| format!("no intact DICOM file: {error}");
    let reader = LazyDataSetReader::new_with_ts(source, syntax);
    let mut reader = reader.map_err(|error| broken(&error))?;
    let mut found = InMemDicomObject::new_empty();
    // Whether each bracket that is open is an item's.
    let mut open = Vec::new();
    while let Some(token) = reader.advance() {
        let token = token.map_err(|error| broken(&error))?;
        match &token {
            LazyDataToken::PixelSequenceStart | LazyDataToken::SequenceStart { .. } => {
                open.push(false);
            }
            LazyDataToken::ItemStart { .. } => open.push(true),
            LazyDataToken::ItemEnd | LazyDataToken::SequenceEnd => {
                let is_item = matches!(token, LazyDataToken::ItemEnd);
                if open.pop() != Some(is_item) {
                    return Err(broken(&"a sequence or an item ends that has not begun"));
                }
            }
            LazyDataToken::ElementHeader(header) => {
                if open.is_empty() && wanted.ends_before(header.tag) {
                    return Ok(found);
                }
            }
            LazyDataToken::LazyValue { header, decoder } => {
                let (tag, length) = (header.tag, header.len.0);
                there(tag, length, bytes, decoder.position())?;
                if open.is_empty() && wanted.has(tag) {
                    if u64::from(length) > wanted.bytes_max() {
                        let most = wanted.bytes_max();
                        return Err(format!("{tag} has {length} bytes, allowed are {most}"));
                    }
                    let vr = header.vr;
                    let value = token.into_value().map_err(|error| broken(&error))?;
                    found.put(DataElement::new(tag, vr, value));
                    continue;
                }
            }
            LazyDataToken::LazyItemValue { len, decoder } => {
                there(tags::PIXEL_DATA, *len, bytes, decoder.position())?;
            }
            _ => return Err(broken(&"something that is no element")),
        }
        token.skip().map_err(|error| broken(&error))?;
        if open.len() > DEPTH_MAX {
            return Err(format!("sequences are nested more than {DEPTH_MAX} deep"));
        }
    }
    if open.is_empty() {
        return Ok(found);
    }
    Err(broken(&"it ends in the middle of a sequence"))
}

/// Refuses an element that claims more bytes than are left of `bytes`.
fn there(tag: Tag, length: u32, bytes: u64, position: u64) -> Result<(), String> {
    let left = bytes.saturating_sub(position);
    if u64::from(length) <= left {
        return Ok(());
    }
    Err(format!(
        "no intact DICOM file: {tag} claims {length} bytes, {left} are left"
    ))
}
