//! The diffusion: how noise is added in training, and how it is taken away again in few steps
//! (DDIM).
//!
//! The network predicts the clean sample. Published schedule: squared cosine, variances of a step
//! capped at 0.999; steps of inference evenly apart and ending at 0; the noise is derived from the
//! sample before it is cut to ±1, and nothing random is added.
//!
//! With `k_t` for the product that papers write as alpha bar. Forward:
//! `x_t = sqrt(k_t) x_0 + sqrt(1 - k_t) e` (Ho et al. 2020, eq. 4). The schedule of Nichol and
//! Dhariwal 2021, `f(u) = cos^2((u + s) / (1 + s) * pi / 2)` with `s = 0.008`, gives
//! `k_t = f((t + 1) / T) / f(0)` for `t` from 0, but for the cap. Backward:
//! `e = (x_t - sqrt(k_t) x_0) / sqrt(1 - k_t)`, then `x_t' = sqrt(k_t') x_0 + sqrt(1 - k_t') e`
//! (Song et al. 2021, eq. 12 with sigma 0), the second `x_0` cut.

use core::f64::consts::FRAC_PI_2;

use tch::{Device, Kind, TchError, Tensor};

/// Cumulative products of what each step leaves of the signal's power.
#[derive(Debug)]
pub struct Diffusion {
    /// `k_t` for every training step, `(steps)`, single precision.
    kept: Tensor,
    /// The steps of inference, the noisiest first.
    steps: Vec<InferenceStep>,
}

/// One step of inference: from a noisier sample to a cleaner one.
#[derive(Clone, Copy, Debug, PartialEq)]
struct InferenceStep {
    timestep: i64,
    /// Of the signal's power, what is left at this step.
    kept: f64,
    /// What is left at the next one; all, after the last.
    kept_after: f64,
}

impl Diffusion {
    /// The published schedule of `train_steps`, walked in `inference_steps`.
    ///
    /// Inference takes the steps `0, a, 2 a, ...` with `a = train_steps / inference_steps` rounded
    /// down, backwards.
    ///
    /// # Errors
    /// The network library's.
    pub fn new(train_steps: i64, inference_steps: i64) -> Result<Self, TchError> {
        let signal = |time: f64| ((time + 0.008) / 1.008 * FRAC_PI_2).cos().powi(2);
        #[expect(clippy::cast_precision_loss, reason = "few steps")]
        let time = |step: i64| step as f64 / train_steps as f64;
        let variances: Vec<f64> = (0..train_steps)
            .map(|step| (1.0 - signal(time(step + 1)) / signal(time(step))).min(0.999))
            .collect();
        let kept = Tensor::f_from_slice(&variances)?
            .f_to_kind(Kind::Float)?
            .f_neg()?
            .f_add_scalar(1.0)?
            .f_cumprod(0, Kind::Float)?;
        let apart = train_steps / inference_steps.max(1);
        let mut steps = Vec::new();
        for timestep in (0..inference_steps).rev().map(|step| step * apart) {
            let at = |timestep| kept.f_double_value(&[timestep]);
            let before = timestep - apart;
            steps.push(InferenceStep {
                timestep,
                kept: at(timestep)?,
                kept_after: if before < 0 { 1.0 } else { at(before)? },
            });
        }
        Ok(Self { kept, steps })
    }

    /// The same for tensors on `device`.
    ///
    /// # Errors
    /// The network library's.
    pub fn on(self, device: Device) -> Result<Self, TchError> {
        Ok(Self {
            kept: self.kept.f_to_device(device)?,
            ..self
        })
    }

