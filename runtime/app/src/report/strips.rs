//! Film strips of trials, from the animations that `eval --keep` left. What can't be read has no
//! strip: a report does not fail for it.

use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::{Path, PathBuf};

use image::codecs::gif::GifDecoder;
use image::imageops::{self, FilterType};
use image::{AnimationDecoder, Frame, ImageDecoder, ImageFormat, Limits, RgbImage, RgbaImage};

use super::load::{Evaluation, Trial};

/// Moments of a strip.
const MOMENTS: usize = 6;

/// Width of one, pixels.
const WIDTH: u32 = 150;

/// Height of one at most, pixels: that of a damaged animation may be anything.
const HEIGHT_MAX: u32 = 4 * WIDTH;

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

/// The frames of an animation, in full size; a damaged one has the frames before the damage.
fn frames(path: &Path) -> Option<impl Iterator<Item = RgbaImage>> {
    let mut decoder = GifDecoder::new(BufReader::new(File::open(path).ok()?)).ok()?;
    decoder.set_limits(Limits::default()).ok()?;
    let frames = decoder.into_frames().take(FRAMES_MAX);
    Some(frames.map_while(Result::ok).map(Frame::into_buffer))
}

/// The frames of the strip, scaled down. The animation is decoded twice, first to count its frames:
/// all of them in full size would fill the memory, and scaling takes longer than decoding.
fn read(path: &Path) -> Option<Vec<RgbaImage>> {
    let wanted = moments(frames(path)?.count());
    let kept = frames(path)?.enumerate();
    let kept = kept.filter(|(index, _)| wanted.contains(index));
    Some(kept.map(|(_, frame)| scaled(&frame)).collect())
}

/// Which of `count` frames are in the strip: up to `MOMENTS`, evenly spaced, the first and the last
/// among them.
fn moments(count: usize) -> Vec<usize> {
    let moments = MOMENTS.min(count);
    let last = count.saturating_sub(1);
    (0..moments)
        .map(|moment| moment * last / (moments - 1).max(1))
        .collect()
}

fn scaled(full: &RgbaImage) -> RgbaImage {
    let height = WIDTH * full.height() / full.width().max(1);
    imageops::resize(
        full,
        WIDTH,
        height.clamp(1, HEIGHT_MAX),
        FilterType::Triangle,
    )
}

/// The frames side by side.
fn strip(frames: &[RgbaImage]) -> Option<Vec<u8>> {
    let (width, height) = frames.first()?.dimensions();
    let mut sheet = RgbImage::new(width * u32::try_from(frames.len()).ok()?, height);
    for (place, frame) in frames.iter().enumerate() {
        let colours = image::DynamicImage::ImageRgba8(frame.clone()).to_rgb8();
        let x = i64::from(width) * i64::try_from(place).ok()?;
        imageops::replace(&mut sheet, &colours, x, 0);
    }
    let mut png = Cursor::new(Vec::new());
    sheet.write_to(&mut png, ImageFormat::Png).ok()?;
    Some(png.into_inner())
}

#[cfg(test)]
mod tests {
    use image::Rgba;
    use image::codecs::gif::GifEncoder;

    use super::*;

    fn grey(value: u8) -> RgbaImage {
        RgbaImage::from_pixel(300, 8, Rgba([value, value, value, 255]))
    }

    /// An animation of so many frames, each of which is brighter than the one before.
    fn animation(name: &str, count: u8) -> PathBuf {
        let path = std::env::temp_dir().join(format!("trocar-{name}-{}.gif", std::process::id()));
        let mut encoder = GifEncoder::new(File::create(&path).unwrap());
        let frames = (0..count).map(|value| Frame::new(grey(value)));
        encoder.encode_frames(frames).unwrap();
        path
    }

    #[test]
    fn a_strip_goes_from_the_first_frame_to_the_last() {
        let path = animation("strip", 100);
        let kept = read(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let png = strip(&kept).unwrap();
        let picture = image::load_from_memory(&png).unwrap().to_rgb8();
        assert_eq!(picture.dimensions(), (6 * WIDTH, 4));
        let greys: Vec<u8> = (0..6)
            .map(|moment| picture.get_pixel(WIDTH * moment + 5, 2).0[0])
            .collect();
        assert_eq!(greys, [0, 19, 39, 59, 79, 99]);
        assert!(strip(&[]).is_none());
    }

    /// The header says 65535 x 65535 pixels, which are 17 GB a frame.
    #[test]
    fn an_animation_of_an_absurd_size_has_no_strip() {
        let path = animation("absurd-strip", 2);
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[6..10].fill(0xff);
        std::fs::write(&path, bytes).unwrap();
        let kept = read(&path).unwrap_or_default();
        std::fs::remove_file(&path).unwrap();
        assert!(strip(&kept).is_none());
    }

    #[test]
    fn a_short_animation_has_each_frame_once() {
        assert_eq!(moments(0), [0_usize; 0]);
        assert_eq!(moments(1), [0]);
        assert_eq!(moments(3), [0, 1, 2]);
        assert_eq!(moments(7), [0, 1, 2, 3, 4, 6]);
    }
}
