//! Walks through the bytes of an MCAP file, checks its checksums and stops cleanly where a file was cut.

use std::borrow::Cow;
use std::collections::BTreeMap;
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

/// More than any chunk of ours holds (a full file chunk and one image). A flipped bit in a length would otherwise ask for
/// more memory than there is.
const RECORD_BYTES_MAX: usize = 64 << 20;

/// Visits every whole record in `bytes`; `Some(reason)` if the file was cut.
///
/// # Errors
/// [`LogError::NotMcap`], or [`LogError::Damaged`] with the offset of the record in which bytes have changed.
pub(super) fn walk(
    path: &Path,
    bytes: &[u8],
    visitor: &mut impl Visitor,
) -> Result<Option<String>, LogError> {
    check_magic(path, bytes)?;
    let mut topics = BTreeMap::new();
    let mut offset = mcap::MAGIC.len();
    loop {
        let damaged = |reason: String| LogError::Damaged {
            path: path.to_owned(),
            offset,
            reason,
        };
        let Some((opcode, body)) = record_at(bytes, offset) else {
            let place = if offset == bytes.len() {
                "before the end of the data".to_owned()
            } else {
                format!("inside the record that begins at {offset}")
            };
            return Ok(Some(format!(
                "the file ends at byte {}, {place}",
                bytes.len()
            )));
        };
        let record = parse_record(opcode, body).map_err(|error| damaged(error.to_string()))?;
        match record {
            Record::Chunk { .. } => {
                let whole = bytes
                    .get(offset..offset + RECORD_HEAD + body.len())
                    .unwrap_or_default();
                open_chunk(whole, |inner| {
                    message_or_channel(inner, &mut topics, visitor)
                })
                .map_err(damaged)?;
            }
            Record::Metadata(metadata) => visitor
                .metadata(&metadata.name, metadata.metadata)
                .map_err(damaged)?,
            Record::DataEnd(end) => {
                let actual = crc32fast::hash(bytes.get(..offset).unwrap_or_default());
                if end.data_section_crc != 0 && end.data_section_crc != actual {
                    return Err(damaged(format!(
                        "checksum of all data is {actual:#010x}, recorded as {:#010x}",
                        end.data_section_crc
                    )));
                }
                return tail(bytes, offset + RECORD_HEAD + body.len()).map_err(damaged);
            }
            Record::Unknown { opcode: 0, .. } => {
                return Err(damaged("a record of type 0".to_owned()));
            }
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
            | Record::Unknown { .. } => {
                message_or_channel(record, &mut topics, visitor).map_err(damaged)?
            }
        }
        offset += RECORD_HEAD + body.len();
    }
}

fn check_magic(path: &Path, bytes: &[u8]) -> Result<(), LogError> {
    if bytes.starts_with(mcap::MAGIC) {
        return Ok(());
    }
    Err(if mcap::MAGIC.starts_with(bytes) {
        LogError::NotOurs {
            path: path.to_owned(),
            missing: format!("everything after byte {}", bytes.len()),
        }
    } else {
        LogError::NotMcap {
            path: path.to_owned(),
        }
    })
}

/// The whole record at `offset`: its type and body. `None` if the file ends before it does.
fn record_at(bytes: &[u8], offset: usize) -> Option<(u8, &[u8])> {
    let rest = bytes.get(offset..)?;
    let (&opcode, rest) = rest.split_first()?;
    let (length, rest) = rest.split_first_chunk::<8>()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
    Some((opcode, rest.get(..length)?))
}

/// Unpacks the chunk record in `bytes` and hands on what is in it, once its checksum is known to be right: only then can
/// lengths inside be trusted.
fn open_chunk(
    bytes: &[u8],
    mut visit: impl FnMut(Record<'_>) -> Result<(), String>,
) -> Result<(), String> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(RECORD_BYTES_MAX);
    let mut reader = LinearReader::new_with_options(options);
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
fn tail(bytes: &[u8], data_end: usize) -> Result<Option<String>, String> {
    let mut offset = data_end;
    let cut = || {
        Ok(Some(format!(
            "the file ends at byte {}, after the data but inside the summary",
            bytes.len()
        )))
    };
    loop {
        let Some((opcode, body)) = record_at(bytes, offset) else {
            return cut();
        };
        let next = offset + RECORD_HEAD + body.len();
        if opcode != op::FOOTER {
            offset = next;
            continue;
        }
        let Ok(Record::Footer(footer)) = parse_record(opcode, body) else {
            return Err("the footer is malformed".to_owned());
        };
        // The checksum covers the summary and the footer up to the checksum itself.
        let covered = bytes
            .get(data_end..next - size_of::<u32>())
            .unwrap_or_default();
        if footer.summary_crc != 0 && footer.summary_crc != crc32fast::hash(covered) {
            return Err("the summary's checksum does not match".to_owned());
        }
        let end = bytes.get(next..).unwrap_or_default();
        return match end {
            end if end == mcap::MAGIC => Ok(None),
            end if mcap::MAGIC.starts_with(end) => cut(),
            _ => Err("other bytes than the closing magic follow the footer".to_owned()),
        };
    }
}
