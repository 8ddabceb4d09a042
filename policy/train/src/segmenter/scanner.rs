//! A CT as another scanner might have given it: contrast, scale, shift, blur, noise, rings and
//! streaks.
//!
//! Amounts are drawn anew for each window, on the CPU; each tissue's contrast and the noise of each
//! voxel come from the network library's generator on the window's device.

use tch::{Device, Kind, TchError, Tensor};

use hal::random::SplitMix64;
use trocar_nets::dimension::dimension;

/// `hounsfield` `(x, y, z)` as another scanner might have given it.
pub(super) fn changed(
    hounsfield: &Tensor,
    classes: &Tensor,
    count: usize,
    random: &mut SplitMix64,
) -> Result<Tensor, TchError> {
    let options = (Kind::Float, hounsfield.device());
    // Contrast medium comes and goes: each tissue a little lighter or darker.
    let tissues =
        Tensor::f_randn([dimension(count)], options)?.f_mul_scalar(random.between(0.0, 10.0))?;
    let mut x = hounsfield.f_add(
        &tissues
            .f_index_select(0, &classes.f_view([-1])?)?
            .f_view_as(classes)?,
    )?;
    x = x
        .f_mul_scalar(random.between(0.95, 1.05))?
        .f_add_scalar(random.between(-15.0, 15.0))?;
    if random.happens(0.3) {
        x = blurred(&x, random.between(0.0, 0.25))?;
    }
    let noise = x.f_randn_like()?.f_mul_scalar(random.between(0.0, 20.0))?;
    x = x.f_add(&noise)?;
    if random.happens(0.3) {
        x = x.f_add(&artefact(&x.size(), options.1, random)?)?;
    }
    Ok(x)
}

/// `x` with `share` of each voxel from either neighbour along every axis.
fn blurred(x: &Tensor, share: f64) -> Result<Tensor, TchError> {
    let mut blurred = x.shallow_clone();
    for (dim, side) in (0..).zip(x.size()) {
        let part = |start| blurred.f_narrow(dim, start, side - 2);
        let [before, here, after] = [part(0)?, part(1)?, part(2)?];
        let both = before.f_add(&after)?.f_mul_scalar(share)?;
        let inner = here.f_mul_scalar(1.0 - 2.0 * share)?.f_add(&both)?;
        let ends = |at| blurred.f_narrow(dim, at, 1);
        blurred = Tensor::f_cat(&[ends(0)?, inner, ends(side - 1)?], dim)?;
    }
    Ok(blurred)
}

/// Rings about an axis of rotation, or streaks from a dense place, HU: `(x, y, 1)` of a window of
/// `size`.
fn artefact(size: &[i64], device: Device, random: &mut SplitMix64) -> Result<Tensor, TchError> {
    let line = |side: i64, at: f64| {
        let line = Tensor::f_arange(side, (Kind::Float, device))?;
        line.f_sub_scalar(at)
    };
    #[expect(clippy::cast_precision_loss, reason = "sides of a window")]
    let mut somewhere = |side: i64| random.between(-0.5, 1.5) * side as f64;
    let (at_x, at_y) = (somewhere(size[0]), somewhere(size[1]));
    let x = line(size[0], at_x)?.f_view([-1, 1, 1])?;
    let y = line(size[1], at_y)?.f_view([1, -1, 1])?;
    let radius = x
        .f_square()?
        .f_add(&y.f_square()?)?
        .f_sqrt()?
        .f_add_scalar(1.0)?;
    let phase = random.between(0.0, 6.3);
    let wave = if random.happens(0.5) {
        radius.f_mul_scalar(random.between(0.5, 3.0))?
    } else {
        y.f_atan2(&x)?
            .f_mul_scalar(random.between(5.0, 40.0).round())?
    };
    let fading = radius.f_mul_scalar(1.0 / 30.0)?.f_neg()?.f_exp()?;
    let height = random.between(0.0, 60.0);
    wave.f_add_scalar(phase)?
        .f_cos()?
        .f_mul(&fading)?
        .f_mul_scalar(height)
}
