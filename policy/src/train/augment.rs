//! Random changes of training images, clouds and states, drawn from the run's own seed.

use tch::{Kind, TchError, Tensor};

use super::options::Augmentation;
use crate::rng::SplitMix64;

/// `images` `(batch, cameras, 3, height, width)`, normalised, each frame changed by its own draw.
pub(super) fn images(
    images: Tensor,
    options: &Augmentation,
    random: &mut SplitMix64,
) -> Result<Tensor, TchError> {
    let batch = images.size()[0];
    let mut images = images;
    if options.shift_px > 0 {
        let mut shifted = Vec::new();
        for index in 0..batch {
            let [down, right] =
                [0, 1].map(|_| i64::from(options.shift_px) - span(random, options.shift_px));
            shifted.push(shift(
                &images.f_select(0, index)?,
                i64::from(options.shift_px),
                down,
                right,
            )?);
        }
        images = Tensor::f_stack(&shifted, 0)?;
    }
    if options.brightness > 0.0 || options.contrast > 0.0 {
        let mut draw = |range: f64| -> Result<Tensor, TchError> {
            let draws: Vec<f64> = (0..batch).map(|_| range * random.signed_unit()).collect();
            let column = Tensor::f_from_slice(&draws)?
                .f_to_kind(Kind::Float)?
                .f_to_device(images.device())?;
            column.f_view([batch, 1, 1, 1, 1])
        };
        let (brightness, contrast) = (draw(options.brightness)?, draw(options.contrast)?);
        let mean = images.f_mean_dim([1, 2, 3, 4].as_slice(), true, Kind::Float)?;
        // A normalised image spans about four units, so a share of one unit times four is a share of the range.
        let stretched = images
            .f_sub(&mean)?
            .f_mul(&contrast.f_add_scalar(1.0)?)?
            .f_add(&mean)?;
        images = stretched.f_add(&brightness.f_mul_scalar(4.0)?)?;
    }
    Ok(images)
}

/// `state` with the noise that the options ask for.
pub(super) fn state(state: Tensor, options: &Augmentation) -> Result<Tensor, TchError> {
    if options.state_noise > 0.0 {
        state.f_add(&state.f_randn_like()?.f_mul_scalar(options.state_noise)?)
    } else {
        Ok(state)
    }
}

/// `points` `(.., points, 3)` with the noise that the options ask for; `metre` is what a metre is in their units, one for each
/// coordinate. Of hidden points the first of the cloud takes the place, if `may_hide`.
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
        let size = points.size();
        let [clouds @ .., _] = size.as_slice() else {
            return Err(TchError::Shape(format!("points of shape {size:?}")));
        };
        let hidden = Tensor::f_rand(clouds, (Kind::Float, points.device()))?
            .f_lt(options.point_dropout)?
            .f_unsqueeze(-1)?;
        let first = points.f_narrow(-2, 0, 1)?;
        points = first.f_where_self(&hidden, &points)?;
    }
    Ok(points)
}

fn span(random: &mut SplitMix64, reach: u32) -> i64 {
    i64::try_from(random.below(2 * reach as usize + 1)).unwrap_or(0)
}

/// One frame `(cameras, 3, height, width)` moved by up to `reach` pixels, its edges repeated.
fn shift(frame: &Tensor, reach: i64, down: i64, right: i64) -> Result<Tensor, TchError> {
    let size = frame.size();
    let padded = frame.f_replication_pad2d([reach; 4])?;
    padded
        .f_narrow(2, reach - down, size[2])?
        .f_narrow(3, reach - right, size[3])
}

#[cfg(test)]
mod tests {
    use super::super::generator;
    use super::{Augmentation, images, points, shift};
    use crate::rng::SplitMix64;
    use tch::{Kind, Tensor};

    #[test]
    fn a_shift_moves_pixels_and_repeats_edges() {
        let frame = Tensor::arange(9, (Kind::Float, tch::Device::Cpu)).view([1, 1, 3, 3]);
        let moved = shift(&frame, 1, 1, 0).unwrap();
        let expected = [0.0, 1.0, 2.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
        assert_eq!(
            Vec::<f32>::try_from(moved.flatten(0, -1)).unwrap(),
            expected
        );
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
        let frame = Tensor::ones([2, 1, 3, 4, 4], (Kind::Float, tch::Device::Cpu));
        let same = images(
            frame.shallow_clone(),
            &Augmentation::default(),
            &mut SplitMix64::new(1),
        )
        .unwrap();
        assert_eq!(same, frame);
    }
}
