//! Letters of five by seven dots: enough for the labels of a sheet.

use hal::count::count_u32;
use image::{Rgb, RgbImage};

/// Width of a letter with the gap after it, dots.
const ADVANCE: u32 = 6;

/// Height of a letter, dots.
const HEIGHT: u32 = 7;

/// The letters, each row from the left in the five lowest bits.
#[rustfmt::skip]
const LETTERS: [(u8, [u8; 7]); 40] = [
    (b'a', [0b00000, 0b00000, 0b01110, 0b00001, 0b01111, 0b10001, 0b01111]),
    (b'b', [0b10000, 0b10000, 0b10110, 0b11001, 0b10001, 0b10001, 0b11110]),
    (b'c', [0b00000, 0b00000, 0b01110, 0b10000, 0b10000, 0b10001, 0b01110]),
    (b'd', [0b00001, 0b00001, 0b01101, 0b10011, 0b10001, 0b10001, 0b01111]),
    (b'e', [0b00000, 0b00000, 0b01110, 0b10001, 0b11111, 0b10000, 0b01110]),
    (b'f', [0b00110, 0b01001, 0b01000, 0b11100, 0b01000, 0b01000, 0b01000]),
    (b'g', [0b00000, 0b01111, 0b10001, 0b10001, 0b01111, 0b00001, 0b01110]),
    (b'h', [0b10000, 0b10000, 0b10110, 0b11001, 0b10001, 0b10001, 0b10001]),
    (b'i', [0b00100, 0b00000, 0b01100, 0b00100, 0b00100, 0b00100, 0b01110]),
    (b'j', [0b00010, 0b00000, 0b00110, 0b00010, 0b00010, 0b10010, 0b01100]),
    (b'k', [0b10000, 0b10000, 0b10010, 0b10100, 0b11000, 0b10100, 0b10010]),
    (b'l', [0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    (b'm', [0b00000, 0b00000, 0b11010, 0b10101, 0b10101, 0b10001, 0b10001]),
    (b'n', [0b00000, 0b00000, 0b10110, 0b11001, 0b10001, 0b10001, 0b10001]),
    (b'o', [0b00000, 0b00000, 0b01110, 0b10001, 0b10001, 0b10001, 0b01110]),
    (b'p', [0b00000, 0b00000, 0b11110, 0b10001, 0b11110, 0b10000, 0b10000]),
    (b'q', [0b00000, 0b00000, 0b01101, 0b10011, 0b01111, 0b00001, 0b00001]),
    (b'r', [0b00000, 0b00000, 0b10110, 0b11001, 0b10000, 0b10000, 0b10000]),
    (b's', [0b00000, 0b00000, 0b01110, 0b10000, 0b01110, 0b00001, 0b11110]),
    (b't', [0b01000, 0b01000, 0b11100, 0b01000, 0b01000, 0b01001, 0b00110]),
    (b'u', [0b00000, 0b00000, 0b10001, 0b10001, 0b10001, 0b10011, 0b01101]),
    (b'v', [0b00000, 0b00000, 0b10001, 0b10001, 0b10001, 0b01010, 0b00100]),
    (b'w', [0b00000, 0b00000, 0b10001, 0b10001, 0b10101, 0b10101, 0b01010]),
    (b'x', [0b00000, 0b00000, 0b10001, 0b01010, 0b00100, 0b01010, 0b10001]),
    (b'y', [0b00000, 0b00000, 0b10001, 0b10001, 0b01111, 0b00001, 0b01110]),
    (b'z', [0b00000, 0b00000, 0b11111, 0b00010, 0b00100, 0b01000, 0b11111]),
    (b'0', [0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110]),
    (b'1', [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    (b'2', [0b01110, 0b10001, 0b00001, 0b00010, 0b00100, 0b01000, 0b11111]),
    (b'3', [0b11111, 0b00010, 0b00100, 0b00010, 0b00001, 0b10001, 0b01110]),
    (b'4', [0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010]),
    (b'5', [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110]),
    (b'6', [0b00110, 0b01000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110]),
    (b'7', [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000]),
    (b'8', [0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110]),
    (b'9', [0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00010, 0b01100]),
    (b'-', [0b00000, 0b00000, 0b00000, 0b11111, 0b00000, 0b00000, 0b00000]),
    (b'_', [0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b11111]),
    (b'.', [0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b01100, 0b01100]),
    (b' ', [0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b00000]),
];

/// A box for what has no letter.
const UNKNOWN: [u8; 7] = [
    0b11111, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b11111,
];

/// Width of `text` with dots of `dot` pixels, pixels.
#[must_use]
pub(super) fn width(text: &str, dot: u32) -> u32 {
    let letters = count_u32(text.len());
    letters * ADVANCE * dot
}

/// Height of a line with dots of `dot` pixels, pixels.
#[must_use]
pub(super) const fn height(dot: u32) -> u32 {
    HEIGHT * dot
}

/// Writes `text` with its upper left corner at `(x, y)`; what lies beside the image is cut off.
pub(super) fn write(image: &mut RgbImage, text: &str, [x, y]: [u32; 2], dot: u32, colour: Rgb<u8>) {
    for (place, letter) in (0_u32..).zip(text.bytes()) {
        let known = LETTERS.iter().find(|(name, _)| *name == letter);
        let rows = known.map_or(UNKNOWN, |(_, rows)| *rows);
        for (row, bits) in (0_u32..).zip(rows) {
            for column in (0..5_u32).filter(|column| bits >> (4 - column) & 1 == 1) {
                let left = x + (place * ADVANCE + column) * dot;
                fill(image, [left, y + row * dot], [dot, dot], colour);
            }
        }
    }
}

/// Fills a rectangle; what lies beside the image is cut off.
pub(super) fn fill(
    image: &mut RgbImage,
    [x, y]: [u32; 2],
    [width, height]: [u32; 2],
    colour: Rgb<u8>,
) {
    for row in y..(y + height).min(image.height()) {
        for column in x..(x + width).min(image.width()) {
            image.put_pixel(column, row, colour);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHITE: Rgb<u8> = Rgb([255; 3]);

    #[test]
    fn letters_differ_and_a_strange_one_is_a_box() {
        let picture = |text: &str| {
            let mut image = RgbImage::new(width(text, 2), height(2));
            write(&mut image, text, [0, 0], 2, WHITE);
            image
        };
        for (index, (letter, _)) in LETTERS.iter().enumerate() {
            for (other, _) in &LETTERS[..index] {
                let [one, two] = [letter, other].map(|name| (*name as char).to_string());
                assert_ne!(picture(&one), picture(&two), "{one} {two}");
            }
        }
        assert_eq!(picture("#"), picture("?"));
        assert_ne!(picture("#"), picture(" "));
    }

    #[test]
    fn what_does_not_fit_is_cut_off() {
        let mut image = RgbImage::new(8, 16);
        write(&mut image, "needle", [3, 1], 3, WHITE);
        write(&mut image, "needle", [30, 40], 3, WHITE);
        assert!(image.pixels().any(|pixel| *pixel == WHITE));
    }
}
