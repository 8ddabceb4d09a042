//! What lies between a scene and its picture besides the lens' geometry.
//!
//! In the order in which light meets them: smoke, condensate, blood, vignette, noise (`lens.wgsl`).
//! All are applied in linear light, before the filmic response and sRGB, which the lens pass undoes
//! on the image that it reads; only the blur by condensate and blood averages encoded values.
//! Exposure is a factor of the light in the colour pass already. Noise is a sum of random bytes
//! that is nearly normal, from a hash of pixel, seed and moment (Jarzynski and Olano, 2020).

/// What dims, veils and roughens a picture on its way through lens and sensor. Colour alone shows
/// it: ids and depth are those of the clean picture. The same numbers give the same bytes on one
/// device. [`super::Shading::Plain`] leaves it out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optics {
    /// Share of the light that is lost in the corner that is furthest from the principal point, 0
    /// to 1: at the distance `r` the factor is `1 - vignette * (r / r_corner)^2`.
    pub vignette: f64,
    /// Factor of the light that the sensor collects, above 0.
    pub exposure: f64,
    /// Standard deviation that the photons of a brightness of 1 make, of that brightness; at `b` it
    /// is `shot_noise * sqrt(b)`, from 8 on that of 8. 0 to 1000.
    pub shot_noise: f64,
    /// Standard deviation of the sensor in the dark, in the same brightness; it adds to the other
    /// in squares. 0 to 1000.
    pub read_noise: f64,
    /// Share of the light that electrosurgical smoke takes and scatters on a short way, of the way
    /// in metres, 1/m; in plumes, so from a fifth to nearly twice as much. From 0.
    pub smoke_per_m: f64,
    /// Blood on the lens: how many spots, and how large, 0 (none) to 1.
    pub blood: f64,
    /// Condensate on the lens, which blurs and veils, 0 (none) to 1.
    pub fog: f64,
    /// Chooses where spots are and how smoke, condensate and noise look.
    pub seed: u32,
    /// When the image is taken, ms: smoke drifts with it, and noise is another one in each image.
    ///
    /// It may wrap: noise does not mind; smoke starts again every 2^24 ms, 4.7 hours.
    pub moment: u32,
}

impl Optics {
    /// Neither dirt nor noise.
    pub const CLEAN: Self = Self {
        vignette: 0.0,
        exposure: 1.0,
        shot_noise: 0.0,
        read_noise: 0.0,
        smoke_per_m: 0.0,
        blood: 0.0,
        fog: 0.0,
        seed: 0,
        moment: 0,
    };

    /// Whether the picture is what it would be without them.
    ///
    /// `seed` and `moment` do not count.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        let Self { seed, moment, .. } = *self;
        *self
            == Self {
                seed,
                moment,
                ..Self::CLEAN
            }
    }

    /// Whether they take a pass of their own: exposure does not.
    pub(super) fn takes_pass(&self) -> bool {
        let exposed = Self {
            exposure: 1.0,
            ..*self
        };
        !exposed.is_clean()
    }

    /// Whether all numbers lie in their ranges.
    pub(super) fn can_be(&self) -> bool {
        let shares = [self.vignette, self.blood, self.fog];
        let amounts = [self.shot_noise, self.read_noise, self.smoke_per_m];
        shares.iter().all(|share| (0.0..=1.0).contains(share))
            && amounts.iter().all(|amount| (0.0..=1e3).contains(amount))
            && self.exposure > 0.0
            && self.exposure <= 1e3
    }
}

impl Default for Optics {
    fn default() -> Self {
        Self::CLEAN
    }
}
