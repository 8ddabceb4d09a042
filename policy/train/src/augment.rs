//! Random changes of training images, clouds and states, drawn from the run's own seed.
//!
//! Images draw from the step's own generator on the CPU, one draw a frame for all its cameras;
//! noise on states and points draws from the network library's generator on the device, which the
//! step seeds. With everything off, tensors pass through untouched and nothing is drawn.

use tch::{Kind, TchError, Tensor};

use super::options::Augmentation;
use hal::count::count_u32;
use hal::random::SplitMix64;

/// What is drawn for `batch` frames, for [`shifted`] and [`coloured`]: `(batch, 4)`, pixels down
/// and right, and the changes of brightness and contrast. On the CPU.
#[expect(
    clippy::cast_possible_truncation,
    reason = "networks compute in single precision"
)]
pub(super) fn drawn(
    batch: usize,
    options: &Augmentation,
    random: &mut SplitMix64,
) -> Result<Tensor, TchError> {
    let mut drawn = vec![[0.0_f32; 4]; batch];
    if options.shift_px > 0 {
        let most = f64::from(options.shift_px);
        for row in &mut drawn {
            for pixels in &mut row[..2] {
                *pixels = (most - span(random, options.shift_px)) as f32;
            }
        }
    }
    if options.brightness > 0.0 || options.contrast > 0.0 {
        for (column, range) in [(2, options.brightness), (3, options.contrast)] {
            for row in &mut drawn {
                row[column] = (range * random.signed_unit()) as f32;
            }
        }
    }
    Tensor::f_from_slice(drawn.as_flattened())?.f_view([-1, 4])
}

/// `images` `(batch, cameras, height, width, channels)`, each frame moved by its own draw, its
/// edges repeated. Works on bytes, by index, so a shifted pixel is exactly the recorded one.
pub(super) fn shifted(
    images: Tensor,
    options: &Augmentation,
    drawn: &Tensor,
) -> Result<Tensor, TchError> {
    let size = images.size();
    let &[batch, cameras, high, wide, channels] = size.as_slice() else {
        return Err(TchError::Shape(format!("images of shape {size:?}")));
    };
    if options.shift_px == 0 {
        return Ok(images);
    }
    let rows = sources(drawn, 0, high)?
        .f_mul_scalar(wide)?
        .f_unsqueeze(-1)?;
    let pixels = rows
        .f_add(&sources(drawn, 1, wide)?.f_unsqueeze(1)?)?
        .f_view([batch, 1, high * wide, 1])?
        .f_expand([batch, cameras, high * wide, channels], false)?;
    images
        .f_view([batch, cameras, high * wide, channels])?
        .f_gather(2, &pixels, false)?
        .f_view(size.as_slice())
}

/// Where the pixels along a side of `side` pixels come from, by the `column` of what was drawn:
/// `(batch, side)`.
fn sources(drawn: &Tensor, column: i64, side: i64) -> Result<Tensor, TchError> {
    let place = Tensor::f_arange(side, (Kind::Int64, drawn.device()))?;
    let moved = drawn.f_narrow(1, column, 1)?.f_to_kind(Kind::Int64)?;
    place.f_sub(&moved)?.f_clamp(0, side - 1)
}

/// `images` `(batch, cameras, 3, height, width)`, normalised, each frame with its own draw's
/// brightness and contrast.
///
/// `(x - mean) (1 + contrast) + mean + 4 brightness`, the mean over all of a frame's images.
pub(super) fn coloured(
    images: Tensor,
    options: &Augmentation,
    drawn: &Tensor,
) -> Result<Tensor, TchError> {
    if options.brightness <= 0.0 && options.contrast <= 0.0 {
        return Ok(images);
    }
    let column = |index| drawn.f_narrow(1, index, 1)?.f_view([-1, 1, 1, 1, 1]);
    let (brightness, contrast) = (column(2)?, column(3)?);
    let mean = images.f_mean_dim([1, 2, 3, 4].as_slice(), true, Kind::Float)?;
    // A normalised image spans about four units, so a share of one unit times four is a share of
    // the range.
    let stretched = images
        .f_sub(&mean)?
        .f_mul(&contrast.f_add_scalar(1.0)?)?
        .f_add(&mean)?;
    stretched.f_add(&brightness.f_mul_scalar(4.0)?)
}

/// `state` with the noise that the options ask for.
pub(super) fn state(state: Tensor, options: &Augmentation) -> Result<Tensor, TchError> {
    if options.state_noise > 0.0 {
        state.f_add(&state.f_randn_like()?.f_mul_scalar(options.state_noise)?)
    } else {
        Ok(state)
    }
}

/// `points` `(.., points, 3)` with the noise that the options ask for; `metre` is what a metre is
/// in their units, one for each coordinate. Of hidden points the first of the cloud takes the
/// place, if `may_hide`.
pub(super) fn points(
    points: Tensor,
    options: &Augmentation,
    metre: Option<&Tensor>,
    may_hide: bool,
) -> Result<Tensor, TchError> {
    let mut points = points;
    if options.point_noise_m > 0.0 {
        let noise = points.f_randn_like()?.f_mul_scalar(options.point_noise_m)?;
        let noise = match metre {
            Some(metre) => noise.f_mul(metre)?,
            None => noise,
        };
        points = points.f_add(&noise)?;
    }
    if may_hide && options.point_dropout > 0.0 {
        points = partly_hidden(&points, options.point_dropout)?;
    }
    Ok(points)
}

