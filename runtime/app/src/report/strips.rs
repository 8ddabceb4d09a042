//! Film strips of trials, from the animations that `eval --keep` left. What can't be read has no
//! strip: a report does not fail for it.

use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::{Path, PathBuf};

use image::codecs::gif::GifDecoder;
use image::imageops::{self, FilterType};
use image::{AnimationDecoder, ImageFormat, RgbImage, RgbaImage};

use super::load::{Evaluation, Trial};

/// Moments of a strip.
const MOMENTS: usize = 6;

/// Width of one, pixels.
const WIDTH: u32 = 150;

/// Frames of an animation that are looked at; no episode has more.
const FRAMES_MAX: usize = 20_000;

/// The log of `trial`, if it is there.
#[must_use]
pub(super) fn log_of(evaluation: &Evaluation, trial: &Trial) -> Option<PathBuf> {
    kept(evaluation, trial, trial.log.as_deref(), "mcap")
}

/// A strip of evenly spaced moments of `trial`, the last one its end, as PNG; none if its animation
/// was not kept.
#[must_use]
pub(super) fn strip_of(evaluation: &Evaluation, trial: &Trial) -> Option<Vec<u8>> {
    let path = kept(evaluation, trial, trial.pictures.as_deref(), "gif")?;
    strip(&read(&path)?)
}

/// A file of `trial`: by its name, or what the result calls it, in the folder of what was kept.
/// Logs and animations may have been moved with their cell's folder, so that the path in the result
/// counts for its last part alone.
fn kept(
    evaluation: &Evaluation,
    trial: &Trial,
    named: Option<&Path>,
    kind: &str,
) -> Option<PathBuf> {
    let folder = evaluation.made.folder.join("kept");
    let names = [
        named
            .and_then(Path::file_name)
            .map(|name| folder.join(name)),
        Some(folder.join(format!("seed-{}.{kind}", trial.seed))),
        Some(folder.join(format!("{}.{kind}", trial.seed))),
    ];
    names.into_iter().flatten().find(|path| path.is_file())
}

/// Scaled down as they are decoded, since a whole animation in full size would fill the memory; a
/// damaged one has the frames before the damage.
fn read(path: &Path) -> Option<Vec<RgbaImage>> {
    let decoder = GifDecoder::new(BufReader::new(File::open(path).ok()?)).ok()?;
    let frames = decoder.into_frames().take(FRAMES_MAX);
    let frames: Vec<RgbaImage> = frames
        .map_while(Result::ok)
        .map(|frame| {
            let full = frame.into_buffer();
            let height = WIDTH * full.height() / full.width().max(1);
            imageops::resize(&full, WIDTH, height.max(1), FilterType::Triangle)
        })
        .collect();
    (!frames.is_empty()).then_some(frames)
}

/// Up to `MOMENTS` frames side by side, the first and the last among them.
fn strip(frames: &[RgbaImage]) -> Option<Vec<u8>> {
    let (width, height) = frames.first()?.dimensions();
    let moments = MOMENTS.min(frames.len());
    let mut sheet = RgbImage::new(width * u32::try_from(moments).ok()?, height);
    for moment in 0..moments {
        let frame = frames.get(moment * (frames.len() - 1) / (moments - 1).max(1))?;
        let colours = image::DynamicImage::ImageRgba8(frame.clone()).to_rgb8();
        let x = i64::from(width) * i64::try_from(moment).ok()?;
        imageops::replace(&mut sheet, &colours, x, 0);
    }
    let mut png = Cursor::new(Vec::new());
    sheet.write_to(&mut png, ImageFormat::Png).ok()?;
    Some(png.into_inner())
}

#[cfg(test)]
mod tests {
    use image::Rgba;

    use super::*;

    #[test]
    fn a_strip_goes_from_the_first_frame_to_the_last() {
        let frames: Vec<RgbaImage> = (0..100_u8)
            .map(|grey| RgbaImage::from_pixel(10, 4, Rgba([grey, 0, 0, 255])))
            .collect();
        let png = strip(&frames).unwrap();
        let picture = image::load_from_memory(&png).unwrap().to_rgb8();
        assert_eq!(picture.dimensions(), (60, 4));
        let reds: Vec<u8> = (0..6)
            .map(|moment| picture.get_pixel(10 * moment + 5, 2).0[0])
            .collect();
        assert_eq!(reds, [0, 19, 39, 59, 79, 99]);
        assert!(strip(&[]).is_none());
    }
}
