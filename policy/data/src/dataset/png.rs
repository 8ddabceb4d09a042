//! RGB images to PNG and back, at the settings that cost least time.
//!
//! Colour only; depth and ids have bit depths and filters of their own in `depth`.

use std::io::Cursor;

use image::{
    DynamicImage, ExtendedColorType, ImageEncoder, ImageError, ImageFormat, ImageReader, Limits,
    RgbImage,
    codecs::png::{CompressionType, FilterType, PngEncoder},
};

/// Pixels that a side of an image may have. Bounds what a header that lies can have a decoder
/// allocate.
pub const SIDE_MAX: u32 = 8192;

/// Encodes 8-bit RGB, row-major, `3 * width * height` bytes.
///
/// Lossless. Fast compression with adaptive filters, to keep up with the cameras at the price of
/// larger files.
///
/// # Errors
/// The codec's, for zero sizes or a wrong number of bytes.
pub fn encode_rgb(rgb: &[u8], width: u32, height: u32) -> Result<Vec<u8>, ImageError> {
    let expected = 3 * u64::from(width) * u64::from(height);
    if u64::try_from(rgb.len()) != Ok(expected) {
        let kind = image::error::ParameterErrorKind::DimensionMismatch;
        return Err(ImageError::Parameter(
            image::error::ParameterError::from_kind(kind),
        ));
    }
    let mut png = Vec::with_capacity(rgb.len() / 3);
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Adaptive)
        .write_image(rgb, width, height, ExtendedColorType::Rgb8)?;
    Ok(png)
}

/// Decodes a PNG of any colour type to 8-bit RGB. Alpha is dropped; grey becomes three equal
/// channels; 16 bits are scaled to 8.
///
/// # Errors
/// The codec's, for anything that is no whole PNG, or one with a side of more than 8192 pixels.
pub fn decode_rgb(png: &[u8]) -> Result<RgbImage, ImageError> {
    Ok(decode(png)?.into_rgb8())
}

/// Decodes a PNG whose header may lie.
pub(super) fn decode(png: &[u8]) -> Result<DynamicImage, ImageError> {
    let mut limits = Limits::default();
    limits.max_image_width = Some(SIDE_MAX);
    limits.max_image_height = Some(SIDE_MAX);
    let mut reader = ImageReader::with_format(Cursor::new(png), ImageFormat::Png);
    reader.limits(limits);
    reader.decode()
}
