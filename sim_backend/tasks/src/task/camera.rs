//! A camera of a task: where it stands and what its lens is like.

use core::f64::consts::PI;

use hal::config::{ConfigError, Source, number_text};
use hal::{Distortion, Intrinsics};
use nalgebra::Vector3;
use serde::Deserialize;
use trocar_render::Optics;

/// The camera that looks at the scene as a surgeon does.
pub const ENDOSCOPE: &str = "endoscope";

/// The camera that stands beside the scene.
pub const SIDE: &str = "side";

/// What a camera is mounted on, which is the frame that its place is given in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mount {
    /// It stands still in the scene.
    #[default]
    Scene,
    /// It goes where the instrument of [`CameraConfig::arm`] goes, all six joints. Its frame is the
    /// tip's: origin on the wrist-yaw axis, z along the closed fingers, x along their hinge, the
    /// left finger at y > 0.
    Wrist,
}

/// Greatest vertical field of view, rad.
const FOV_RAD_MAX: f64 = 0.9 * PI;

/// Least and greatest focal length over the picture's width or height: 162 and 3 degrees of view.
const FOCAL_SHARE: [f64; 2] = [0.08, 20.0];

/// What the calibration of a pinhole gives, as OpenCV and ROS' `camera_info` have it: a ray through
/// `x`, `y`, 1 in the camera frame falls on column `fx_px x + cx_px` and row `fy_px y + cy_px`,
/// counted from 0 at the centre of the first pixel, which is 0.5 less than in [`Intrinsics`].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Focal length along x, pixels.
    pub fx_px: f64,
    /// Focal length along y, pixels.
    pub fy_px: f64,
    /// Column of the principal point, pixels.
    pub cx_px: f64,
    /// Row of the principal point, pixels.
    pub cy_px: f64,
}

impl Calibration {
    /// That of the same picture with `across` and `down` times the columns and rows.
    fn scaled(self, [across, down]: [f64; 2]) -> Self {
        Self {
            fx_px: across * self.fx_px,
            fy_px: down * self.fy_px,
            cx_px: across * (self.cx_px + 0.5) - 0.5,
            cy_px: down * (self.cy_px + 0.5) - 0.5,
        }
    }
}

/// A camera.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Name, as observations and datasets call it.
    pub name: String,
    /// What it is mounted on; the scene if not given.
    #[serde(default)]
    pub mount: Mount,
    /// The arm that carries a wrist camera, counted from 0; no other camera has one.
    pub arm: Option<usize>,
    /// Whether it is the one that policies of a single camera see. Without any such camera it is
    /// the first.
    #[serde(default)]
    pub primary: bool,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Vertical field of view, rad, of square pixels around the middle. A camera has either this or
    /// a calibration.
    pub vertical_fov_rad: Option<f64>,
    /// What a calibration gives instead: `intrinsics` in the file.
    #[serde(rename = "intrinsics")]
    pub calibration: Option<Calibration>,
    /// Distortion of the lens, `k1`, `k2`, `p1`, `p2` of [`Distortion`]; none if not given. Field
    /// of view and calibration are those without.
    #[serde(default)]
    pub distortion: [f64; 4],
    /// Share of the light that the lens loses in the picture's corner, as [`Optics::vignette`] has
    /// it, 0 to 1; none if not given.
    #[serde(default)]
    pub vignette: f64,
    /// Where the lens is, in the frame of the mount, m.
    pub eye_m: [f64; 3],
    /// The point on the lens' axis, in the middle of the image unless a calibration has the
    /// principal point elsewhere; in the frame of the mount, m.
    pub target_m: [f64; 3],
    /// The direction that is up in the image, in the frame of the mount.
    pub up: [f64; 3],
}

