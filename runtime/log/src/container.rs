//! Walks through the bytes of an MCAP file, checks its checksums and stops cleanly where a file was
//! cut.
//!
//! An MCAP file is a magic of eight bytes, then records: opcode (one byte), length (eight,
//! little-endian), body. Ours has metadata and chunks of messages, which are compressed and have a
//! CRC-32 each, then `DataEnd` with the CRC-32 of all before, the summary, the footer with the
//! summary's CRC-32, and the magic again. The summary is checked and not used: the file is read
//! from front to back.
//!
//! A file that ends early is cut, not damaged: the run may have crashed. A byte that differs is
//! damage, and nothing after it is trusted.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Read};
use std::path::Path;

use mcap::read::parse_record;
use mcap::records::{MessageHeader, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::error::LogError;

/// Takes what the walk finds, in file order.
pub(super) trait Visitor {
    /// A message on `topic`. An error names what is wrong with it.
    fn message(&mut self, topic: &str, header: &MessageHeader, data: &[u8]) -> Result<(), String>;
    /// A metadata record. An error names what is wrong with it.
    fn metadata(&mut self, name: &str, map: BTreeMap<String, String>) -> Result<(), String>;
}

/// Opcode and length before each record.
const RECORD_HEAD: usize = 9;

/// More than any chunk of ours holds (a full file chunk and one image). A flipped bit in a length
/// would otherwise ask for more memory than there is.
const RECORD_BYTES_MAX: usize = 64 << 20;

/// Visits every whole record of `input`, one after the other; `Some(reason)` if the file was cut.
///
/// # Errors
/// [`LogError::Read`], [`LogError::NotMcap`], or [`LogError::Damaged`] with the offset of the
/// record in which bytes have changed.
pub(super) fn walk(
    path: &Path,
    input: impl Read,
    visitor: &mut impl Visitor,
) -> Result<Option<String>, LogError> {
    let mut input = Input::new(path, input);
    input.magic()?;
    let mut topics = BTreeMap::new();
    loop {
        match input.advance()? {
            Found::Cut(reason) => return Ok(Some(reason)),
            Found::Record { opcode } => {
                let record = parse_record(opcode, input.body());
                let record = record.map_err(|error| input.damaged(error.to_string()))?;
                if let Record::DataEnd(end) = &record {
                    input.check_data(end.data_section_crc)?;
                    return tail(&mut input);
                }
                visit(record, input.whole(), &mut topics, visitor)
                    .map_err(|reason| input.damaged(reason))?;
            }
        }
    }
}

/// Hands on what a record of the data holds.
fn visit(
    record: Record<'_>,
    whole: &[u8],
    topics: &mut BTreeMap<u16, String>,
    visitor: &mut impl Visitor,
) -> Result<(), String> {
    match record {
        Record::Chunk { .. } => {
            open_chunk(whole, |inner| message_or_channel(inner, topics, visitor))
        }
        Record::Metadata(metadata) => visitor.metadata(&metadata.name, metadata.metadata),
        Record::Unknown { opcode: 0, .. } => Err("a record of type 0".to_owned()),
        Record::Header(_)
        | Record::Footer(_)
        | Record::Schema { .. }
        | Record::Channel(_)
        | Record::Message { .. }
        | Record::MessageIndex(_)
        | Record::ChunkIndex(_)
        | Record::Attachment { .. }
        | Record::AttachmentIndex(_)
        | Record::Statistics(_)
        | Record::MetadataIndex(_)
        | Record::SummaryOffset(_)
        | Record::DataEnd(_)
        | Record::Unknown { .. } => message_or_channel(record, topics, visitor),
    }
}

/// A file that is read record by record.
///
/// Holds one record at a time, whatever the file's size.
struct Input<'a, R> {
    path: &'a Path,
    reader: R,
    /// Where the newest record begins.
    ///
    /// Byte offset in the file; errors name it.
    begin: u64,
    /// Where the next one does.
    end: u64,
    /// The newest record with its head.
    record: Vec<u8>,
    /// Of everything before the newest record, since [`Self::restart`].
    checksum: crc32fast::Hasher,
}

