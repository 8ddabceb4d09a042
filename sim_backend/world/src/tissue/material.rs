//! What the sheet is made of.

use hal::config::{ConfigError, Source};
use serde::Deserialize;

/// An isotropic elastic sheet with inner damping.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Thickness, m.
    pub thickness_m: f64,
    /// Young's modulus at small strain, Pa. Stretching stiffens the sheet as it does skin (Saint
    /// Venant-Kirchhoff).
    pub young_pa: f64,
    /// Poisson ratio.
    pub poisson: f64,
    /// Density, kg/m³.
    pub density_kg_m3: f64,
    /// Inner damping (Kelvin-Voigt): viscosity over stiffness, s; strain lags stress by it.
    pub relaxation_s: f64,
    /// Damping by what surrounds the sheet: the share of its momentum that it loses in a second,
    /// 1/s.
    pub drag_per_s: f64,
    /// Stretch (0.5 is half as long again) at which the tissue counts as torn and its stress grows
    /// no further.
    pub tear_strain: f64,
}

impl Material {
    /// Checks the ranges of a material read from `source` at the dotted `key`.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`].
    pub fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        let check = |name: &str, value, low, high| {
            source.check_range(&format!("{key}.{name}"), value, low, high)
        };
        check("thickness_m", self.thickness_m, 0.0005, 0.02)?;
        check("young_pa", self.young_pa, 1e3, 2e6)?;
        check("poisson", self.poisson, 0.0, 0.499)?;
        check("density_kg_m3", self.density_kg_m3, 500.0, 2000.0)?;
        check("relaxation_s", self.relaxation_s, 0.0, 1e-3)?;
        check("drag_per_s", self.drag_per_s, 0.0, 100.0)?;
        check("tear_strain", self.tear_strain, 0.05, 2.0)
    }

    /// Mass of a square metre, kg/m².
    #[must_use]
    pub fn mass_kg_m2(&self) -> f64 {
        self.density_kg_m3 * self.thickness_m
    }

    /// Plane-stress stiffness `E t / (1 - nu²)`, N/m.
    #[must_use]
    pub fn stretch_n_m(&self) -> f64 {
        self.young_pa * self.thickness_m / (1.0 - self.poisson * self.poisson)
    }

    /// Shear stiffness `E t / (2 (1 + nu))`, N/m.
    #[must_use]
    pub fn shear_n_m(&self) -> f64 {
        self.young_pa * self.thickness_m / (2.0 * (1.0 + self.poisson))
    }

    /// Plate stiffness `E t³ / (12 (1 - nu²))`, N m.
    #[must_use]
    pub fn bend_n_m(&self) -> f64 {
        self.stretch_n_m() * self.thickness_m * self.thickness_m / 12.0
    }

    /// The Green strain at [`Self::tear_strain`].
    pub(super) fn tear_green(&self) -> f64 {
        self.tear_strain * (1.0 + 0.5 * self.tear_strain)
    }
}