impl CameraConfig {
    /// The lens.
    #[must_use]
    pub fn intrinsics(&self) -> Intrinsics {
        let (width, height) = (self.width, self.height);
        let fov_rad = self.vertical_fov_rad.unwrap_or(FOV_RAD_MAX);
        let mut lens = Intrinsics::from_vertical_fov(width, height, fov_rad);
        if let Some(calibration) = self.calibration {
            (lens.fx, lens.fy) = (calibration.fx_px, calibration.fy_px);
            (lens.cx, lens.cy) = (calibration.cx_px + 0.5, calibration.cy_px + 0.5);
        }
        lens.distortion = Distortion::new(self.distortion);
        lens
    }

    /// What else the lens does to pictures.
    pub(crate) const fn optics(&self) -> Optics {
        Optics {
            vignette: self.vignette,
            ..Optics::CLEAN
        }
    }

    /// Takes pictures of another size; a calibrated camera shows in them what it showed before,
    /// others keep their vertical field of view.
    pub fn resize(&mut self, width: u32, height: u32) {
        let shares = [(width, self.width), (height, self.height)]
            .map(|(now, before)| f64::from(now) / f64::from(before));
        self.calibration = self.calibration.map(|it| it.scaled(shares));
        (self.width, self.height) = (width, height);
    }

    /// The right eye beside this camera, which is the left one: `baseline_m` to its right, with the
    /// same point in the middle.
    #[must_use]
    pub fn right_eye(&self, baseline_m: f64) -> Self {
        let [eye, target, up] = [self.eye_m, self.target_m, self.up].map(Vector3::from);
        let right = (target - eye).cross(&up).normalize();
        Self {
            name: format!("{}_right", self.name),
            primary: false,
            eye_m: (eye + right * baseline_m).into(),
            ..self.clone()
        }
    }

    /// The arm that carries the camera, if one does.
    #[must_use]
    pub const fn carrier(&self) -> Option<usize> {
        match self.mount {
            Mount::Scene => None,
            Mount::Wrist => self.arm,
        }
    }

    /// Checks all cameras of a file.
    pub(super) fn check_all(
        cameras: &[Self],
        source: &Source,
        arm_count: usize,
    ) -> Result<(), ConfigError> {
        if cameras.is_empty() {
            return Err(source.out_of_range("camera", "no camera", "at least one"));
        }
        for (index, camera) in cameras.iter().enumerate() {
            camera.check(source, index)?;
            camera.check_mount(source, index, arm_count)?;
            let before = &cameras[..index];
            if before.iter().any(|other| other.name == camera.name) {
                let key = format!("camera.{index}.name");
                return Err(source.out_of_range(&key, &camera.name, "names used once"));
            }
            if camera.primary && before.iter().any(|other| other.primary) {
                let key = format!("camera.{index}.primary");
                return Err(source.out_of_range(&key, "true", "one camera"));
            }
        }
        Ok(())
    }

    fn check_mount(
        &self,
        source: &Source,
        index: usize,
        arm_count: usize,
    ) -> Result<(), ConfigError> {
        let refuse = |found: &str, allowed: &str| {
            Err(source.out_of_range(&format!("camera.{index}.arm"), found, allowed))
        };
        match (self.mount, self.arm) {
            (Mount::Scene, None) => Ok(()),
            (Mount::Scene, Some(arm)) => refuse(&arm.to_string(), "cameras with mount = \"wrist\""),
            (Mount::Wrist, Some(arm)) if arm < arm_count => Ok(()),
            (Mount::Wrist, Some(arm)) => refuse(
                &arm.to_string(),
                &format!("the task's {arm_count} arms from 0"),
            ),
            (Mount::Wrist, None) => refuse("absent", "the arm that carries the camera"),
        }
    }

