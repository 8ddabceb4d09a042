//! Pictures of a run that a person can look at: a strip of moments and an animation.

use hal::count::count_u32;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;

use hal::CameraFrame;
use image::codecs::gif::{GifEncoder, Repeat};
use image::imageops::{self, FilterType};
use image::{Delay, Frame, RgbImage, buffer::ConvertBuffer};

use super::SessionError;

/// Frames of one camera, kept small.
#[derive(Debug, Default)]
pub struct Thumbnails {
    frames: Vec<RgbImage>,
}

/// Time between two policy steps, which is that between two pictures of an animation, ms.
pub const STEP_MS: u32 = 40;

/// Width of one image at most, pixels.
const WIDTH: u32 = 256;

impl Thumbnails {
    /// Keeps a copy of `frame`, scaled down to 256 pixels across where it has more.
    pub fn push(&mut self, frame: &CameraFrame) {
        let (width, height) = (frame.intrinsics.width, frame.intrinsics.height);
        if width <= WIDTH {
            self.push_whole(frame);
        } else if let Some(full) = RgbImage::from_raw(width, height, frame.colour.clone()) {
            let scaled =
                imageops::resize(&full, WIDTH, WIDTH * height / width, FilterType::Triangle);
            self.frames.push(scaled);
        }
    }

    /// Keeps a copy of `frame` as large as it is.
    pub fn push_whole(&mut self, frame: &CameraFrame) {
        let (width, height) = (frame.intrinsics.width, frame.intrinsics.height);
        self.frames
            .extend(RgbImage::from_raw(width, height, frame.colour.clone()));
    }

    /// How many frames were kept.
    #[must_use]
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Whether none was kept.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Writes `columns * rows` evenly spaced frames, in reading order, as one PNG.
    ///
    /// # Errors
    /// [`SessionError::Output`] when the file can't be written.
    pub fn write_strip(&self, path: &Path, columns: u32, rows: u32) -> Result<(), SessionError> {
        let Some((first, last)) = self.frames.first().zip(self.frames.len().checked_sub(1)) else {
            return Ok(());
        };
        let (width, height) = first.dimensions();
        let mut sheet = RgbImage::new(width * columns, height * rows);
        let count = (columns * rows) as usize;
        for index in 0..count {
            let frame = &self.frames[index * last / count.saturating_sub(1).max(1)];
            let cell = count_u32(index);
            let (x, y) = (
                i64::from(cell % columns * width),
                i64::from(cell / columns * height),
            );
            imageops::replace(&mut sheet, frame, x, y);
        }
        create_parent(path)?;
        sheet
            .save(path)
            .map_err(|error| SessionError::output(path, error))
    }

    /// Writes all frames as an endless GIF, `frame_ms` apart.
    ///
    /// # Errors
    /// [`SessionError::Output`] when the file can't be written.
    pub fn write_gif(&self, path: &Path, frame_ms: u32) -> Result<(), SessionError> {
        create_parent(path)?;
        let file = File::create(path).map_err(|error| SessionError::output(path, error))?;
        // 10 is a good trade of colours against time; the scene has few.
        let mut encoder = GifEncoder::new_with_speed(BufWriter::new(file), 10);
        encoder
            .set_repeat(Repeat::Infinite)
            .map_err(|error| SessionError::output(path, error))?;
        for frame in &self.frames {
            let delay = Delay::from_numer_denom_ms(frame_ms, 1);
            let frame = Frame::from_parts(frame.convert(), 0, 0, delay);
            encoder
                .encode_frame(frame)
                .map_err(|error| SessionError::output(path, error))?;
        }
        Ok(())
    }
}

/// Makes the folder that `path` lies in.
///
/// # Errors
/// [`SessionError::Output`].
pub fn create_parent(path: &Path) -> Result<(), SessionError> {
    let Some(parent) = path.parent() else {
        return Ok(());
    };
    fs::create_dir_all(parent).map_err(|error| SessionError::output(parent, error))
}
