//! The camera frames of a log: when each was taken, and of which size. The images stay where they
//! are.

use std::io::Cursor;
use std::path::Path;

use hal::TimeNs;
use image::{ImageError, ImageReader, Limits, RgbImage};
use trocar_data::dataset::SIDE_MAX;
use trocar_log::{LoggedItem, read_items};

use super::LogImportError;

/// A frame of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LoggedFrame {
    /// When it was taken.
    pub(super) at: TimeNs,
    /// How many of its camera come before it in the file.
    pub(super) place: usize,
}

/// A camera with all its frames.
#[derive(Clone, Debug)]
pub(super) struct LoggedCamera {
    pub(super) name: String,
    /// In the order of their stamps.
    pub(super) frames: Vec<LoggedFrame>,
    /// Width and height of the first frame, pixels.
    pub(super) size: (u32, u32),
    /// The first frame of another size, and when.
    other_size: Option<(TimeNs, (u32, u32))>,
}

impl LoggedCamera {
    /// The cameras of `log` in the order in which they appear in the file.
    ///
    /// # Errors
    /// [`LogImportError::Log`] and [`LogImportError::Image`].
    pub(super) fn all(log: &Path) -> Result<Vec<Self>, LogImportError> {
        let (mut cameras, mut failure) = (Vec::new(), None);
        read_items(log, |item| {
            if let LoggedItem::Image { camera, at, image } = item
                && failure.is_none()
            {
                let size = decoder(image).and_then(ImageReader::into_dimensions);
                match size {
                    Ok(size) => add(&mut cameras, camera, at, size),
                    Err(source) => failure = Some(undecodable(log, camera, at, source)),
                }
            }
        })?;
        if let Some(failure) = failure {
            return Err(failure);
        }
        for camera in &mut cameras {
            camera.frames.sort_by_key(|frame| (frame.at, frame.place));
        }
        Ok(cameras)
    }

    /// The cameras called `names` among `found` in `log`, in their order; all if there is no name.
    ///
    /// # Errors
    /// [`LogImportError::NoCamera`] or [`LogImportError::NoFrames`].
    pub(super) fn chosen(
        log: &Path,
        mut found: Vec<Self>,
        names: &[String],
    ) -> Result<Vec<Self>, LogImportError> {
        if found.is_empty() {
            let log = log.to_owned();
            return Err(LogImportError::NoFrames { log });
        }
        if names.is_empty() {
            return Ok(found);
        }
        let mut chosen = Vec::with_capacity(names.len());
        for name in names {
            let Some(index) = found.iter().position(|camera| camera.name == *name) else {
                let rest = chosen.iter().chain(&found);
                let names: Vec<&str> = rest.map(|camera: &Self| camera.name.as_str()).collect();
                return Err(LogImportError::NoCamera {
                    log: log.to_owned(),
                    camera: name.clone(),
                    found: names.join(", "),
                });
            };
            chosen.push(found.remove(index));
        }
        Ok(chosen)
    }

    /// Refuses images of several sizes.
    ///
    /// # Errors
    /// [`LogImportError::Sizes`].
    pub(super) fn check_size(&self, log: &Path) -> Result<(), LogImportError> {
        match self.other_size {
            None => Ok(()),
            Some((at, other)) => Err(LogImportError::Sizes {
                log: log.to_owned(),
                camera: self.name.clone(),
                first: self.size,
                other,
                at_s: at.seconds(),
            }),
        }
    }

    /// The frame nearest to `at`; of two the earlier.
    pub(super) fn nearest(&self, at: TimeNs) -> Option<LoggedFrame> {
        let later = self.frames.partition_point(|frame| frame.at < at);
        let before = later.checked_sub(1).and_then(|it| self.frames.get(it));
        let around = before.into_iter().chain(self.frames.get(later));
        around
            .min_by_key(|frame| frame.at.0.abs_diff(at.0))
            .copied()
    }
}

/// Adds a frame to its camera.
fn add(cameras: &mut Vec<LoggedCamera>, name: &str, at: TimeNs, size: (u32, u32)) {
    let known = cameras.iter().position(|camera| camera.name == name);
    let index = known.unwrap_or_else(|| {
        cameras.push(LoggedCamera {
            name: name.to_owned(),
            frames: Vec::new(),
            size,
            other_size: None,
        });
        cameras.len() - 1
    });
    let camera = &mut cameras[index];
    if size != camera.size {
        camera.other_size = camera.other_size.or(Some((at, size)));
    }
    let place = camera.frames.len();
    camera.frames.push(LoggedFrame { at, place });
}

/// An image of the log, PNG or JPEG, whose header may lie.
fn decoder(image: &[u8]) -> Result<ImageReader<Cursor<&[u8]>>, ImageError> {
    let mut limits = Limits::default();
    limits.max_image_width = Some(SIDE_MAX);
    limits.max_image_height = Some(SIDE_MAX);
    let mut reader = ImageReader::new(Cursor::new(image)).with_guessed_format()?;
    reader.limits(limits);
    Ok(reader)
}

/// The image as RGB.
///
/// # Errors
/// The codec's.
pub(super) fn decoded(image: &[u8]) -> Result<RgbImage, ImageError> {
    Ok(decoder(image)?.decode()?.into_rgb8())
}

/// The error of an image of `log`.
pub(super) fn undecodable(
    log: &Path,
    camera: &str,
    at: TimeNs,
    source: ImageError,
) -> LogImportError {
    LogImportError::Image {
        log: log.to_owned(),
        camera: camera.to_owned(),
        at_s: at.seconds(),
        source,
    }
}
