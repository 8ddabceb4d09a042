//! The frames of one camera in one episode, a few at a time.
//!
//! Frames of one chunk are unpacked together, and callers ask in order, so each chunk is unpacked
//! once, unless it is larger than a window. A camera's window is of at most `READ_MAX` bytes.

use std::io::Cursor;

use hdf5_reader::error::Error;
use hdf5_reader::{Dataset, Datatype, SliceInfo, SliceInfoElem};
use image::imageops::{self, FilterType};
use image::{ImageFormat, ImageReader, Limits};

use super::ImportError;
use super::file::{READ_MAX, Recording, kind};
use crate::dataset::SIDE_MAX;

/// What becomes of frames as they are stored.
#[derive(Clone, Copy, Debug)]
pub(super) struct Form {
    /// Red and blue of JPEG are the other way round: act-plus-plus hands red, green, blue to an
    /// encoder that takes blue, green, red.
    pub(super) swapped: bool,
    /// Width and height that frames are brought to.
    pub(super) resized: Option<(u32, u32)>,
}

/// One camera's frames.
pub(super) struct CameraFrames<'a> {
    recording: &'a Recording,
    name: &'a str,
    dataset: Dataset,
    /// Width and height, unless it takes a decoded frame to know.
    stored: Option<(u32, u32)>,
    form: Form,
    /// Bytes of a step as stored: a frame, or a padded JPEG.
    row_bytes: usize,
    /// Steps that are read together: those of one chunk, which are unpacked together.
    window_steps: usize,
    /// The first step in `window`.
    window_start: usize,
    /// Stored bytes of the steps that were read last.
    window: Vec<u8>,
    /// RGB of the last frame, where it is not stored as such.
    decoded: Vec<u8>,
}

impl<'a> CameraFrames<'a> {
    /// The frames in the dataset `name`, of which there must be `steps`.
    pub(super) fn open(
        recording: &'a Recording,
        name: &'a str,
        steps: usize,
        form: Form,
    ) -> Result<Self, ImportError> {
        let dataset = recording.dataset(name)?;
        let refuse = |found: String, expected: &str| recording.mismatch(name, found, expected);
        let byte = matches!(
            dataset.dtype(),
            Datatype::FixedPoint {
                size: 1,
                signed: false,
                ..
            }
        );
        if !byte {
            return Err(refuse(format!("is of {}", kind(dataset.dtype())), "uint8"));
        }
        let shape = dataset.shape();
        let side = |extent: u64| {
            let extent = u32::try_from(extent).ok();
            extent.filter(|extent| (1..=SIDE_MAX).contains(extent))
        };
        let stored = match *shape {
            [_, height, width, 3] => side(width).zip(side(height)),
            _ => None,
        };
        let row_bytes = match (shape, stored) {
            (_, Some((width, height))) => Some(3 * width as usize * height as usize),
            (&[_, bytes], None) => usize::try_from(bytes).ok().filter(|bytes| *bytes > 0),
            _ => None,
        };
        let Some(row_bytes) = row_bytes.filter(|bytes| *bytes <= READ_MAX) else {
            let expected = format!(
                "(steps, height, width, 3) with sides of 1 to {SIDE_MAX}, or (steps, bytes) of JPEG"
            );
            return Err(refuse(format!("has the shape {shape:?}"), &expected));
        };
        if shape[0] != steps as u64 {
            let found = format!("has {} frames of {steps} steps", shape[0]);
            return Err(refuse(found, "one a step"));
        }
        let chunk = dataset
            .chunks()
            .and_then(|extents| extents.first().copied());
        let window_steps = chunk.map_or(1, |steps| steps as usize);
        let window_steps = window_steps.clamp(1, (READ_MAX / row_bytes).max(1));
        recording.check_chunks(name, &dataset, window_steps as u64)?;
        Ok(Self {
            recording,
            name,
            stored,
            form,
            row_bytes,
            window_steps,
            window_start: 0,
            window: Vec::new(),
            decoded: Vec::new(),
            dataset,
        })
    }