/// What comes next in a file.
enum Found {
    /// A whole record, which is in [`Input::record`]; its first byte is `opcode`.
    Record { opcode: u8 },
    /// The end of the file where a record should be, and where that is.
    Cut(String),
}

impl<'a, R: Read> Input<'a, R> {
    fn new(path: &'a Path, reader: R) -> Self {
        Self {
            path,
            reader,
            begin: 0,
            end: 0,
            record: Vec::new(),
            checksum: crc32fast::Hasher::new(),
        }
    }

    /// The system refuses to read.
    fn unreadable(&self, source: io::Error) -> LogError {
        LogError::Read {
            path: self.path.to_owned(),
            source,
        }
    }

    /// Bytes of the file have changed.
    fn damaged(&self, reason: String) -> LogError {
        LogError::Damaged {
            path: self.path.to_owned(),
            offset: self.begin,
            reason,
        }
    }

    /// Reads up to `count` bytes behind what is in [`Self::record`]; gives how many there were.
    fn read(&mut self, count: u64) -> Result<u64, LogError> {
        let read = self
            .reader
            .by_ref()
            .take(count)
            .read_to_end(&mut self.record);
        let read = read.map_err(|source| self.unreadable(source))? as u64;
        self.end += read;
        Ok(read)
    }

    /// Reads the opening magic.
    fn magic(&mut self) -> Result<(), LogError> {
        self.read(mcap::MAGIC.len() as u64)?;
        if self.record == mcap::MAGIC {
            return Ok(());
        }
        let path = self.path.to_owned();
        Err(if mcap::MAGIC.starts_with(&self.record) {
            LogError::NotOurs {
                path,
                missing: format!("everything after byte {}", self.end),
            }
        } else {
            LogError::NotMcap { path }
        })
    }

    /// Reads the next record.
    ///
    /// A record that claims more than 64 MiB is skipped without storing it: it is a cut if the file
    /// ends before, damage otherwise.
    fn advance(&mut self) -> Result<Found, LogError> {
        self.checksum.update(&self.record);
        self.record.clear();
        self.begin = self.end;
        self.read(RECORD_HEAD as u64)?;
        let head = self.record.split_first();
        let head = head.and_then(|(opcode, rest)| Some((*opcode, rest.first_chunk::<8>()?)));
        let Some((opcode, length)) = head else {
            return Ok(self.cut());
        };
        let length = u64::from_le_bytes(*length);
        if length > RECORD_BYTES_MAX as u64 {
            let rest = io::copy(&mut self.reader.by_ref().take(length), &mut io::sink());
            let rest = rest.map_err(|source| self.unreadable(source))?;
            self.end += rest;
            if rest < length {
                return Ok(self.cut());
            }
            return Err(self.damaged(format!("a record of {length} bytes, more than any has")));
        }
        if self.read(length)? < length {
            return Ok(self.cut());
        }
        Ok(Found::Record { opcode })
    }

    /// The newest record without its head.
    fn body(&self) -> &[u8] {
        self.record.get(RECORD_HEAD..).unwrap_or_default()
    }

    /// The newest record with its head.
    fn whole(&self) -> &[u8] {
        &self.record
    }

    /// The reason for people: at which byte, and inside which record.
    fn cut(&self) -> Found {
        let place = if self.end == self.begin {
            "before the end of the data".to_owned()
        } else {
            format!("inside the record that begins at {}", self.begin)
        };
        Found::Cut(format!("the file ends at byte {}, {place}", self.end))
    }

    /// Compares the checksum of all that came before the newest record; 0 means that there is none.
    fn check_data(&self, expected: u32) -> Result<(), LogError> {
        let actual = self.checksum.clone().finalize();
        if expected == 0 || expected == actual {
            return Ok(());
        }
        Err(self.damaged(format!(
            "checksum of all data is {actual:#010x}, recorded as {expected:#010x}"
        )))
    }

    /// Begins a new checksum with the next record.
    fn restart(&mut self) {
        self.record.clear();
        self.checksum = crc32fast::Hasher::new();
    }
}

