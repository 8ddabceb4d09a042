//! What a log shows people beside its ticks: camera images as they were kept, what happened in words, and the messages themselves.

use std::collections::BTreeMap;
use std::path::Path;

use hal::TimeNs;
use mcap::records::MessageHeader;
use prost::Message as _;

use super::container::{self, Visitor};
use super::error::LogError;
use super::live;
use super::messages::{CompressedImage, Log};
use super::read;
use super::topic::Topic;

/// An item of a log that a viewer shows.
#[derive(Clone, Copy, Debug)]
pub enum LoggedItem<'a> {
    /// What a camera saw.
    Image {
        /// The camera.
        camera: &'a str,
        /// When it was taken.
        at: TimeNs,
        /// The compressed image, PNG or JPEG, as it is in the file.
        image: &'a [u8],
    },
    /// What happened.
    Event {
        /// When.
        at: TimeNs,
        /// In words.
        text: &'a str,
    },
    /// Any message, those of images and events too, which come before it in their own form.
    Message {
        /// Its topic.
        topic: &'a str,
        /// When.
        at: TimeNs,
        /// As it is in the file.
        data: &'a [u8],
    },
}

/// Reads the log at `path` in the order of the file, up to the cut if it was cut: each image, each event and each message goes to `each`.
///
/// # Errors
/// [`LogError`] when there is no such file, it is no MCAP file, or bytes in it have changed.
pub fn read_items(path: &Path, each: impl FnMut(LoggedItem<'_>)) -> Result<(), LogError> {
    let mut looking = Looking(each);
    container::walk(path, read::buffered(path)?, &mut looking).map(|_cut| ())
}

/// Passes on every message, and images and events once more as what they are.
struct Looking<F>(F);

impl<F: FnMut(LoggedItem<'_>)> Visitor for Looking<F> {
    fn message(&mut self, topic: &str, header: &MessageHeader, data: &[u8]) -> Result<(), String> {
        let at = TimeNs(header.log_time);
        if let Some((Topic::Events, _)) = Topic::find(topic) {
            let log = Log::decode(data).map_err(|error| error.to_string())?;
            let text = &log.message;
            (self.0)(LoggedItem::Event { at, text });
        }
        if let Some(camera) = live::camera_of(topic) {
            let found = CompressedImage::decode(data).map_err(|error| error.to_string())?;
            let image = &found.data;
            (self.0)(LoggedItem::Image { camera, at, image });
        }
        (self.0)(LoggedItem::Message { topic, at, data });
        Ok(())
    }

    fn metadata(&mut self, _name: &str, _map: BTreeMap<String, String>) -> Result<(), String> {
        Ok(())
    }
}
