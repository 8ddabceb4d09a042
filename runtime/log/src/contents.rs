//! One hash over everything that a log holds, in order: what was changed afterwards shows, unless
//! whoever changed it computed this one again too.
//!
//! SHA-256 over the parts in file order. Of a message: topic, log time, publish time (eight bytes
//! each, little-endian), data. Of a metadata record: name, then each key and value by key. Texts
//! and data go in with their length in eight bytes before them. Channel numbers, sequence numbers
//! and how the file is compressed do not enter, so a file that was repacked keeps its hash.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use mcap::records::MessageHeader;
use sha2::{Digest as _, Sha256};

/// The hash as it grows.
#[derive(Clone, Default)]
pub(super) struct ContentHash(Sha256);

impl ContentHash {
    /// Takes in a message.
    pub(super) fn message(&mut self, topic: &str, header: &MessageHeader, data: &[u8]) {
        self.part(topic.as_bytes());
        self.0.update(header.log_time.to_le_bytes());
        self.0.update(header.publish_time.to_le_bytes());
        self.part(data);
    }

    /// Takes in a metadata record.
    pub(super) fn metadata(&mut self, name: &str, map: &BTreeMap<String, String>) {
        self.part(name.as_bytes());
        for text in map.iter().flat_map(|(key, value)| [key, value]) {
            self.part(text.as_bytes());
        }
    }

    /// The hash of everything up to now, hexadecimal.
    pub(super) fn value(&self) -> String {
        let digest = self.0.clone().finalize();
        digest.iter().fold(String::new(), |mut text, byte| {
            let _infallible = write!(text, "{byte:02x}");
            text
        })
    }

    /// Takes in a part with its length, so that nothing can move from one part to the next.
    fn part(&mut self, bytes: &[u8]) {
        self.0.update((bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contents_depend_on_every_part_and_its_place() {
        let header = |log_time| MessageHeader {
            channel_id: 1,
            sequence: 0,
            log_time,
            publish_time: 0,
        };
        let of = |messages: &[(&str, u64, &[u8])]| {
            let mut contents = ContentHash::default();
            for (topic, at, data) in messages {
                contents.message(topic, &header(*at), data);
            }
            contents.value()
        };
        let honest = of(&[("/a", 1, b"x"), ("/b", 2, b"y")]);
        assert_eq!(honest.len(), 64);
        for other in [
            of(&[("/b", 2, b"y"), ("/a", 1, b"x")]),
            of(&[("/a", 1, b"y"), ("/b", 2, b"x")]),
            of(&[("/a", 1, b"x"), ("/b", 3, b"y")]),
            of(&[("/a", 1, b"x")]),
            of(&[("/ax", 1, b""), ("/b", 2, b"y")]),
        ] {
            assert_ne!(honest, other);
        }
        let mut contents = ContentHash::default();
        contents.metadata("run", &BTreeMap::from([("a".to_owned(), "b".to_owned())]));
        assert_ne!(contents.value(), ContentHash::default().value());
    }
}
