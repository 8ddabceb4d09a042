//! A camera of a task: where it stands and what its lens is like.

use core::f64::consts::PI;

use hal::config::{ConfigError, Source};
use hal::{Distortion, Intrinsics};
use nalgebra::Vector3;
use serde::Deserialize;

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
    /// It goes where the instrument of [`CameraConfig::arm`] goes, all six joints. Its frame is the tip's: origin on the
    /// wrist-yaw axis, z along the closed fingers, x along their hinge, the left finger at y > 0.
    Wrist,
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
    /// Whether it is the one that policies of a single camera see. Without any such camera it is the first.
    #[serde(default)]
    pub primary: bool,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Vertical field of view, rad.
    pub vertical_fov_rad: f64,
    /// Distortion of the lens, `k1`, `k2`, `p1`, `p2` of [`Distortion`]; none if not given. The field of view is the one without.
    #[serde(default)]
    pub distortion: [f64; 4],
    /// Where the lens is, in the frame of the mount, m.
    pub eye_m: [f64; 3],
    /// The point in the middle of the image, in the frame of the mount, m.
    pub target_m: [f64; 3],
    /// The direction that is up in the image, in the frame of the mount.
    pub up: [f64; 3],
}

impl CameraConfig {
    /// The lens.
    #[must_use]
    pub fn intrinsics(&self) -> Intrinsics {
        Intrinsics {
            distortion: Distortion::new(self.distortion),
            ..Intrinsics::from_vertical_fov(self.width, self.height, self.vertical_fov_rad)
        }
    }

    /// The right eye beside this camera, which is the left one: `baseline_m` to its right, with the same point in the middle.
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

    /// The numbers must be those of a lens that shows nothing twice.
    fn check_distortion(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        for (place, value) in self.distortion.iter().enumerate() {
            source.check_range(&format!("{key}.{place}"), *value, -5.0, 5.0)?;
        }
        let half = |size: u32, focal: f64| 0.5 * f64::from(size) / focal;
        let lens = self.intrinsics();
        // Beyond, the pinhole's image that the picture is made from would be too large.
        let most = [
            2.0 * half(lens.width, lens.fx),
            2.0 * half(lens.height, lens.fy),
        ];
        let reaches = |field: [[f64; 2]; 2]| {
            let mut sides = field.iter().zip(most);
            sides.all(|([low, high], most)| high - low < 1.9 * most)
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
        source.check_range(
            &key("vertical_fov_rad"),
            self.vertical_fov_rad,
            0.05,
            0.9 * PI,
        )?;
        self.check_distortion(source, &key("distortion"))?;
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
