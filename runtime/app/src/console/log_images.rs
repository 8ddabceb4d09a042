//! The images of a log by camera: a bounded number of bytes of a log of any length.

use std::collections::BTreeMap;

use axum::body::Bytes;
use hal::{Intrinsics, Pose, TimeNs};

use super::drawn::{Plane, Stream};
use super::encode;
use super::path::Lenses;

/// Bytes of images that are kept; of more, every second one goes.
const IMAGE_BYTES_MAX: usize = 256 << 20;

/// Images by camera, in the order in which cameras first come.
#[derive(Debug, Default)]
pub(super) struct Images {
    cameras: Vec<LoggedCamera>,
    bytes: usize,
    /// Of so many images one is kept.
    stride: u64,
    seen: u64,
}

/// A camera of a log.
#[derive(Debug, Default)]
struct LoggedCamera {
    name: String,
    images: BTreeMap<TimeNs, Bytes>,
    /// Through what it saw and from where, as often as that changed.
    views: BTreeMap<TimeNs, (Intrinsics, Pose)>,
}

impl Images {
    pub(super) fn cameras(&self) -> Vec<String> {
        let cameras = self.cameras.iter();
        cameras.map(|camera| camera.name.clone()).collect()
    }

    /// The camera `name` and its index; it is added if it is not there yet.
    fn camera(&mut self, name: &str) -> (usize, &mut LoggedCamera) {
        let known = self.cameras.iter().position(|camera| camera.name == name);
        let index = known.unwrap_or_else(|| {
            self.cameras.push(LoggedCamera {
                name: name.to_owned(),
                ..LoggedCamera::default()
            });
            self.cameras.len() - 1
        });
        (index, &mut self.cameras[index])
    }

    pub(super) fn keep_view(&mut self, camera: &str, at: TimeNs, view: (Intrinsics, Pose)) {
        let (_, camera) = self.camera(camera);
        let before = camera.views.last_key_value();
        if before.is_none_or(|(_, before)| *before != view) {
            camera.views.insert(at, view);
        }
    }

    /// The lenses of all cameras at that time, and where they were.
    pub(super) fn lenses(&self, at: TimeNs) -> Lenses {
        let views = (0..=u8::MAX)
            .zip(&self.cameras)
            .filter_map(|(index, camera)| {
                let before = camera.views.range(..=at).next_back();
                let (_, view) = before.or_else(|| camera.views.first_key_value())?;
                Some((index, *view))
            });
        views.collect()
    }

    /// Copies `image`, PNG or JPEG as it is in the log, behind a head, so that it is sent as it is.
    /// The first image of a camera is always kept.
    pub(super) fn keep(&mut self, camera: &str, at: TimeNs, image: &[u8]) {
        self.seen += 1;
        let (seen, stride) = (self.seen, self.stride.max(1));
        let (index, LoggedCamera { images: kept, .. }) = self.camera(camera);
        let Ok(number) = u8::try_from(index) else {
            return;
        };
        if !kept.is_empty() && !seen.is_multiple_of(stride) {
            return;
        }
        let stream = Stream {
            camera: number,
            plane: Plane::Colour,
        };
        let mut message = encode::head(stream, at);
        message.extend_from_slice(image);
        let bytes = message.len();
        kept.insert(at, message.into());
        self.bytes += bytes;
        if self.bytes > IMAGE_BYTES_MAX {
            self.thin_out();
        }
    }

    /// Lets every second image go.
    fn thin_out(&mut self) {
        self.stride = 2 * self.stride.max(1);
        for camera in &mut self.cameras {
            let mut index = 0;
            camera.images.retain(|_, _| {
                index += 1;
                index % 2 == 1
            });
        }
        let cameras = self.cameras.iter();
        let images = cameras.flat_map(|camera| camera.images.values());
        self.bytes = images.map(Bytes::len).sum();
    }

    /// The image at that time, the nearest before it, or else the first; with a number that is its
    /// own, its time in ns plus one.
    pub(super) fn at(&self, camera: u8, at: TimeNs) -> Option<(u64, Bytes)> {
        let kept = &self.cameras.get(usize::from(camera))?.images;
        let before = kept.range(..=at).next_back();
        let (stamp, image) = before.or_else(|| kept.first_key_value())?;
        Some((stamp.0 + 1, image.clone()))
    }
}

#[cfg(test)]
mod tests {
    use hal::{Intrinsics, Pose, TimeNs};

    use super::Images;

    /// Where a camera was when a chunk came is the newest that the log says of it.
    #[test]
    fn a_cameras_view_is_the_newest_before() {
        let lens = Intrinsics::from_vertical_fov(8, 8, 1.0);
        let mut images = Images::default();
        for (ms, x) in [(0, 0.0), (40, 0.0), (80, 1.0)] {
            let at = TimeNs(ms * 1_000_000);
            images.keep_view("wrist", at, (lens, Pose::translation(x, 0.0, 0.0)));
            images.keep("wrist", at, &[0xff, 0xd8]);
        }
        assert_eq!(images.cameras[0].views.len(), 2, "what stays is kept once");
        assert_eq!(images.cameras[0].images.len(), 3);
        for (ms, x) in [(0, 0.0), (79, 0.0), (80, 1.0), (500, 1.0)] {
            let lenses = images.lenses(TimeNs(ms * 1_000_000));
            let (_, pose) = lenses[&0];
            assert!((pose.translation.x - x).abs() < 1e-12, "{ms}");
        }
    }
}