    /// `clean` `(batch, ..)` with `noise` as each one's `timestep` (whole numbers, `(batch)`) has
    /// it.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn add_noise(
        &self,
        clean: &Tensor,
        noise: &Tensor,
        timestep: &Tensor,
    ) -> Result<Tensor, TchError> {
        let mut shape = vec![1; clean.dim()];
        shape[0] = -1;
        let kept = self
            .kept
            .f_index_select(0, timestep)?
            .f_view(shape.as_slice())?;
        let lost = kept.f_neg()?.f_add_scalar(1.0)?;
        let signal = clean.f_mul(&kept.f_sqrt()?)?;
        signal.f_add(&noise.f_mul(&lost.f_sqrt()?)?)
    }

    /// The sample that `predict` leads to from `noise`; `predict` gets the noisy sample and the
    /// timestep, and answers with the clean one.
    ///
    /// # Errors
    /// Those of `predict`, and the network library's.
    pub fn sample(
        &self,
        noise: &Tensor,
        mut predict: impl FnMut(&Tensor, i64) -> Result<Tensor, TchError>,
    ) -> Result<Tensor, TchError> {
        let mut x = noise.shallow_clone();
        for step in &self.steps {
            let clean = predict(&x, step.timestep)?;
            let (signal, lost) = (step.kept.sqrt(), (1.0 - step.kept).sqrt());
            let noise = x.f_sub(&clean.f_mul_scalar(signal)?)?.f_div_scalar(lost)?;
            let (signal, lost) = (step.kept_after.sqrt(), (1.0 - step.kept_after).sqrt());
            let clean = clean.f_clamp(-1.0, 1.0)?;
            x = clean
                .f_mul_scalar(signal)?
                .f_add(&noise.f_mul_scalar(lost)?)?;
        }
        Ok(x)
    }

    /// The inference's timesteps, the noisiest first.
    #[must_use]
    pub fn timesteps(&self) -> Vec<i64> {
        self.steps.iter().map(|step| step.timestep).collect()
    }

    /// What is left of the signal's power at a training step.
    ///
    /// # Errors
    /// The network library's, if there is no such step.
    pub fn kept(&self, timestep: i64) -> Result<f64, TchError> {
        self.kept.f_double_value(&[timestep])
    }
}

#[cfg(test)]
mod tests {
    use super::Diffusion;
    use tch::{Kind, Tensor};

    #[test]
    fn the_schedule_is_the_published_one() {
        let diffusion = Diffusion::new(100, 10).unwrap();
        let published = [
            (90, 0.019_544_374),
            (80, 0.085_146_196),
            (70, 0.190_727_472),
            (60, 0.326_115_221),
            (50, 0.478_264_57),
            (40, 0.632_515_669),
            (30, 0.774_006_188),
            (20, 0.889_103_115),
            (10, 0.966_716_647),
            (0, 0.999_368_727),
        ];
        assert_eq!(diffusion.timesteps(), published.map(|(step, _)| step));
        for (step, kept) in published {
            let error = (diffusion.kept(step).unwrap() - kept).abs();
            assert!(error < 1e-8, "step {step}: off by {error:e}");
        }
    }

    #[test]
    fn who_knows_the_clean_sample_gets_it_back() {
        let diffusion = Diffusion::new(100, 10).unwrap();
        let clean = Tensor::from_slice(&[0.5_f32, -0.25, 1.0]).view([1, 3, 1]);
        let noise = Tensor::from_slice(&[1.5_f32, -2.0, 0.3]).view([1, 3, 1]);
        let found = diffusion.sample(&noise, |_, _| Ok(clean.copy())).unwrap();
        assert_eq!(found, clean, "the last step returns the prediction");
    }

    #[test]
    fn a_prediction_beyond_the_limits_is_cut_at_the_end() {
        let diffusion = Diffusion::new(100, 10).unwrap();
        let noise = Tensor::from_slice(&[0.3_f32]).view([1, 1, 1]);
        let beyond = Tensor::from_slice(&[7.0_f32]).view([1, 1, 1]);
        let found = diffusion.sample(&noise, |_, _| Ok(beyond.copy())).unwrap();
        assert_eq!(found, beyond.ones_like());
    }

    #[test]
    fn noise_that_was_added_is_taken_away_by_its_own_prediction() {
        // One step from the first timestep of inference: x = sqrt(kept) clean + sqrt(1 - kept)
        // noise.
        let diffusion = Diffusion::new(100, 1).unwrap();
        let clean = Tensor::from_slice(&[0.5_f32, -0.5]).view([2, 1, 1]);
        let noise = Tensor::from_slice(&[2.0_f32, -1.0]).view([2, 1, 1]);
        let timestep = Tensor::from_slice(&[50_i64, 90]);
        let noisy = diffusion.add_noise(&clean, &noise, &timestep).unwrap();
        for (index, (clean, noise, kept)) in
            [(0.5, 2.0, 0.478_264_57_f64), (-0.5, -1.0, 0.019_544_374)]
                .into_iter()
                .enumerate()
        {
            let expected = kept.sqrt() * clean + (1.0 - kept).sqrt() * noise;
            let index = i64::try_from(index).unwrap();
            assert!((noisy.double_value(&[index, 0, 0]) - expected).abs() < 1e-6);
        }
        assert_eq!(noisy.kind(), Kind::Float);
    }
}