/// Unpacks the chunk record in `bytes` and hands on what is in it, once its checksum is known to be
/// right: only then can lengths inside be trusted.
fn open_chunk(
    bytes: &[u8],
    mut visit: impl FnMut(Record<'_>) -> Result<(), String>,
) -> Result<(), String> {
    let mut reader = LinearReader::new_with_options(record_options());
    let mut rest = bytes;
    while let Some(event) = reader.next_event() {
        match event.map_err(|error| error.to_string())? {
            LinearReadEvent::ReadRequest(wanted) => {
                let (now, later) = rest.split_at(wanted.min(rest.len()));
                reader.insert(now.len()).copy_from_slice(now);
                reader.notify_read(now.len());
                rest = later;
            }
            LinearReadEvent::Record { data, opcode } => {
                visit(parse_record(opcode, data).map_err(|error| error.to_string())?)?;
            }
        }
    }
    Ok(())
}

/// For records outside of a file, checksums first.
fn record_options() -> LinearReaderOptions {
    LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(RECORD_BYTES_MAX)
}

/// Hands on a message with the name of its channel, and remembers channels.
fn message_or_channel(
    record: Record<'_>,
    topics: &mut BTreeMap<u16, String>,
    visitor: &mut impl Visitor,
) -> Result<(), String> {
    match record {
        Record::Channel(channel) => {
            topics.insert(channel.id, channel.topic);
            Ok(())
        }
        Record::Message { header, data } => {
            let topic = topics.get(&header.channel_id).ok_or_else(|| {
                format!(
                    "a message on channel {}, which was not announced",
                    header.channel_id
                )
            })?;
            let data: Cow<'_, [u8]> = data;
            visitor
                .message(topic, &header, &data)
                .map_err(|reason| format!("{topic}: {reason}"))
        }
        Record::Header(_)
        | Record::Footer(_)
        | Record::Schema { .. }
        | Record::Chunk { .. }
        | Record::MessageIndex(_)
        | Record::ChunkIndex(_)
        | Record::Attachment { .. }
        | Record::AttachmentIndex(_)
        | Record::Statistics(_)
        | Record::Metadata(_)
        | Record::MetadataIndex(_)
        | Record::SummaryOffset(_)
        | Record::DataEnd(_)
        | Record::Unknown { .. } => Ok(()),
    }
}

/// Checks everything behind the data: summary, footer, closing magic. `Some(reason)` if it was cut.
///
/// Errors name the offset at which the data end.
fn tail(input: &mut Input<'_, impl Read>) -> Result<Option<String>, LogError> {
    let data_end = input.end;
    input.restart();
    let in_tail = |input: &Input<'_, _>, reason: &str| {
        let mut error = input.damaged(reason.to_owned());
        if let LogError::Damaged { offset, .. } = &mut error {
            *offset = data_end;
        }
        error
    };
    let cut = |end: u64| {
        let place = "after the data but inside the summary";
        Ok(Some(format!("the file ends at byte {end}, {place}")))
    };
    loop {
        let Found::Record { opcode } = input.advance()? else {
            return cut(input.end);
        };
        if opcode != op::FOOTER {
            continue;
        }
        let Ok(Record::Footer(footer)) = parse_record(opcode, input.body()) else {
            return Err(in_tail(input, "the footer is malformed"));
        };
        // The checksum covers the summary and the footer up to the checksum itself.
        let mut checksum = input.checksum.clone();
        let covered = input.record.len().saturating_sub(size_of::<u32>());
        checksum.update(input.record.get(..covered).unwrap_or_default());
        if footer.summary_crc != 0 && footer.summary_crc != checksum.finalize() {
            return Err(in_tail(input, "the summary's checksum does not match"));
        }
        input.restart();
        input.read(mcap::MAGIC.len() as u64 + 1)?;
        return if input.record == mcap::MAGIC {
            Ok(None)
        } else if mcap::MAGIC.starts_with(&input.record) {
            cut(input.end)
        } else {
            let reason = "other bytes than the closing magic follow the footer";
            Err(in_tail(input, reason))
        };
    }
}
