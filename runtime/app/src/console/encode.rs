//! Pictures as bytes: colour and depth as JPEG, ids as PNG, since their edges are what counts.

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _};

use super::drawn::{Drawn, Pixels, Stream};
use hal::TimeNs;

/// Bytes before the image: camera, plane, two that are 0, a count of 4 that is 0, and seconds as a
/// double, little endian.
pub(super) const HEAD: usize = 16;

/// JPEG quality, 1 to 100.
const QUALITY: u8 = 82;

/// Near to far: stops of a colour map that also tells by lightness alone. sRGB, from 0 to 255; five
/// stops of viridis, turned round.
const DEPTH: [[f32; 3]; 5] = [
    [253.0, 231.0, 37.0],
    [94.0, 201.0, 98.0],
    [33.0, 145.0, 140.0],
    [59.0, 82.0, 139.0],
    [68.0, 1.0, 84.0],
];

/// The message for pages, if the pixels fill an image. None if they don't, or if it can't be
/// encoded.
pub(super) fn message(drawn: &Drawn) -> Option<Vec<u8>> {
    let (width, height) = (drawn.width, drawn.height);
    let mut bytes = head(drawn.stream, drawn.stamp);
    let count = (width as usize).checked_mul(height as usize)?;
    let done = match &drawn.pixels {
        Pixels::Colour(colour) if colour.len() == 3 * count => {
            jpeg(&mut bytes, colour, width, height)
        }
        Pixels::Depth(depth_m) if depth_m.len() == count => {
            jpeg(&mut bytes, &depth_colours(depth_m), width, height)
        }
        Pixels::Ids(ids) if ids.len() == count => png(&mut bytes, &id_colours(ids), width, height),
        Pixels::Colour(_) | Pixels::Depth(_) | Pixels::Ids(_) => return None,
    };
    done.ok().map(|()| bytes)
}

/// What stands before an image.
pub(super) fn head(stream: Stream, stamp: TimeNs) -> Vec<u8> {
    let mut bytes = vec![0; HEAD];
    bytes[0] = stream.camera;
    bytes[1] = stream.plane as u8;
    bytes[8..].copy_from_slice(&stamp.seconds().to_le_bytes());
    bytes
}

/// Appends the image behind the head.
fn jpeg(to: &mut Vec<u8>, rgb: &[u8], width: u32, height: u32) -> image::ImageResult<()> {
    JpegEncoder::new_with_quality(to, QUALITY).write_image(
        rgb,
        width,
        height,
        ExtendedColorType::Rgb8,
    )
}

/// Appends the image; fast rather than small.
fn png(to: &mut Vec<u8>, rgb: &[u8], width: u32, height: u32) -> image::ImageResult<()> {
    PngEncoder::new_with_quality(to, CompressionType::Fast, FilterType::Up).write_image(
        rgb,
        width,
        height,
        ExtendedColorType::Rgb8,
    )
}

/// Depths between the nearest and the farthest of the image; black where nothing was hit. Each
/// image has its own scale, so that colours of two can't be compared.
fn depth_colours(depth_m: &[f32]) -> Vec<u8> {
    let hit = || {
        depth_m
            .iter()
            .copied()
            .filter(|d| *d > 0.0 && d.is_finite())
    };
    let (near, far) = (hit().fold(f32::MAX, f32::min), hit().fold(0.0, f32::max));
    let span = (far - near).max(1e-6);
    let colour = |d: &f32| {
        if *d > 0.0 && d.is_finite() {
            between((d - near) / span)
        } else {
            [0; 3]
        }
    };
    depth_m.iter().flat_map(colour).collect()
}

/// The colour at `share` of the way from near to far.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "a share of a few stops, and colours from 0 to 255"
)]
fn between(share: f32) -> [u8; 3] {
    let last = DEPTH.len() - 1;
    let at = share.clamp(0.0, 1.0) * last as f32;
    let from = (at as usize).min(last - 1);
    let part = at - from as f32;
    std::array::from_fn(|i| {
        let (a, b) = (DEPTH[from][i], DEPTH[from + 1][i]);
        (a + (b - a) * part).round() as u8
    })
}

/// A colour for each id, neighbours far apart; black for nothing.
fn id_colours(ids: &[u8]) -> Vec<u8> {
    ids.iter().flat_map(|id| id_colour(*id)).collect()
}

/// Hues are steps of the golden ratio; even and odd ids differ in brightness too.
fn id_colour(id: u8) -> [u8; 3] {
    if id == 0 {
        return [0; 3];
    }
    // Steps of the golden ratio around the circle of hues.
    let hue = f32::from(id.wrapping_mul(158)) / 256.0 * 6.0;
    let value = if id.is_multiple_of(2) { 235.0 } else { 180.0 };
    std::array::from_fn(|i| {
        let shift = [0.0, 4.0, 2.0][i];
        let distance = ((hue + shift) % 6.0 - 3.0).abs() - 1.0;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a colour from 0 to 255"
        )]
        let level = (value * (0.25 + 0.75 * distance.clamp(0.0, 1.0))) as u8;
        level
    })
}

#[cfg(test)]
mod tests {
    use super::super::drawn::Plane;
    use super::*;

    fn drawn(plane: Plane, pixels: Pixels) -> Drawn {
        Drawn {
            stream: Stream { camera: 2, plane },
            stamp: TimeNs(1_500_000_000),
            width: 16,
            height: 8,
            pixels,
        }
    }

    #[test]
    fn each_plane_becomes_an_image() {
        let ramp: Vec<f32> = (0_u8..128).map(|i| f32::from(i) * 1e-3).collect();
        for (plane, pixels) in [
            (Plane::Colour, Pixels::Colour(vec![90; 3 * 128])),
            (Plane::Depth, Pixels::Depth(ramp)),
            (Plane::Ids, Pixels::Ids((0..128).collect())),
        ] {
            let message = message(&drawn(plane, pixels)).unwrap();
            assert_eq!((message[0], message[1]), (2, plane as u8));
            let seconds = f64::from_le_bytes(message[8..HEAD].try_into().unwrap());
            assert_eq!(seconds.to_bits(), 1.5_f64.to_bits());
            let image = image::load_from_memory(&message[HEAD..]).unwrap();
            assert_eq!((image.width(), image.height()), (16, 8));
        }
        let short = drawn(Plane::Colour, Pixels::Colour(vec![90; 128]));
        assert_eq!(message(&short), None);
    }

    #[test]
    fn near_is_light_and_nothing_is_black() {
        let colours = depth_colours(&[0.0, 0.1, 0.2, f32::NAN]);
        assert_eq!(colours[..3], [0; 3]);
        assert_eq!(colours[3..6], [253, 231, 37]);
        assert_eq!(colours[6..9], [68, 1, 84]);
        assert_eq!(colours[9..], [0; 3]);
    }

    #[test]
    fn ids_have_different_colours() {
        let colours: std::collections::BTreeSet<_> = (0..24).map(id_colour).collect();
        assert_eq!(colours.len(), 24);
        assert_eq!(id_colour(0), [0; 3]);
    }
}
