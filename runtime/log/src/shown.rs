//! What a log shows people beside its ticks: camera images as they were kept, the scene, what
//! happened in words, and the messages themselves.

use std::collections::BTreeMap;
use std::path::Path;

use hal::{Intrinsics, Pose, TimeNs};
use mcap::records::MessageHeader;
use prost::Message as _;

use super::camera;
use super::container::{self, Visitor};
use super::error::LogError;
use super::live;
use super::messages::{CameraCalibration, CompressedImage, Log, PoseInFrame};
use super::read;
use super::topic::{self, Topic};

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
    /// Through what a camera saw, and from where; before its image of that time.
    View {
        /// The camera.
        camera: &'a str,
        /// When.
        at: TimeNs,
        /// Its lens.
        lens: &'a Intrinsics,
        /// Where it was in the scene, looking along z with y down.
        camera_in_scene: &'a Pose,
    },
    /// A simulated scene at a policy step.
    Scene {
        /// When.
        at: TimeNs,
        /// The message, for [`SceneRecord::read`](super::SceneRecord::read).
        message: &'a str,
    },
    /// The CAN buses of the arms.
    Buses {
        /// When.
        at: TimeNs,
        /// The message, for [`BusesRecord::read`](super::BusesRecord::read).
        message: &'a str,
    },
    /// What happened.
    Event {
        /// When.
        at: TimeNs,
        /// In words.
        text: &'a str,
    },
    /// Any message, those of the others too, which come before it in their own form.
    Message {
        /// Its topic.
        topic: &'a str,
        /// When.
        at: TimeNs,
        /// As it is in the file.
        data: &'a [u8],
    },
}

/// Reads the log at `path` in the order of the file, up to the cut if it was cut: each item goes to
/// `each`.
///
/// # Errors
/// [`LogError`] when there is no such file, it is no MCAP file, or bytes in it have changed.
pub fn read_items(path: &Path, each: impl FnMut(LoggedItem<'_>)) -> Result<(), LogError> {
    let mut looking = Looking {
        each,
        lenses: BTreeMap::new(),
    };
    container::walk(path, read::buffered(path)?, &mut looking).map(|_cut| ())
}

/// Passes on every message, and what is more than that once more as what it is.
struct Looking<F> {
    each: F,
    /// The newest of each camera.
    lenses: BTreeMap<String, Intrinsics>,
}

impl<F: FnMut(LoggedItem<'_>)> Looking<F> {
    /// Takes in what a topic of `camera` besides its images says.
    fn beside_images(
        &mut self,
        (camera, what): (&str, &str),
        at: TimeNs,
        data: &[u8],
    ) -> Result<(), String> {
        match what {
            "calibration" => {
                let lens = CameraCalibration::decode(data).map_err(|error| error.to_string())?;
                if let Some(lens) = camera::intrinsics(&lens) {
                    self.lenses.insert(camera.to_owned(), lens);
                }
            }
            "pose" => {
                let found = PoseInFrame::decode(data).map_err(|error| error.to_string())?;
                let pose = found.pose.and_then(|pose| pose.pose());
                if let (Some(lens), Some(camera_in_scene)) = (self.lenses.get(camera), &pose) {
                    (self.each)(LoggedItem::View {
                        camera,
                        at,
                        lens,
                        camera_in_scene,
                    });
                }
            }
            _ => {}
        }
        Ok(())
    }
}

impl<F: FnMut(LoggedItem<'_>)> Visitor for Looking<F> {
    fn message(&mut self, topic: &str, header: &MessageHeader, data: &[u8]) -> Result<(), String> {
        let at = TimeNs(header.log_time);
        if let Some((Topic::Events, _)) = Topic::find(topic) {
            let log = Log::decode(data).map_err(|error| error.to_string())?;
            let text = &log.message;
            (self.each)(LoggedItem::Event { at, text });
        }
        if let Some(camera) = live::camera_of(topic) {
            let found = CompressedImage::decode(data).map_err(|error| error.to_string())?;
            let image = &found.data;
            (self.each)(LoggedItem::Image { camera, at, image });
        }
        if let Some(beside) = topic::beside_images(topic) {
            self.beside_images(beside, at, data)?;
        }
        let text = || std::str::from_utf8(data).map_err(|error| error.to_string());
        if topic == live::TASK {
            let message = text()?;
            (self.each)(LoggedItem::Scene { at, message });
        }
        if topic == live::BUSES {
            let message = text()?;
            (self.each)(LoggedItem::Buses { at, message });
        }
        (self.each)(LoggedItem::Message { topic, at, data });
        Ok(())
    }

    fn metadata(&mut self, _name: &str, _map: BTreeMap<String, String>) -> Result<(), String> {
        Ok(())
    }
}
