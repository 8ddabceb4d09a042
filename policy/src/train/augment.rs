//! Random changes of training images and states, drawn from the run's own seed.

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
    use super::{Augmentation, images, shift};
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