/// `points` `(.., points, 3)`, of which this share is replaced by the first of its cloud.
fn partly_hidden(points: &Tensor, share: f64) -> Result<Tensor, TchError> {
    let size = points.size();
    let [clouds @ .., _] = size.as_slice() else {
        return Err(TchError::Shape(format!("points of shape {size:?}")));
    };
    let hidden = Tensor::f_rand(clouds, (Kind::Float, points.device()))?
        .f_lt(share)?
        .f_unsqueeze(-1)?;
    let first = points.f_narrow(-2, 0, 1)?;
    first.f_where_self(&hidden, points)
}

/// A whole number from 0 to twice `reach`.
fn span(random: &mut SplitMix64, reach: u32) -> f64 {
    f64::from(count_u32(random.below(2 * reach as usize + 1)))
}

#[cfg(test)]
mod tests {
    use super::{Augmentation, coloured, drawn, points, shifted};
    use hal::random::SplitMix64;
    use tch::{Kind, Tensor};
    use trocar_nets::generator;

    #[test]
    fn a_shift_moves_each_frame_s_pixels_and_repeats_edges() {
        let frame = Tensor::arange(18, (Kind::Float, tch::Device::Cpu)).view([2, 1, 3, 3, 1]);
        let draws = Tensor::from_slice(&[1.0_f32, 0.0, 0.0, 0.0, 0.0, -2.0, 0.0, 0.0]);
        let options = Augmentation {
            shift_px: 2,
            ..Augmentation::default()
        };
        let moved = shifted(frame, &options, &draws.view([2, 4])).unwrap();
        assert_eq!(moved.size(), [2, 1, 3, 3, 1]);
        let down = [0.0, 1.0, 2.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
        let left = [11.0, 11.0, 11.0, 14.0, 14.0, 14.0, 17.0, 17.0, 17.0];
        assert_eq!(
            Vec::<f32>::try_from(moved.flatten(0, -1)).unwrap(),
            [down, left].as_flattened()
        );
    }

    #[test]
    fn draws_are_whole_pixels_and_shares_within_their_ranges() {
        let options = Augmentation {
            shift_px: 3,
            brightness: 0.2,
            contrast: 0.1,
            ..Augmentation::default()
        };
        let drawn = drawn(500, &options, &mut SplitMix64::new(4)).unwrap();
        let drawn = Vec::<f32>::try_from(drawn.view([-1])).unwrap();
        let (rows, _) = drawn.as_chunks::<4>();
        let pixels = rows.iter().flat_map(|row| [row[0], row[1]]);
        let found: std::collections::BTreeSet<String> =
            pixels.map(|pixels| pixels.to_string()).collect();
        let all: std::collections::BTreeSet<String> =
            (-3..=3).map(|pixels: i8| pixels.to_string()).collect();
        assert_eq!(found, all);
        for (column, range) in [(2, 0.2), (3, 0.1)] {
            let most = rows.iter().map(|row| row[column].abs()).fold(0.0, f32::max);
            assert!((0.9 * range..=range).contains(&most), "{most} of {range}");
        }
    }

    #[test]
    fn points_are_moved_by_the_noise_and_hidden_ones_are_the_first() {
        let _drawing = generator::seeded(1);
        let clouds = Tensor::arange(2 * 500 * 3, (Kind::Float, tch::Device::Cpu)).view([2, 500, 3]);
        let noisy = Augmentation {
            point_noise_m: 0.5,
            ..Augmentation::default()
        };
        let metre = Tensor::from_slice(&[1.0_f32, 0.0, 2.0]);
        let moved = points(clouds.shallow_clone(), &noisy, Some(&metre), true).unwrap();
        let moved = (&moved - &clouds).std_dim([0, 1].as_slice(), true, false);
        let moved = Vec::<f32>::try_from(moved).unwrap();
        assert!(
            (moved[0] - 0.5).abs() < 0.1 && moved[1].to_bits() == 0 && (moved[2] - 1.0).abs() < 0.2,
            "{moved:?}"
        );
        let hiding = Augmentation {
            point_dropout: 0.3,
            ..Augmentation::default()
        };
        let shown = points(clouds.shallow_clone(), &hiding, None, true).unwrap();
        let same = shown.eq_tensor(&clouds).all_dim(-1, false);
        let first = shown.eq_tensor(&clouds.narrow(1, 0, 1)).all_dim(-1, false);
        assert!(bool::try_from(same.logical_or(&first).all()).unwrap());
        let kept = same
            .to_kind(Kind::Float)
            .mean(Kind::Float)
            .double_value(&[]);
        assert!((kept - 0.7).abs() < 0.06, "{kept}");
        assert_eq!(
            points(clouds.shallow_clone(), &hiding, None, false).unwrap(),
            clouds
        );
        assert_eq!(
            points(clouds.shallow_clone(), &Augmentation::default(), None, true).unwrap(),
            clouds
        );
    }

    #[test]
    fn without_options_nothing_changes() {
        let frame = Tensor::ones([2, 1, 4, 4, 3], (Kind::Float, tch::Device::Cpu));
        let none = Augmentation::default();
        let drawn = drawn(2, &none, &mut SplitMix64::new(1)).unwrap();
        assert_eq!(
            drawn,
            Tensor::zeros([2, 4], (Kind::Float, tch::Device::Cpu))
        );
        let same = shifted(frame.shallow_clone(), &none, &drawn).unwrap();
        assert_eq!(coloured(same, &none, &drawn).unwrap(), frame);
    }
}
