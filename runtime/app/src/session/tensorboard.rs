//! Scalars in TensorBoard's event files.
//!
//! A file is a row of records: length (u64), its checksum, the message, its checksum; all
//! little-endian. The checksum is CRC-32C, masked as TensorFlow does. The messages are
//! `tensorflow.Event` of `tensorflow/core/util/event.proto`, of which these are the fields that are
//! written.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

use prost::Message;

/// What the first record of a file says.
const FILE_VERSION: &str = "brain.Event:2";
/// `SessionLog.SessionStatus.START`.
const SESSION_START: i32 = 1;
/// Files that one process may begin in one second in one folder.
const NAMES_MAX: u32 = 100;

/// `tensorflow.Event`.
#[derive(Clone, PartialEq, Message)]
struct Event {
    /// Seconds since 1970.
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(string, optional, tag = "3")]
    file_version: Option<String>,
    #[prost(message, optional, tag = "5")]
    summary: Option<Summary>,
    #[prost(message, optional, tag = "7")]
    session_log: Option<SessionLog>,
}

/// `tensorflow.Summary`.
#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Value>,
}

/// `tensorflow.Summary.Value`.
#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
}

/// `tensorflow.SessionLog`.
#[derive(Clone, PartialEq, Message)]
struct SessionLog {
    #[prost(int32, tag = "1")]
    status: i32,
}

/// An event file being written.
#[derive(Debug)]
pub(super) struct EventFile {
    file: File,
}

impl EventFile {
    /// Begins a file in `folder` for what comes after `step`; whatever older files there have of
    /// later steps is no longer shown.
    ///
    /// `unix_s` is the time since 1970, s.
    pub(super) fn create(folder: &Path, step: u64, unix_s: f64) -> io::Result<Self> {
        let mut events = Self {
            file: create_new(folder, unix_s)?,
        };
        events.write(&Event {
            wall_time: unix_s,
            file_version: Some(FILE_VERSION.to_owned()),
            ..Event::default()
        })?;
        events.write(&Event {
            wall_time: unix_s,
            step: signed(step.saturating_add(1)),
            session_log: Some(SessionLog {
                status: SESSION_START,
            }),
            ..Event::default()
        })?;
        Ok(events)
    }

    /// Writes numbers of `step`, each with its tag.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the format has single precision"
    )]
    pub(super) fn scalars(
        &mut self,
        step: u64,
        unix_s: f64,
        scalars: &[(&str, f64)],
    ) -> io::Result<()> {
        let value = scalars.iter().map(|&(tag, value)| Value {
            tag: tag.to_owned(),
            simple_value: Some(value as f32),
        });
        self.write(&Event {
            wall_time: unix_s,
            step: signed(step),
            summary: Some(Summary {
                value: value.collect(),
            }),
            ..Event::default()
        })
    }

    fn write(&mut self, event: &Event) -> io::Result<()> {
        // In one piece, so that a cut-off leaves whole records and at most one that readers leave
        // out.
        self.file.write_all(&record(&event.encode_to_vec()))
    }
}

/// A file whose name TensorBoard looks for.
fn create_new(folder: &Path, unix_s: f64) -> io::Result<File> {
    let process = std::process::id();
    let mut count = 0;
    loop {
        let name = format!("events.out.tfevents.{unix_s:010.0}.trocar.{process}.{count}");
        let created = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(folder.join(name));
        match created {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists && count < NAMES_MAX => {
                count += 1;
            }
            result => return result,
        }
    }
}

fn signed(step: u64) -> i64 {
    i64::try_from(step).unwrap_or(i64::MAX)
}

fn record(message: &[u8]) -> Vec<u8> {
    let length = (message.len() as u64).to_le_bytes();
    [
        &length[..],
        &masked_crc(&length).to_le_bytes(),
        message,
        &masked_crc(message).to_le_bytes(),
    ]
    .concat()
}

/// The checksum as the format stores it: a checksum of data that holds its own checksum would be
/// weak.
const fn masked_crc(data: &[u8]) -> u32 {
    crc32c(data).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// CRC-32C (Castagnoli), as in RFC 3720.
const fn crc32c(data: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    let mut at = 0;
    while at < data.len() {
        crc ^= data[at] as u32;
        let mut bit = 0;
        while bit < 8 {
            crc = (crc >> 1) ^ (0x82f6_3b78 & (crc & 1).wrapping_neg());
            bit += 1;
        }
        at += 1;
    }
    !crc
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::scratch::Scratch;
    use super::*;
    use std::collections::BTreeMap;
    use std::fs;
    use std::path::PathBuf;

    /// All scalars in the event files of `folder` by tag, in the order of the files' names,
    /// checksums checked.
    pub(in crate::session) fn scalars(folder: &Path) -> BTreeMap<String, Vec<(i64, f32)>> {
        let mut files: Vec<PathBuf> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.to_string_lossy().contains("tfevents"))
            .collect();
        files.sort();
        let mut scalars: BTreeMap<String, Vec<(i64, f32)>> = BTreeMap::new();
        for event in files.iter().flat_map(|file| read(&fs::read(file).unwrap())) {
            for value in event.summary.into_iter().flat_map(|summary| summary.value) {
                let point = (event.step, value.simple_value.unwrap());
                scalars.entry(value.tag).or_default().push(point);
            }
        }
        scalars
    }

    fn read(mut bytes: &[u8]) -> Vec<Event> {
        let mut events = Vec::new();
        while let Some((length, rest)) = bytes.split_first_chunk::<8>() {
            let size = usize::try_from(u64::from_le_bytes(*length)).unwrap();
            let (length_crc, rest) = rest.split_first_chunk::<4>().unwrap();
            let (message, rest) = rest.split_at(size);
            let (crc, rest) = rest.split_first_chunk::<4>().unwrap();
            assert_eq!(masked_crc(length), u32::from_le_bytes(*length_crc));
            assert_eq!(masked_crc(message), u32::from_le_bytes(*crc));
            events.push(Event::decode(message).unwrap());
            bytes = rest;
        }
        events
    }

    #[test]
    fn checksums_are_those_of_rfc_3720() {
        assert_eq!(crc32c(b"123456789"), 0xe306_9283);
        assert_eq!(crc32c(&[0; 32]), 0x8a91_36aa);
        assert_eq!(crc32c(&[0xff; 32]), 0x62a8_ab43);
        assert_eq!(crc32c(b""), 0);
    }

    /// The bytes that TensorFlow's own writer begins a file with, at time 0.
    #[test]
    fn the_first_record_is_the_version() {
        let event = Event {
            file_version: Some(FILE_VERSION.to_owned()),
            ..Event::default()
        };
        let bytes = record(&event.encode_to_vec());
        assert_eq!(&bytes[..8], &[15, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(
            &bytes[12..],
            [b"\x1a\x0dbrain.Event:2", &bytes[27..]].concat()
        );
    }

    /// What is written is read and a second file takes another name.
    #[test]
    fn written_events_are_read_back() {
        let folder = Scratch::folder("events");
        let mut first = EventFile::create(&folder, 0, 1.7e9).unwrap();
        first.scalars(5, 1.7e9, &[("a", 0.5), ("b", -2.0)]).unwrap();
        let mut second = EventFile::create(&folder, 5, 1.7e9).unwrap();
        second.scalars(6, 1.7e9, &[("a", 0.25)]).unwrap();
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 2);
        let read = scalars(&folder);
        assert_eq!(read["a"], [(5, 0.5), (6, 0.25)]);
        assert_eq!(read["b"], [(5, -2.0)]);
    }
}
