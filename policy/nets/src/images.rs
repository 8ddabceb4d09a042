//! Colour images on their way into a network: shrinking by a whole factor with the area's average.

/// Why an image could not be used.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// Its size is no whole multiple of the wanted one.
    #[error("image of {width}x{height} is no whole multiple of {wanted_width}x{wanted_height}")]
    NoMultiple {
        /// Width of the image, pixels.
        width: u32,
        /// Height of the image, pixels.
        height: u32,
        /// Wanted width, pixels.
        wanted_width: u32,
        /// Wanted height, pixels.
        wanted_height: u32,
    },
}

/// By what whole factor an image of `width` x `height` shrinks to the wanted size, the same in both
/// directions.
///
/// # Errors
/// [`ImageError::NoMultiple`] if there is none.
pub const fn shrink_factor(
    width: u32,
    height: u32,
    wanted_width: u32,
    wanted_height: u32,
) -> Result<u32, ImageError> {
    let fits = wanted_width > 0 && wanted_height > 0 && width >= wanted_width;
    if fits && width.is_multiple_of(wanted_width) {
        let factor = width / wanted_width;
        if height == factor * wanted_height {
            return Ok(factor);
        }
    }
    Err(ImageError::NoMultiple {
        width,
        height,
        wanted_width,
        wanted_height,
    })
}

/// `bytes` (3 a pixel, rows of `width` pixels) shrunk by `factor`: every block averaged and rounded
/// to nearest.
///
/// Sums in `u32`, rounded half up: the same bytes in training and at run time, on every machine.
#[must_use]
pub fn area_average(bytes: &[u8], width: u32, factor: u32) -> Vec<u8> {
    if factor <= 1 {
        return bytes.to_vec();
    }
    let side = factor as usize;
    let row_bytes = 3 * width as usize;
    let columns = width as usize / side;
    let area = factor * factor;
    let mut sums = vec![0_u32; 3 * columns];
    let mut shrunk = Vec::with_capacity(bytes.len() / (side * side));
    for rows in bytes.chunks_exact(row_bytes * side) {
        sums.fill(0);
        for row in rows.chunks_exact(row_bytes) {
            add_row(&mut sums, row, side);
        }
        #[expect(
            clippy::cast_possible_truncation,
            reason = "an average of bytes is a byte"
        )]
        shrunk.extend(sums.iter().map(|sum| ((sum + area / 2) / area) as u8));
    }
    shrunk
}

/// Adds the pixels of a row to the sums of their blocks, `side` pixels wide.
fn add_row(sums: &mut [u32], row: &[u8], side: usize) {
    for (sum, block) in sums.chunks_exact_mut(3).zip(row.chunks_exact(3 * side)) {
        for pixel in block.chunks_exact(3) {
            sum[0] += u32::from(pixel[0]);
            sum[1] += u32::from(pixel[1]);
            sum[2] += u32::from(pixel[2]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{area_average, shrink_factor};

    #[test]
    fn blocks_are_averaged_by_channel_and_rounded() {
        // Two rows of four pixels; red counts up, green is even, blue is 255 in one pixel of the
        // left block.
        let rows = [
            [[0, 8, 255], [1, 8, 0], [2, 8, 0], [3, 8, 0]],
            [[4, 8, 0], [5, 8, 0], [6, 8, 0], [7, 8, 0]],
        ];
        let bytes: Vec<u8> = rows.as_flattened().as_flattened().to_vec();
        assert_eq!(area_average(&bytes, 4, 2), [3, 8, 64, 5, 8, 0]);
    }

    #[test]
    fn only_whole_factors_are_accepted() {
        assert_eq!(shrink_factor(512, 512, 256, 256).unwrap(), 2);
        assert_eq!(shrink_factor(256, 256, 256, 256).unwrap(), 1);
        assert!(shrink_factor(512, 512, 200, 200).is_err());
        assert!(shrink_factor(512, 256, 256, 256).is_err());
        assert!(shrink_factor(128, 128, 256, 256).is_err());
    }
}