    /// Width and height of the first frame, pixels, as the dataset will have it.
    pub(super) fn size(&mut self) -> Result<(u32, u32), ImportError> {
        let stored = match self.stored {
            Some(size) => size,
            None => self.decode(0)?.dimensions(),
        };
        Ok(self.form.resized.unwrap_or(stored))
    }

    /// RGB of `step`, which must be `size`.
    pub(super) fn rgb(&mut self, step: usize, size: (u32, u32)) -> Result<&[u8], ImportError> {
        let found = match self.stored {
            Some(found) => found,
            None => {
                let image = self.decode(step)?;
                let found = image.dimensions();
                self.decoded = image.into_raw();
                found
            }
        };
        if let Some(size) = self.form.resized {
            return self.resized(step, found, size);
        }
        if found != size {
            let found = format!("is {} x {} in step {step}", found.0, found.1);
            let expected = format!("{} x {} as before", size.0, size.1);
            return Err(self.recording.mismatch(self.name, found, expected));
        }
        match self.stored {
            Some(_) => self.row(step),
            None => Ok(&self.decoded),
        }
    }

    /// The frame of `step`, which is of `from`, brought to `size`.
    fn resized(
        &mut self,
        step: usize,
        from: (u32, u32),
        size: (u32, u32),
    ) -> Result<&[u8], ImportError> {
        let whole = match self.stored {
            Some(_) => self.row(step)?.to_vec(),
            None => std::mem::take(&mut self.decoded),
        };
        let (recording, name) = (self.recording, self.name);
        let image = image::RgbImage::from_raw(from.0, from.1, whole);
        let image = image.ok_or_else(|| {
            let short = Error::InvalidData(format!("step {step} is cut off"));
            recording.unreadable(name, short)
        })?;
        let image = imageops::resize(&image, size.0, size.1, FilterType::Triangle);
        self.decoded = image.into_raw();
        Ok(&self.decoded)
    }

    /// The JPEG of a step as RGB; padding behind its end is ignored by the decoder.
    fn decode(&mut self, step: usize) -> Result<image::RgbImage, ImportError> {
        let (place, name) = (self.recording.place.clone(), self.name.to_owned());
        let mut limits = Limits::default();
        limits.max_image_width = Some(SIDE_MAX);
        limits.max_image_height = Some(SIDE_MAX);
        let row = Cursor::new(self.row(step)?);
        let mut reader = ImageReader::with_format(row, ImageFormat::Jpeg);
        reader.limits(limits);
        let image = reader.decode().map_err(|source| ImportError::Jpeg {
            place,
            name,
            step,
            source,
        })?;
        let mut image = image.into_rgb8();
        if self.form.swapped {
            for pixel in image.pixels_mut() {
                pixel.0.reverse();
            }
        }
        Ok(image)
    }

    /// The bytes of `step` as they are stored.
    fn row(&mut self, step: usize) -> Result<&[u8], ImportError> {
        let start = step - step % self.window_steps;
        if self.window.is_empty() || self.window_start != start {
            self.window = self
                .read(start)
                .map_err(|error| self.recording.unreadable(self.name, error))?;
            self.window_start = start;
        }
        let from = (step - start) * self.row_bytes;
        let row = self.window.get(from..from + self.row_bytes);
        row.ok_or_else(|| {
            let short = Error::InvalidData(format!("step {step} is cut off"));
            self.recording.unreadable(self.name, short)
        })
    }

    fn read(&self, start: usize) -> Result<Vec<u8>, Error> {
        let steps = self.dataset.shape().first().copied().unwrap_or(0);
        let mut part = SliceInfo::all(self.dataset.ndim());
        part.selections[0] = SliceInfoElem::Slice {
            start: start as u64,
            end: steps.min((start + self.window_steps) as u64),
            step: 1,
        };
        let bytes = self.dataset.read_slice::<u8>(&part)?;
        Ok(bytes.into_raw_vec_and_offset().0)
    }
}
