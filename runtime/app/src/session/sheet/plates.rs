//! A frame as pictures for people: colour as it is, depth and ids in colours.

use core::ops::RangeInclusive;

use hal::CameraFrame;
use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};
use trocar_tasks::task;

/// Colours from near to far: yellow, green, blue, violet. Every fifth of the colour map viridis.
const NEAR_TO_FAR: [[f32; 3]; 6] = [
    [253.0, 231.0, 37.0],
    [122.0, 209.0, 81.0],
    [34.0, 168.0, 132.0],
    [42.0, 120.0, 142.0],
    [65.0, 68.0, 135.0],
    [68.0, 1.0, 84.0],
];

/// What nothing was seen of.
const NOTHING: Rgb<u8> = Rgb([0; 3]);

/// The three pictures of one frame, all of one size.
pub(super) struct Plates {
    /// As the camera saw it.
    pub(super) colour: RgbImage,
    /// Near is bright, far is dark; black where nothing was hit.
    pub(super) depth: RgbImage,
    /// A colour an id.
    pub(super) ids: RgbImage,
    /// Nearest and furthest depth, mm; none if nothing was hit.
    pub(super) range_mm: Option<RangeInclusive<u32>>,
}

impl Plates {
    /// The pictures of `frame`, `width` pixels wide.
    pub(super) fn new(frame: &CameraFrame, width: u32) -> Self {
        let (wide, high) = (frame.intrinsics.width, frame.intrinsics.height);
        let height = (width * high / wide.max(1)).max(1);
        let hits = || frame.depth_m.iter().copied().filter(|depth| *depth > 0.0);
        let (near, far) = (hits().fold(f32::MAX, f32::min), hits().fold(0.0, f32::max));
        let depths = frame.depth_m.iter().map(|&depth| {
            let share = (depth - near) / (far - near).max(f32::MIN_POSITIVE);
            if depth > 0.0 { shade(share) } else { NOTHING }
        });
        let ids = frame.instance.iter().map(|&id| id_colour(id));
        // Ids must not be mixed, nor depths across an edge.
        let shrunk = |image: &RgbImage, filter| imageops::resize(image, width, height, filter);
        let colour = RgbImage::from_raw(wide, high, frame.colour.clone()).unwrap_or_default();
        Self {
            colour: shrunk(&colour, FilterType::Triangle),
            depth: shrunk(&painted(wide, high, depths), FilterType::Nearest),
            ids: shrunk(&painted(wide, high, ids), FilterType::Nearest),
            range_mm: (far > 0.0).then(|| millimetres(near)..=millimetres(far)),
        }
    }
}

fn painted(width: u32, height: u32, colours: impl Iterator<Item = Rgb<u8>>) -> RgbImage {
    let bytes = colours.flat_map(|Rgb(bytes)| bytes).collect();
    RgbImage::from_raw(width, height, bytes).unwrap_or_default()
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a depth is positive and below the far plane"
)]
fn millimetres(depth_m: f32) -> u32 {
    (1e3 * depth_m).round() as u32
}

/// The colour at `share` of the way from near to far.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "both numbers are clamped to their range"
)]
fn shade(share: f32) -> Rgb<u8> {
    let place = share.clamp(0.0, 1.0) * 5.0;
    let from = (place as usize).min(4);
    let rest = place - place.floor().min(4.0);
    let ([low, high], mut mixed) = ([NEAR_TO_FAR[from], NEAR_TO_FAR[from + 1]], [0; 3]);
    for (mixed, (low, high)) in mixed.iter_mut().zip(low.into_iter().zip(high)) {
        *mixed = (low + (high - low) * rest).clamp(0.0, 255.0) as u8;
    }
    Rgb(mixed)
}

/// A colour for an instance id, black for the background. Ids that no part has get hues a golden
/// section apart.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the numbers are clamped to their range"
)]
pub(super) fn id_colour(id: u8) -> Rgb<u8> {
    const GOLDEN: f32 = 0.618_034;
    if id == 0 {
        return NOTHING;
    }
    if let Some(part) = task::parts().find(|part| part.instance == id) {
        return Rgb(part.colour);
    }
    let hue = (GOLDEN * f32::from(id)).fract();
    // The hue circle, a third of it for each primary.
    let primaries = [0.0, 2.0 / 3.0, 1.0 / 3.0];
    Rgb(primaries.map(|offset| {
        let away = ((hue + offset).fract() * 6.0 - 3.0).abs() - 1.0;
        (200.0 * (0.25 + 0.75 * away.clamp(0.0, 1.0))).clamp(0.0, 255.0) as u8
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::Intrinsics;
    use trocar_render::visual::instance;

    /// How far two colours are apart: the sum over red, green and blue.
    fn apart(one: [u8; 3], two: [u8; 3]) -> u32 {
        let parts = one.into_iter().zip(two);
        parts.map(|(a, b)| u32::from(a.abs_diff(b))).sum()
    }

    #[test]
    fn near_is_bright_and_far_is_dark_and_nothing_is_black() {
        let mut frame = CameraFrame::blank(Intrinsics::from_vertical_fov(4, 1, 0.9));
        frame.depth_m.copy_from_slice(&[0.05, 0.10, 0.15, 0.0]);
        let plates = Plates::new(&frame, 4);
        assert_eq!(plates.range_mm, Some(50..=150));
        let brightness = |x| {
            plates
                .depth
                .get_pixel(x, 0)
                .0
                .map(u32::from)
                .iter()
                .sum::<u32>()
        };
        assert!(brightness(0) > brightness(1) && brightness(1) > brightness(2));
        assert_eq!(*plates.depth.get_pixel(3, 0), NOTHING);
        let empty = CameraFrame::blank(Intrinsics::from_vertical_fov(4, 1, 0.9));
        assert_eq!(Plates::new(&empty, 4).range_mm, None);
    }

    #[test]
    fn ids_that_tasks_use_have_colours_far_apart() {
        for id in 1..=15 {
            for other in 0..id {
                let (Rgb(one), Rgb(two)) = (id_colour(id), id_colour(other));
                let off = apart(one, two);
                assert!(off > 60, "{id} {other}: {one:?} {two:?}");
            }
        }
    }

    #[test]
    fn flap_and_mark_can_be_told_from_all_that_is_around_them() {
        for id in [instance::TISSUE, instance::MARK] {
            for other in [
                0,
                instance::ORGAN,
                instance::SHAFT,
                instance::WRIST,
                instance::JAW,
            ] {
                let off = apart(id_colour(id).0, id_colour(other).0);
                assert!(off > 200, "{id} {other}: {off}");
            }
        }
        let [flap, mark] = [instance::TISSUE, instance::MARK].map(|id| id_colour(id).0);
        assert!(apart(flap, mark) > 200);
    }
}