    /// Either the field of view or the calibration must be there, and the principal point in the
    /// picture.
    fn check_lens(&self, source: &Source, index: usize) -> Result<(), ConfigError> {
        let key = |name: &str| format!("camera.{index}.{name}");
        let fov = key("vertical_fov_rad");
        match (self.vertical_fov_rad, self.calibration) {
            (Some(fov_rad), None) => source.check_range(&fov, fov_rad, 0.05, FOV_RAD_MAX),
            (None, Some(lens)) => {
                let [wide, high] = [self.width, self.height].map(f64::from);
                let focal = |size: f64| FOCAL_SHARE.map(|share| share * size);
                let place = |size: f64| [-0.5, size - 0.5];
                let bounds = [
                    ("fx_px", lens.fx_px, focal(wide)),
                    ("fy_px", lens.fy_px, focal(high)),
                    ("cx_px", lens.cx_px, place(wide)),
                    ("cy_px", lens.cy_px, place(high)),
                ];
                bounds
                    .into_iter()
                    .try_for_each(|(name, value, [low, high])| {
                        let key = key(&format!("intrinsics.{name}"));
                        source.check_range(&key, value, low, high)
                    })
            }
            (Some(fov_rad), Some(_)) => Err(source.refused(
                &fov,
                &number_text(fov_rad),
                "intrinsics say what the lens is like; give either",
            )),
            (None, None) => {
                Err(source.out_of_range(&fov, "absent", "a field of view, or intrinsics instead"))
            }
        }
    }

    /// The numbers must be those of a lens that shows nothing twice.
    fn check_distortion(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        for (place, value) in self.distortion.iter().enumerate() {
            source.check_range(&format!("{key}.{place}"), *value, -5.0, 5.0)?;
        }
        let lens = self.intrinsics();
        let sides = [
            (lens.width, lens.fx, lens.cx),
            (lens.height, lens.fy, lens.cy),
        ];
        // Beyond, the pinhole's image that the picture is made from, which has what it shows
        // besides, would be too large.
        let reaches = |field: [[f64; 2]; 2]| {
            let mut both = field.iter().zip(sides);
            both.all(|([low, high], (size, focal, centre))| {
                let size = f64::from(size) / focal;
                let first = -centre / focal;
                high.max(first + size) - low.min(first) < 1.9 * size
            })
        };
        if lens.field().is_some_and(reaches) {
            return Ok(());
        }
        Err(source.out_of_range(
            key,
            &format!("{:?}", self.distortion),
            "those of a lens that shows nothing twice and widens the picture's field less than 1.9 times",
        ))
    }

    /// Checks every number; `index` counts the cameras of the file from 0.
    fn check(&self, source: &Source, index: usize) -> Result<(), ConfigError> {
        let key = |name: &str| format!("camera.{index}.{name}");
        let letters = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if self.name.is_empty() || !self.name.chars().all(letters) {
            let allowed = "letters, digits and underscores";
            return Err(source.out_of_range(&key("name"), &self.name, allowed));
        }
        source.check_range(&key("width"), f64::from(self.width), 16.0, 4096.0)?;
        source.check_range(&key("height"), f64::from(self.height), 16.0, 4096.0)?;
        self.check_lens(source, index)?;
        self.check_distortion(source, &key("distortion"))?;
        source.check_range(&key("vignette"), self.vignette, 0.0, 1.0)?;
        for axis in 0..3 {
            source.check_range(&key(&format!("eye_m.{axis}")), self.eye_m[axis], -2.0, 2.0)?;
            source.check_range(
                &key(&format!("target_m.{axis}")),
                self.target_m[axis],
                -2.0,
                2.0,
            )?;
            source.check_range(&key(&format!("up.{axis}")), self.up[axis], -1.0, 1.0)?;
        }
        let view = nalgebra::Vector3::from(self.target_m) - nalgebra::Vector3::from(self.eye_m);
        let up = nalgebra::Vector3::from(self.up);
        if view.cross(&up).norm() < 1e-3 * view.norm().max(1e-3) {
            return Err(source.out_of_range(
                &key("up"),
                &format!("{:?}", self.up),
                "directions across the view",
            ));
        }
        Ok(())
    }
}
